"""Live view: pure functions from a view model to lines of text, and a Textual app over them.

`source` fills the view model from the client. `figures` and `signals` make lines of it, which
`layout` arranges for the terminal's size. `terminal` runs the `app`.
"""
