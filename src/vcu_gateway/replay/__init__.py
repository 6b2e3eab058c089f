"""Replay of recorded drives and logs: equality and verdict, what-if, closed loop.

`drive_replay.replay_drive` and `log_replay.replay_log` answer with one report
(`report.ReplayReport`): lines for a terminal, values for JSON, a page with plots.
"""
