"""Signal quality as colour and word or mark: colour is never the only sign."""

from rich.text import Text

from vcu_gateway.api.results import QualityName, Signal

QUALITY_STYLES: dict[QualityName, str] = {
    "good": "green",
    "out of range": "yellow",
    "saturated": "yellow",
    "stale": "red",
    "never": "dim",
}
NOT_GOOD_MARK = "!"


def value_style(signal: Signal) -> str:
    """Style of a value: none where it is good, so that the others stand out."""
    quality = signal["quality"]
    return "" if quality == "good" else QUALITY_STYLES[quality]


def marked(shown: str, signal: Signal) -> Text:
    """The value, with a mark where it is not good."""
    good = signal["quality"] == "good"
    return Text(shown if good else shown + NOT_GOOD_MARK, value_style(signal))
