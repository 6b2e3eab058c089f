"""Libraries: none but the program's own; break one thing, and install asammdf."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.doctor.judged import not_ok, only, well
from tests.export_libraries import PATIENCE_S, export_folder, with_export_libraries
from vcu_gateway.doctor import libraries
from vcu_gateway.doctor.check_result import Unreadable
from vcu_gateway.doctor.libraries import ForeignLibrary, ImportCost, LibraryFacts

__all__ = ["export_folder"]

FACTS = LibraryFacts(None, {})
OWN = "nothing but its own libraries delays the gateway's start"


def test_a_gateway_with_its_own_libraries_is_one_line():
    assert well(libraries.judge(FACTS)) == OWN
    assert not_ok(libraries.judge(FACTS)) == {}


def test_asammdf_beside_the_gateway_is_warned_of_with_what_it_costs_other_programs():
    found = only(libraries.judge(FACTS._replace(asammdf=ImportCost(309.6, 100.5))))
    assert (found.check, found.kind.value) == ("asammdf", "warning")
    assert found.what == (
        "asammdf stands beside the gateway, which keeps it out of its own process; in every other "
        "program it makes `import can` 310 ms longer and 100 MB larger"
    )
    assert found.remedy.startswith("pip uninstall asammdf; vcu-gateway[mf4] belongs into a")


@pytest.mark.parametrize(
    ("facts", "check", "kind", "what", "remedy"),
    [
        (
            {"foreign": {"numpy": ForeignLibrary(88.4), "attrs": ForeignLibrary(19.9)}},
            *("stray", "warning"),
            "numpy is imported into the gateway without need: 88 ms a start",
            "pip uninstall numpy, where nothing else needs it",
        ),
        (
            {"foreign": {"sitecustomize": ForeignLibrary(20.0, "/opt/sitecustomize.py")}},
            *("stray", "warning"),
            "sitecustomize is imported into the gateway without need: 20 ms a start",
            "take /opt/sitecustomize.py out of this Python's path",
        ),
        ({"foreign": Unreadable("import vcu_gateway: no")}, "stray", "unknown", "import vcu", ""),
        ({"asammdf": Unreadable("import can: no")}, "asammdf", "unknown", "import can: no", ""),
    ],
)
def test_each_library_too_many_is_one_finding(facts, check, kind, what, remedy):
    found = only(libraries.judge(FACTS._replace(**facts)))
    assert (found.subject, found.check, found.kind.value) == ("libraries", check, kind)
    assert found.what.startswith(what)
    assert found.remedy == remedy


def test_what_delays_the_start_too_little_to_tell_is_well():
    assert well(libraries.judge(FACTS._replace(foreign={"attrs": ForeignLibrary(19.9)}))) == OWN


def read(environment: dict[str, str]) -> dict:
    """The facts as a process in this environment reads them."""
    program = "import json; from vcu_gateway.doctor import libraries as one; "
    program += "print(json.dumps(one.read()))"
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=110)
    assert done.returncode == 0, done.stderr
    asammdf, foreign = json.loads(done.stdout)
    return {"asammdf": asammdf, "foreign": foreign}


def test_what_python_imports_by_itself_is_found_in_the_gateway(tmp_path: Path):
    custom = tmp_path / "sitecustomize.py"
    custom.write_text("import time\ntime.sleep(0.05)\nimport hypothesis\n")
    foreign = read({**os.environ, "PYTHONPATH": str(tmp_path)})["foreign"]
    own_ms, file = foreign["sitecustomize"]
    assert own_ms >= 50
    assert file == str(custom)
    took_ms, file = foreign["hypothesis"]
    assert took_ms > 1
    assert file == ""
    assert not {"can", "python-can", "pydantic", "click", "vcu-gateway"} & foreign.keys()


@pytest.mark.ci
@pytest.mark.timeout(PATIENCE_S)
def test_the_cost_of_asammdf_is_measured(export_folder):
    found = read(with_export_libraries(export_folder))
    time_ms, memory_mb = found["asammdf"]
    assert time_ms > 30
    assert memory_mb > 15
    assert not {"asammdf", "numpy", "pandas"} & found["foreign"].keys()


def test_where_asammdf_is_not_installed_nothing_is_measured_of_it():
    assert libraries.read().asammdf is None
