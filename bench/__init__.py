"""Benchmarks: this gateway beside the naive way, in the same run. `python -m bench --help`.

Nothing is imported here: the naive script under test must not carry our modules.
"""

from pathlib import Path

DBC = Path(__file__).parent.parent / "dbc" / "vcu.dbc"
CHANNEL = "vcan0"
