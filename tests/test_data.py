"""The script that says where real measurements are to be had: what tests read, and what is there."""

import pathlib
import re
import subprocess
import sys

import pytest

HERE = pathlib.Path(__file__).parent


def told(folder=None):
    environment = {} if folder is None else {"JAXFRF_DATA": str(folder)}
    done = subprocess.run(
        [sys.executable, HERE / "data.py"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    return done.returncode, done.stdout


def names():
    """Sets that tests and pages read."""
    text = "\n".join(path.read_text() for path in HERE.rglob("test_*.py"))
    pages = "\n".join(path.read_text() for path in (HERE.parent / "notebooks").rglob("*.md"))
    return {*re.findall(r'measured / "(\w+)"', text), *re.findall(r"<!-- data: (\w+) -->", pages)}


def test_every_set_is_told(tmp_path):
    """Without a folder and in an empty one all are missing; each has an address."""
    for folder in (None, tmp_path):
        code, text = told(folder)
        assert code == 1 and set(re.findall(r"^(\w+): missing$", text, re.MULTILINE)) == names()
        assert text.count("https://raw.githubusercontent.com/") == text.count(" (missing)")


def test_what_is_there(tmp_path):
    """One file short, and whole."""
    _, text = told(tmp_path)
    first, *files = re.findall(r"^  (\S+) \(missing\)$", text, re.MULTILINE)
    for file in files:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    code, text = told(tmp_path)
    assert code == 1 and text.count("missing") == 2 and f"{first} (missing)" in text
    (tmp_path / first).touch()
    code, text = told(tmp_path)
    assert code == 0 and "missing" not in text


@pytest.mark.data
def test_the_folder_of_the_tests_is_whole(measured):
    assert told(measured)[0] == 0
