"""Gateway and simulated vehicle in a process of their own: `main` is it, `process` its handle.

`config` is what it runs; `recorder` is the handle of a second process, which keeps the drive.
"""
