"""Spans of causes: what replay and export say of when a cause counted."""

from vcu_gateway.core.causes import Effect, Finding, HeldCause
from vcu_gateway.recording.reader import CauseSpans

SUBJECT, EFFECT = "PCU1_Status1.Throttle", Effect.STOP


def told(spans: CauseSpans, now_ns: int, name: str, cause: str) -> None:
    fields = {"cause": cause, "subject": SUBJECT, "effect": EFFECT.value, "detail": "0.0 %"}
    spans.event(name, fields, now_ns)


def held(cause: str) -> HeldCause:
    return HeldCause(Finding(cause, SUBJECT, EFFECT), 0, 0)


def times(spans: CauseSpans) -> list[tuple[str, int, int | None]]:
    return [(one.key.cause, one.began_ns, one.ended_ns) for one in spans.spans]


def both() -> CauseSpans:
    """A controller that lags echoes too little, then too much: a STOP all the time."""
    spans = CauseSpans()
    told(spans, 10, "cause_began", "echo_below")
    told(spans, 20, "cause_began", "throttle_echo")
    return spans


def test_two_causes_of_one_subject_and_effect_have_a_span_each():
    spans = both()
    told(spans, 30, "cause_ended", "echo_below")
    assert times(spans) == [("echo_below", 10, 30), ("throttle_echo", 20, None)]
    assert spans.effects == {"stop"}
    told(spans, 1100, "cause_ended", "throttle_echo")
    assert times(spans) == [("echo_below", 10, 30), ("throttle_echo", 20, 1100)]
    assert spans.effects == set()


def test_what_stands_at_a_checkpoint_goes_on_and_the_rest_has_ended():
    spans = both()
    spans.stand([held("throttle_echo"), held("stale")], 30)
    assert times(spans) == [
        ("echo_below", 10, 30),
        ("throttle_echo", 20, None),
        ("stale", 30, None),
    ]


def test_where_nothing_is_known_of_what_follows_every_cause_ends():
    spans = both()
    spans.end(40)
    assert times(spans) == [("echo_below", 10, 40), ("throttle_echo", 20, 40)]
    assert spans.effects == set()


def test_a_cause_that_is_told_twice_goes_on_from_its_first_time():
    spans = both()
    told(spans, 30, "cause_began", "echo_below")
    told(spans, 40, "cause_ended", "echo_below")
    assert times(spans) == [("echo_below", 10, 40), ("throttle_echo", 20, None)]


def test_other_events_and_an_end_without_a_beginning_change_no_span():
    spans = CauseSpans()
    told(spans, 10, "cause_ended", "echo_below")
    told(spans, 20, "cause_began", "echo_below")
    told(spans, 30, "frame_blocked", "echo_below")
    assert times(spans) == [("echo_below", 20, None)]


def test_beyond_the_most_spans_the_effects_are_still_known():
    spans = CauseSpans(most=1)
    told(spans, 10, "cause_began", "echo_below")
    told(spans, 20, "cause_began", "throttle_echo")
    told(spans, 30, "cause_ended", "echo_below")
    assert times(spans) == [("echo_below", 10, 30)]
    assert spans.effects == {"stop"}
