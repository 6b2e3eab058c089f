"""Gateway and simulated vehicle in a process of their own: `main` is it, `process` its handle.

`process` also has what it runs, and the handle of a second process, which keeps the drive.
"""
