"""Judge of a recorded or tested bus, by code that shares nothing with the core.

Written from docs/safety.md and docs/protocol.md, with its own decoding of bytes; import contracts
keep the core, the drive's readers and the configuration out.
"""

from vcu_gateway.judge.command_rules import SentFrame
from vcu_gateway.judge.demands import GrantedDemand
from vcu_gateway.judge.judge import Judge
from vcu_gateway.judge.limits import (
    JudgedDemand,
    JudgedPedals,
    JudgedSignal,
    JudgedTrack,
    VerdictLimits,
)
from vcu_gateway.judge.result import DriveVerdict, Findings, ReactionTime, Violation

__all__ = [
    "DriveVerdict",
    "Findings",
    "GrantedDemand",
    "Judge",
    "JudgedDemand",
    "JudgedPedals",
    "JudgedSignal",
    "JudgedTrack",
    "ReactionTime",
    "SentFrame",
    "VerdictLimits",
    "Violation",
]
