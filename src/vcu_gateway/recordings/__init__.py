"""Recordings on a disk: listed, checked, kept and removed; no gateway and no recorder is needed.

`folder` finds drives and incidents by name, `summary` tells of each what a list shows, `check`
reads every byte and adds up, `keep` and `remove` change what the recorder would do by itself.
"""

from vcu_gateway.recordings.check import CheckedRecording, check_recording
from vcu_gateway.recordings.folder import RecordingFolder, RecordingPath
from vcu_gateway.recordings.keep import keep_part, keep_whole
from vcu_gateway.recordings.owner import act_as_owner
from vcu_gateway.recordings.remove import remove_recording
from vcu_gateway.recordings.summary import RecordingSummary, summarise

__all__ = [
    "CheckedRecording",
    "RecordingFolder",
    "RecordingPath",
    "RecordingSummary",
    "act_as_owner",
    "check_recording",
    "keep_part",
    "keep_whole",
    "remove_recording",
    "summarise",
]
