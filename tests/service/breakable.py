"""The real program, with ways to break it from outside: breakable.py ARGUMENT...

Run by the interpreter of the package instead of its own command, with the same arguments.
"""

import signal
import sys
import threading

import can

from vcu_gateway.cli import main


def stand_still(_number, _frame):
    """The thread that ticks waits for a lock that it holds itself."""
    lock = threading.Lock()
    lock.acquire()
    lock.acquire()


def end_receiving(_number, _frame):
    """Nothing is read from the bus any more, without a word."""
    for pair in list(can.Notifier._registry.pairs):
        pair.notifier.stop()


def leak(_number, _frame):
    """Memory is taken and never given back; the kernel fills it, sooner than the watchdog ends."""
    taken = []
    with open("/dev/zero", "rb", buffering=0) as zeros:
        while True:
            taken.append(zeros.read(1 << 28))


signal.signal(signal.SIGUSR1, stand_still)
signal.signal(signal.SIGUSR2, end_receiving)
signal.signal(signal.SIGRTMIN, leak)
sys.argv[0] = "vcu-gateway"
main()
