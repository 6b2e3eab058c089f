"""The files for systemd, as text; that they do what they say is shown in tests/service."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

SYSTEMD = Path(__file__).parents[2] / "systemd"
UNITS = sorted(
    path
    for path in SYSTEMD.rglob("*")
    if path.suffix in {".service", ".socket", ".network", ".netdev", ".link"}
)


SERVICES = sorted(path.name for path in UNITS if path.suffix == ".service")
MOST_EXPOSED = {
    "vcu-gateway.service": 1.0,
    "vcu-gateway@.service": 1.0,
    "vcu-gateway-recorder.service": 0.3,
    "vcu-gateway-pedals.service": 0.6,
}
"""What `systemd-analyze security` may say, 0 to 10; exporter and page have an internet socket."""


def settings(path: Path) -> list[tuple[int, str]]:
    """Line numbers and names of the directives; the Match section is what, not why."""
    section, found = "", []
    for number, line in enumerate(path.read_text().splitlines()):
        if line.startswith("["):
            section = line
        elif line and not line.startswith("#") and section not in ("[Match]", "[NetDev]"):
            found.append((number, line.partition("=")[0]))
    return found


@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.name)
def test_every_directive_has_a_comment_that_says_why(path):
    lines = path.read_text().splitlines()
    for number, name in settings(path):
        before = lines[number - 1]
        assert before.startswith(("#", f"{name}=")), f"{path.name}:{number + 1}: {name} says no why"


def test_the_instance_is_made_from_the_plain_unit():
    made = subprocess.run([SYSTEMD / "make-instance"], capture_output=True, text=True, check=True)
    assert (SYSTEMD / "vcu-gateway@.service").read_text() == made.stdout


def test_an_instance_shares_no_folder_with_another():
    text = (SYSTEMD / "vcu-gateway@.service").read_text()
    directives = [line for line in text.splitlines() if line[:1].isalpha()]
    shared = [
        line
        for line in directives
        if re.search(r"(/run|Directory=)/?vcu-gateway(?!-%i|-root|-recorder|/%i)", line)
    ]
    assert shared == []


@pytest.mark.parametrize("name", SERVICES)
def test_systemd_understands_every_line(name, tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze on this machine; tests/service asks the real one")
    for unit in [SYSTEMD / name, *SYSTEMD.glob("*.socket")]:
        shutil.copy(unit, tmp_path)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", f"./{name}"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    said = [
        line for line in done.stderr.splitlines() if name in line and "not executable" not in line
    ]
    assert said == []


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_is_exposed_no_more_than_it_has_to_be(name):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze on this machine; tests/service asks the real one")
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=yes", "--no-pager", str(SYSTEMD / name)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    found = re.search(r"Overall exposure level for \S+: ([0-9.]+)", done.stdout)
    assert found, done.stderr
    assert float(found[1]) <= MOST_EXPOSED.get(name, 1.1)


def test_the_exporter_listens_on_the_one_port_that_its_unit_lets_it_have():
    text = (SYSTEMD / "vcu-gateway-exporter.service").read_text()
    (listen,) = re.findall(r"^ExecStart=.* --listen 127\.0\.0\.1:(\d+)$", text, re.MULTILINE)
    assert "\nSocketBindDeny=any\n" in text
    assert re.findall(r"^SocketBindAllow=(.*)$", text, re.MULTILINE) == [f"tcp:{listen}"]
    example = (SYSTEMD.parent / "docs/monitoring/prometheus.yml").read_text()
    assert f'"127.0.0.1:{listen}"' in example


def test_the_page_listens_on_the_one_port_that_its_unit_lets_it_have_and_on_no_network():
    text = (SYSTEMD / "vcu-gateway-web.service").read_text()
    (listen,) = re.findall(r"^ExecStart=.* --listen 127\.0\.0\.1:(\d+) ", text, re.MULTILINE)
    assert "\nSocketBindDeny=any\n" in text
    assert re.findall(r"^SocketBindAllow=(.*)$", text, re.MULTILINE) == [f"tcp:{listen}"]
    assert re.findall(r"^IPAddressAllow=(.*)$", text, re.MULTILINE) == ["localhost"]
    assert f"<http://127.0.0.1:{listen}/>" in (SYSTEMD.parent / "docs/web.md").read_text()


@pytest.mark.parametrize("name", ["exporter", "web", "pedals"])
def test_a_program_beside_the_gateway_needs_it_only_for_the_order(name):
    text = (SYSTEMD / f"vcu-gateway-{name}.service").read_text()
    assert "\nAfter=vcu-gateway.service\n" in text
    assert not re.search(r"^(Requires|BindsTo|PartOf|Requisite|Wants)=", text, re.MULTILINE)


RECORDER = SYSTEMD / "vcu-gateway-recorder.service"


def test_no_gateway_ever_waits_for_the_recorder():
    ordering = re.compile(
        r"^(?:After|Before|Requires|BindsTo|PartOf|Requisite|Wants|Upholds)=(.*)$", re.MULTILINE
    )
    of_recorder = ordering.findall(RECORDER.read_text())
    assert of_recorder == ["vcu-gateway-recorder.socket"]
    of_gateway = " ".join(ordering.findall((SYSTEMD / "vcu-gateway.service").read_text()))
    assert "recorder" not in of_gateway


def test_the_recorders_socket_lies_where_the_gateways_root_folder_has_it():
    socket = (SYSTEMD / "vcu-gateway-recorder.socket").read_text()
    (path,) = re.findall(r"^ListenSequentialPacket=(.*)$", socket, re.MULTILINE)
    folder = str(Path(path).parent)
    for name in ("vcu-gateway.service", "vcu-gateway@.service"):
        assert f"\nBindReadOnlyPaths=-{folder}\n" in (SYSTEMD / name).read_text()
    assert f"\nBindPaths={folder}\n" in RECORDER.read_text()
    assert (
        f"\nd {folder} 0750 vcu-gateway-recorder vcu-gateway\n"
        in (SYSTEMD / "tmpfiles.conf").read_text()
    )


def test_the_gateways_user_alone_is_in_the_group_of_the_recorders_socket():
    socket = (SYSTEMD / "vcu-gateway-recorder.socket").read_text()
    (group,) = re.findall(r"^SocketGroup=(.*)$", socket, re.MULTILINE)
    users = (SYSTEMD / "sysusers.conf").read_text()
    assert f"\ng {group} -\n" in users
    assert re.findall(rf"^m (\S+) {group}$", users, re.MULTILINE) == ["vcu-gateway"]
    units = "".join(path.read_text() for path in SYSTEMD.glob("*.service"))
    assert group not in units
    assert "\nPrivateUsers=" not in RECORDER.read_text()  # it has to see who connects


def test_the_recorder_has_no_network_at_all():
    text = RECORDER.read_text()
    for line in ("RestrictAddressFamilies=AF_UNIX", "PrivateNetwork=yes", "IPAddressDeny=any"):
        assert f"\n{line}\n" in text
