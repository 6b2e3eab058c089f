"""Work in a process beside this one, where the machine has a processor for it."""

import contextlib
import os
import pickle
import signal
from collections.abc import Callable, Iterator
from typing import NoReturn, TypeVar

_Result = TypeVar("_Result")


@contextlib.contextmanager
def beside(work: Callable[[], _Result]) -> Iterator[Callable[[], _Result]]:
    """Begin some work; what is given waits for its result, and raises what it raises.

    With one processor, or where its process does not come to its end, the work is done then. It
    must not write anything; for a process of one thread.
    """
    if len(os.sched_getaffinity(0)) < 2:
        yield work
        return
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        _work(work, writing)
    os.close(writing)
    with os.fdopen(reading, "rb") as answer:
        try:
            yield lambda: _result(answer.read(), work)
        finally:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def _work(work: Callable[[], object], writing: int) -> NoReturn:
    try:
        try:
            answer = pickle.dumps((work(), None))
        except Exception as error:  # noqa: BLE001 - raised where the result is waited for
            answer = pickle.dumps((None, error))
        with os.fdopen(writing, "wb") as out:
            out.write(answer)
    finally:
        os._exit(0)


def _result(answer: bytes, work: Callable[[], _Result]) -> _Result:
    try:
        found, error = pickle.loads(answer)  # noqa: S301 - our own process wrote it
    except (EOFError, pickle.UnpicklingError):
        return work()
    if error is not None:
        raise error
    result: _Result = found
    return result
