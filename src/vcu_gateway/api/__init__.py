"""The contract of the API: methods, results, errors and rights; no sockets, no gateway."""
