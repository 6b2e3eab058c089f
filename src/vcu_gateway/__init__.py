"""Vehicle-control-unit gateway for a two-motor electric vehicle on Linux SocketCAN."""

__version__ = "0.1.0"
