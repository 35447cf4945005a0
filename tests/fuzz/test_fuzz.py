"""Hostile files end in a log, a policy, a soil - or in one sentence, soon, and in little room."""

from __future__ import annotations

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from fuzz_corpus import READERS, File, crafted, mutations

from offroad_env.errors import OffroadError

#: Longest time [s], most room [bytes] and longest sentence [characters] for one file.
_TIME, _ROOM, _SENTENCE = 5.0, 1e9, 3000
#: Mutated files here; ``make fuzz`` reads ten times as many.
_COUNT = 204


class TooLongError(Exception):
    pass


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Stop what takes longer, by the processor's clock."""

    def stop(*_: object) -> None:
        raise TooLongError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def answer(file: File, folder: Path) -> str:
    """What a reader states of a file; "" where it takes it."""
    path = file.make(folder)
    room = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with at_most(_TIME):
        try:
            READERS[file.kind](path)
        except OffroadError as error:
            return str(error)
    assert 1024.0 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - room) < _ROOM
    return ""


@pytest.fixture(scope="module", autouse=True)
def ready(tmp_path_factory):
    """What is imported and made once is no part of the time of a file."""
    for i, file in enumerate(mutations(len(READERS), seed=0)):
        with pytest.MonkeyPatch.context():
            answer(file, tmp_path_factory.mktemp(f"first{i}"))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_mutated_files_are_read_or_refused_in_a_sentence(tmp_path):
    refused = 0
    for i, file in enumerate(mutations(_COUNT, seed=21)):
        (folder := tmp_path / str(i)).mkdir()
        sentence = answer(file, folder)
        refused += bool(sentence)
        assert len(sentence) < _SENTENCE, file.name
    assert refused > _COUNT // 3


@pytest.mark.parametrize("file", crafted(), ids=lambda file: file.name)
def test_a_file_that_is_dangerous_by_design_does_no_harm(file, tmp_path):
    sentence = answer(file, tmp_path)
    assert len(sentence) < _SENTENCE
    if not file.name.startswith("csv: every") and "clock jumps" not in file.name:
        assert sentence
