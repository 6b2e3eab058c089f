"""Recorded drives: every input and result of the core, written, read and restored."""
