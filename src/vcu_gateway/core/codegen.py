"""Code generation: the Python source of a message's decoder and encoder.

Theory of operation
-------------------
A decoder runs for every received frame, so nothing is looked up in it: `plan` decides once where
each signal comes from, `decoder` and `encoder` write that down as straight-line source, and
`codec.compile_message` compiles it. Only numbers and names of the protocol go into the source.

- A signal of whole bytes in the order of the frame is moved by one call of struct: r<i>.
- A signal inside one byte is shifted out of that byte: b<k>.
- A signal that crosses bytes in another way comes from all 64 bits at once: q.

Of VCU_PCU1_Command (four signals in byte 0, two bytes, two words) these come out, but for the
breaks in the line of `return Decoded`:

    def decode(data):
        (b0, r4, r5, r6, r7, ) = unpack(data)
        r0 = b0 >> 2 & 3
        r1 = b0 >> 4 & 1
        r2 = b0 >> 5 & 1
        r3 = b0 >> 7
        raws = (r0, r1, r2, r3, r4, r5, r6, r7, )
        return Decoded(((r0, r1, r2, r3, r4 * 0.39, r5 * 0.39, r6, r7, ), raws,
            0 if r6 <= 12000 and r7 <= 60000
            else (0 if r6 <= 12000 else 64) | (0 if r7 <= 60000 else 128)))

    def encode(values):
        try:
            x = values['PowerMode']
            r0 = x.__round__() if 0 < x < 3 else 3 if x >= 3 else 0
            r1 = 1 if values['MotorReverse'] > 0.5 else 0
            r2 = 1 if values['RegenBrake'] > 0.5 else 0
            r3 = 1 if values['PowerCut'] > 0.5 else 0
            x = values['Throttle'] / 0.39
            r4 = x.__round__() if 0.0 < x < 255.0 else 255 if x >= 255.0 else 0
            x = values['Brake'] / 0.39
            r5 = x.__round__() if 0.0 < x < 255.0 else 255 if x >= 255.0 else 0
            x = values['SpeedLimit']
            r6 = x.__round__() if 0.0 < x < 12000.0 else 12000 if x >= 12000.0 else 0
            x = values['PowerLimit']
            r7 = x.__round__() if 0.0 < x < 60000.0 else 60000 if x >= 60000.0 else 0
        except (KeyError, OverflowError):
            return encode(complete(values))
        return pack(r0 << 2 | r1 << 4 | r2 << 5 | r3 << 7, r4, r5, r6, r7)

The last item of `Decoded` has bit i set where signal i is not good. The encoder saturates: every
comparison with NaN is false, so that NaN becomes the lowest code.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from vcu_gateway.core.spec import FRAME_LENGTH_BYTES, MessageSpec, SignalSpec, plain

_STRUCT_CODES = {8: "B", 16: "H", 32: "I", 64: "Q"}
_EXACT_FLOAT_BITS = 53


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a frame: signal i becomes r<i>, byte k becomes b<k>.

    Attributes:
        struct_format: of the eight bytes.
        fields: the names that struct fills, in the order of the bytes.
        byte_of: signal index -> byte that it shares with others.
        crossing: indices of the signals that no field holds.

    """

    struct_format: str
    fields: tuple[str, ...]
    byte_of: dict[int, int]
    crossing: frozenset[int]


def plan(message: MessageSpec) -> Layout:
    """Layout of a message: where each of its signals comes from."""
    signals = message.signals
    orders = {signal.byte_order for signal in signals if signal.length_bits > 8}
    order = "big" if orders == {"big"} else "little"
    whole = {
        signal.start_bit // 8: (i, code)
        for i, signal in enumerate(signals)
        if (code := _struct_code(signal, order))
    }
    held = {i for i, _ in whole.values()}
    bytes_of = {
        i: {position // 8 for position in signal.bit_positions()}
        for i, signal in enumerate(signals)
        if i not in held
    }
    byte_of = {i: min(touched) for i, touched in bytes_of.items() if len(touched) == 1}
    codes, fields, free_from = [">" if order == "big" else "<"], [], 0
    for byte in range(FRAME_LENGTH_BYTES):
        if byte in whole:
            index, code = whole[byte]
            fields.append(f"r{index}")
            codes.append(code)
            free_from = byte + signals[index].length_bits // 8
        elif byte in byte_of.values():
            fields.append(f"b{byte}")
            codes.append("B")
        elif byte >= free_from:
            codes.append("x")
    crossing = frozenset(bytes_of.keys() - byte_of.keys())
    return Layout("".join(codes), tuple(fields), byte_of, crossing)


def _struct_code(signal: SignalSpec, order: str) -> str | None:
    """Struct code for a signal of whole bytes in this order, or None."""
    code = _STRUCT_CODES.get(signal.length_bits)
    first = 0 if signal.byte_order == "little" else 7
    if code is None or signal.start_bit % 8 != first:
        return None
    if signal.length_bits > 8 and signal.byte_order != order:
        return None
    return code.lower() if signal.signed else code


def decoder(message: MessageSpec, layout: Layout) -> str:
    """Source of `decode(data)`; it needs unpack, unpack_all and Decoded."""
    signals = message.signals
    raws = tuple(f"r{i}" for i in range(len(signals)))
    lines = ["def decode(data):"]
    if layout.fields:
        keep = "raws = " if layout.fields == raws else ""
        lines.append(f"    {keep}{_tuple(layout.fields)} = unpack(data)")
    if layout.crossing:
        lines.append("    (q,) = unpack_all(data)")
    lines += [
        f"    r{i} = {_raw_expression(signal, layout.byte_of.get(i))}"
        for i, signal in enumerate(signals)
        if f"r{i}" not in layout.fields
    ]
    if layout.fields != raws or not raws:
        lines.append(f"    raws = {_tuple(raws)}")
    values = tuple(_value_expression(i, signal) for i, signal in enumerate(signals))
    values_source = "raws" if values == raws else _tuple(values)
    lines.append(f"    return Decoded(({values_source}, raws, {_marks(signals)}))")
    return "\n".join(lines)


def _tuple(parts: Iterable[str]) -> str:
    return "(" + "".join(part + ", " for part in parts) + ")"


def _raw_expression(signal: SignalSpec, byte: int | None) -> str:
    """The signal's code, from its byte or from all 64 bits."""
    if byte is not None:
        bits = _masked(f"b{byte}", signal.bit_positions()[0] % 8, signal.length_bits, 8)
    elif signal.byte_order == "little":
        bits = _masked("q", signal.start_bit, signal.length_bits, 64)
    else:
        bits = " | ".join(_big_endian_parts(signal))
    if not signal.signed:
        return bits
    # Flip the sign bit, then take its weight off again: two's complement without a branch.
    half = 1 << (signal.length_bits - 1)
    return f"(({bits}) ^ {half}) - {half}"


def _masked(name: str, shift: int, length_bits: int, width_bits: int) -> str:
    shifted = f"{name} >> {shift}" if shift else name
    return shifted if shift + length_bits == width_bits else f"{shifted} & {_mask(length_bits)}"


def _mask(length_bits: int) -> int:
    return (1 << length_bits) - 1


def _big_endian_parts(signal: SignalSpec) -> list[str]:
    """One term per byte that the signal touches."""
    runs: dict[int, list[tuple[int, int]]] = {}
    for weight, position in enumerate(signal.bit_positions()):
        runs.setdefault(position // 8, []).append((weight, position))
    return [
        f"(q >> {position} & {_mask(len(run))}) << {weight}"
        for run in runs.values()
        for weight, position in run[:1]
    ]


def _value_expression(index: int, signal: SignalSpec) -> str:
    value = f"r{index}"
    if signal.factor != 1:
        value += f" * {plain(signal.factor)!r}"
    if signal.offset != 0:
        value += f" + {plain(signal.offset)!r}"
    return value


def _marks(signals: tuple[SignalSpec, ...]) -> str:
    """Bit i where signal i is not good; one test where all are."""
    checks = {i: _good_expression(i, signal) for i, signal in enumerate(signals)}
    checks = {i: check for i, check in checks.items() if check}
    if not checks:
        return "0"
    bits = " | ".join(f"(0 if {check} else {1 << i})" for i, check in checks.items())
    return f"0 if {' and '.join(checks.values())} else {bits}"


def _good_expression(index: int, signal: SignalSpec) -> str:
    """Test of a code inside the range and not saturated; empty where every code is good."""
    raw, parts = f"r{index}", []
    lowest, highest = signal.raw_minimum, signal.raw_maximum
    if signal.saturated_raw == highest:
        highest -= 1
    elif signal.saturated_raw is not None and lowest <= signal.saturated_raw < highest:
        parts.append(f"{raw} != {signal.saturated_raw}")
    if lowest > signal.raw_lowest:
        parts.append(f"{raw} >= {lowest}")
    if highest < signal.raw_highest:
        parts.append(f"{raw} <= {highest}")
    return " and ".join(parts)


def encoder(message: MessageSpec, layout: Layout) -> str:
    """Source of `encode(values)`; it needs pack, pack_all and complete."""
    signals = message.signals
    coded = [line for i, signal in enumerate(signals) for line in _saturating_lines(i, signal)]
    # A name left out, or an int beyond every float, is rare: the common way pays nothing for it.
    lines = [
        "def encode(values):",
        "    try:",
        *(coded or ["        pass"]),
        "    except (KeyError, OverflowError):",
        "        return encode(complete(values))",
        _pack_line(signals, layout),
    ]
    return "\n".join(lines)


def _saturating_lines(index: int, signal: SignalSpec) -> list[str]:
    """Code number `index` into r<index>, nearest and inside the range; NaN is the lowest."""
    low, high, raw = signal.raw_minimum, signal.raw_maximum, f"r{index}"
    scaled = f"values[{signal.name!r}]"
    if signal.offset != 0:
        scaled = f"({scaled} - {plain(signal.offset)!r})"
    if signal.factor != 1:
        scaled += f" / {plain(signal.factor)!r}"
    if (low, high) == (0, 1):
        return [f"        {raw} = 1 if {scaled} > 0.5 else 0"]
    above, below = _limit(signal, low), _limit(signal, high)
    # round() calls the same method, after a search that costs as much again.
    inside, outside = "x.__round__()", f"{high} if x >= {below} else {low}"
    return [
        f"        x = {scaled}",
        f"        {raw} = {inside} if {above} < x < {below} else {outside}",
    ]


def _limit(signal: SignalSpec, raw: int) -> float:
    """Code to compare with: quantities come as floats, and like is compared with like faster."""
    exact = signal.length_bits <= _EXACT_FLOAT_BITS
    return float(raw) if exact and not signal.names else raw


def _pack_line(signals: tuple[SignalSpec, ...], layout: Layout) -> str:
    if layout.crossing:
        everything = " | ".join(_placed_in_frame(i, signal) for i, signal in enumerate(signals))
        return f"    return pack_all({everything})"
    shared: dict[str, list[str]] = {}
    for index, byte in layout.byte_of.items():
        shift = signals[index].bit_positions()[0] % 8
        shared.setdefault(f"b{byte}", []).append(_placed(index, signals[index], shift))
    fields = (" | ".join(shared[field]) if field in shared else field for field in layout.fields)
    return f"    return pack({', '.join(fields)})"


def _placed(index: int, signal: SignalSpec, shift: int) -> str:
    raw = f"(r{index} & {_mask(signal.length_bits)})" if signal.signed else f"r{index}"
    return f"{raw} << {shift}" if shift else raw


def _placed_in_frame(index: int, signal: SignalSpec) -> str:
    if signal.byte_order == "little":
        return _placed(index, signal, signal.start_bit)
    return " | ".join(
        f"(r{index} >> {weight} & 1) << {position}"
        for weight, position in enumerate(signal.bit_positions())
    )
