"""CAN bus: connection, SocketCAN, reconnecting, interface state; the home of python-can."""
