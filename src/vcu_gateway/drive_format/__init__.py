"""Recorded drives as bytes: names, gzip members, candump lines, and the tap's datagrams.

The contract between the gateway, which hands on, the recorder, which writes, and the tools, which
read. Standard library alone; nothing of the core.
"""
