"""When STOPPING has done its duty: enough safe frames left, or cannot leave."""

_TICKS = 3
_TICKS_AT_MOST = 10


class Shutdown:
    """Counts the ticks of STOPPING."""

    def __init__(self) -> None:
        self._ticks = 0
        self._unsent_ticks = 0
        self._unsent_in_tick = False

    def note_tick(self, stopping: bool) -> None:
        """A tick begins to be sent."""
        self._unsent_ticks += self._unsent_in_tick and self._ticks > 0
        self._unsent_in_tick = False
        self._ticks += stopping

    def note_unsent(self) -> None:
        """A frame of this tick was not taken by the bus."""
        self._unsent_in_tick = True

    def over(self, talking: bool) -> bool:
        """True where the safe frames were sent, or cannot be; asked after each tick's sending."""
        sent_ticks = self._ticks - self._unsent_ticks - self._unsent_in_tick
        given_up = self._ticks >= _TICKS_AT_MOST or not talking
        return self._ticks > 0 and (sent_ticks >= _TICKS or given_up)
