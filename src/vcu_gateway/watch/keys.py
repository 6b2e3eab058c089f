"""What the keys do, as one line and as a page."""

HINTS = "q quit  space pause  m message  / find  e stop  d disarm  ? help"

NAMES = {"estop": "emergency stop", "disarm": "disarming"}
"""The two requests, as a person reads them."""

_QUESTIONS = {
    "estop": "Emergency stop: cut the power of both controllers? Shift-E yes, Esc no",
    "disarm": "Disarm: from active to standby? Shift-D yes, Esc no",
}


def confirmation(what: str) -> str:
    """The question that stands between the two keys of a request."""
    return _QUESTIONS[what]


HELP = """\
Keys
  q, Ctrl-C       quit; the gateway goes on
  up, down        scroll the signals by a line; PgUp, PgDn by a page
  Home, End       to either end of them
  space, p        let the picture stand still, and go on
  m, M            the next message alone, the one before; all of them at the end
  /               find a part of a name: Enter keeps it, Esc shows all again
  e then E        emergency stop: cuts the power of both controllers
  d then D        disarm: from active to standby
  ?, h            this page, and back

Words
  told, reports   what a controller was commanded, and what it sends back
  max             a limit that it was told
  temp            of the controller / of the motor
  !               the value is not good; the list of signals says why
  good            may be relied upon; out of range, saturated, stale, never may not
  foreign         command frames of another sender
  late ms         how late the ticks of 50 ms began: half, 99 %, all of them
  old             the gateway has gone; this is what it said last
"""
