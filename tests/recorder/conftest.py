"""A recorder and gateways that hand over to it."""

import tempfile

import pytest

from tests.recorder.gateway import Gateway, RecorderProcess


@pytest.fixture
def recordings_in_memory(tmp_path):
    """Recordings where the machine's disk, which may stand still for seconds, is not judged.

    What a process wrote before it was killed is in memory on either.
    """
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        (tmp_path / "recordings").symlink_to(folder)
        yield


@pytest.fixture
def recorder(tmp_path):
    """Starts the recorder; options as on its command line."""
    started = []

    def start(*options, **how):
        started.append(RecorderProcess(tmp_path, *options, **how))
        return started[-1]

    yield start
    for one in started:
        one.close()


@pytest.fixture
def gateway(tmp_path):
    """Connects a gateway to the recorder."""
    made = []

    def connect(**how):
        made.append(Gateway(tmp_path / "tap.sock", **how))
        made[-1].connect()
        return made[-1]

    yield connect
    for one in made:
        one.close()
