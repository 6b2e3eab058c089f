"""Which connection a source name belongs to."""


class Sources:
    """A source name is the connection's that first made a demand in its name, until it ends.

    Belongs to the ticking thread.
    """

    def __init__(self) -> None:
        self._owners: dict[str, int] = {}

    def owner_of(self, source: str) -> int | None:
        """Number of the connection; None where the name is free."""
        return self._owners.get(source)

    def note(self, source: str, connection: int) -> None:
        """This connection made a demand in this name."""
        self._owners[source] = connection

    def forget(self, connection: int) -> tuple[str, ...]:
        """The connection has ended; the names that were its own."""
        own = tuple(name for name, owner in self._owners.items() if owner == connection)
        for name in own:
            del self._owners[name]
        return own
