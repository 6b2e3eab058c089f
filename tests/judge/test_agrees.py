"""Verdict and gateway agree on everything that may happen to a gateway."""

import pytest
from hypothesis import Phase, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.core import test_invariants
from tests.core.test_invariants import GatewayMachine
from tests.replay.tapped import records
from vcu_gateway.core.settings import Settings
from vcu_gateway.protocol import DEFAULT_ALIASES
from vcu_gateway.recording.tap import Tap, TappedGateway
from vcu_gateway.replay.judged import JudgedRecords

FIRST_SETTINGS: dict[int, Settings] = {}


class JudgedMachine(GatewayMachine):
    """The same machine with its gateway tapped; the verdict has nothing against the records."""

    def teardown(self):
        super().teardown()
        if self.gateway is None:
            return
        first = FIRST_SETTINGS[id(self.gateway)]
        judged = JudgedRecords(first, DEFAULT_ALIASES)
        judged.begin(first, 0)
        for record in records(self.gateway.tap):
            judged.note(record)
        verdict = judged.verdict()
        # The machine hands over frames with old stamps, which no gateway can have answered in time.
        broken = [one for one in verdict.violations if one.rule != "reaction time"]
        assert not broken, "\n".join(map(str, broken))


@pytest.fixture(autouse=True)
def _tapped(monkeypatch):
    def gateway(codec, settings, now_ns):
        made = TappedGateway(codec, settings, now_ns, Tap())
        FIRST_SETTINGS[id(made)] = settings  # a reload changes those of the gateway
        return made

    monkeypatch.setattr(test_invariants, "Gateway", gateway)


@pytest.mark.ci
def test_the_verdict_has_nothing_against_any_drive_of_the_gateway():
    run_state_machine_as_test(
        JudgedMachine,
        settings=settings(max_examples=15, stateful_step_count=50, phases=[Phase.generate]),
    )
