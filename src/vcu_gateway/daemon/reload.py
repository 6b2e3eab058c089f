"""Reload: a new configuration for the running program, all of it or nothing."""

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway import config as configuration
from vcu_gateway.config import Config
from vcu_gateway.config.tuning import TUNING_SECTIONS, flat
from vcu_gateway.core.calls import ReloadSettings
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.settings import KEYS, RESTART_ONLY, Reload, loosened
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.daemon.events import EventLog
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.errors import GatewayError, Problem


class ReloadOutcome(NamedTuple):
    """Outcome of a reload: names of the changed keys, or the problems, a sentence each."""

    taken: bool
    changed: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


class Reloader:
    """Reads and checks the file on a thread of its own, and hands it to the ticking thread.

    Attributes:
        config: the configuration in effect; replaced whole, on the ticking thread.
    """

    def __init__(self, config: Config, protocol: ProtocolSpec, loop: TickLoop) -> None:
        self.config = config
        self._protocol = protocol
        self._loop = loop
        self._busy = threading.Lock()

    def begin(self, done: Callable[[ReloadOutcome], None] = lambda _: None) -> None:
        """Start; `done` is called once, on the ticking thread, or here where one runs already.

        Without it, as for SIGHUP, the event log alone tells the outcome.
        """
        if not self._busy.acquire(blocking=False):
            done(_refused("a reload is under way already"))
            return
        try:
            threading.Thread(target=self._read, args=(done,), name="reload", daemon=True).start()
        except RuntimeError as error:  # no memory or no more threads: no reason to stop a vehicle
            self._busy.release()
            outcome = _refused(f"a reload cannot be begun: {error}")
            done(self._reported(outcome))

    def _read(self, done: Callable[[ReloadOutcome], None]) -> None:
        new: Config | None = None
        problems: list[Problem] = []
        try:
            new = configuration.load(Path(self.config.source.file))
            problems += configuration.check_against(new, self._protocol)
        except GatewayError as error:
            problems += error.problems
        self._busy.release()
        found = [str(problem) for problem in problems]
        self._loop.work_queue.post(lambda: done(self._reported(self._take(new, found))))

    def _take(self, new: Config | None, problems: Sequence[str]) -> ReloadOutcome:
        """On the ticking thread: the checks that depend on what is in effect, and the change."""
        if new is None or problems:
            return _refused(*problems)
        names = changed(self.config, new)
        if fixed := [name for name in names if not is_live(name)]:
            return _refused(*(f"{name} needs a restart" for name in fixed))
        gateway, settings = self._loop.gateway, configuration.core_settings(new)
        answer = gateway.apply(ReloadSettings(settings))
        if not answer.granted:
            looser = loosened(gateway.settings, settings) if gateway.mode is Mode.ACTIVE else ()
            why = [_in_a_drive(name) for name in looser] or [answer.sentence]
            return _refused(*why)
        self.config = new
        return ReloadOutcome(True, changed=names)

    def _reported(self, outcome: ReloadOutcome) -> ReloadOutcome:
        if outcome.taken:
            report_effect(self.config, self._loop.event_log)
            digest = configuration.digest(self.config)
            new = {"changed": list(outcome.changed), "digest": digest}
            self._loop.event_log.emit(Event("config_reloaded", Severity.INFO, new))
        else:
            fields = {"problems": list(outcome.problems)}
            self._loop.event_log.emit(Event("config_refused", Severity.ERROR, fields))
        return outcome


def _refused(*problems: str) -> ReloadOutcome:
    return ReloadOutcome(False, problems=problems)


def _in_a_drive(name: str) -> str:
    """Which way this setting may change while the vehicle can move, if any."""
    key = KEYS.get(name)
    if key is None:
        lower = "may only become a curve that is nowhere higher while active"
        none = "cannot change while active; disarm first"
        return f"{name} {lower if name.startswith('curves.') else none}"
    direction = {Reload.SMALLER: "smaller", Reload.LARGER: "larger"}.get(key.reload)
    if direction is None:
        return f"{key.section}.{name} cannot change while active; disarm first"
    return f"{key.section}.{name} may only become {direction} while active"


def report_effect(config: Config, event_log: EventLog) -> None:
    """One event where values of the configuration in effect have no effect."""
    if problems := [str(problem) for problem in configuration.check_effect(config)]:
        event_log.emit(Event("config_warning", Severity.WARNING, {"problems": problems}))


def changed(before: Config, after: Config) -> tuple[str, ...]:
    """Dotted names of the keys whose effective values differ."""
    old, new = _flat(before), _flat(after)
    return tuple(name for name in dict.fromkeys([*old, *new]) if old.get(name) != new.get(name))


def is_live(name: str) -> bool:
    """True where a running gateway takes this key, a dotted name; the others need a restart."""
    section, _, key = name.partition(".")
    if section in TUNING_SECTIONS:
        return name not in RESTART_ONLY
    setting = KEYS.get(key)
    return setting is not None and setting.section == section and setting.reload is not Reload.NEVER


def _flat(config: Config) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for section, keys in configuration.effective(config).items():
        if section in TUNING_SECTIONS:
            values |= flat(keys, section)
        else:
            values |= {f"{section}.{key}": value for key, value in keys.items()}
    return values
