"""Replay of recorded drives: equality, what-if, verdict."""
