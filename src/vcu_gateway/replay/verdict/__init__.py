"""Verdict on a recorded drive, by code that shares nothing with the core.

Written from docs/safety.md and docs/protocol.md, with its own decoding of bytes; import contracts
keep the core, the drive's readers and the configuration out.
"""

from vcu_gateway.replay.verdict.demands import GrantedDemand
from vcu_gateway.replay.verdict.frame_pairs import SentFrame
from vcu_gateway.replay.verdict.judge import Judge
from vcu_gateway.replay.verdict.limits import JudgedDemand, VerdictLimits
from vcu_gateway.replay.verdict.result import DriveVerdict, Findings, ReactionTime, Violation

__all__ = [
    "DriveVerdict",
    "Findings",
    "GrantedDemand",
    "Judge",
    "JudgedDemand",
    "ReactionTime",
    "SentFrame",
    "VerdictLimits",
    "Violation",
]
