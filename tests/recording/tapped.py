"""A drive in simulated time whose gateway is tapped."""

from typing import Any

from tests.core.simulated_drive import CODEC, Drive
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.recording import datagram
from vcu_gateway.recording.core_lines import LineParser, LineWriter, Placed
from vcu_gateway.recording.tap import Tap, TappedGateway


class TappedDrive(Drive):
    """`tap` has what was noted since its last take."""

    gateway: TappedGateway

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.tap = Tap()
        self.gateway = TappedGateway(CODEC, Settings(**settings), self.now_ns, self.tap)


def lines_of(tap: Tap, writer: LineWriter | None = None) -> str:
    """The core lines of what the tap has."""
    frames, calls = tap.take()
    return (writer or LineWriter()).lines(calls, len(frames))


def parsed(text: str, parser: LineParser | None = None) -> list[Placed]:
    """The records of these lines."""
    parser = parser or LineParser()
    return [record for line in text.splitlines() for record in parser.records(line)]


def frames_of(packed: bytes) -> list[Frame]:
    """Frames of the core from those of a datagram."""
    return [
        Frame(
            can_id & datagram.ID_MASK,
            data,
            at_ns,
            extended=can_id & datagram.EXTENDED != 0,
            remote=can_id & datagram.REMOTE != 0,
            error=can_id & datagram.ERROR != 0,
            own_echo=own,
        )
        for at_ns, can_id, own, data in datagram.frame_records(packed)
    ]
