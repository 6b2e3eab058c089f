"""The local API: JSON-RPC 2.0, one message a line, over a Unix stream socket."""
