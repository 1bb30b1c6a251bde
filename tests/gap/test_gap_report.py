"""gap.json, the pictures and the page of a diagnosis, from made-up ones of every verdict."""

import dataclasses
import html.parser
import json
import re

import numpy as np
import pytest
from gap_examples import AXES, NAMES, example
from marks import slow

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.gap.result import EstimatedValue
from jaxfrf.gap.verdict import VERDICTS
from jaxfrf.io.gaps import equation, read_gap, write_gap
from jaxfrf.plot.gap import AFTER, BEFORE, gap_bode, gap_dumbbells, gap_maps, torque_courses
from jaxfrf.report.gap import gap_page, write_gap_report
from jaxfrf.report.gap_words import axes_of, axis_of_channel, estimate, headline, joined, p_text, percent


def strict(path):
    """JSON as other programs read it: no NaN."""

    def refuse(name):
        raise AssertionError(f"{name} in {path}")

    return json.loads(path.read_text(), parse_constant=refuse)


class TestFile:
    """gap.json as other programs may rely on it."""

    CONTRACT = ("verdict", "effects", "ranking", "where", "gap", "parameters")

    @pytest.mark.parametrize("name", NAMES)
    def test_fields(self, name, tmp_path):
        write_gap(tmp_path / "gap.json", example(name))
        found = strict(tmp_path / "gap.json")
        assert set(self.CONTRACT) <= set(found) and found["verdict"] in VERDICTS
        for x in found["ranking"]:
            assert {"name", "joint", "score", "p_value"} <= set(x)
        for x in found["where"]:
            assert {"position", "channel", "band_hz", "z", "says"} <= set(x) and len(x["band_hz"]) == 2
        assert {"before", "after", "floor", "shrink", "unit", "on"} <= set(found["gap"])
        for x in found["parameters"].values():
            assert {"value", "std", "unit", "start", "identifiable"} <= set(x)
        assert read_gap(tmp_path / "gap.json") == found
        assert [p.name for p in tmp_path.iterdir()] == ["gap.json"]
        older = found | {"positions": {"fitted": found["positions"]["fitted"], "sealed": found["positions"]["heldout"]}}
        (tmp_path / "older.json").write_text(json.dumps(older))
        assert read_gap(tmp_path / "older.json") == found

    def test_an_effect(self, tmp_path):
        write_gap(tmp_path / "gap.json", example("coulomb"))
        found = read_gap(tmp_path / "gap.json")
        (effect,) = found["effects"]
        assert (effect["name"], effect["joint"]) == ("coulomb_friction", "joint3")
        assert effect["parameters"]["level"] | {"interval95": None} == {
            "value": 0.2087,
            "std": 0.0061,
            "unit": "N m",
            "interval95": None,
        }
        np.testing.assert_allclose(effect["parameters"]["level"]["interval95"], [0.19674, 0.22066], atol=1e-5)
        assert effect["equivalent"] == [] and "tau = level tanh" in effect["equation"]
        assert found["gap"]["torque_before"]["joint3"] == 0.164
        assert found["positions"] == {"fitted": [0, 1, 2, 3, 4], "heldout": [5, 6]}
        assert found["sources"][0] == {"name": "cell4_run1.nc", "sha256": "3f" * 32}

    def test_parameters_know_where_they_began(self, tmp_path):
        d = example("two")
        write_gap(tmp_path / "gap.json", d)
        found = read_gap(tmp_path / "gap.json")["parameters"]
        start = {n: float(x) for n, x in jf.robot.parameters(d.given, ("stiffness", "damping")).items()}
        for name, begun in start.items():
            assert found[name]["start"] == begun
            assert found[name]["value"] == pytest.approx(begun * (1 + found[name]["changed"]))
        own = found["joint2.torque_delay.delay"]  # an effect's: the given robot has none
        assert own["start"] is None and own["changed"] is None and own["identifiable"]

    def test_what_is_not_known_is_null(self, tmp_path):
        write_gap(tmp_path / "gap.json", example("inconclusive"))
        found = strict(tmp_path / "gap.json")
        assert found["gap"]["torque_before"]["joint3"] is None
        held = found["parameters"]["bearing2.damping"]
        assert held["std"] is None and held["interval95"] is None and not held["identifiable"]

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            (None, "no such file"),
            ("{", "no JSON"),
            ("[1]", "JSON without verdict, effects, ranking, where, gap and parameters"),
            ('{"parameters": {}, "cost": 1}', "JSON without verdict, effects, ranking, where and gap"),
        ],
    )
    def test_refused(self, tmp_path, text, message):
        if text is not None:
            (tmp_path / "gap.json").write_text(text)
        with pytest.raises(jf.InputError, match=rf"gap\.json: found {message}"):
            read_gap(tmp_path / "gap.json")

    def test_no_folder(self, tmp_path):
        with pytest.raises(jf.InputError, match="nowhere"):
            write_gap(tmp_path / "nowhere" / "gap.json", example("coulomb"))

    def test_equation(self):
        class Bare(fx.MotorInertia):
            pass

        class Told(fx.MotorInertia):
            """A rotor that
            is `heavier`, J + dJ.

            More of it.
            """

        assert equation(Told("joint1", 1e-5)) == "A rotor that is heavier, J + dJ."
        assert equation(Bare("joint1", 1e-5)) == fx.MotorInertia.signature


class TestWords:
    @pytest.mark.parametrize(
        ("value", "std", "unit", "says"),
        [
            (0.2087, 0.0061, "N m", "0.209 ± 0.012 N m"),
            (3.6e-4, 2.1e-5, "s", "0.360 ± 0.041 ms"),
            (1.05e-4, 4e-6, "rad", "(1.050 ± 0.078) × 10⁻⁴ rad"),
            (-0.02, 0.004, "1", "-0.0200 ± 0.0078"),
            (41234.0, 210.0, "N m/rad", "41234 ± 412 N m/rad"),
            (6.0, np.nan, "1", "6.000"),
            (0.0, 0.5, "N m", "0.00 ± 0.98 N m"),
            (2.5e8, np.inf, "N m/rad", "2.500 × 10⁸ N m/rad"),
        ],
    )
    def test_estimate(self, value, std, unit, says):
        assert estimate(EstimatedValue(value, std, unit)) == says

    def test_numbers(self):
        assert (percent(0.972), percent(0.0125, signed=True), percent(np.nan)) == ("97 %", "+1.2 %", "-")
        assert (p_text(0.0312), p_text(4e-5), p_text(1e-9), p_text(np.nan)) == ("p = 0.031", "p = 4e-5", "p < 1e-6", "")
        assert (joined([]), joined("a"), joined("ab"), joined("abc")) == ("", "a", "a and b", "a, b and c")

    def test_headlines(self):
        assert {n: headline(example(n)) for n in NAMES} == {
            "coulomb": "Missing: Coulomb friction of joint3.",
            "two": "Missing: payload and torque delay of joint2.",
            "ambiguous": "Missing: torque delay or current loop lag of joint2.",
            "unexplained": "Something is missing at joint4 that no known effect explains.",
            "sufficient": "Nothing is missing: the model explains the data.",
            "inconclusive": "No missing effect shows, but these data could not rule one out.",
        }

    def test_axes(self):
        """Those of the effects; of an effect without a joint, those whose torque it brought down."""
        assert axes_of(example("coulomb")) == ["joint3"]
        assert axes_of(example("two")) == ["joint2", "joint3", "joint5"]
        assert axes_of(example("unexplained")) == ["joint4"]
        assert axes_of(example("sufficient")) == []

    @pytest.mark.parametrize(
        ("channel", "axis"),
        [("torque of joint3", "joint3"), ("G34", "joint4"), ("G7", None), ("load", None), ("joint12", "joint12")],
    )
    def test_channels(self, channel, axis):
        assert axis_of_channel(channel, (*AXES, "joint12")[:6] if axis != "joint12" else (*AXES, "joint12")) == axis


class TestPictures:
    def test_maps_hold_the_residuals_on_one_scale(self):
        maps = example("coulomb").maps
        _, axes = gap_maps(maps.before, maps.after, maps.bands, AXES, marked=["joint3"], heldout=(5, 6))
        assert [a.get_title(loc="left") for a in axes] == ["before", "after"]
        for axis, values in zip(axes, (maps.before, maps.after), strict=True):
            drawn = np.stack([mesh.get_array().reshape(values[:, 0].shape) for mesh in axis.collections], axis=1)
            np.testing.assert_array_equal(drawn, np.maximum(values, 1.0))
        (scale,) = {(m.norm.vmin, m.norm.vmax) for a in axes for m in a.collections}
        assert scale == (1.0, maps.before.max())
        assert [t.get_text() for t in axes[0].get_xticklabels()] == ["0.5", "4", "8", "14", "20", "30", "45", "80"]
        weights = {t.get_text(): t.get_fontweight() for t in axes[0].texts}
        assert weights["joint3"] == "bold" and weights["joint2"] == "normal" and weights["5"] == "bold"

    def test_many_positions_and_holes(self):
        before = np.full((49, 2, 3), 2.0)
        before[3, 1, 1] = np.nan
        figure, axes = gap_maps(before, None, np.array([0.0, 5, 10, 80]), ("a", "b"))
        assert len(axes) == 1 and figure.get_figheight() < 4
        assert sum(np.ma.count_masked(m.get_array()) for m in axes[0].collections) == 1
        numbers = [t.get_text() for t in axes[0].texts if t.get_text().isdigit()]
        assert len(numbers) < 30  # not one on top of the other

    def test_courses(self):
        courses = example("coulomb").maps.courses
        _, axes = torque_courses(courses, AXES, ["joint3", "joint1"])
        assert axes.shape == (2, 3)
        _, before, after = axes[0, 0].lines
        np.testing.assert_array_equal(before.get_ydata(), courses["speed"][1][2])
        np.testing.assert_array_equal(after.get_ydata(), courses["speed"][2][2])
        assert (before.get_color(), after.get_color()) == (BEFORE, AFTER)
        assert len({a.get_ylim() for a in axes[0]}) == 1
        assert axes[1, 0].get_ylim()[1] >= 0.02 * 4.0  # noise of joint1 is drawn small

    def test_what_does_not_fit(self):
        with pytest.raises(jf.InputError, match=r"before: found shape \(2,\); expected \(pos, axis, band\)"):
            gap_maps(np.ones(2), None, np.arange(3.0), AXES)
        with pytest.raises(jf.InputError, match="axis_names: found 6; expected one for each of the 2 axes"):
            gap_dumbbells(np.ones(2), None, AXES)
        with pytest.raises(jf.InputError, match="courses: found 5"):
            torque_courses(5, AXES, AXES)

    def test_unchanged(self):
        """One curve, one panel, one dot where nothing was added."""
        d = example("unexplained")
        one = {k: x[:2] for k, x in d.maps.courses.items()}
        figure, axes = torque_courses(one, AXES, ["joint4"])
        assert len(axes[0, 0].lines) == 2 and not figure.legends
        _, axis = gap_dumbbells(d.gap.torque_before, None, AXES)
        assert len(axis.lines) == 1 and axis.get_legend() is None
        _, axes = gap_bode(d.frf[:2], 3, 0)
        assert len(axes[2].lines) == 1

    def test_dumbbells(self):
        gap = example("coulomb").gap
        _, axis = gap_dumbbells(gap.torque_before, gap.torque_after, AXES, marked=["joint3"])
        before, after = axis.lines
        np.testing.assert_allclose(before.get_xdata(), 100 * gap.torque_before)
        np.testing.assert_allclose(after.get_xdata(), 100 * gap.torque_after)
        assert "16.4 → 2.5 %" in [t.get_text() for t in axis.texts]

    def test_bode(self):
        """The error that is drawn is that of the models over the measured FRF."""
        frf = example("two").frf
        _, (_, _, error) = gap_bode(frf, 1, 1)
        for line, model in zip(error.lines, frf[1:], strict=True):
            expected = 100 * np.abs(model.G[1, :, 1, 1] - frf[0].G[1, :, 1, 1]) / np.abs(frf[0].G[1, :, 1, 1])
            np.testing.assert_allclose(line.get_ydata(), expected)


class Balanced(html.parser.HTMLParser):
    """Every tag that is opened is closed, in order; texts and identifiers are kept."""

    VOID = ("meta", "img", "input", "br")

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.said = [], [], []

    def handle_starttag(self, tag, attrs):
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] != ["style"]:
            self.said.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.said).split())


def read(page):
    checker = Balanced()
    checker.feed(page)
    assert checker.open == [] and len(checker.ids) == len(set(checker.ids))
    return checker.text


@pytest.fixture(scope="module", params=[n if n in ("two", "coulomb") else slow(n) for n in NAMES])
def written(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "gap.html"
    write_gap_report(path, example(request.param))
    return example(request.param), path.read_text()


class TestPage:
    def test_holds_everything(self, written):
        d, page = written
        text = read(page)
        assert f"<h1>{headline(d)}</h1>" in page and d.says in text and d.verdict in text
        assert text.count(d.next_experiment) >= 2  # at the top and where it belongs
        for x in (*d.ranking, *d.where):
            assert (x.why if hasattr(x, "why") else x.says) in text
        for x in d.effects:
            assert x.effect.signature.replace("omega", "ω") in text and x.separating_experiment in text
            assert all(estimate(e) in text for e in x.parameters.values())
        for name in d.parameters:
            assert name in text
        for x in (*d.sources, *d.settings):
            assert (x if isinstance(x, str) else x.sha256) in text
        assert d.compared in text

    def test_needs_nothing_else(self, written):
        _, page = written
        assert not re.search(r"(src|href)=\"(?!data:)|url\(|@import|<script|https?:", page)

    def test_pictures(self, written):
        """Maps, courses, dumbbells; and an FRF for every axis and held-out position."""
        d, page = written
        others = 1 if axes_of(d) else 0
        bodes = 0 if d.frf is None else 2 * min(len(axes_of(d)) or 1, 2)
        assert page.count("<img ") == 3 + others + bodes

    def test_text_is_escaped(self):
        d = example("coulomb")
        bad = "<b>&\"'"
        named = dataclasses.replace(d.effects[0], separating_experiment=bad, equivalent=(bad,))
        ranked = dataclasses.replace(d.ranking[1], why=bad, name=bad, expected={bad: 1.0})
        cell = dataclasses.replace(d.where[0], says=bad, channel=bad)
        d = dataclasses.replace(
            d,
            says=bad,
            effects=(named,),
            ranking=(ranked,),
            where=(cell,),
            next_experiment=bad,
            compared=bad,
            gap=dataclasses.replace(d.gap, unit=bad, on=bad),
            settings={bad: bad},
            frf=None,
        )
        page = gap_page(d)
        assert bad not in page and "<b>&amp;" not in page
        assert read(page).count(bad) >= 12

    @pytest.mark.slow
    def test_a_large_shift_is_remarked(self):
        page = read(gap_page(dataclasses.replace(example("two"), frf=None)))
        assert "joint3.damping moved by more than 20 %" in page and "-31 %" in page
        quiet = read(gap_page(dataclasses.replace(example("coulomb"), frf=None)))
        assert "No parameter of the given model moved by more than 20 %" in quiet

    @pytest.mark.slow
    def test_sparse(self):
        """What another way of comparing may leave out: reasons, sizes, strength of a cell."""
        d, nan = example("coulomb"), float("nan")
        ranking = tuple(dataclasses.replace(x, why="", expected={}, visible=nan) for x in d.ranking)
        where = (*d.where, dataclasses.replace(d.where[0], channel="joint5", z=nan))
        settings = {"remarks": ["one", "two"], "left_out": {"payload": "no mass"}}
        gap = dataclasses.replace(d.gap, unit="1")
        d = dataclasses.replace(d, ranking=ranking, where=where, settings=settings, gap=gap, frf=None)
        text = read(gap_page(d))
        assert "why it was taken" not in text and "expected" not in text
        assert "one, two" in text and "payload: no mass" in text and "torque residual (rms); floor" in text
        unnamed = dataclasses.replace(d, effects=(), verdict="unexplained")
        assert axes_of(unnamed) == ["joint3", "joint5"]

    def test_nothing_known(self):
        """Numbers that are not finite, no courses, no parameters, no sources."""
        d = example("inconclusive")
        nan = float("nan")
        gap = dataclasses.replace(d.gap, before=nan, after=nan, floor=nan, shrink=nan, torque_before=np.full(6, nan))
        gap = dataclasses.replace(gap, torque_after=np.full(6, nan))
        maps = dataclasses.replace(d.maps, before=np.full((1, 6, 7), nan), after=np.full((1, 6, 7), nan), courses={})
        bare = dataclasses.replace(
            d, gap=gap, maps=maps, parameters={}, changed={}, ranking=(), sources=(), settings={}, next_experiment=""
        )
        text = read(gap_page(bare))
        assert "data in memory" in text and not re.search(r"\bnan\b", text)
