"""The README's picture of the live view.

    python -m tests.watch.screenshot FILE [COLUMNS LINES [VIEW]]

The vehicle is the simulated one, in simulated time: the same picture comes out every time.
"""

import asyncio
import re
import sys
from pathlib import Path

from tests.watch import view_models
from vcu_gateway.watch.app import WatchApp

FONTS = "Fira Code, DejaVu Sans Mono, Menlo, Consolas, monospace"


async def draw(columns: int, lines: int, view: str = "limited") -> str:
    """The view as SVG that fetches nothing."""
    app = WatchApp(view_models.Scripted(getattr(view_models, view)()))
    async with app.run_test(size=(columns, lines)) as pilot:
        await pilot.pause(0.5)
        svg = app.export_screenshot(title="vcu-gateway watch")
    svg = re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL)
    return svg.replace("Fira Code, monospace", FONTS)


if __name__ == "__main__":
    given = sys.argv[2:]
    columns, lines, view = [*given, *["120", "40", "limited"][len(given) :]]
    svg = asyncio.run(draw(int(columns), int(lines), view))
    Path(sys.argv[1]).write_text(svg, encoding="utf-8")
