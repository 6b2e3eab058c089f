"""Core of the gateway: every decision, no input or output.

No clock, socket, file, thread or log is used here. Time is an argument, in integer
nanoseconds of the monotonic clock.
"""
