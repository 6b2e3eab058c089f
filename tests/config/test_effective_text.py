"""The effective configuration as a file, which is read as the same configuration again."""

import pytest

from vcu_gateway.config import digest, parse, yaml_text
from vcu_gateway.protocol import packaged

CONFIGS = [
    "bus: {channel: can1}\n",
    "recorder: {socket_path: null}\n",
    "recorder: {socket_path: /run/größe.sock}\n",
    "protocol: {status_code_names: {3: overvoltage, 7: 'no: \"wheel\"'}, aliases: {}}\n",
    "limits: {throttle_slew_pct_per_s: 50}\n",
    "demand: {priorities: {'12': 3, 'yes': 4, joystick: 5}, ttl_max_ms: 150}\n",
    "freshness: {stale_after_ms: {IMU_Attitude: 250}}\n",
    "api: {operator_users: [root, '0'], socket_mode: '0600'}\n",
    "bench: {demand: {bench_use_only: true, throttle_pct: 5}, auto_arm: true}\n",
]


@pytest.mark.parametrize("contents", CONFIGS)
def test_the_text_of_a_configuration_is_read_as_the_same_one(contents):
    config = parse(contents, "/etc/gateway.yaml")
    read = parse(yaml_text(config), "/elsewhere/config.yaml")
    assert read == config
    assert digest(read) == digest(config)


def test_the_text_can_name_the_dbc_that_lies_beside_it(tmp_path):
    for name in ("here.dbc", "vcu.dbc"):
        (tmp_path / name).write_bytes(packaged("vcu.dbc").read_bytes())
    config = parse("protocol: {dbc: here.dbc}\n", str(tmp_path / "gateway.yaml"))
    read = parse(yaml_text(config, dbc="vcu.dbc"), str(tmp_path / "config.yaml"))
    assert read.protocol.dbc == tmp_path / "vcu.dbc"
    assert "dbc: null" in yaml_text(parse("bus: {channel: can1}\n", ""), dbc="vcu.dbc")
