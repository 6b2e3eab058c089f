"""The view on real terminals: what is seen, what is written, and what is left behind."""

import re
import signal
import subprocess
import sys
from typing import Any

import pytest

from tests.watch.terminals import ROOT, SCRIPTED, VCU_GATEWAY, WAIT_S, terminal, window

COLOUR = re.compile(r"\x1b\[(?:[0-9;:]*[;:])?(?:[34][0-9]|9[0-7]|10[0-7])(?:[;:][0-9;:]*)?m")
# tmux itself goes back to the terminal's own colours after bold and dim.
NO_MATTER = re.compile(r"\x1b\[[34]9m")
LEFT = rb"\x1b\[\?1049l.*\x1b\[\?25h"


@pytest.mark.timeout(600)  # twenty things to wait for
def test_in_a_window_it_shows_scrolls_resizes_and_leaves_the_terminal_as_it_was():
    with window(80, 24) as shell:
        before = shell.settings()
        shell.type(f"clear; {SCRIPTED}; echo exit=$?")
        shell.until(r"^ ACTIVE  drive: nothing limits it")
        screen = shell.until(r"1-8/74$")
        assert len(screen.splitlines()) == 24
        assert screen.startswith("vcu-gateway  can0 (socketcan) up")
        assert shell.fact("alternate_on") == "1"

        shell.press("End")
        shell.until(r"67-74/74$")
        shell.press("Home", "m")
        shell.until(r"^only ARD2_SteeringWheel")
        shell.press("Escape")
        shell.until(r"1-8/74$")
        shell.press("Space")
        shell.until("PAUSED")
        shell.press("p", "/", "S", "O", "C", "Enter")
        shell.until(r"^only SOC")
        shell.press("Escape")
        shell.until("SteeringAngle")
        shell.press("e")
        shell.until("Shift-E yes")
        shell.press("E")
        shell.until("emergency stop granted")
        shell.press("?")
        shell.until("emergency stop: cuts the power")
        shell.press("h")

        shell.resize(120, 40)
        screen = shell.until(r"1-21/38$")
        assert len(screen.splitlines()) == 40
        assert "protection" in screen
        shell.resize(80, 24)
        shell.until(r"1-8/74$")

        shell.press("q")
        screen = shell.until(r"^exit=0")
        assert "ACTIVE" not in screen
        assert shell.fact("alternate_on") == "0"
        assert shell.fact("cursor_flag") == "1"
        assert shell.settings() == before


def test_in_a_window_there_are_colours_but_with_no_color_there_is_none():
    with window() as shell:
        for variable, wanted in (("NO_COLOR=", True), ("NO_COLOR=1", False)):
            shell.type(f"clear; {variable} {SCRIPTED} faulty; echo exit=$?")
            shell.until(r"^ FAULT  stopped")
            shell.until(r"throttle % +0\.0 +40\.2! +0\.0 +40\.2$")
            shell.until(r"\? help")
            escapes = NO_MATTER.sub("", shell.screen_with_escapes)
            assert bool(COLOUR.search(escapes)) is wanted
            shell.press("q")
            shell.until(r"^exit=0")


@pytest.mark.ci
def test_with_no_color_not_one_byte_of_colour_is_written():
    with terminal(f"{SCRIPTED} faulty", {"NO_COLOR": "1"}) as view:
        view.until(rb"\? help")
        for keys in (b"e", b"\x1b", b"/", b"x\r", b"\x1b", b"?", b"?", b" ", b"q"):
            view.press(keys)
            view.read(0.3)
        assert view.ended() == 0
        assert not COLOUR.search(view.output.decode())
    with terminal(f"{SCRIPTED} faulty") as view:
        view.until(rb"\? help")
        assert COLOUR.search(view.output.decode())


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_ends_it_in_order(number):
    with terminal(SCRIPTED) as view:
        view.until(rb"\? help")
        assert not view.is_as_before
        view.process.send_signal(number)
        assert view.ended() == 0
        assert view.is_as_before
        assert re.search(LEFT, view.output, re.DOTALL)
        assert b"Traceback" not in view.output


@pytest.mark.parametrize("keys", [b"q", b"\x03"])
def test_a_key_ends_it_in_order(keys):
    with terminal(SCRIPTED) as view:
        view.until(rb"\? help")
        view.press(keys)
        assert view.ended() == 0
        assert view.is_as_before
        assert re.search(LEFT, view.output, re.DOTALL)


@pytest.mark.ci
@pytest.mark.parametrize("is_told", [True, False])
def test_it_ends_with_the_terminal_told_by_the_kernel_or_not(is_told):
    with terminal(f"{SCRIPTED} driving moving", controls=is_told) as view:
        view.until(rb"\? help")
        view.hang_up()
        assert view.process.wait(WAIT_S) == 0


def test_it_ends_on_a_signal_though_the_terminal_takes_nothing_any_more():
    with terminal(f"{SCRIPTED} driving moving") as view:
        view.until(rb"\? help")
        view.stop_output()
        view.process.send_signal(signal.SIGTERM)
        assert view.process.wait(WAIT_S) == 0
        assert view.is_as_before


def test_a_gateway_that_is_not_there_is_waited_for(tmp_path):
    with terminal(f"{VCU_GATEWAY} watch --socket {tmp_path}/none") as view:
        view.until(rb"NOT REACHABLE")
        view.press(b"eE")
        view.until(rb"not granted")
        view.press(b"q")
        assert view.ended() == 0
        assert b"Traceback" not in view.output


def vcu(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "vcu_gateway", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=90, cwd=ROOT, **options)


def test_without_a_terminal_it_says_what_to_do_instead():
    done = vcu("watch")
    assert done.returncode == 69
    assert "needs a terminal" in done.stderr
    assert "vcu-gateway status" in done.stderr


def test_a_dumb_terminal_is_none():
    with terminal(f"{VCU_GATEWAY} watch", {"TERM": "dumb"}) as view:
        assert view.ended() == 69
        assert b"needs a terminal" in view.output


@pytest.mark.parametrize("verb", ["watch", "demo"])
@pytest.mark.parametrize("missing", ["textual", "rich"])
def test_without_the_extra_it_says_how_to_install_it(verb, missing):
    code = f"import sys; sys.modules[{missing!r}] = None; import vcu_gateway.cli as c; c.main()"
    done = subprocess.run(
        [sys.executable, "-c", code, verb], capture_output=True, text=True, timeout=90, cwd=ROOT
    )
    assert done.returncode == 69, done.stderr
    assert "pip install 'vcu-gateway[tui]'" in done.stderr
    assert "Traceback" not in done.stderr
