"""Recorder: a process beside the gateway that keeps every drive on disk.

`receiver` takes the tap's datagrams from the gateways that connected, and never waits for the disk:
what it took lies in the `backlog`, bounded, until the `writer`'s thread has it. A connection's
drive is a `DriveRecorder`, which writes segments in the format of `recording`; `ring` removes the
oldest of them, `incidents` keeps what surrounds a fault by hard links, and `program` says how it
goes. Nothing of the gateway is imported, and the standard library alone.
"""
