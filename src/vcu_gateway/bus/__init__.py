"""The door to the bus: the only place of the daemon that knows python-can."""
