"""Recorded data: everything that is kept of a bus and of a gateway, on disk and read back.

- The format, which the recorder imports, too, and which needs the standard library alone: `layout`
  (names and folders), `members` (gzip members), `chain`, `signature`, `segment`, `datagram` (the
  tap's), `recorder_status`.
- A recorded drive: `tap` notes every call of the core, `core_lines` and `call_text` are its text,
  `checkpoint` its state; `reader` reads it, and says how long each cause counted.
- A foreign log: `candump` and `log` read it frame by frame, `decoded` writes it. No identifier is
  ever shortened to 29 bits: a number beyond them is an error frame or damage (docs/protocol.md E2).
- Kept recordings: `folder`, `keep`, `check` with `checked_segment`.
"""
