"""What passed the door, counted."""

from dataclasses import dataclass, field


@dataclass(slots=True)
class BusCounters:
    """Each counter is written by one thread at a time.

    Attributes:
        refused: frames that could not be sent at once, by errno name.
        dropped: frames that the kernel's receive buffer had no room for, or that waited in it
            when the socket was closed.
        repeated_errors: error frames that said the same as the one before; not looked at.
        reader_not_awaited: ticks that went on without what the reader had in its hands.
        undecodable: datagrams of a multicast group that hold no frame.
        receiver_bugs: exceptions of our own receiving code; the frame is lost, the rest goes on.
    """

    received: int = 0
    sent: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    dropped: int = 0
    repeated_errors: int = 0
    reader_not_awaited: int = 0
    undecodable: int = 0
    receiver_bugs: int = 0
    last_bug: str = ""
