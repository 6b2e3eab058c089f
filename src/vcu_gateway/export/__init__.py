"""Export of recorded drives and foreign logs: MF4, CSV, Parquet, MCAP and one HTML page.

Frames are kept as they were recorded, by message, and decoded by the gateway's codec when their
table is written. Libraries that only a second environment has are imported by the module of their
format alone.
"""
