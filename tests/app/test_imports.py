"""What a gateway's process has imported after its first ticks, and how it starts."""

import json
import subprocess
import sys
from importlib.metadata import version
from typing import Any

import pytest

from vcu_gateway.protocol import packaged

# Libraries, of the standard library what loads OpenSSL, and parts of the program.
UNWANTED = {
    *("cantools", "bitstruct", "textparser", "rich", "pygments", "textual", "better_exceptions"),
    *("twisted", "greenlet", "asammdf", "numpy", "pandas", "wrapt", "msgpack", "prometheus_client"),
    *("ssl", "_ssl", "_hashlib", "argparse", "unittest", "difflib", "http", "xml"),
    *("asyncio", "importlib.metadata", "email", "zipfile", "yaml._yaml"),
    *(
        f"vcu_gateway.{name}"
        for name in (
            *("client", "demo", "doctor", "exporter", "simulator", "watch"),
            *("protocol.cantools_dbc", "protocol.definition", "recording.candump"),
            *("recording.check", "recording.log", "recording.reader", "recording.segment"),
        )
    ),
}
PROGRAM = """
import json, sys
from vcu_gateway.cli import main

sys.argv = ["vcu-gateway", "run", "--config", sys.argv[1], "--duration", "0.3"]
main()
print(json.dumps(sorted(sys.modules)))
"""


def run(tmp_path, more: str = "", program: str = PROGRAM) -> Any:
    """What the program prints after a gateway has run in its process."""
    config = tmp_path / "gateway.yaml"
    config.write_text(
        "bus: {interface: virtual, channel: start}\n"
        f"api: {{socket_path: {tmp_path}/control.sock}}\n{more}"
    )
    command = [sys.executable, "-c", program, str(config)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert '"api_open"' in done.stderr
    return json.loads(done.stdout)


def test_a_running_gateway_has_imported_nothing_that_it_does_not_need(tmp_path):
    modules = set(run(tmp_path))
    assert {"vcu_gateway.daemon.loop", "can", "structlog", "pydantic"} <= modules
    assert modules & UNWANTED == set()


def test_a_dbc_of_ones_own_is_read_by_cantools(tmp_path):
    text = packaged("vcu.dbc").read_text(encoding="utf-8")
    (tmp_path / "own.dbc").write_text(f"{text}\n", encoding="utf-8")
    modules = set(run(tmp_path, "protocol: {dbc: own.dbc}\n"))
    assert {"cantools", "vcu_gateway.protocol.cantools_dbc"} <= modules


def test_a_plugin_of_pydantic_that_is_merely_installed_is_not_run(tmp_path):
    (tmp_path / "stowaway.py").write_text("plugin = None\n")
    described = tmp_path / "stowaway-1.dist-info"
    described.mkdir()
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: stowaway\nVersion: 1\n")
    (described / "entry_points.txt").write_text("[pydantic]\nstowaway = stowaway:plugin\n")
    assert "stowaway" not in run(tmp_path)


COLLECTED = """
import gc, json, sys
began = []
gc.callbacks.append(lambda phase, info: began.append(phase))
from vcu_gateway import cli
from vcu_gateway.daemon.loop import TickLoop
imported = len(began)  # here, by this program
run, frozen = TickLoop._run, []

def counted(self, duration_s):
    frozen.append((len(began), gc.get_freeze_count(), gc.isenabled()))
    run(self, duration_s)

TickLoop._run = counted
sys.argv = ["vcu-gateway", "run", "--config", sys.argv[1], "--duration", "0.3"]
cli.main()
during = len(began)
((before, objects, enabled),) = frozen
print(json.dumps([before - imported, objects, enabled, during - before, gc.collect()]))
"""


def test_a_start_collects_no_garbage_and_leaves_hardly_any(tmp_path):
    at_start, objects, enabled, while_ticking, garbage = run(tmp_path, program=COLLECTED)
    assert (at_start, enabled, while_ticking) == (0, False, 0)
    assert objects > 20_000
    assert garbage < objects / 10


def test_other_verbs_collect_garbage():
    program = (
        "import gc, sys; from vcu_gateway import cli; sys.argv[1:] = ['version']; cli.main();"
        "print(gc.isenabled())"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "True", done.stderr


def said_by(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize("name", ["ssl", "_hashlib", "rich", "wrapt"])
def test_what_was_hidden_can_be_imported_afterwards(name):
    program = (
        "from vcu_gateway.lean_imports import hidden; import vcu_gateway.daemon.log;"
        "import vcu_gateway.python_can, sys, importlib, importlib.util;"
        f"assert {name!r} not in sys.modules; importlib.util.find_spec({name!r}) is None"
        f" or importlib.import_module({name!r})"
    )
    said_by(program)


def test_a_module_that_was_put_off_is_imported_where_something_of_it_is_asked():
    program = (
        "import vcu_gateway.daemon.log, sys; from vcu_gateway.python_can import can\n"
        "assert 'asyncio' not in sys.modules\n"
        "assert can.AsyncBufferedReader().buffer.empty()\n"
        "import asyncio; assert can.listener.asyncio.Queue is asyncio.Queue\n"
        "asyncio.run(asyncio.sleep(0))"
    )
    said_by(program)


def test_the_version_of_python_can_is_what_its_metadata_say():
    program = (
        "from vcu_gateway import python_can; import sys\n"
        "assert 'importlib.metadata' not in sys.modules; print(python_can.VERSION)"
    )
    assert said_by(program) == version("python-can")


def test_a_module_that_was_imported_before_is_not_hidden():
    program = (
        "import ssl, sys; from vcu_gateway.lean_imports import hidden\n"
        "with hidden('ssl', 'absent'): import ssl as again\n"
        "assert again is ssl is sys.modules['ssl'] and 'absent' not in sys.modules"
    )
    said_by(program)
