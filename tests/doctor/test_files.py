"""Configuration and DBC: a valid file that nobody else may change; break one thing."""

import os
import stat
from pathlib import Path

import pytest

from tests.doctor.judged import not_ok, only, well
from vcu_gateway.doctor import configuration
from vcu_gateway.doctor.check_result import Unreadable
from vcu_gateway.doctor.configuration import judge, read
from vcu_gateway.doctor.permissions import FilePermissions
from vcu_gateway.errors import Problem
from vcu_gateway.protocol import packaged

ME = 1000
OTHER = 1001


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "gateway.yaml"
    file.write_text("bus: {channel: can0}\n")
    file.chmod(0o644)
    return file


@pytest.fixture
def healthy(path: Path) -> configuration.ConfigurationFacts:
    return read(path)._replace(
        file=FilePermissions("", stat.S_IFREG | 0o644, 0, 0),
        folder=FilePermissions("", stat.S_IFDIR | 0o755, 0, 0),
        own_uid=ME,
    )


def test_a_valid_file_is_one_line_with_its_digest(path, healthy):
    assert not_ok(judge(healthy)) == {}
    assert well(judge(healthy)).startswith(f"{path}: valid, digest ")


@pytest.mark.parametrize(
    ("file", "check", "kind", "command"),
    [
        (FilePermissions("", stat.S_IFREG | 0o646, 0, 0), "mode", "wrong", "sudo chmod o-w "),
        (
            FilePermissions("", stat.S_IFREG | 0o664, 0, OTHER),
            "group",
            "warning",
            "sudo chmod g-w ",
        ),
        (
            FilePermissions("", stat.S_IFREG | 0o644, OTHER, 0),
            "owner",
            "warning",
            "sudo chown root: ",
        ),
    ],
)
def test_a_file_that_others_may_change_is_told(path, healthy, file, check, kind, command):
    found = only(judge(healthy._replace(file=file)))
    assert (found.check, found.kind.value) == (check, kind)
    assert found.remedy == f"{command}{path}"


@pytest.mark.parametrize(
    "file",
    [
        FilePermissions("", stat.S_IFREG | 0o664, 0, 0),
        FilePermissions("", stat.S_IFREG | 0o600, ME, OTHER),
    ],
)
def test_a_file_of_roots_or_of_whoever_asks_is_well(healthy, file):
    assert not_ok(judge(healthy._replace(file=file))) == {}


@pytest.mark.parametrize(("mode", "kinds"), [(0o777, {"folder": "wrong"}), (0o1777, {})])
def test_a_folder_where_everybody_may_replace_the_file_is_wrong_unless_sticky(healthy, mode, kinds):
    folder = FilePermissions("", stat.S_IFDIR | mode, 0, 0)
    assert not_ok(judge(healthy._replace(folder=folder))) == kinds


def test_every_mistake_is_a_line_in_check_configs_words(path):
    path.write_text("bus:\n  chanel: can0\n  reopen_ms: 1\n")
    facts = read(path)
    assert not facts.can_be_checked
    wrong = [one for one in judge(facts) if one.kind.value == "wrong"]
    assert [one.check for one in wrong] == ["valid", "valid"]
    assert wrong[0].what == f"{path}:2: bus.chanel: unknown key"
    assert wrong[0].remedy == 'did you mean "channel"?'


def test_an_account_that_does_not_exist_is_wrong_and_the_file_still_valid(path):
    path.write_text("api: {operator_groups: [no_such_group]}\n")
    facts = read(path)
    assert facts.config is not None
    assert only(judge(facts)).check == "accounts"


def test_a_static_demand_is_a_warning(path):
    path.write_text("bench: {demand: {bench_use_only: true}}\n")
    assert not_ok(judge(read(path))) == {"bench": "warning"}


def test_a_derated_power_that_lowers_nothing_is_a_warning(path):
    path.write_text("limits: {power_limit_max_w: 5000}\n")
    assert not_ok(judge(read(path))) == {"effect": "warning"}


def test_without_a_file_the_defaults_are_held_against_the_machine():
    facts = read(None, (Problem("there is no configuration file", "x.yaml", "give one"),))
    assert not_ok(judge(facts)) == {"valid": "wrong"}
    assert facts.can_be_checked
    assert facts.in_effect.bus.channel == "can0"
    assert "default of every key" in well(judge(facts))


def test_a_file_that_is_not_there_or_a_folder_is_wrong(tmp_path):
    missing = not_ok(judge(read(tmp_path / "none.yaml")))
    assert missing == {"valid": "wrong", "dependent": "unknown"}
    assert not_ok(judge(read(tmp_path)))["valid"] == "wrong"


def test_a_file_that_this_user_may_not_read_is_unknown(healthy):
    facts = healthy._replace(config=None, unread=Unreadable("this user may not read it"))
    found = next(judge(facts))
    assert not_ok(judge(facts)) == {"readable": "unknown", "dependent": "unknown"}
    assert found.remedy == "sudo vcu-gateway doctor"


@pytest.mark.skipif(os.geteuid() != 0, reason="root alone can become another user")
def test_a_stranger_finds_a_private_file_unknown(path):
    path.chmod(0o600)
    os.chmod(path.parent, 0o755)
    os.seteuid(65534)
    try:
        facts = read(path)
    finally:
        os.seteuid(0)
    assert facts.unread is not None
    assert facts.problems == ()


# The DBC.


def test_the_packaged_dbc_is_well():
    facts = configuration.read_protocol(read(None).in_effect)
    assert not_ok(configuration.judge_protocol(facts)) == {}
    assert "the packaged DBC: 12 messages" in well(configuration.judge_protocol(facts))


def with_dbc(path: Path, text: str) -> configuration.ProtocolFacts:
    (path.parent / "own.dbc").write_text(text)
    path.write_text("protocol: {dbc: own.dbc}\n")
    return configuration.read_protocol(read(path).in_effect)


def test_a_copy_of_the_packaged_dbc_is_well_and_named(path):
    facts = with_dbc(path, packaged("vcu.dbc").read_text())
    assert not_ok(configuration.judge_protocol(facts)) == {}
    assert str(path.parent / "own.dbc") in well(configuration.judge_protocol(facts))


@pytest.mark.parametrize(
    ("old", "new"), [("BMS_Status: 8", "BMS_Statos: 8"), ("BO_", "BX_"), ("VERSION", "")]
)
def test_a_dbc_that_contradicts_the_rules_or_is_none_is_wrong(path, old, new):
    facts = with_dbc(path, packaged("vcu.dbc").read_text().replace(old, new))
    assert set(not_ok(configuration.judge_protocol(facts)).values()) == {"wrong"}


def test_a_message_that_the_protocol_does_not_have_is_wrong(path):
    path.write_text("freshness: {stale_after_ms: {BMS_Stats: 900}}\n")
    found = only(configuration.judge_protocol(configuration.read_protocol(read(path).in_effect)))
    assert found.check == "names"
    assert 'did you mean "BMS_Status"?' in found.remedy
