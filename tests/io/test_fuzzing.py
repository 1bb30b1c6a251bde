"""Damaged files of every kind: an `InputError`, or a reading, and nothing else."""

import pathlib
import subprocess
import sys

import fuzzing
import pytest

SECONDS = 600  # of the long run


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    return fuzzing.corpus(tmp_path_factory.mktemp("fuzzing"))


def test_damaged_files(cases, tmp_path):
    for name, case in cases.items():
        for number in range(2 if case[1] in (".nc", ".mat") else 12):
            fuzzing.read_damaged(tmp_path, name, case, number)


@pytest.mark.slow
@pytest.mark.timeout(SECONDS + 300)
def test_damaged_files_for_ten_minutes():
    """In a process of its own, which a library that crashes takes with it."""
    path = pathlib.Path(fuzzing.__file__)
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", path, str(SECONDS)], capture_output=True, text=True, errors="replace"
    )
    assert done.returncode == 0, done.stderr[:3000] + done.stderr[-1000:]
