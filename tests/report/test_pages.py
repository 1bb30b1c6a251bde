"""Result pages as a person meets them: in a browser, on a phone, zoomed, read, and of files that are too large."""

import dataclasses
import json
import re
import webbrowser

import browser
import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.__main__ import main
from jaxfrf.report import response
from jaxfrf.report.response import frf_page


def made(n_pos=2, n_freq=60, n=2, seed=0):
    """An FRF of some resonances with a covariance, without estimating one."""
    rng = np.random.default_rng(seed)
    frequency = np.linspace(2.0, 80.0, n_freq)
    s = 2j * np.pi * frequency
    poles = 2 * np.pi * rng.uniform(5, 60, (n_pos, n, n))
    G = 1e3 / (s[None, :, None, None] ** 2 + 0.05 * poles[:, None] * s[None, :, None, None] + poles[:, None] ** 2)
    frf = jf.io.frf_from_arrays(G, frequency, q=np.zeros((n_pos, n)))
    spread = (0.05 * np.abs(G.swapaxes(-1, -2).reshape(n_pos, n_freq, n * n))) ** 2
    cov = spread[..., None] * np.eye(n * n) + 0j
    return dataclasses.replace(frf, cov=cov, dof=np.full((n_pos, n_freq), 30.0))


def data_of(page: str) -> dict:
    return json.loads(re.search(r'id="frf-data">(.*?)</script>', page)[1])


def numbers_of(estimate: dict, n_out: int, n_in: int):
    import base64

    raw = np.frombuffer(base64.b64decode(estimate["data"]), "<i2")
    shape = (estimate["positions"], len(estimate["layers"]), n_out, n_in, len(estimate["frequency"]))
    return dict(zip(estimate["layers"], np.moveaxis(raw.reshape(shape) / 100, 1, 0), strict=True))


def test_the_page_holds_the_frf():
    frf = made()
    (estimate,) = data_of(frf_page(frf))["estimates"]
    found = numbers_of(estimate, 2, 2)
    G = np.moveaxis(frf.G, 1, -1)
    np.testing.assert_allclose(found["level"], 20 * np.log10(np.abs(G)), atol=0.006)
    np.testing.assert_allclose(found["phase"], np.degrees(np.angle(G)), atol=0.006)
    radius = np.moveaxis(jf.plot.confidence_radius(frf), 1, -1)
    np.testing.assert_allclose(found["radius"], 20 * np.log10(radius), atol=0.006)


def test_lines_without_an_estimate_and_without_a_covariance():
    frf = made(n_pos=1)
    G = np.array(frf.G)
    G[0, 7] = np.nan
    status = np.array(frf.status)
    status[0, 7] = int(jf.Status.NOT_FINITE)
    frf = dataclasses.replace(frf, G=G, status=status, cov=np.full_like(frf.cov, np.nan))
    (estimate,) = data_of(frf_page(frf))["estimates"]
    found = numbers_of(estimate, 2, 2)
    assert (found["level"][..., 7] == -327.68).all() and (found["radius"] == -327.68).all()
    assert found["doubt"][0, 0, 0, 7] == 1 and found["doubt"].sum() == 4


@pytest.mark.parametrize(("n_pos", "n_freq", "says"), [(9, 40, "Positions 0 to 2 of 9"), (1, 500, "One line of 4")])
def test_large_frfs_make_small_pages(monkeypatch, n_pos, n_freq, says):
    assert response._NUMBERS * 2 * 4 / 3 < 2.7e6
    monkeypatch.setattr(response, "_NUMBERS", 2000)  # what 4 elements and 4 layers of 125 lines need
    page = frf_page(made(n_pos, n_freq))
    assert says in page
    assert len(data_of(page)["estimates"][0]["data"]) <= 2000 * 2 * 4 / 3 + 4


def test_pages_of_frfs_that_do_not_fit_together():
    with pytest.raises(jf.InputError, match=r"2 x 2 in .*; expected 1 x 1"):
        frf_page([made(n=1), made(n=2)], ["a", "b"])


def test_names_are_written_as_they_are():
    """No name of a file or method ends the script or becomes a tag."""
    page = frf_page(made(), ["</script><b>&"])
    assert "<b>&" not in page.replace("&lt;b&gt;", "") and data_of(page)["estimates"][0]["name"] == "</script><b>&"


def test_view(tmp_path, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    for name in ("a/frf.npz", "b/frf.npz"):
        (tmp_path / name).parent.mkdir()
        jf.io.write_frf(tmp_path / name, made())
    assert main(["view", str(tmp_path / "a" / "frf.npz")]) == 0
    assert opened and capsys.readouterr().out.startswith("opened ")
    both = [str(tmp_path / x / "frf.npz") for x in "ab"]
    assert main(["view", *both, "-o", str(tmp_path / "both.html")]) == 0 and len(opened) == 1
    page = (tmp_path / "both.html").read_text()
    assert [e["name"] for e in data_of(page)["estimates"]] == ["a/frf.npz", "b/frf.npz"]
    for label in ("a/frf.npz", "b/frf.npz"):  # whose resonance, remark, method
        assert f"<td>{label}</td><td>" in page and f"<li>{label}: " in page and f"{label}: " in page
    assert main(["view", both[0], "-o", both[1]]) == 2 and "the suffix '.npz'" in capsys.readouterr().err


# --- in a browser

CHOOSE = """
const pick = (name, value) => {
  const select = document.querySelector(name);
  select.value = value;
  select.dispatchEvent(new window.Event("change"));
};
const text = (name) => document.querySelector(name).textContent;
const value = (column) => document.querySelector(`.values tbody tr td:nth-child(${column})`).textContent;
const ticks = () => [...document.querySelectorAll(".chart.phase .tick")].map((x) => x.textContent);
const before = ticks();
pick(".position", 1); pick(".output", 1); pick(".input", 0);
const what = text(".what");
const charts = document.querySelector(".charts");
for (let k = 0; k < 200; k++) charts.dispatchEvent(new window.KeyboardEvent("keydown", { key: "ArrowLeft" }));
const first = [value(2), value(5), value(6)];
const svg = document.querySelector(".chart.magnitude svg");
const box = svg.getBoundingClientRect();
const at = (kind, x) =>
  svg.dispatchEvent(new window.PointerEvent(kind, { clientX: box.left + x, pointerType: "mouse" }));
at("pointerdown", 200); at("pointermove", 300); at("pointerup", 300);
const zoomed = ticks();
document.querySelector(".reset").click();
const after = ticks();
document.querySelector(".axis").click();
document.querySelectorAll(".cell")[3].click();
const rows = document.querySelectorAll(".values tbody tr").length;
return { what, first, before, zoomed, after, last: text(".what"), rows };
"""


@pytest.mark.slow
def test_a_person_chooses_zooms_and_reads(tmp_path):
    frf = made(n_pos=3)
    jf.report.write_frf_page(tmp_path / "frf.html", [frf, made(seed=1)], ["one", "two"])
    browser.assert_fine(tmp_path / "frf.html")
    found = browser.seen(tmp_path / "frf.html", action=CHOOSE)
    assert found.wrong == [] and found.broken == 0
    told = found.answer
    assert told["what"].startswith("G21: y2 ") and "position 1" in told["what"] and told["last"].startswith("G22")
    g = frf.G[1, 0, 1, 0]
    assert float(told["first"][0]) == pytest.approx(2.0)
    assert float(told["first"][1]) == pytest.approx(20 * np.log10(abs(g)), abs=0.01)
    assert float(told["first"][2].split(" ")[0]) == pytest.approx(np.degrees(np.angle(g)), abs=0.1)
    assert told["before"] == told["after"] != told["zoomed"] and told["rows"] == 2


@pytest.mark.slow
def test_large_and_small_pages_in_a_browser(tmp_path):
    for name, frf in {"large": made(20, 336, 6), "one": made(1, 30, 1), "line": made(1, 1, 1)}.items():
        jf.report.write_frf_page(tmp_path / f"{name}.html", frf)
        browser.assert_fine(tmp_path / f"{name}.html")


@pytest.mark.slow
def test_the_page_of_a_diagnosis_in_a_browser(tmp_path):
    from gap_examples import NAMES, example

    for name in NAMES:
        jf.report.write_gap_report(tmp_path / f"{name}.html", example(name))
        browser.assert_fine(tmp_path / f"{name}.html")


@pytest.mark.slow
def test_pages_of_the_commands_in_a_browser(tmp_path, capsys):
    """A calibrated robot, its springs alone, and one page of every file."""
    import book_files

    book_files.write(tmp_path, "run1.nc log.mat")
    run, robot = str(tmp_path / "run1.nc"), ["--robot", str(tmp_path / "robot.toml")]
    for name, more in {"whole": [], "springs": ["--springs", "--direct"]}.items():
        page = tmp_path / f"{name}.html"
        written = ["-o", str(tmp_path / f"{name}.json"), "--report", str(page)]
        assert main(["identify", run, *robot, *more, *written]) == 0, capsys.readouterr().err
        browser.assert_fine(page)
    how = ["--map", "u=[tau1;tau2],y=rec.motor_speed", "--set", "fs=2000,period=8000"]
    assert main(["estimate", str(tmp_path / "logs" / "*.mat"), "--each", "-o", str(tmp_path / "each"), *how]) == 0
    for page in sorted((tmp_path / "each").glob("*.html")):
        browser.assert_fine(page)
    assert (tmp_path / "each" / "a.html").is_file() and browser.seen(tmp_path / "each" / "index.html").images == 2
