"""Anything may happen to a tapped gateway: what is recorded of it gives the same core again.

After each tick a datagram is made as the recorder gets it, read, and given to two other cores: one
was there from the start, the other is restored from a checkpoint of the tick before.
"""

import json

import pytest
from hypothesis import settings
from hypothesis.stateful import run_state_machine_as_test

from tests.core.test_invariants import CODEC, COUNTS, GatewayMachine
from tests.recording.tapped import frames_of
from vcu_gateway.core.calls import RunTick
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.recording import datagram
from vcu_gateway.recording.checkpoint import restore, state_of
from vcu_gateway.recording.core_lines import Checkpoint, LineParser, Placed, TickRecord, WhyRecord
from vcu_gateway.recording.datagram import TickHeader
from vcu_gateway.recording.tap import Tap, TappedGateway, TapStream, packed_frames

EXAMPLES = 6


class RecordedMachine(GatewayMachine):
    """The machine of the invariants, with a tap."""

    def _new_gateway(self):
        gateway = TappedGateway(CODEC, self.settings, self.now_ns, Tap())
        self.stream, self.parser = TapStream(gateway), LineParser()
        self.stream.begin(self.now_ns, self.now_ns)
        self.from_the_start, self.last_checkpoint = None, None
        self.seen = 0
        return gateway

    def _tick(self):
        result = super()._tick()
        signature = self.gateway.reasons(self.now_ns).signature()
        self.stream.note_why(self.now_ns, signature)
        frames, lines = self.stream.batch()
        self.seen += len(frames)
        header = TickHeader(1, self.stream.frames, 0, 0)
        packed = datagram.packed_tick(header, packed_frames(frames), lines)
        self._check(datagram.tick_parts(packed))
        return result

    def _check(self, received):
        placed = [one for line in received.lines.splitlines() for one in self.parser.records(line)]
        if isinstance(placed[0].record, Checkpoint):
            first = placed.pop(0).record
            self.from_the_start = restore(first.state, CODEC, first.settings)
        frames = frames_of(received.frames)
        self._apply(self.from_the_start, frames, placed)
        state = state_of(self.gateway)
        assert state_of(self.from_the_start) == state
        if self.last_checkpoint is not None:
            behind = restore(*self.last_checkpoint)
            self._apply(behind, frames, placed)
            assert state_of(behind) == state
        self.last_checkpoint = json.loads(json.dumps(state)), CODEC, self.gateway.settings
        COUNTS["restored"] += 1

    def _apply(self, gateway: Gateway, frames, placed: list[Placed]):
        taken, before = 0, self.seen - len(frames)
        for frames_before, record in placed:
            while before + taken < frames_before:
                gateway.receive(frames[taken])
                taken += 1
            if isinstance(record, TickRecord):
                result = RunTick(record.now_ns).apply(gateway)
                assert (result.frames, result.mode, result.events) == record[1:]
            elif isinstance(record, WhyRecord):
                assert gateway.why(record.now_ns).sentence() == record.sentence
            else:
                assert record.input.apply(gateway) == record.answer
        for frame in frames[taken:]:
            gateway.receive(frame)


@pytest.mark.ci
@pytest.mark.timeout(3600)
def test_a_recorded_core_is_restored_at_every_tick_whatever_happens():
    COUNTS.clear()
    nightly = settings().max_examples > 1000
    run_state_machine_as_test(
        RecordedMachine,
        settings=settings(
            max_examples=300 if nightly else EXAMPLES,
            stateful_step_count=100 if nightly else 40,
            deadline=None,
            print_blob=True,
            report_multiple_bugs=False,
        ),
    )
    assert COUNTS["restored"] >= EXAMPLES * 20
