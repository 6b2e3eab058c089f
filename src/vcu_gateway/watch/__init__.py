"""Live view: pure functions from a view model to lines of text, and a Textual app over them.

`poller` fills the `view_model` from the client. `header`, `reasons`, `controllers`, `bus` and
`signals` make lines of it, which `layout` arranges for the terminal's size. `terminal` runs the
`app`; `plain_text` is for a pipe.
"""
