"""A second opinion: the specification against the real process on a real vcan0.

Nothing here imports the gateway or another test: the standard library and pytest are all.
"""
