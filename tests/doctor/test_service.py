"""The unit: installed, enabled, running; break one thing."""

from pathlib import Path

import pytest

from tests.doctor.judged import not_ok, only, well
from vcu_gateway.doctor import service
from vcu_gateway.doctor.check_result import Unreadable
from vcu_gateway.doctor.service import ServiceFacts, judge, parsed, unit_of

UNIT = "vcu-gateway.service"
FILE = "/etc/vcu-gateway/gateway.yaml"
TOLD = parsed(
    "LoadState=loaded\nUnitFileState=enabled\nActiveState=active\nSubState=running\n"
    "MainPID=700\nStatusText=standby, can0 up\nNRestarts=0\nResult=success\nExecMainStatus=0\n"
    "User=vcu-gateway\nNeedDaemonReload=no\n"
    f"ExecStart={{ path=/usr/bin/vcu-gateway ; argv[]=/usr/bin/vcu-gateway run -c {FILE} ; }}\n"
)


def of(**changed: str) -> ServiceFacts:
    return ServiceFacts(UNIT, {**TOLD, **changed})


def test_a_running_service_is_one_line():
    findings = list(judge(of()))
    assert not_ok(findings) == {}
    expected = 'vcu-gateway.service: running as 700 ("standby, can0 up"), starts at boot'
    assert well(findings) == expected


@pytest.mark.parametrize(
    ("changed", "check", "kind", "remedy"),
    [
        ({"UnitFileState": "disabled"}, "enabled", "warning", "sudo systemctl enable"),
        ({"UnitFileState": "masked"}, "enabled", "warning", "sudo systemctl unmask"),
        ({"UnitFileState": ""}, "enabled", "warning", "sudo systemctl enable"),
        ({"ActiveState": "inactive"}, "active", "warning", "sudo systemctl start"),
        ({"ActiveState": "activating"}, "active", "warning", "again"),
        (
            {"ActiveState": "activating", "SubState": "auto-restart", "Result": "watchdog"},
            "active",
            "wrong",
            "journalctl -u vcu-gateway.service -n 50",
        ),
        ({"ActiveState": "failed"}, "active", "wrong", "journalctl -u vcu-gateway.service"),
        (
            {"ActiveState": "failed", "ExecMainStatus": "78"},
            "active",
            "wrong",
            "fix the configuration, then sudo systemctl start",
        ),
        ({"NRestarts": "1"}, "restarts", "warning", "journalctl"),
        ({"NeedDaemonReload": "yes"}, "changed", "warning", "sudo systemctl daemon-reload"),
        ({"LoadState": "bad-setting"}, "installed", "wrong", "systemctl status"),
        ({"LoadState": "masked"}, "installed", "wrong", "sudo systemctl unmask"),
    ],
)
def test_each_fault_of_the_service_is_one_finding(changed, check, kind, remedy):
    found = only(judge(of(**changed)))
    assert (found.subject, found.check, found.kind.value) == ("service", check, kind)
    assert found.remedy.startswith(remedy) or remedy in found.remedy


@pytest.mark.parametrize("told", [None, {**TOLD, "LoadState": "not-found"}])
def test_a_development_machine_without_the_service_is_well(told):
    findings = list(judge(ServiceFacts(UNIT, told)))
    assert not_ok(findings) == {}
    assert len(findings) == 1


def test_a_machine_that_systemd_has_not_booted_is_not_asked(tmp_path):
    assert service.read(UNIT, booted=str(tmp_path / "none")).properties is None


def test_without_a_word_of_its_own_the_service_is_told_without_one():
    assert well(judge(of(StatusText=""))).startswith("vcu-gateway.service: running as 700, starts")
    changed = {"ActiveState": "failed", "Result": "watchdog", "StatusText": ""}
    found = only(judge(of(**changed)))
    assert found.what == "vcu-gateway.service has failed: watchdog, status 0"


def test_whether_it_starts_at_boot_is_told_in_systemds_word():
    assert "(disabled)" in only(judge(of(UnitFileState="disabled"))).what
    assert "(state unknown)" in only(judge(of(UnitFileState=""))).what
    for state in ("enabled-runtime", "static", "generated"):
        assert not_ok(judge(of(UnitFileState=state))) == {}


def test_only_an_active_service_ought_to_answer():
    assert of().is_active
    assert not of(ActiveState="failed").is_active


def test_a_count_that_systemd_does_not_tell_is_none():
    assert not_ok(judge(of(NRestarts=""))) == {}


def test_a_systemd_that_does_not_answer_is_unknown():
    found = only(judge(ServiceFacts(UNIT, Unreadable("systemd did not answer within 2 s"))))
    assert found.kind.value == "unknown"


def test_a_failure_tells_result_status_and_the_programs_own_words():
    changed = {"ActiveState": "failed", "Result": "exit-code", "ExecMainStatus": "70"}
    found = only(judge(of(**changed, StatusText="stopping")))
    assert found.what == "vcu-gateway.service has failed: exit-code, status 70 (stopping)"


@pytest.mark.parametrize(
    ("path", "unit"),
    [
        (None, UNIT),
        (Path(FILE), UNIT),
        (Path("/etc/vcu-gateway/can1.yaml"), "vcu-gateway@can1.service"),
        (Path("/home/me/bench.yaml"), UNIT),
    ],
)
def test_an_instance_is_known_by_its_configuration_file(path, unit):
    assert unit_of(path) == unit


def test_the_service_runs_with_its_own_configuration_alone():
    assert of().runs_with(Path(FILE))
    assert of().runs_with(None)
    assert not of().runs_with(Path("/home/me/bench.yaml"))
    assert not ServiceFacts(UNIT, None).runs_with(None)
    assert not of(LoadState="not-found").runs_with(None)


def test_a_unit_with_a_root_of_its_own_sees_only_what_it_is_shown():
    assert of().visible_folders is None
    binds = {"BindReadOnlyPaths": "/usr:/usr:rbind -/etc:/etc:rbind", "BindPaths": "/opt"}
    assert of(RootDirectory="/run/root", **binds).visible_folders == ("/usr", "/etc", "/opt")


def test_the_process_is_known_only_while_there_is_one():
    assert of().pid == 700
    assert of(MainPID="0").pid is None
    assert ServiceFacts(UNIT, None).pid is None


def test_this_machine_is_asked_without_a_failure():
    facts = service.read(UNIT)
    assert facts.unit == UNIT
    assert {one.kind.value for one in judge(facts)} <= {"ok", "warning", "wrong", "unknown"}


def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> ServiceFacts:
    """With this in place of systemctl, as on a machine that systemd has booted."""
    program = tmp_path / "systemctl"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    return service.read(UNIT, booted=str(tmp_path))


def test_systemd_is_asked_once_for_this_unit_and_only_shown(tmp_path, monkeypatch):
    facts = asked(tmp_path, monkeypatch, f'echo "$@" >>{tmp_path}/calls; echo LoadState=loaded')
    assert facts.is_installed
    (call,) = (tmp_path / "calls").read_text().splitlines()
    assert call.startswith(f"show {UNIT} --property LoadState,")


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ("exec sleep 30", "did not answer within 2 s"),
        ("echo no bus here >&2; exit 1", "systemctl: no bus here"),
    ],
)
def test_a_systemctl_that_hangs_or_fails_is_unknown(tmp_path, monkeypatch, script, reason):
    found = only(judge(asked(tmp_path, monkeypatch, script)))
    assert found.kind.value == "unknown"
    assert reason in found.what


def test_a_machine_without_systemctl_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert only(judge(service.read(UNIT, booted=str(tmp_path)))).what == "there is no systemctl"
