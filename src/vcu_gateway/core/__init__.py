"""The core: it decides and touches nothing.

No clock, socket, file, thread or log is used here. Time is an argument, in integer
nanoseconds of the monotonic clock.
"""
