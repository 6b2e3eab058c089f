"""`vcu-gateway doctor`: is this machine ready to drive, and what mends what is not?

Each room has the facts of one subject as a value, a thin reader of them, and a pure judgement.
Nothing here writes, sends a frame or needs root.
"""
