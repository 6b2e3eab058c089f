"""HELLO of a running gateway: what the recorder has to know of it, made when it connects."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vcu_gateway import config as configuration
from vcu_gateway.bus.timestamps import read_clocks
from vcu_gateway.config import Config
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.daemon.reload import EffectiveConfig
from vcu_gateway.daemon.restarts import boot_id
from vcu_gateway.recording.layout import DBC_FILE
from vcu_gateway.recording.tap import Hello

_RUN_BYTES = 16


class TapHello:
    """Makes the HELLO; run id and clocks are those of its making, once for a process."""

    def __init__(
        self, in_effect: EffectiveConfig, gateway: Gateway, dbc: Path, dbc_digest: str
    ) -> None:
        self._in_effect = in_effect
        self._gateway = gateway
        self._dbc, self._dbc_digest = dbc.read_bytes().decode(), dbc_digest
        self._run, self._boot = os.urandom(_RUN_BYTES).hex(), boot_id()
        self._clock = read_clocks()
        self._written: tuple[Config, str, str] | None = None

    def __call__(self) -> Mapping[str, Any]:
        config, digest, text = self._config()
        return Hello(
            run=self._run,
            boot=self._boot,
            channel=config.bus.channel,
            clock=self._clock,
            settings=self._gateway.settings,
            config=text,
            config_digest=digest,
            dbc=self._dbc,
            dbc_digest=self._dbc_digest,
        ).values()

    def _config(self) -> tuple[Config, str, str]:
        """Configuration in effect, its digest and its text, which takes a while to make."""
        config = self._in_effect.config
        if self._written is None or self._written[0] is not config:
            digest, text = configuration.digest(config), configuration.yaml_text(config, DBC_FILE)
            self._written = config, digest, text
        return self._written
