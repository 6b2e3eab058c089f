"""Gateway and simulated vehicle in a process of their own: `main` is it, `process` its handle.

`recorder` is the handle of a second one, which keeps the drive.
"""
