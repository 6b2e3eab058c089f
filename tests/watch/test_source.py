"""The view's source: it asks a gateway again and again, and lives on when that goes away."""

import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.watch import view_models
from vcu_gateway.client import ClientError
from vcu_gateway.watch import source as source_module
from vcu_gateway.watch.source import GatewaySource, ViewModel

WAIT_S = 60.0


class Gateway:
    """Answers each line of each connection as the API does, until it is closed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.view = view_models.driving()
        self.requests: list[str] = []
        self.error: dict[str, object] | None = None
        self.older = False
        self._connections: list[socket.socket] = []
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self.path.unlink()
        for one in (self._listener, *self._connections):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self._connections.append(connection)
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError, ValueError):
            for line in connection.makefile("rb"):
                request = json.loads(line)
                self.requests.append(request["method"])
                answer = {"jsonrpc": "2.0", "id": request["id"], **self._answer(request["method"])}
                connection.sendall(json.dumps(answer).encode() + b"\n")

    def _answer(self, method: str) -> dict[str, object]:
        if self.error is not None:
            return {"error": self.error}
        view = self.view
        if method == "tuning.get" and self.older:
            return {"error": {"code": -32601, "message": "there is no method tuning.get"}}
        results = {"state.get": view.state, "why": view.why, "health": view.health}
        results |= {"tuning.get": view.tuning}
        return {"result": results.get(method, {"granted": True, "mode": "standby"})}


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "s"


@contextlib.contextmanager
def gateway(path: Path) -> Iterator[Gateway]:
    made = Gateway(path)
    try:
        yield made
    finally:
        with contextlib.suppress(OSError):
            made.close()


def seen(source: GatewaySource, wanted: Callable[[ViewModel], object]) -> ViewModel:
    """The first view like this, however slow this machine is."""
    end_s = time.monotonic() + WAIT_S
    while time.monotonic() < end_s:
        view = source.latest()
        if wanted(view):
            return view
        time.sleep(0.01)
    raise AssertionError(f"not seen, but {source.latest().problem}")


def test_state_why_and_health_are_what_the_gateway_says(path):
    with gateway(path) as made, GatewaySource(path) as source:
        assert seen(source, lambda view: view.state) == made.view


def test_an_older_gateway_without_tuning_is_shown_without_it(path):
    with gateway(path) as made:
        made.older = True
        with GatewaySource(path) as source:
            view = seen(source, lambda view: view.state)
    assert (view.tuning, view.problem) == (None, None)


def test_new_values_arrive(path):
    with gateway(path) as made, GatewaySource(path) as source:
        seen(source, lambda view: view.state)
        made.view.state["monotonic_ns"] = 1
        made.view.health["frames"]["sent"] = 2
        view = seen(source, lambda view: view.state["monotonic_ns"] == 1)
        assert view.problem is None
        seen(source, lambda view: view.health["frames"]["sent"] == 2)


def test_a_new_mode_is_explained_at_once(path, monkeypatch):
    monkeypatch.setattr(source_module, "_REST_PERIOD_S", 3600)
    with gateway(path) as made, GatewaySource(path) as source:
        seen(source, lambda view: view.state)
        made.view = view_models.faulty()
        view = seen(source, lambda view: view.state["mode"] == "fault")
        assert view.why["mode"] == "fault"


def test_the_state_is_asked_for_more_often_than_the_rest(path, monkeypatch):
    monkeypatch.setattr(source_module, "_REST_PERIOD_S", 3600)
    with gateway(path) as made, GatewaySource(path) as source:
        seen(source, lambda _: made.requests.count("state.get") >= 3)
    assert made.requests.count("why") == made.requests.count("health") == 1


def test_a_gateway_that_is_not_there_yet_is_waited_for(path):
    with GatewaySource(path) as source:
        before = seen(source, lambda view: view.problem)
        assert before.state is None
        assert str(path) in before.problem.sentence
        with gateway(path):
            assert seen(source, lambda view: view.state).problem is None


def test_a_gateway_that_goes_away_is_told_with_the_time_and_found_again(path):
    with GatewaySource(path) as source:
        with gateway(path):
            seen(source, lambda view: view.state)
        first = seen(source, lambda view: view.problem)
        assert first.state is not None
        later = seen(source, lambda view: view is not first)
        assert later.problem.since == first.problem.since
        with gateway(path):
            assert seen(source, lambda view: view.problem is None).state is not None


def test_an_error_of_the_gateway_is_a_problem_and_passes(path, monkeypatch):
    monkeypatch.setattr(source_module, "_REST_PERIOD_S", 3600)
    with gateway(path) as made, GatewaySource(path) as source:
        seen(source, lambda view: view.state)
        made.error = {"code": -32004, "message": "the gateway is ending", "data": {}}
        assert seen(source, lambda view: view.problem).problem.sentence.endswith("is ending")
        made.error = None
        seen(source, lambda view: view.problem is None)


def test_a_gateway_of_another_version_is_a_problem_and_no_traceback(path):
    with gateway(path) as made, GatewaySource(path) as source:
        seen(source, lambda view: view.state)
        made.view.state["mode"] = "flying"  # type: ignore[typeddict-item]
        assert "another version" in seen(source, lambda view: view.problem).problem.sentence
        made.view = view_models.driving()
        del made.view.why["waits"]  # type: ignore[misc]
        seen(source, lambda view: view.problem and "Why" in view.problem.sentence)


@pytest.mark.parametrize("what", ["estop", "disarm"])
def test_stopping_goes_to_the_gateway(path, what):
    with gateway(path) as made:
        GatewaySource(path).request(what)
        assert made.requests == [what]


@pytest.mark.parametrize("what", ["estop", "disarm"])
def test_a_refusal_and_a_missing_gateway_are_told_alike(path, what):
    with gateway(path) as made:
        made.error = {"code": -32002, "message": "the mode is standby", "data": {}}
        with pytest.raises(ClientError, match="the mode is standby"):
            GatewaySource(path).request(what)
    with pytest.raises(ClientError, match="no socket"):
        GatewaySource(path).request(what)
