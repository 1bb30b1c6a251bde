"""Pages made from what `identify` and `diagnose` wrote: those of the results at hand, but for pictures of FRFs."""

import dataclasses
import html
import json
import re

import pytest
from gap_examples import NAMES, example

import jaxfrf as jf
from jaxfrf.__main__ import main
from jaxfrf.cli.view import _next
from jaxfrf.report import calibration_page, gap_page, identification_page

NUMBER = {
    "value": 5.5,
    "std": 0.1,
    "unit": "kg",
    "start": 5.0,
    "interval95": [5.3, 5.7],
    "determined_by": "data",
    "with": [],
    "identifiable": True,
    "kind": "mass",
    "size": 0.1,
    "logarithmic": True,
    "known_before": True,
}
WHOLE = {
    "kind": "whole robot",
    "compared": "through the experiment",
    "parameters": {
        "joint1.mass": NUMBER,
        "joint1.com.x": NUMBER
        | {"kind": "com", "unit": "m", "value": 0.0, "start": 0.1, "logarithmic": False, "interval95": [-0.2, None]}
        | {"determined_by": "data in combination", "with": ["joint1.mass"]},
    },
    "ripple": [{"joint": "joint1", "kind": "torque", "order": 6, "sine": 0.3, "cosine": 0.4}],
    "converged": True,
    "doubts": [],
    "rounds": [{"misfit": 4.0, "left": 1.0, "design_effect": 2.5}],
    "torque_missed": {"before": [0.2], "after": [0.01], "heldout": [[0.3], [None]]},
    "axes": ["joint1"],
    "robot": "small",
    "sources": [{"name": "run.nc", "sha256": "abc"}],
    "version": "0.1.0",
}


def words(page: str) -> str:
    """A page without its pictures."""
    return re.sub(r"data:image[^\"]*", "", page)


def test_a_calibration_of_a_file():
    page = calibration_page(WHOLE)
    for text in ("small: calibrated", "Converged", "1 of 2 numbers are determined", "2.50 lines count as one", "20 %"):
        assert text in page
    assert "5.300 to 5.700" in page and "-0.2000 to -" in page and page.count("data:image") == 1
    with pytest.raises(jf.InputError, match=r"fit.json: found no 'axes'|fit.json: found no axes"):
        calibration_page({name: x for name, x in WHOLE.items() if name != "axes"})


@pytest.mark.parametrize("name", ["two", pytest.param("coulomb", marks=pytest.mark.slow)])
def test_a_diagnosis_of_a_file(name, tmp_path):
    found = dataclasses.replace(example(name), frf=None)
    jf.io.write_gap(tmp_path / "gap.json", found)
    page = words(gap_page(jf.io.read_gap(tmp_path / "gap.json")))
    no_frf = "There are no FRFs on held-out positions to compare."
    left_out = "Pictures of the FRFs are on the page that `jaxfrf diagnose --report` makes: a gap.json holds none."
    assert no_frf in words(gap_page(found)) and words(gap_page(found)).replace(no_frf, left_out) == page
    assert (tmp_path / "gap.json").stat().st_size < 300_000


@pytest.mark.slow
def test_every_verdict_is_viewed(tmp_path, capsys):
    for name in NAMES:
        jf.io.write_gap(tmp_path / f"{name}.json", example(name))
        assert main(["view", str(tmp_path / f"{name}.json"), "-o", str(tmp_path / f"{name}.html")]) == 0
        assert html.escape(example(name).says) in (tmp_path / f"{name}.html").read_text()
    assert main(["view", str(tmp_path / f"{NAMES[0]}s.json"), "-o", str(tmp_path / "page.html")]) == 2
    assert re.search(rf"no such file.*Did you mean .*{NAMES[0]}.json", capsys.readouterr().err, re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("more", [[], ["--springs"], ["--springs", "--direct", "--heldout", "2"]])
def test_a_fit_is_viewed_as_it_was_reported(more, tmp_path, capsys):
    import book_files

    book_files.write(tmp_path, "run1.nc")
    fit, report, page = (str(tmp_path / name) for name in ("fit.json", "report.html", "page.html"))
    robot = ["--robot", str(tmp_path / "robot.toml")]
    assert main(["identify", str(tmp_path / "run1.nc"), *robot, *more, "-o", fit, "--report", report]) == 0
    assert main(["view", fit, "-o", page]) == 0, capsys.readouterr().err
    assert _next([fit]) == ["next: what is missing? jaxfrf diagnose DATA --robot ROBOT -o gap.json"]
    bode = re.compile(r"<section>\n<h2>Measured and modelled</h2>.*?</section>", re.DOTALL)
    made, viewed = (words((tmp_path / name).read_text()) for name in ("report.html", "page.html"))
    assert bode.sub("", made) == bode.sub("", viewed)
    assert ("a fit.json holds no FRFs" in viewed) == bool(more)
    assert (tmp_path / "fit.json").stat().st_size < 300_000
    if more:
        without = {name: x for name, x in json.loads((tmp_path / "fit.json").read_text()).items() if name != "frf"}
        with pytest.raises(jf.InputError, match="found no frf"):
            identification_page(without)
