"""The mailbox: replies from any thread, at the price of one system call."""

import gc
import os
import threading

import pytest

from vcu_gateway.server.reply_queue import QueuedReply, ReplyQueue


@pytest.fixture
def mailbox():
    return ReplyQueue()


def test_letters_come_out_in_their_order(mailbox):
    mailbox.put(1, 2, {})
    mailbox.put(1, 3, {"a": 1})
    assert list(mailbox.take()) == [QueuedReply(1, 2, {}), QueuedReply(1, 3, {"a": 1})]
    assert list(mailbox.take()) == []


def test_it_rings_once_until_it_is_hushed(mailbox):
    with pytest.raises(BlockingIOError):
        os.eventfd_read(mailbox.fd)
    for number in range(5):
        mailbox.put(1, number, {})
    assert os.eventfd_read(mailbox.fd) == 1
    mailbox.ring()
    with pytest.raises(BlockingIOError):
        mailbox.hush()  # not hushed yet: it has not rung again


def test_after_a_hush_it_rings_again(mailbox):
    mailbox.put(1, 1, {})
    mailbox.hush()
    mailbox.put(1, 2, {})
    mailbox.hush()
    assert len(list(mailbox.take())) == 2


def test_a_shut_mailbox_keeps_nothing(mailbox):
    mailbox.put(1, 1, {})
    mailbox.shut()
    mailbox.put(1, 2, {})
    assert list(mailbox.take()) == []


def test_its_descriptor_is_closed_with_the_last_who_could_ring():
    mailbox = ReplyQueue()
    put, fd = mailbox.put, mailbox.fd
    del mailbox
    put(1, 1, {})
    assert os.eventfd_read(fd) == 1
    del put
    gc.collect()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.eventfd_read(fd)


def test_no_letter_is_lost_between_threads(mailbox):
    count, taken = 20_000, []

    def write() -> None:
        for number in range(count):
            mailbox.put(0, number, {})

    writer = threading.Thread(target=write)
    os.set_blocking(mailbox.fd, True)
    writer.start()
    while len(taken) < count:
        mailbox.hush()
        taken.extend(letter.number for letter in mailbox.take())
    writer.join()
    assert taken == list(range(count))
