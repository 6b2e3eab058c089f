"""Figures of the bus are told at the end, as in tests/vcan."""

from tests.vcan.conftest import figures, pytest_terminal_summary

__all__ = ["figures", "pytest_terminal_summary"]
