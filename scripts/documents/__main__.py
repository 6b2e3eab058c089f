"""Write docs/protocol.md, config/gateway.yaml, part of docs/api.md, pictures and example DBCs.

usage: python -m scripts.documents [--check], in the source tree, with the Python of .venv. With
--check nothing is written: exit 1 where a file is not what the program says.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from scripts.documents import api_page, gateway_yaml, pedals_dbc, protocol_page, tuning_picture

from vcu_gateway.api import openrpc
from vcu_gateway.cli.generate import differences
from vcu_gateway.protocol import definition

TREE = Path(__file__).resolve().parents[2]


def main() -> None:
    """Write the files, or compare them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if not current")
    check = parser.parse_args().check
    stale = dict(_stale())
    for name, (path, text) in stale.items():
        if not check:
            path.write_text(text, encoding="utf-8")
            continue
        print(f"{name} is not current: run `python -m scripts.documents`", file=sys.stderr)
        print(*differences(name, path.read_text(encoding="utf-8"), text), sep="\n", file=sys.stderr)
    if check and stale:
        sys.exit(1)


def _stale() -> Iterator[tuple[str, tuple[Path, str]]]:
    """Name, path and text of each file that is to be written."""
    defined = definition.load(TREE / "dbc" / "vcu.yaml")
    api = (TREE / "docs" / "api.md").read_text(encoding="utf-8")
    for name, text in (
        ("docs/protocol.md", protocol_page.write(defined)),
        ("docs/api.md", api_page.within(api, openrpc.document())),
        ("config/gateway.yaml", gateway_yaml.text()),
        ("config/examples/pedals.dbc", pedals_dbc.own_node(defined)),
        ("config/examples/pedals-eec2.dbc", pedals_dbc.eec2(defined)),
        ("docs/pictures/tuning.svg", tuning_picture.svg(TREE / "config/examples/tuning.yaml")),
    ):
        path = TREE / name
        if path.read_text(encoding="utf-8") != text:
            yield name, (path, text)


if __name__ == "__main__":
    main()
