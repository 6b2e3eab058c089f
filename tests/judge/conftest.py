"""Recorded drives, those of the replay's tests."""

from tests.replay.conftest import recorded

__all__ = ["recorded"]
