"""Extras that verbs need: a missing one becomes a sentence and an exit code."""

from functools import partial

from vcu_gateway.errors import extra_needed

tui_needed = partial(extra_needed, "the live view needs", "tui", "textual", "rich")
web_needed = partial(extra_needed, "the page needs", "web", "starlette", "uvicorn", "h11", "anyio")
metrics_needed = partial(extra_needed, "the exporter needs", "metrics", "prometheus_client")
