"""The live view: pure functions from plain data to lines of text, and a Textual app over them.

`picture` is what is shown and where it comes from; `heading`, `reasons`, `controllers`, `bus`
and `signals` make the lines; `app` puts them on a terminal, `plain` into a pipe. Only this room
imports textual and rich.
"""
