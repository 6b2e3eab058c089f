"""The view on a source that is written by hand: python -m tests.watch.scripted_view [WORLD [moving]]."""

import random
import sys

from tests.watch import view_models as worlds
from vcu_gateway.watch.run import watch


def shake(source: worlds.Scripted) -> None:
    """Change every figure, as a drive does."""
    state = source.picture.state
    for message in state["messages"].values() if state else ():
        for signal in message["signals"].values():
            signal["value"] = random.uniform(-100, 1000)


if __name__ == "__main__":
    name = sys.argv[1] if len(sys.argv) > 1 else "driving"
    source = worlds.Scripted(getattr(worlds, name)())
    if "moving" in sys.argv:
        source.on_look = lambda: shake(source)
    watch(source, "vcu-gateway")
