"""JSON-RPC codec: requests, refusals and the errors that answer them."""

import json
import time

import pytest

from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.api.methods import ControllerParams, DemandParams, Nothing, StateParams
from vcu_gateway.server import jsonrpc
from vcu_gateway.server.session import MAX_LINE_BYTES, LineBuffer

WORST_MS = 30.0  # on a busy machine; about 1 on a quiet one

HEALTHY = {"jsonrpc": "2.0", "id": 7, "method": "state.get", "params": {"messages": ["IMU"]}}


def line_with(**changes) -> bytes:
    """The healthy request with members changed, or left out where None."""
    message = {**HEALTHY, **changes}
    return json.dumps({k: v for k, v in message.items() if v is not ...}).encode()


def refused(line: bytes) -> jsonrpc.RefusedRequest:
    answer = jsonrpc.parse(line)
    assert isinstance(answer, jsonrpc.RefusedRequest), answer
    return answer


def code_and_sentence(line: bytes):
    error = refused(line).error
    return error.code, error.sentence


def test_a_healthy_line_is_a_request():
    assert jsonrpc.parse(line_with()) == jsonrpc.Request(
        "state.get", StateParams(messages=["IMU"]), 7
    )


def test_params_may_be_left_out():
    assert jsonrpc.parse(line_with(method="arm", params=...)) == jsonrpc.Request(
        "arm", Nothing(), 7
    )


def test_a_request_without_an_id_is_a_notification():
    assert jsonrpc.parse(line_with(id=...)).id is None


def test_a_carriage_return_before_the_newline_is_as_good():
    assert isinstance(jsonrpc.parse(line_with() + b"\r"), jsonrpc.Request)


@pytest.mark.parametrize("good", ["", "a" * 64, "Grüße", 0, -(2**63), 2**64 - 1])
def test_an_id_is_a_short_string_or_an_integer_of_64_bits(good):
    assert jsonrpc.parse(line_with(id=good)).id == good


@pytest.mark.parametrize("bad", [None, 1.0, 1.5, True, [], {}, "a" * 65])
def test_any_other_id_is_refused_and_not_sent_back(bad):
    answer = refused(line_with(id=bad))
    assert answer.error.code is ErrorCode.INVALID_REQUEST
    assert "id must be" in answer.error.sentence
    assert (answer.id, answer.is_answered) == (None, True)


def test_values_for_one_controller_or_both_are_read_as_they_are():
    controllers = {"PCU1": {"throttle_pct": 5}, "PCU2": {"brake_pct": 0.5}}
    params = {"source": "pedal", "sequence": 1, "controllers": controllers}
    request = jsonrpc.parse(line_with(method="demand.set", params=params))
    assert request.params == DemandParams(
        source="pedal",
        sequence=1,
        controllers={
            "PCU1": ControllerParams(throttle_pct=5.0),
            "PCU2": ControllerParams(brake_pct=0.5),
        },
    )


ABOUT_JSON = {
    b"": "not JSON at character 1",
    b"   ": "not JSON at character",
    b"hello": "not JSON at character 1",
    b'{"jsonrpc":"2.0",': "not JSON at character",
    line_with() + b"}": "Extra data",
    b'{"a":"\x01"}': "Invalid control character",
    b"\xef\xbb\xbf" + line_with(): "BOM",
    b'{"jsonrpc":"\xff"}': "not UTF-8 at byte 13",
    b'{"jsonrpc":"\xed\xa0\x80"}': "not UTF-8 at byte",  # a surrogate in UTF-8
    b'{"jsonrpc":"\xc0\x80"}': "not UTF-8 at byte",  # overlong
    b'{"jsonrpc":"\\ud800"}': "half of a surrogate pair",
    b'{"\\udfff":1}': "half of a surrogate pair",
    b'{"id":NaN}': "NaN is no number",
    b'{"id":[{"a":Infinity}]}': "Infinity is no number",
    b'{"id":-Infinity}': "-Infinity is no number",
    b'{"id":1,"id":2}': 'duplicate key "id"',
    b'{"params":{"x":[{"a":1,"b":2,"a":1}]}}': 'duplicate key "a"',
    b'{"id":1' + b"0" * 20 + b"}": "an integer needs more than 64 bits",
    b'{"id":1' + b"0" * 5000 + b"}": "too many digits",
    b'{"id":' + b"[" * 16 + b"]" * 16 + b"}": "nested more than 16 deep",
    b"[" * 2000 + b"]" * 2000: "nested more than 16 deep",
    b'{"a":' * 2000 + b"1" + b"}" * 2000: "nested more than 16 deep",
    b'{"b":1,"a":1,"a":1}': 'duplicate key "a"',
    b"[" + b"1," * 512 + b"1]": "more than 512 values",
    b"[[1],[" + b"1," * 509 + b"1]]": "more than 512 values",
    b'{"a":' * 17 + b"1" + b"}" * 17: "nested more than 16 deep",
    b"[" * MAX_LINE_BYTES: "more commas and brackets",
    b"[" + b"1," * 30000 + b"1]": "more commas and brackets",
}


@pytest.mark.parametrize(("line", "sentence"), ABOUT_JSON.items())
def test_what_is_no_strict_json_is_refused_with_a_null_id(line, sentence):
    answer = refused(line)
    assert answer.error.code is ErrorCode.PARSE_ERROR
    assert sentence in answer.error.sentence
    assert (answer.id, answer.is_answered) == (None, True)


def test_nesting_of_16_is_read():
    line = b'{"jsonrpc":"2.0","id":1,"method":"arm","params":' + b"[" * 15 + b"]" * 15 + b"}"
    assert refused(line).error.code is ErrorCode.INVALID_PARAMS


def test_512_values_are_read():
    assert refused(b"[" + b"1," * 511 + b"1]").error.code is ErrorCode.INVALID_REQUEST
    assert refused(b"[[1],[" + b"1," * 508 + b"1]]").error.code is ErrorCode.INVALID_REQUEST


def test_the_first_three_things_that_are_wrong_are_named_and_the_others_counted():
    sentence = code_and_sentence(line_with(params={"a": 1, "b": 1, "c": 1}))[1]
    assert sentence == "; ".join(f'there is no parameter "{name}"' for name in "abc")
    sentence = code_and_sentence(line_with(params=dict.fromkeys("abcde", 1)))[1]
    assert sentence.endswith('parameter "c"; and 2 more')


def test_a_whole_surrogate_pair_is_a_character():
    assert jsonrpc.parse(line_with(id="\U0001f600").replace(b"ud83d", b"uD83D")).id == "\U0001f600"


ABOUT_THE_REQUEST = {
    b"[]": "this is a batch; send one request a line",
    b"[" + line_with() + b"]": "this is a batch",
    b"1": "this is no object",
    b"null": "this is no object",
    b'"state.get"': "this is no object",
    b"{}": 'jsonrpc must be "2.0"',
    line_with(jsonrpc=...): 'jsonrpc must be "2.0"',
    line_with(jsonrpc="1.0"): 'jsonrpc must be "2.0"',
    line_with(jsonrpc=2.0): 'jsonrpc must be "2.0"',
    line_with(method=...): "method must be a string",
    line_with(method=["arm"]): "method must be a string",
    line_with(parms={}): 'no member "parms" in a request; the nearest is "params"',
    line_with(**{"": 1}): 'no member "" in a request',
}


@pytest.mark.parametrize(("line", "sentence"), ABOUT_THE_REQUEST.items())
def test_json_that_is_no_request_is_refused(line, sentence):
    answer = refused(line)
    assert answer.error.code is ErrorCode.INVALID_REQUEST
    assert sentence in answer.error.sentence
    assert answer.is_answered
    assert answer.id == (7 if b'"id"' in line and line.startswith(b"{") else None)


@pytest.mark.parametrize(
    ("method", "sentence"),
    [
        ("stat.get", 'there is no method "stat.get"; the nearest is "state.get"'),
        ("disram", 'there is no method "disram"; the nearest is "disarm"'),
        ("xyzzy", 'there is no method "xyzzy"'),
        ("", 'there is no method ""'),
        ("ar\x1b[m", 'there is no method "ar\\u001b[m"; the nearest is "arm"'),
    ],
)
def test_an_unknown_method_is_answered_with_the_nearest(method, sentence):
    assert code_and_sentence(line_with(method=method)) == (ErrorCode.METHOD_NOT_FOUND, sentence)


DEMAND = {"source": "pedal", "sequence": 1, "values": {}}
ABOUT_PARAMS = [
    ("state.get", [], "params must be an object: parameters go by name"),
    ("state.get", None, "params must be an object: parameters go by name"),
    (
        "state.get",
        {"mesages": []},
        'there is no parameter "mesages"; the nearest is "messages"',
    ),
    ("state.get", {"messages": [1]}, '"messages.0" should be a valid string'),
    ("state.get", {"messages": ["a"] * 65}, "at most 64 items"),
    (
        "state.subscribe",
        {"rate_hz": 51},
        '"rate_hz" should be less than or equal to 50',
    ),
    ("state.subscribe", {"rate_hz": "10"}, '"rate_hz" should be a valid number'),
    ("state.subscribe", {"rate_hz": True}, '"rate_hz" should be a valid number'),
    ("demand.release", {}, '"source" is missing'),
    ("demand.release", {"source": "a b"}, '"source": String should match pattern'),
    ("demand.set", {**DEMAND, "sequence": 1.0}, '"sequence" should be a valid integer'),
    ("demand.set", {**DEMAND, "sequence": 2**63}, '"sequence" should be less than'),
    (
        "demand.set",
        {**DEMAND, "values": {"throttle": 1}},
        'there is no parameter "values.throttle"; the nearest is "throttle_pct"',
    ),
    (
        "demand.set",
        {"source": "a", "sequence": 0, "controllers": {"PCU3": {}}},
        "\"controllers.PCU3\" should be 'PCU1' or 'PCU2'",
    ),
    ("reset", {"level": "Service"}, "\"level\" should be 'driver' or 'service'"),
    ("arm", {"now": 1}, 'there is no parameter "now"'),
]


@pytest.mark.parametrize(("method", "params", "sentence"), ABOUT_PARAMS)
def test_parameters_that_do_not_fit_are_named(method, params, sentence):
    code, answered = code_and_sentence(line_with(method=method, params=params))
    assert code is ErrorCode.INVALID_PARAMS
    assert sentence in answered


def test_an_infinite_number_is_named():
    line = line_with(method="demand.set", params=DEMAND)
    line = line.replace(b'"values": {}', b'"values": {"throttle_pct": 1e999}')
    assert code_and_sentence(line)[1] == '"values.throttle_pct" should be a finite number'


def test_a_notification_with_wrong_parameters_is_not_answered():
    assert not refused(line_with(id=..., params={"x": 1})).is_answered
    assert not refused(line_with(id=..., method="x")).is_answered


def test_what_is_no_request_is_answered_even_without_an_id():
    assert refused(line_with(id=..., jsonrpc="1.0")).is_answered


# Stopping is always possible.

WRONG_IN_FORM = {
    "an empty list of parameters": line_with(method="estop", params=[]),
    "a list of parameters": line_with(method="estop", params=[1, "now"]),
    "parameters that are null": line_with(method="estop", params=None),
    "an unknown parameter": line_with(method="estop", params={"now": True}),
    "no version": line_with(method="estop", params={}, jsonrpc=...),
    "version 1": line_with(method="estop", params={}, jsonrpc="1.0"),
    "a version that is a number": line_with(method="estop", params={}, jsonrpc=2.0),
    "an id that is null": line_with(method="estop", params={}, id=None),
    "an id that is a list": line_with(method="estop", params={}, id=[1]),
    "a fraction as id": line_with(method="estop", params={}, id=1.5),
    "no id, and an empty list": line_with(method="estop", params=[], id=...),
    "nothing but the method": b'{"method":"estop"}',
    "an unknown member": line_with(method="estop", params={}, now=1),
    "a member twice": b'{"id":1,"id":2,"jsonrpc":"2.0","method":"estop"}',
    "the method twice": b'{"jsonrpc":"2.0","id":1,"method":"estop","method":"estop"}',
    "NaN": b'{"jsonrpc":"2.0","id":1,"method":"estop","params":{"a":NaN}}',
    "half of a surrogate pair": b'{"jsonrpc":"2.0","id":"\\ud800","method":"estop"}',
    "deep parameters": line_with(method="estop", params=[[[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]]),
    "many values": line_with(method="estop", params=[0] * 600),
    "very many values": line_with(method="estop", params=[0] * 20_000),
    "a long integer": line_with(method="estop", params=[2**70]),
    "an id of 5000 digits": b'{"jsonrpc":"2.0","id":' + b"1" * 5000 + b',"method":"estop"}',
    "not UTF-8": b'{"jsonrpc":"2.0","id":1,"method":"estop","params":"\xff"}',
    "a byte order mark": b'\xef\xbb\xbf{"jsonrpc":"2.0","id":1,"method":"estop"}',
    "a tab in the id": b'{"jsonrpc":"2.0","id":"a\tb","method":"estop"}',
    "a batch of one": b'[{"jsonrpc":"2.0","id":1,"method":"estop"}]',
}


@pytest.mark.parametrize("line", WRONG_IN_FORM.values(), ids=WRONG_IN_FORM.keys())
@pytest.mark.parametrize("stop", ["estop", "disarm"])
def test_a_stop_that_is_wrong_in_form_is_named_and_answered(line, stop):
    answer = refused(line.replace(b"estop", stop.encode()))
    assert (answer.stop, answer.is_answered) == (stop, True)
    assert answer.error.sentence


def test_a_stop_may_be_written_with_escapes():
    assert refused(b'{"id":1,"method":"\\u0065stop"}').stop == "estop"


NO_STOP = {
    "not JSON": b"estop",
    "cut off": b'{"jsonrpc":"2.0","id":1,"method":"estop","params":{}',
    "something behind": b'{"jsonrpc":"2.0","id":1,"method":"estop"} x',
    "no object": b'["estop"]',
    "a batch of two": b'[{"jsonrpc":"2.0","id":1,"method":"estop"},{"method":"estop"}]',
    "an empty batch, and the word": b'[[], "estop"]',
    "a word": b'"estop"',
    "another method": line_with(method="reset", params=["estop"]),
    "an unknown method": line_with(method="estop ", params={}),
    "capitals": line_with(method="ESTOP", params={}),
    "a list of one": line_with(method=["estop"]),
    "two methods": b'{"jsonrpc":"2.0","id":1,"method":"why","method":"estop"}',
    "two methods, estop first": b'{"jsonrpc":"2.0","id":1,"method":"estop","method":"why"}',
    "estop and disarm": b'{"jsonrpc":"2.0","id":1,"method":"estop","method":"disarm"}',
    "in another member": line_with(method=..., params={"method": "estop"}),
    "in a name": line_with(method=..., estop=1),
    "nested too deep for any reader": b'{"method":"estop","params":' + b"[" * 60_000,
}


@pytest.mark.parametrize("line", NO_STOP.values(), ids=NO_STOP.keys())
def test_what_names_no_stop_stops_nothing(line):
    assert refused(line).stop is None


@pytest.mark.parametrize("stop", ["estop", "disarm"])
def test_a_stop_in_good_form_is_a_request_with_or_without_an_id(stop):
    for line in (line_with(method=stop, params={}), line_with(method=stop, params={}, id=...)):
        assert jsonrpc.parse(line).method == stop


LONG = "ABCDEFGH" * 8000
ECHOING = [
    line_with(method=LONG),
    line_with(**{LONG: 1}),
    line_with(params={LONG: 1}),
    line_with(params={LONG + str(n): 1 for n in range(1)}),
    line_with(params={f"ABCDEFGH{n}" * 10: 1 for n in range(400)}),
    line_with(method="demand.release", params={"source": LONG}),
    line_with(method="demand.set", params={**DEMAND, "values": {LONG[:50000]: 1}}),
    b'{"ABCDEFGH":1,' + b'"ABCDEFGH":1,' * 2000 + b'"":0}',
    b'{"' + LONG.encode() + b'":1,"' + LONG[:100].encode() + b'"}',
    line_with(method="😀" * 5000),
]


@pytest.mark.parametrize("line", ECHOING)
def test_a_sentence_is_short_and_repeats_little_of_the_input(line):
    sentence = refused(line).error.sentence
    assert len(sentence) <= jsonrpc.MAX_SENTENCE_CHARACTERS
    assert sentence.isascii()
    assert sentence.count("ABCDEFGH") * 8 <= 200


COSTLY = {
    "deep lists": b"[" * MAX_LINE_BYTES,
    "deep objects": b'{"a":' * 2000,
    "many integers": b"[" + b"1," * 32000 + b"1]",
    "long integers": b"[" + b",".join([b"9" * 4300] * 15) + b"]",
    "many objects": b"[" + b"{}," * 21000 + b"{}]",
    "many names": b"{" + b",".join(b'"%d":1' % n for n in range(6500)) + b"}",
    "twice at the end": b"{" + b",".join(b'"%d":1' % n for n in range(2000)) + b',"1999":1}',
    "a long method": line_with(method="a" * 65000),
    "a long member": line_with(**{"methad" * 10000: 1}),
    "wrong names": line_with(
        method="demand.set", params={"controllers": {str(n): {} for n in range(500)}}
    ),
    "long names": line_with(params={"n" * 120 + str(n): 1 for n in range(500)}),
    "escapes": b'"' + b"\\u0041" * 10900 + b'"',
    "a stop among many integers": b'{"method":"estop","id":[' + b"1," * 32000 + b"1]}",
    "a stop among many objects": b'{"method":"estop","id":[' + b"{}," * 21000 + b"{}]}",
    "a stop among many names": b'{"method":"estop"' + b',"a":1' * 10900 + b"}",
}


@pytest.mark.parametrize("line", COSTLY.values(), ids=COSTLY.keys())
def test_the_worst_lines_of_64_kib_cost_little(line):
    assert len(line) <= MAX_LINE_BYTES
    times_ms = []
    for _ in range(5):
        begin_ns = time.thread_time_ns()
        refused(line)
        times_ms.append((time.thread_time_ns() - begin_ns) / 1e6)
    assert min(times_ms) < WORST_MS


def test_an_answer_is_one_ascii_line_without_spaces():
    line = jsonrpc.result_line("ä\n", {"sentence": "Straße\u2028\n", "value": None})
    assert line.count(b"\n") == 1
    assert line.endswith(b"}\n")
    assert line.isascii()
    assert json.loads(line) == {
        "jsonrpc": "2.0",
        "id": "ä\n",
        "result": {"sentence": "Straße\u2028\n", "value": None},
    }
    assert b": " not in line


def test_an_error_carries_its_code_word_and_sentence():
    failure = RequestError(ErrorCode.REFUSED, "not now", "not_allowed_now")
    assert json.loads(jsonrpc.error_line(None, failure)) == {
        "jsonrpc": "2.0",
        "id": None,
        "error": {
            "code": -32002,
            "message": "not now",
            "data": {"word": "refused", "refusal": "not_allowed_now"},
        },
    }


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_no_answer_holds_what_json_has_not(value):
    with pytest.raises(ValueError, match="JSON compliant"):
        jsonrpc.result_line(1, {"value": value})


def test_a_notification_has_no_id():
    assert json.loads(jsonrpc.notification_line("state.update", {"lost": 0})) == {
        "jsonrpc": "2.0",
        "method": "state.update",
        "params": {"lost": 0},
    }


# Lines of a stream.


def test_lines_come_out_as_they_went_in_however_they_were_cut():
    data = b"one\n\ntwo three\r\nfour"
    for size in range(1, len(data) + 1):
        lines, out = LineBuffer(), []
        for start in range(0, len(data), size):
            lines.feed(data[start : start + size])
            while lines.has_line:
                out.append(lines.take())
        assert out == [b"one", b"", b"two three\r"]
        assert lines.is_partial
        lines.end()
        assert lines.take() == b"four"
        lines.end()
        assert len(lines) == 0
        assert not lines.has_line


def test_a_line_of_exactly_64_kib_passes_and_one_byte_more_does_not():
    lines = LineBuffer()
    lines.feed(b"a" * MAX_LINE_BYTES)
    assert not lines.is_too_long
    lines.feed(b"\n")
    assert lines.has_line
    assert not lines.is_partial
    assert len(lines.take()) == MAX_LINE_BYTES
    lines.feed(b"\n" + b"a" * MAX_LINE_BYTES + b"bc")
    assert lines.has_line
    assert not lines.is_partial
    assert not lines.is_too_long
    assert lines.take() == b""
    assert lines.is_too_long


def test_no_line_of_more_than_64_kib_can_be_taken():
    lines = LineBuffer()
    lines.feed(b"a" * (MAX_LINE_BYTES + 1))
    assert lines.is_too_long
    lines.feed(b"\n")
    assert lines.is_too_long
    assert not lines.has_line


def test_a_line_fed_byte_by_byte_is_searched_once():
    lines = LineBuffer()
    begin_ns = time.thread_time_ns()
    for _ in range(MAX_LINE_BYTES):
        lines.feed(b"a")
    assert (time.thread_time_ns() - begin_ns) / 1e6 < 500
