"""`vcu-gateway doctor`: checks of this machine, and how to fix what fails.

Each subject has its facts as a value, `read` that collects them, and a pure `judge`.
Nothing here writes, sends a frame or needs root.
"""
