"""Bytes to messages: halves wait, rubbish is refused, errors become exceptions."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.client import (
    ApiError,
    ConfigRefusedError,
    GarbledError,
    NoRightError,
    RefusedError,
    jsonrpc,
)

RESULT = b'{"jsonrpc":"2.0","id":7,"result":{"mode":"standby"}}\n'
UPDATE = b'{"jsonrpc":"2.0","method":"state.update","params":{"lost":0}}\n'


def answer_with(failure: RequestError, request_id: int | None = 7) -> jsonrpc.Response:
    line = json.dumps({"jsonrpc": "2.0", "id": request_id, "error": failure.as_json()})
    (answer,) = jsonrpc.MessageDecoder().feed(line.encode() + b"\n")
    assert isinstance(answer, jsonrpc.Response)
    return answer


def test_a_request_is_one_line_of_json_rpc():
    line = jsonrpc.request(7, "events", {"limit": 3})
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    assert json.loads(line) == {
        "jsonrpc": "2.0",
        "id": 7,
        "method": "events",
        "params": {"limit": 3},
    }


def test_a_line_break_inside_a_value_does_not_end_the_line():
    assert jsonrpc.request(1, "demand.release", {"source": "a\nb"}).count(b"\n") == 1


def test_a_number_that_json_does_not_have_is_not_sent():
    with pytest.raises(ValueError, match="JSON"):
        jsonrpc.request(1, "state.subscribe", {"rate_hz": float("nan")})


def test_half_a_line_waits_for_its_end():
    inbox = jsonrpc.MessageDecoder()
    assert inbox.feed(RESULT[:20]) == []
    assert inbox.feed(RESULT[20:]) == [jsonrpc.Response(7, {"mode": "standby"}, None)]


def test_two_lines_at_once_are_two_messages_in_order():
    messages = jsonrpc.MessageDecoder().feed(UPDATE + RESULT)
    assert [type(one) for one in messages] == [jsonrpc.Notification, jsonrpc.Response]


@given(st.lists(st.integers(0, len(RESULT + UPDATE) * 2), max_size=8))
def test_wherever_the_bytes_are_cut_the_messages_are_the_same(cuts):
    stream = (RESULT + UPDATE) * 2
    inbox, messages, at = jsonrpc.MessageDecoder(), [], 0
    for cut in [*sorted(cuts), len(stream)]:
        messages += inbox.feed(stream[at:cut])
        at = max(at, cut)
    assert messages == jsonrpc.MessageDecoder().feed(stream)


@pytest.mark.parametrize(
    "line",
    [
        b"HTTP/1.1 400 Bad Request",
        b"\xff\xfe",
        b"",
        b"[]",
        b"7",
        b'{"id":7,"result":1}',
        b'{"jsonrpc":"1.0","id":7,"result":1}',
        b'{"jsonrpc":"2.0","id":7}',
        b'{"jsonrpc":"2.0","id":7,"result":1,"error":{"code":-1,"message":""}}',
        b'{"jsonrpc":"2.0","id":"seven","result":1}',
        b'{"jsonrpc":"2.0","id":true,"result":1}',
        b'{"jsonrpc":"2.0","id":7,"error":"no"}',
        b'{"jsonrpc":"2.0","id":7,"error":{"message":"no code"}}',
        b'{"jsonrpc":"2.0","method":7}',
        b'{"jsonrpc":"2.0","method":"state.update","params":[1]}',
        b"[" * 100_000,
        b'{"jsonrpc":"2.0","id":' + b"9" * 5000 + b',"result":1}',
    ],
)
def test_what_is_no_answer_is_garbled(line):
    with pytest.raises(GarbledError):
        jsonrpc.MessageDecoder().feed(line + b"\n")


@given(st.binary(max_size=200))
def test_any_bytes_are_messages_or_garbled(data):
    try:
        jsonrpc.MessageDecoder().feed(data)
    except GarbledError:
        return


def test_a_line_without_an_end_is_garbled_before_it_fills_the_memory():
    inbox = jsonrpc.MessageDecoder()
    inbox.feed(b"x" * jsonrpc.MAX_LINE_BYTES)
    with pytest.raises(GarbledError, match="more than"):
        inbox.feed(b"x")


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        (ErrorCode.REFUSED, RefusedError),
        (ErrorCode.NO_RIGHT, NoRightError),
        (ErrorCode.CONFIG_REFUSED, ConfigRefusedError),
        (ErrorCode.INVALID_PARAMS, ApiError),
        (ErrorCode.NOT_READY, ApiError),
    ],
)
def test_each_error_of_the_contract_is_raised_as_its_kind(code, kind):
    with pytest.raises(ApiError) as raised:
        answer_with(RequestError(code, "the sentence")).value()
    assert type(raised.value) is kind
    assert raised.value.code == code.value
    assert raised.value.word == code.name.lower()
    assert str(raised.value) == raised.value.sentence == "the sentence"


def test_a_refusal_carries_its_machine_word():
    error = answer_with(RequestError(ErrorCode.REFUSED, "no", refusal="other_owner")).error
    assert error is not None
    assert error.refusal == "other_owner"


def test_a_refused_configuration_carries_every_problem():
    error = answer_with(RequestError(ErrorCode.CONFIG_REFUSED, "no", problems=("one", "two"))).error
    assert error is not None
    assert error.problems == ("one", "two")


def test_an_error_without_data_still_has_a_word():
    line = b'{"jsonrpc":"2.0","id":7,"error":{"code":-32601,"message":"no"}}\n'
    (answer,) = jsonrpc.MessageDecoder().feed(line)
    assert answer.error.word == "method_not_found"


def test_the_gateways_own_word_counts():
    error = b'{"code":-32099,"message":"new","data":{"word":"too_warm"}}'
    (answer,) = jsonrpc.MessageDecoder().feed(b'{"jsonrpc":"2.0","id":7,"error":' + error + b"}\n")
    assert answer.error.word == "too_warm"


def test_an_error_of_a_later_gateway_is_an_api_error_of_an_unknown_word():
    line = b'{"jsonrpc":"2.0","id":7,"error":{"code":-32099,"message":"new"}}\n'
    (answer,) = jsonrpc.MessageDecoder().feed(line)
    assert (type(answer.error), answer.error.word) == (ApiError, "unknown")


@pytest.mark.parametrize("error", [None, ApiError(-32004, "not_ready", "try again")])
def test_an_answer_ends_its_own_request_only(error):
    answer = jsonrpc.Response(7, {}, error)
    assert answer.concerns(7)
    assert not answer.concerns(8)


def test_the_value_of_an_answer_is_its_result():
    assert jsonrpc.Response(7, {"mode": "standby"}, None).value() == {"mode": "standby"}


def test_an_error_without_an_id_ends_whatever_waits():
    assert answer_with(RequestError(ErrorCode.TOO_MANY_CLIENTS, "full"), request_id=None).concerns(
        8
    )
    assert not jsonrpc.Response(None, {}, None).concerns(8)
