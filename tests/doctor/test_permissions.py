"""Who may do what: an installed service and an operator; break one thing."""

import grp
import os
import stat
from pathlib import Path

import pytest

from tests.doctor.judged import not_ok, only, well
from vcu_gateway.api.errors import Policy
from vcu_gateway.config import Config
from vcu_gateway.config.model import ApiSection, ProtocolSection
from vcu_gateway.doctor import permissions
from vcu_gateway.doctor.check_result import Unreadable
from vcu_gateway.doctor.permissions import Account, FilePermissions, PermissionFacts, judge

DRIVER = Account("driver", 1000, frozenset({1000, 500}))
GATEWAY = Account("vcu-gateway", 900, frozenset({900}))
SOCKET = FilePermissions("/run/vcu-gateway/control.sock", stat.S_IFSOCK | 0o660, 900, 500)
FOLDER = FilePermissions("/run/vcu-gateway", stat.S_IFDIR | 0o755, 900, 900)
ETC = FilePermissions("/etc", stat.S_IFDIR | 0o755, 0, 0)
OWN = FilePermissions("/etc/vcu-gateway", stat.S_IFDIR | 0o755, 0, 0)
FILE = FilePermissions("/etc/vcu-gateway/gateway.yaml", stat.S_IFREG | 0o644, 0, 0)
HEALTHY = PermissionFacts(
    me=DRIVER,
    service=GATEWAY,
    policy=Policy(900, operator_gids=frozenset({500})),
    socket_path=SOCKET.path,
    socket=SOCKET,
    folder=FOLDER,
    files=((ETC, OWN, FILE),),
    socket_group="drivers",
)


def test_an_operator_beside_an_installed_service_is_one_line():
    assert not_ok(judge(HEALTHY)) == {}
    expected = "vcu-gateway can read its files, driver may read, stop and operate"
    assert well(judge(HEALTHY)) == expected


@pytest.mark.parametrize(
    ("changed", "check", "kind", "remedy"),
    [
        (
            {"service": Unreadable("this machine has no user vcu-gateway")},
            "service_user",
            "wrong",
            "sudo systemd-sysusers",
        ),
        (
            {"files": ((ETC, OWN, FILE._replace(mode=stat.S_IFREG | 0o640)),)},
            "service_files",
            "wrong",
            "sudo chmod o+rX /etc/vcu-gateway/gateway.yaml",
        ),
        (
            {"files": ((ETC, OWN._replace(mode=stat.S_IFDIR | 0o750), FILE),)},
            "service_files",
            "wrong",
            "sudo chmod o+rX /etc/vcu-gateway",
        ),
        (
            {"visible_folders": ("/usr", "/opt")},
            "service_files",
            "wrong",
            "keep it in /etc/vcu-gateway",
        ),
        ({"folder": FOLDER._replace(mode=stat.S_IFDIR | 0o777)}, "folder", "wrong", "chmod o-w"),
        ({"folder": Unreadable("no permission")}, "folder", "unknown", ""),
        ({"socket": Unreadable("no permission")}, "mine", "unknown", ""),
        ({"has_operators": False}, "operators", "warning", "api.operator_groups"),
        (
            {"socket": SOCKET._replace(gid=501)},
            "mine",
            "warning",
            "sudo usermod -aG drivers driver, and log in again",
        ),
    ],
)
def test_each_missing_permission_is_one_finding(changed, check, kind, remedy):
    found = only(judge(HEALTHY._replace(**changed)))
    assert (found.subject, found.check, found.kind.value) == ("permissions", check, kind)
    assert remedy in found.remedy


@pytest.mark.parametrize(
    "changed",
    [
        {"folder": None, "socket": None},  # the service is down and takes its folder along
        {"folder": FOLDER._replace(mode=stat.S_IFDIR | 0o1777)},
        {"files": ((ETC, OWN, FILE._replace(mode=stat.S_IFREG | 0o640, gid=900)),)},
        {"policy": None},
        {"visible_folders": ("/usr", "/etc")},
        {"me": Account("root", 0, frozenset({0}))},
        {"socket_path": None, "socket": None, "folder": None, "has_operators": False},
    ],
)
def test_what_the_service_makes_and_what_root_may_is_well(changed):
    assert not_ok(judge(HEALTHY._replace(**changed))) == {}


def test_a_reader_is_told_what_she_may_and_that_is_well():
    findings = list(judge(HEALTHY._replace(policy=Policy(900))))
    assert not_ok(findings) == {}
    assert "driver may read and stop" in well(findings)


def test_a_folder_that_lets_through_without_listing_is_no_barrier():
    way = (ETC, OWN._replace(mode=stat.S_IFDIR | 0o711), FILE)
    assert not_ok(judge(HEALTHY._replace(files=(way,)))) == {}


def test_without_files_nothing_is_said_of_them():
    assert well(judge(HEALTHY._replace(files=((),)))) == "driver may read, stop and operate"


def test_a_machine_without_the_service_needs_no_operators_and_without_an_api_no_folder():
    bare = HEALTHY._replace(service=None, has_operators=False)
    assert not_ok(judge(bare)) == {}
    without_api = bare._replace(socket_path=None, socket=None, folder=None)
    assert not_ok(judge(without_api)) == {}
    assert well(judge(without_api)) == ""


def test_without_a_service_the_sockets_folder_is_made_by_hand():
    found = only(judge(HEALTHY._replace(service=None, folder=None, socket=None)))
    assert (found.check, found.kind.value) == ("folder", "warning")
    assert found.remedy == "sudo install -d -o driver /run/vcu-gateway"


@pytest.mark.parametrize(
    ("mode", "uid", "gid", "may"),
    [
        (0o600, 1000, 1, True),
        (0o060, 1, 500, True),
        (0o006, 1, 1, True),
        (0o066, 1000, 500, False),  # the owner's bits count for the owner
        (0o606, 1, 500, False),  # and the group's for the group
        (0o400, 1000, 1, False),
    ],
)
def test_the_first_class_of_bits_that_fits_decides(mode, uid, gid, may):
    assert FilePermissions("x", mode, uid, gid).grants(DRIVER, 6) is may


def test_this_machines_accounts_and_files_are_read(tmp_path: Path):
    file = tmp_path / "gateway.yaml"
    file.touch()
    api = ApiSection(socket_path=str(tmp_path / "control.sock"), operator_groups=("root",))
    facts = permissions.read(Config(api=api), file, "nobody")
    assert facts.me.uid == os.geteuid()
    assert isinstance(facts.service, Account)
    assert facts.socket is None
    assert isinstance(facts.folder, FilePermissions)
    assert [place.path for place in facts.files[0]][0 :: len(facts.files[0]) - 1] == [
        "/",
        str(file),
    ]
    assert facts.policy is not None
    assert facts.policy.operator_gids == {0}


def test_an_api_that_is_off_has_no_socket_and_the_dbc_is_a_file_of_the_service(tmp_path: Path):
    dbc = tmp_path / "own.dbc"
    dbc.touch()
    config = Config(api=ApiSection(enabled=False), protocol=ProtocolSection(dbc=dbc))
    facts = permissions.read(config, None, None, ("/etc",))
    assert (facts.socket_path, facts.socket, facts.folder) == (None, None, None)
    assert [way[-1].path for way in facts.files] == [str(dbc)]
    assert facts.visible_folders == ("/etc",)


def test_the_group_to_join_is_the_sockets_own(tmp_path: Path):
    path = tmp_path / "control.sock"
    path.touch()
    group = grp.getgrgid(path.stat().st_gid).gr_name
    assert (
        permissions.read(Config(api=ApiSection(socket_path=str(path))), None, None).socket_group
        == group
    )


def test_a_service_user_that_does_not_exist_is_read_as_such():
    facts = permissions.read(Config(), None, "no_such_user")
    assert "service_user" in not_ok(judge(facts))


def test_an_account_that_does_not_exist_leaves_the_policy_unknown():
    api = ApiSection(operator_users=("no_such_user",))
    assert permissions.read(Config(api=api), None, None).policy is None
