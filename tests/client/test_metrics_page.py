"""The page of metrics: whole, or told what is wrong with it."""

import pytest

from tests.client.fake_gateway import METRICS, page
from vcu_gateway.client import ApiError, GarbledError
from vcu_gateway.client.metrics_page import MAX_PAGE_BYTES, Page


def text_of(data):
    gathered = Page()
    gathered.feed(data)
    return gathered.text()


def test_the_text_is_what_follows_the_head():
    assert text_of(page(METRICS)) == METRICS


def test_it_may_come_in_pieces():
    gathered = Page()
    for at in range(len(page(METRICS))):
        gathered.feed(page(METRICS)[at : at + 1])
    assert gathered.text() == METRICS


def test_a_page_without_a_length_ends_with_the_connection():
    assert text_of(b"HTTP/1.0 200 OK\r\n\r\nvcu_ticks 7\n") == "vcu_ticks 7\n"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b'{"jsonrpc":"2.0"}\n',
        b"HTTP/1.1 200 OK\r\n",
        b"HTTP/1.1 OK\r\n\r\n",
        b"HTTP/1.1\r\n\r\n",
        b"FTP/1.1 200 OK\r\n\r\n",
        page(METRICS)[:-1],
        page(METRICS) + b"x",
    ],
)
def test_what_is_no_whole_page_is_garbled(data):
    with pytest.raises(GarbledError):
        text_of(data)


def test_a_page_without_an_end_is_garbled_before_it_fills_the_memory():
    gathered = Page()
    gathered.feed(b"x" * MAX_PAGE_BYTES)
    with pytest.raises(GarbledError, match="more than"):
        gathered.feed(b"x")


def test_another_status_is_an_error_with_the_gateways_sentence():
    with pytest.raises(ApiError, match="not installed") as raised:
        text_of(page("not installed\n", "503 Service Unavailable"))
    assert (raised.value.code, raised.value.word) == (503, "http_503")


def test_another_status_without_a_sentence_is_told_by_its_line():
    with pytest.raises(ApiError, match="404 Not Found"):
        text_of(page("", "404 Not Found"))
