"""Texts about the keys: hints, help and confirmations."""

HINTS = "q quit  space pause  m message  / find  e stop  d disarm  ? help"

NAMES = {"estop": "emergency stop", "disarm": "disarming"}
"""Request names for people."""

_QUESTIONS = {
    "estop": "Emergency stop: cut the power of both controllers? Shift-E yes, Esc no",
    "disarm": "Disarm: from active to standby? Shift-D yes, Esc no",
}


def confirmation(what: str) -> str:
    return _QUESTIONS[what]


HELP = """\
Keys
  q, Ctrl-C       quit; the gateway goes on
  up, down        scroll the signals by a line; PgUp, PgDn by a page
  Home, End       to either end of them
  space, p        freeze the view, and resume
  m, M            only the next message, the one before; all of them at the end
  /               find a part of a name: Enter keeps it, Esc shows all again
  e then E        emergency stop: cuts the power of both controllers
  d then D        disarm: from active to standby
  ?, h            this page, and back

Words
  commanded       what the gateway sent to a controller
  reported        what the controller sends back
  max             a commanded limit
  temp            of the controller / of the motor
  !               the value is not good; the list of signals says why
  good            valid; out of range, saturated, stale and never are not
  foreign         command frames of another sender
  late ms         lateness of the 50 ms ticks: median, 99th percentile, maximum
  old             the gateway is not reachable; these are its last values
"""
