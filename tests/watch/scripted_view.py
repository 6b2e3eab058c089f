"""The live view of a fixed source: python -m tests.watch.scripted_view [VIEW [moving]]."""

import random
import sys

from tests.watch import view_models
from vcu_gateway.watch.terminal import watch


def shake(source: view_models.Scripted) -> None:
    """Change every figure, as a drive does."""
    state = source.view.state
    for message in state["messages"].values() if state else ():
        for signal in message["signals"].values():
            signal["value"] = random.uniform(-100, 1000)


if __name__ == "__main__":
    name = sys.argv[1] if len(sys.argv) > 1 else "driving"
    source = view_models.Scripted(getattr(view_models, name)())
    if "moving" in sys.argv:
        source.on_look = lambda: shake(source)
    watch(source, "vcu-gateway")
