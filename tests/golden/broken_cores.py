"""Cores with one mistake for which the gate has to act: without one no recording shows the gate.

The gate checks what the rest of the core decides, and that never breaks a rule of the gate. So
mutants of the gate are shown beside a mistake elsewhere: the mistake alone gives one drive, with
events of the gate and safe frames, and a mutant of the gate has to give another one.
"""

from typing import NamedTuple

from tests.mutation.run import CORE


class BrokenCore(NamedTuple):
    """A mistake in a module of the core, and the golden drives that show it.

    Attributes:
        blocked: the rule of the gate that it breaks.
        old, new: the text that is changed; it stands once in the module.
    """

    blocked: str
    module: str
    old: str
    new: str
    drives: tuple[str, ...]

    def told(self) -> str:
        """Which mistake, for a report."""
        return f"with {self.blocked} broken: {self.drives[0]}"

    def source(self) -> str:
        """The module with the mistake."""
        text = (CORE / f"{self.module}.py").read_text(encoding="utf-8")
        assert text.count(self.old) == 1, f"{self.module}.py: {self.old!r} stands there otherwise"
        return text.replace(self.old, self.new)


BROKEN_CORES = (
    BrokenCore(
        "throttle_slew",
        "commands",
        "throttle_pct=min(demanded.throttle_pct, throttle_max_pct)",
        "throttle_pct=demanded.throttle_pct",
        ("pedals", "late-ticks", "refused"),
    ),
    BrokenCore(
        "speed_slew",
        "commands",
        "return max(target_rpm, sent_rpm - settings.speed_slew_rpm_per_s * self._elapsed_s)",
        "return target_rpm",
        ("pedals", "reloads"),
    ),
    BrokenCore(
        "speed_limit",
        "commands",
        "target_rpm = max(_SPEED_LIMIT_MIN_RPM, min(demanded_rpm, settings.speed_limit_max_rpm))",
        "target_rpm = min(demanded_rpm, 12000.0)",
        ("other-limits", "reloads", "speed-limits"),
    ),
    *(
        # By as much as rounding may take, and by one more.
        BrokenCore(
            "speed_slew",
            "commands",
            "return max(target_rpm, sent_rpm - settings.speed_slew_rpm_per_s * self._elapsed_s)",
            "return max(target_rpm,"
            f" sent_rpm - settings.speed_slew_rpm_per_s * self._elapsed_s - {too_far_rpm})",
            ("speed-limits",),
        )
        for too_far_rpm in (1, 2)
    ),
    BrokenCore(
        "direction",
        "commands",
        "change = slow and self._standing() and not _differ(demanded, settings)",
        "change = True",
        ("directions",),
    ),
    BrokenCore(
        "unarmed",
        "gateway",
        "if mode is Mode.ACTIVE and demanded is not None:",
        "if demanded is not None:",
        ("silent-driver", "two-drivers"),
    ),
    BrokenCore(
        "power_limit",
        "commands",
        "power_limit_w=min(demanded.power_limit_w, ramps.power_w)",
        "power_limit_w=demanded.power_limit_w",
        ("other-limits", "reloads"),
    ),
    BrokenCore(
        "regeneration",
        "commands",
        "regen_brake=demanded.regen_brake and regenerates",
        "regen_brake=demanded.regen_brake",
        ("regeneration",),
    ),
    BrokenCore(
        "power_mode",
        "commands",
        "throttle_max_pct = 0.0\n",
        "pass\n",
        ("pedals",),
    ),
    BrokenCore(
        "power_mode_rise",
        "commands",
        "power_mode = lower_mode(power_mode, self.last[name].power_mode)",
        "pass",
        ("power-modes", "pedals"),
    ),
    BrokenCore(
        "directions",
        "transmit",
        "OutFrame(name, self._can_ids[name], data)",
        'OutFrame(name, self._can_ids[name], bytes((data[0] | (name == "PCU2") << 4, *data[1:])))',
        ("pedals", "directions"),
    ),
    BrokenCore(
        "asymmetry",
        "transmit",
        "OutFrame(name, self._can_ids[name], data)",
        "OutFrame(name, self._can_ids[name],"
        ' bytes((data[0], data[1] >> (name == "PCU2"), *data[2:])))',
        ("slip",),
    ),
    BrokenCore(
        "identifier",
        "transmit",
        "OutFrame(name, self._can_ids[name], data)",
        'OutFrame(name, self._can_ids["PCU1"], data)',
        ("ended-in-order",),
    ),
    BrokenCore(
        "length",
        "transmit",
        "data = codec.encode(command.signals())",
        "data = codec.encode(command.signals()) + bytes(command.throttle_pct > 0)",
        ("ended-in-order", "pedals"),
    ),
    BrokenCore(
        "unused_bits",
        "transmit",
        "data = codec.encode(command.signals())",
        "data = (int.from_bytes(codec.encode(command.signals()), 'little')"
        " | (command.throttle_pct > 0) << 24).to_bytes(8, 'little')",
        ("ended-in-order", "pedals"),
    ),
    BrokenCore(
        "unused_bits",
        "transmit",
        "data = codec.encode(command.signals())",
        "data = (int.from_bytes(codec.encode(command.signals()), 'little')"
        " | (command.throttle_pct > 0) << 6).to_bytes(8, 'little')",
        ("ended-in-order", "pedals"),
    ),
)
