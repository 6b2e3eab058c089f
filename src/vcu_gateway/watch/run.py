"""The view from its first line to a terminal that is as it was before."""

import os
from collections.abc import Callable

from vcu_gateway import streams
from vcu_gateway.watch import terminal
from vcu_gateway.watch.app import WatchApp
from vcu_gateway.watch.view_model import ViewSource


def watch(source: ViewSource, title: str, over: Callable[[], bool] = lambda: False) -> None:
    """Show the source until a key or a signal ends it, the terminal goes away, or it is over.

    Only in the main thread, and where `terminal.is_full`. The process ends with 70 after a bug.
    """
    leaving = terminal.TerminalExit()
    leaving.handle_signals()

    def done() -> bool:
        if terminal.has_gone():
            leaving.ask()
        return leaving.asked or over()

    app = WatchApp(source, title, done)
    # Without the mouse the terminal keeps its own way to select and copy.
    app.run(mouse=False)
    streams.flush()  # the terminal may be gone
    leaving.finished()
    if app.return_code:
        raise SystemExit(os.EX_SOFTWARE)
