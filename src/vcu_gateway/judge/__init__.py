"""Judge of a recorded or tested bus, by code that shares nothing with the core.

Written from docs/safety.md and docs/protocol.md, with its own decoding of bytes; import contracts
keep the core, the drive's readers and the configuration out.
"""
