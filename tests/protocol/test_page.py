"""What docs/protocol.md says around its tables."""

import re

import pytest
from scripts.documents import protocol_page

from vcu_gateway.protocol import dbc, definition, packaged

TEXT = packaged("vcu.yaml").read_text(encoding="utf-8")


def written(*replaced: tuple[str, str]) -> list[str]:
    """The lines of the page after these changes to the definition."""
    text = TEXT
    for old, new in replaced:
        assert old in text
        text = text.replace(old, new)
    return protocol_page.write(definition.parse(text)).splitlines()


def line(beginning: str, lines: list[str]) -> str:
    (found,) = [one for one in lines if one.startswith(beginning)]
    return found


def test_every_erratum_has_a_title_a_decision_and_an_anchor():
    listed = [one for one in written() if one.startswith("- ")]
    for number, one in enumerate(listed, 1):
        anchor = f'- <a id="e{number}"></a>**E{number} '
        assert one.startswith(anchor)
        assert re.search(r"\*\*E\d+ [^*]+\.\*\* .+\.\)?$", one)
    assert len(listed) == 14


def test_the_page_names_its_source_and_sends_to_the_decisions():
    said = line("Source: the vehicle's signal table", written())
    assert "[Errata and decisions](#errata-and-decisions)" in said
    assert "## Errata and decisions" in written()


def test_the_bit_rate_is_the_definitions():
    rate = ("bit_rate_default_bit_s: 250000", "bit_rate_default_bit_s: 500000")
    assert "250 kbit/s by default" in line("CAN 2.0B", written())
    assert "500 kbit/s by default" in line("CAN 2.0B", written(rate))


def test_an_identifier_that_names_no_receiver_is_told():
    assert line("P is the priority", written()).endswith(" but 0x08F02DE2.")
    to_one = ("  - {id: 0x08F02DE2", "  - {id: 0x08EFD0E2")
    assert line("P is the priority", written(to_one)).endswith("in all identifiers here.")


def test_a_message_of_the_other_byte_order_is_told():
    assert "is the low one (E5). " in line("B1 to B8", written())
    period = "period_ms: 100\n    byte_order: "
    said = line("B1 to B8", written((f"{period}little", f"{period}big")))
    assert "is the low one (E5) but ARD2_SteeringWheel. " in said


def test_every_reading_of_the_source_is_a_paragraph_before_the_messages():
    lines = written(("readings:\n", "readings:\n  - A first one.\n"))
    first = lines.index("A first one.")
    assert lines[first + 2].startswith('The source writes bit ranges as "0-1 (LSB)"')
    assert lines[first + 4].startswith("| message |")


@pytest.mark.parametrize(
    ("message", "printed"),
    [
        ("PCU1_Status2", "the same"),
        ("PCU2_Status2", "the same as controller 1, SA 168"),
        ("VCU_PCU2_Command", "PS is 168"),
        ("IMU_AngularRate", "0x240BD079"),
    ],
)
def test_a_message_has_its_identifier_as_the_source_has_it(message, printed):
    assert line(f"| [{message}]", written()).split(" | ")[2] == printed


def test_what_the_page_alone_says_of_a_message_follows_its_comment():
    lines = written()
    said = lines[lines.index("## PCU2_Status1") + 2]
    assert said.endswith("state1. B1 to B3 are laid out as in the command: they are what the "
                         "controller says it obeys.")  # fmt: skip
    lines = written(('comment: "Attitude. ', 'note: "Alone. '))
    assert lines[lines.index("## IMU_Attitude") + 2].startswith("Alone. The source: ")


def test_the_page_says_what_an_own_definition_may_change():
    lines = written()
    at = lines.index("## What your own definition may change")
    assert {one.split(" | ")[0] for one in lines[at:] if one.startswith("| ")} >= {
        *("| messages", "| signals", "| identifiers", "| periods", "| commands"),
    }
    assert f"see docs/protocol.md, {lines[at].removeprefix('## ')}" == dbc.REMEDY
