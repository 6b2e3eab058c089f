"""State as a browser gets it twenty times a second: numbers in the protocol's order, no names."""

from vcu_gateway.api.results import Message, Protocol, QualityName, State
from vcu_gateway.units import NS_PER_MS

QUALITY_LETTERS: dict[QualityName, str] = {
    "good": "g",
    "out of range": "r",
    "saturated": "s",
    "stale": "o",
    "never": "n",
}

Row = list[object]
"""Age in ms, observed period in ms, stale (0, 1), frames, values, a letter for each quality."""


def state_row(state: State, received_ms: float) -> dict[str, object]:
    """One state, small; `received_ms` is when it got here, on the clock of `t`."""
    return {
        "t": state["monotonic_ns"] / NS_PER_MS,
        "received": received_ms,
        "mode": state["mode"],
        "messages": {name: _row(message) for name, message in state["messages"].items()},
        "commands": state["commands"],
        "demanded": state["demanded"],
    }


def _row(message: Message) -> Row:
    signals = message["signals"].values()
    return [
        message["age_ms"],
        message["period_ms"],
        int(message["stale"]),
        message["frame_count"],
        [_short(signal["value"]) for signal in signals],
        "".join(QUALITY_LETTERS[signal["quality"]] for signal in signals),
    ]


def _short(value: float | None) -> float | None:
    """Without the digits that no signal of 16 bits has."""
    return round(value, 4) if isinstance(value, float) else value


def definition(protocol: Protocol, received: list[str]) -> dict[str, object]:
    """What the page needs to name the numbers: messages in the state's order."""
    known = {message["name"]: message for message in protocol["messages"]}
    return {
        "digest": protocol["digest"],
        "messages": [
            {
                "name": name,
                "sender": known[name]["sender"],
                "id": known[name]["can_id"],
                "period_ms": known[name]["period_ms"],
                "signals": [
                    {
                        "name": signal["name"],
                        "unit": signal["unit"],
                        "minimum": signal["minimum"],
                        "maximum": signal["maximum"],
                        "factor": signal["factor"],
                        "names": signal["names"],
                        "comment": signal["comment"],
                    }
                    for signal in known[name]["signals"]
                ],
            }
            for name in received
            if name in known
        ],
    }
