"""A recording of which anything was changed, removed or added is not called whole."""

import shutil
from collections import Counter
from pathlib import Path

import pytest

from tests.recording.forger import KINDS, content, forge
from tests.recording.kept import WrittenDrive
from tests.recording.signed import make_key, sign
from vcu_gateway.recording import layout
from vcu_gateway.recording.check import check_recording
from vcu_gateway.recording.folder import RecordingPath


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three whole segments."""
    one = WrittenDrive(tmp_path_factory.mktemp("recorded"))
    for number in range(3):
        one.segment(closes=number == 2)
    return one.path


@pytest.fixture(scope="module")
def signed(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, signed by its recorder."""
    folder = tmp_path_factory.mktemp("signed")
    copy = shutil.copytree(drive, folder / layout.DRIVES / drive.name)
    sign(copy, make_key(folder / "key"))
    return copy


def in_words(folder: Path) -> str:
    found = check_recording(RecordingPath("drive", folder), lambda _: None)
    if not found.is_whole:
        return found.state.name
    if not found.is_chained:
        return "NOT CHAINED"
    return "SIGNED" if found.signatures.signers else "UNSIGNED"


def accepted(drive: Path, folder: Path, seeds: range) -> Counter[str]:
    """How the check called each forgery; AssertionError where it accepted one."""
    genuine, called = content(drive), Counter[str]()
    for seed in seeds:
        copy = shutil.copytree(drive, folder / str(seed))
        forgery = forge(copy, seed)
        word = in_words(copy)
        where = f"{forgery} (seed {seed})"
        if forgery.is_stripped:
            assert word in ("NOT CHAINED", "CHANGED", "INCOMPLETE"), where
        elif forgery.is_anew:
            assert word in ("UNSIGNED", "CHANGED", "INCOMPLETE"), where
        elif content(copy) != genuine:
            assert word in ("CHANGED", "INCOMPLETE"), where
        called[f"{KINDS[seed % len(KINDS)].__name__}: {word}"] += 1
        shutil.rmtree(copy)
    return called


def test_the_drive_that_is_forged_is_whole(drive, signed):
    assert in_words(drive) == "UNSIGNED"
    assert in_words(signed) == "SIGNED"


@pytest.mark.parametrize(
    "seeds", [range(112), pytest.param(range(112, 2000), marks=pytest.mark.ci)], ids=len
)
def test_no_forgery_is_called_whole(drive, tmp_path, seeds):
    found = accepted(drive, tmp_path, seeds)
    assert sum(found.values()) == len(seeds)
    print(*sorted(found.items()), sep="\n")


@pytest.mark.parametrize("kind", ["said_anew", "beside_anew", "said", "tail_removed"])
def test_a_forgery_of_what_was_signed_is_found_though_its_chain_was_made_anew(
    signed, tmp_path, kind
):
    seed = [one.__name__ for one in KINDS].index(kind)
    copy = shutil.copytree(signed, tmp_path / "copy")
    print(forge(copy, seed))
    assert in_words(copy) in ("CHANGED", "INCOMPLETE")
    if kind.endswith("_anew"):
        assert in_words(copy) == "CHANGED"
