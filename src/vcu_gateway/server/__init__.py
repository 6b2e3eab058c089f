"""JSON-RPC on a Unix socket, between the ticks."""
