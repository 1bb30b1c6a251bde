"""The study: its measures against plain loops, the paper's claims on the paper's own numbers, interrupted runs."""

import base64
import json
import re

import browser
import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf import parts as parts_module
from jaxfrf.__main__ import main
from jaxfrf.cli.study import _settings
from jaxfrf.parts import Parts
from jaxfrf.robot import parameters, r3x
from jaxfrf.study import DEMO, MEDIUM, PAPER, claims as claims_module, run as run_module
from jaxfrf.study.bias import amplitude_bias, level_error, weights
from jaxfrf.study.claims import claims
from jaxfrf.study.figures import SHOWN, picture_of
from jaxfrf.study.hidden import HIDDEN, OFF, machine, model
from jaxfrf.study.page import _made_smaller
from jaxfrf.study.page_uncertain import in_a_sentence, uncertain_section
from jaxfrf.study.run import Task, mean_bias, summarise, write_json
from jaxfrf.study.settings import PUBLISHED_BIAS, PUBLISHED_PARAMETERS, design, methods
from jaxfrf.study.summary import hidden_lines, summary_lines, uncertain_lines
from jaxfrf.study.uncertain import OFF as UNKNOWN, compared, drawn, trial


def hidden_example():
    """A hidden effect and what a diagnosis might say of it."""
    x = {"value": 0.0602, "unit": "N m", "std": 0.0008, "low": 0.0586, "high": 0.0618}
    effect = {"name": "coulomb_friction", "joint": "shoulder", "parameters": {"level": x}, "equivalent": []}
    return {
        "robot": "two axes",
        "verdict": "named",
        "says": "Missing: coulomb friction on shoulder.",
        "effects": [effect],
        "true": {"name": "coulomb_friction", "joint": "shoulder", "parameters": {"level": 0.06}},
        "gap": {"before": 8.0, "after": 0.2, "floor": 1.0, "shrink": 1.0, "on": "held-out positions"},
        "torque": {"shoulder": {"before": 0.12, "after": 0.005}},
    }


def machines_example():
    """Two machines: a stiffness and a damping, friction that one fit takes as exact, and two masses."""

    def number(name, true, given, whole, half, springs=None):
        found = lambda x, h: {"value": x, "low": x - h, "high": x + h, "holds": bool(abs(x - true) <= h)}
        return {
            "name": name,
            "kind": name.rpartition(".")[2],
            "true": true,
            "given": given,
            "whole": found(whole, half),
            "determined_by": "prior" if name == "a.mass" else "data",
            "springs": None if springs is None else found(springs, 0.5),
        }

    numbers = lambda off: [
        number("a.stiffness", 100.0, 110.0, 100.0 + off, 2.0, 103.0),
        number("b.stiffness", 100.0, 90.0, 100.0 - off, 2.0, 100.1),
        number("a.damping", 10.0, 6.0, 10.1, 0.2, 12.0),
        number("a.coulomb_friction", 1.0, 1.3, 1.02, 0.01),
        number("a.mass", 5.0, 5.2, 5.5, 0.1),
        number("b.mass", 2.0, 2.1, 2.02, 0.1),
    ]
    about = {"robot": "two axes", "experiments": 2, "positions": 5, "period_s": 4.0}
    return [{**about, "seed": k, "numbers": numbers(off)} for k, off in enumerate((1.0, 3.0))]


def random_response(seed, n=4, lines=7):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((lines, n, n)) + 1j * rng.standard_normal((lines, n, n))


def test_amplitude_bias_against_a_loop():
    G, true = random_response(0), random_response(1)
    W = np.full((4, 4), 0.2) + 0.8 * np.eye(4)
    W = W / np.linalg.svd(W)[1][0]
    expected = np.mean([np.linalg.svd(W * (abs(true[k]) - abs(G[k])))[1][0] for k in range(7)])
    assert amplitude_bias(G, true) == pytest.approx(expected, rel=1e-12)
    assert np.linalg.norm(weights(4), 2) == pytest.approx(1.0)


def test_bias_leaves_out_lines_that_are_not_finite():
    G, true = random_response(0), random_response(1)
    broken = G.copy()
    broken[2, 1, 1] = np.nan
    keep = np.arange(7) != 2
    assert amplitude_bias(broken, true) == pytest.approx(amplitude_bias(G[keep], true[keep]), rel=1e-12)
    assert np.isfinite(level_error(broken, true)).all()


def test_level_error_is_in_decibels():
    true = random_response(1)
    assert np.allclose(level_error(10 ** (0.5 / 20) * true, true), 0.5)


def test_the_excitation_is_the_papers():
    plan = design(4, 0)
    frequency = np.asarray(plan.lines) * plan.fs / plan.period
    assert len(plan.lines) == 336 and np.all(np.asarray(plan.lines) % 2 == 1)
    assert 4.0 <= frequency[0] and frequency[-1] <= 80.0
    assert plan.n_exp == 24 and plan.period / plan.fs == 28.0
    assert PAPER.positions == 49 and PAPER.fit_positions == 7 and PAPER.experiments == (24, 6, 1)


def test_a_smaller_experiment_is_the_beginning_of_a_larger_one():
    """Six experiments are the first block of twenty-four: tables of fewer experiments use part of the same record."""
    from jaxfrf.excitation import reference

    assert np.array_equal(reference(design(1, 3)).r, reference(design(2, 3)).r[:6])


@pytest.mark.parametrize("count", [24, 6, 1])
def test_every_published_column_is_compared(count):
    assert set(PUBLISHED_BIAS[count]) <= set(methods(count))


def published():
    """The paper's own tables in the form of a study's results."""
    entry = lambda x: {"median": x, "least": x, "largest": x}
    summary = [
        {"experiments": c, "method": m, "mean_bias": entry(v), "stiffness_bias": entry(v), "damping_bias": entry(v)}
        for c, by in PUBLISHED_PARAMETERS.items()
        for m, v in by.items()
    ]
    bias = {str(c): {m: {"mean": v} for m, v in by.items()} for c, by in PUBLISHED_BIAS.items()}
    return {
        "settings": PAPER.as_dict(),
        "lines": 336,
        "period_s": 28.0,
        "minutes": 1.0,
        "bias": {"bias": {"in motion": bias}},
        "summary": summary,
        "uncertain": {"off": UNKNOWN, "machines": machines_example(), "summary": compared(machines_example())},
        "hidden": hidden_example(),
    }


def test_the_paper_confirms_its_own_claims():
    made = claims(published())
    assert len(made) == 9
    assert [c.says for c in made if not c.confirmed] == []


def test_claims_can_fail():
    results = published()
    results["bias"]["bias"]["in motion"]["1"]["LRM, JIO"]["mean"] = 500.0
    assert [c.says for c in claims(results) if not c.confirmed] == [
        "JIO-LRM from one experiment has a lower FRF bias than LOG from six"
    ]
    assert claims_module.PUBLISHED_BIAS[1]["LRM, JIO"] == 147.27


def test_a_study_without_the_data_makes_no_claim():
    results = published()
    del results["bias"]["bias"]["in motion"]["1"]
    results["summary"] = [row for row in results["summary"] if row["method"] != "LOG"]
    assert len(claims(results)) == 9 - 2 - 2  # without one experiment; without parameters from LOG
    del results["bias"]["bias"]["in motion"]["24"]
    left = claims(results)
    assert all("n_e = 24" not in c.found for c in left)
    assert not any(c.says.startswith("Without a local model") for c in left)  # from six experiments it is LOG


def test_summary_has_both_tables_and_the_hidden_effect():
    text = "\n".join(summary_lines(published()))
    assert "125.2 (125.2)" in text and "4.80 (4.8)" in text and "9 of 9 claims" in text
    assert "level 0.0602 [0.0586, 0.0618] N m; true 0.06 N m" in text and "8.0 before, 0.20 after" in text


def test_a_wrong_effect_is_not_compared_with_the_hidden_ones_value():
    hidden = hidden_example()
    hidden["effects"][0]["joint"] = "elbow"
    assert not any("true 0.06" in line for line in hidden_lines(hidden))


def test_the_page_says_what_is_smaller_than_the_papers_study():
    said = "\n".join(_made_smaller(DEMO.as_dict()))
    assert "positions of Table I: 2 of 49" in said and "realisations of phases and noise: 1 of 5" in said
    assert _made_smaller(PAPER.as_dict()) == []
    assert MEDIUM.positions == 6 and MEDIUM.experiments == (12, 6, 1) and MEDIUM.indirect == (6, 1)


def test_the_search_is_given_the_model_without_what_is_hidden():
    """Machine and model differ by the hidden effect, ripple, and what a data sheet is off by."""
    assert model().effects == () and [e.name for e in machine().effects] == ["torque_ripple"] * 2
    kinds = ("stiffness", "mass", "coulomb_friction")
    own, stated = (jf.robot.parameters(robot, kinds) for robot in (machine(), model()))
    hidden = {f"{HIDDEN.joint}.coulomb_friction": HIDDEN.level}
    for name, value in stated.items():
        expected = OFF.get(name.rpartition(".")[2], 1.0) * float(value) + hidden.get(name, 0.0)
        assert float(own[name]) == pytest.approx(expected), name


def test_means_and_spreads():
    positions = [{"bias": {"at rest": {"6": {"LOG": x}}}} for x in (1.0, 2.0, 6.0)]
    found = mean_bias(positions)["bias"]["at rest"]["6"]["LOG"]
    assert found["mean"] == 3.0 and found["standard_error"] == pytest.approx(np.std([1, 2, 6], ddof=1) / 3**0.5)
    fields = (
        "mean_bias",
        "stiffness_bias",
        "damping_bias",
        "largest_stiffness_bias",
        "largest_damping_bias",
        "covered",
    )
    rows = [{"experiments": 6, "method": "LOG", **dict.fromkeys(fields, x)} for x in (0.1, 0.5, 0.2)]
    (entry,) = summarise(rows)
    assert entry["mean_bias"] == {"median": 0.2, "least": 0.1, "largest": 0.5} and entry["seeds"] == 3


def test_errors_where_nothing_is_known_exactly():
    (entry,) = compared(machines_example())
    stiffness = entry["errors"]["stiffness"]
    assert stiffness["given"]["median"] == pytest.approx(0.1)
    assert stiffness["springs"]["median"] == pytest.approx((0.03 + 0.001) / 2)
    assert stiffness["springs"]["worst"] == pytest.approx(0.03)
    assert [stiffness["whole"][k] for k in ("least", "median", "largest")] == pytest.approx([0.01, 0.02, 0.03])
    assert entry["errors"]["coulomb_friction"]["springs"] is None
    assert entry["errors"]["last_mass"]["whole"]["median"] == pytest.approx(0.01)
    # The first mass is not determined by the data: whether its interval holds does not count.
    assert entry["intervals"] == {"whole": {"hold": 2 + 0 + 2 + 2, "of": 10}, "springs": {"hold": 2, "of": 6}}
    assert entry["machines"] == 2 and compared([]) == []


def data_of(page: str) -> dict:
    return json.loads(re.search(r'id="frf-data">(.*?)</script>', page)[1])


def test_the_picture_holds_every_element():
    """As the estimates are: every position, method and element, with their regions, and the truth without points."""
    G = {name: random_response(k, n=2)[None] for k, name in enumerate(("true", "LOG_12", *(f"{n}_6" for n in SHOWN)))}
    G["LRM, JIO_1"] = random_response(9, n=2)[None]
    radii = {f"radius of {name}": 0.1 * np.abs(x) for name, x in G.items() if name != "true"}
    html = picture_of({"frequency": np.geomspace(4, 80, 7)} | G | radii, 3)
    data = data_of(html)
    assert data["positions"] == ["position 3"] and len(data["outputs"]) == len(data["inputs"]) == 2
    names = [e["name"] for e in data["estimates"]]
    assert names[:3] == ["true", "LOG, 12 experiments", "LOG, 6 experiments"] and names[-1] == "LRM, JIO, 1 experiment"
    assert [e["points"] for e in data["estimates"]] == [False] + [True] * 6
    (estimate,) = (e for e in data["estimates"] if e["name"] == "LRM, JIO, 6 experiments")
    held = np.frombuffer(base64.b64decode(estimate["data"]), "<i2").reshape(1, 3, 2, 2, 7) / 100
    wanted = np.moveaxis(20 * np.log10(np.abs(G["LRM, JIO_6"])), 1, -1)
    np.testing.assert_allclose(held[:, 0], wanted, atol=0.006)
    np.testing.assert_allclose(held[:, 2], wanted - 20, atol=0.006)


def test_the_page_and_the_summary_say_what_nothing_known_exactly_costs():
    uncertain = {"off": UNKNOWN, "machines": machines_example(), "summary": compared(machines_example())}
    page, text = uncertain_section(uncertain), "\n".join(uncertain_lines(uncertain["summary"]))
    for said in (
        "2 machines are drawn",
        "40 % (damping)",
        "all else exact 2 of 6, whole robot 6 of 10",
        "own simulator",
    ):
        assert said in page, said
    assert page.count("<img") == 2 * 4 and "2.00 [1.00-3.00]" in page
    assert ">machine 0</label>" in page and ">machine 1</label>" in page and "(seeds 0, 1), n_e = 2" in page
    one = uncertain_section(uncertain | {"machines": machines_example()[:1]})
    assert "<label" not in one and "one machine (seed 0), n_e = 2" in one
    assert "2.00 [1.00-3.00]" in text and "Coulomb friction" in text and "6 of 10" in text
    whole = [dict(row, numbers=[dict(n, springs=None) for n in row["numbers"]]) for row in machines_example()]
    alone = {"off": UNKNOWN, "machines": whole, "summary": compared(whole)}
    page, text = uncertain_section(alone), "\n".join(uncertain_lines(alone["summary"]))
    assert "exact 2 of 6" not in page + text and "orange" not in page and "whole robot 6 of 10" in page
    assert "springs" not in in_a_sentence(alone["summary"][0])
    nothing = {"off": UNKNOWN, "machines": [], "summary": []}
    assert uncertain_section(nothing) == "" and uncertain_lines([]) == []


def test_machines_are_drawn_around_the_robot():
    """Every number within what is said, tensors as a whole, linear springs linear; others for another seed."""
    robot = r3x()
    one, again, other = (drawn(robot, seed) for seed in (1, 1, 2))
    for kind, most in UNKNOWN.items():
        stated, own, same, else_ = (parameters(x, [kind]) for x in (robot, one, again, other))
        off = np.concatenate([np.ravel(own[n] - v) for n, v in stated.items()])
        size = np.concatenate([np.ravel(np.abs(v)) for v in stated.values()])
        assert np.all(np.abs(off) <= most * size + 1e-15) and np.abs(off[size > 0] / size[size > 0]).max() > most / 2
        assert all(np.array_equal(own[n], same[n]) for n in own)
        assert not all(np.array_equal(own[n], else_[n]) for n in own)
    ratio = parameters(one, ["stiffness_ratio"])
    assert float(ratio["joint6.stiffness_ratio"]) == 1.0 != float(ratio["joint1.stiffness_ratio"])
    for name, tensor in parameters(one, ["inertia"]).items():
        stated = parameters(robot, ["inertia"])[name]
        factor = tensor[stated != 0] / stated[stated != 0]
        assert np.ptp(factor) < 1e-12 if factor.size else True


def test_a_calibration_is_not_told_what_machines_are_drawn_from():
    given = trial(DEMO, 0)
    assert given.robot.tolerances.stated == () and model().tolerances.stated != ()
    assert given.q.shape == (5, 2) and given.plan.n_exp == 2
    assert DEMO.uncertain == (2,) and MEDIUM.uncertain == PAPER.uncertain == (6, 1)
    assert MEDIUM.uncertain_robot == PAPER.uncertain_robot == "R3X" and PAPER.machines == PAPER.seeds


def test_an_interrupted_study_goes_on(tmp_path, monkeypatch):
    """Finished steps are not done again, and an interruption in the middle of a step loses that step only."""
    done = []

    def tasks(settings, parts, say):
        def work(i):
            def run():
                if i == 2 and len(done) < 3:
                    done.append("interrupted")
                    raise KeyboardInterrupt
                done.append(i)
                return {"i": i}

            return run

        return [Task(parts / f"step-{i}.json", f"step {i}", 1.0, work(i)) for i in range(4)]

    monkeypatch.setattr(run_module, "study_tasks", tasks)
    monkeypatch.setattr(run_module, "collect", lambda settings, parts: {"ok": np.float64(np.nan)})
    monkeypatch.setattr(run_module, "read_curves", lambda path: {})
    monkeypatch.setattr(run_module, "draw_figures", lambda curves, folder: {})
    monkeypatch.setattr(run_module, "write_study_page", lambda path, *results: path.write_text("page"))
    said, place = [], tmp_path / "study"

    def run(settings, **more):
        with Parts(place, "study", say=said.append, **more) as parts:
            return run_module.run_study(settings, place, said.append, parts=parts)

    with pytest.raises(KeyboardInterrupt) as stopped:
        run(MEDIUM)
    assert done == [0, 1, "interrupted"] and "2 finished parts kept in" in stopped.value.__notes__[0]
    with pytest.raises(jf.InputError, match=r"found 2 finished parts .*expected none, or --resume"):
        run_module.run_study(MEDIUM, place)
    with pytest.raises(jf.InputError, match="name: medium then, paper now; positions: 6 then, 49 now"):
        run(PAPER, resume=True)
    with monkeypatch.context() as patch:
        patch.setattr(parts_module, "program", lambda: "another")
        with pytest.raises(jf.InputError, match="the program's files have changed since"):
            run(MEDIUM, resume=True)
    (tmp_path / "study.parts" / "step-0.json").write_text('{"sec')
    run(MEDIUM, resume=True)
    assert done == [0, 1, "interrupted", 0, 2, 3]
    assert "1 of 4 steps are done already" in said and "step 3" in said[-1]
    assert json.loads((place / "study.json").read_text())["ok"] is None
    assert not (tmp_path / "study.parts").exists()


@pytest.mark.parametrize("together", [1, 2])
def test_a_step_that_fails_ends_the_study(tmp_path, together):
    """Whichever thread makes it; what is finished stays."""

    def fails():
        raise jf.InputError("no such step")

    work = [lambda: {"i": 0}, lambda: {"i": 1}, fails, fails]
    tasks = [Task(tmp_path / f"step-{i}.json", f"step {i}", 1.0, w) for i, w in enumerate(work)]
    with pytest.raises(jf.InputError, match="no such step"):
        run_module._work(tasks, together, lambda text: None)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["step-0.json", "step-1.json"]


def test_steps_that_workers_share_are_made_by_their_names(tmp_path, monkeypatch):
    made, said = [], []

    def tasks(settings, parts, say):
        work = lambda i: lambda: made.append(i) or {"i": i}
        return [Task(parts / f"step-{i}.json", f"step {i}", 1.0, work(i)) for i in range(3)]

    monkeypatch.setattr(run_module, "study_tasks", tasks)
    (tmp_path / "step-1.json").write_text('{"seconds": 1.0, "result": {"i": 1}}')
    run_module._share(DEMO, tmp_path, said.append, {"workers": 1})
    assert made == [0, 2] and json.loads((tmp_path / "step-2.json").read_text())["result"] == {"i": 2}
    assert said == ["1 of 3 steps are done already", "[1/2] step 0", "[2/2] step 2"]


def test_a_study_at_fewer_positions(tmp_path, capsys):
    assert _settings(PAPER, 4).positions == _settings(PAPER, 4).fit_positions == 4
    assert _settings(PAPER, None) == PAPER and _settings(PAPER, 20).fit_positions == 7
    assert main(["study", "--positions", "1", "-o", str(tmp_path / "study")]) == 2
    assert "--positions: found 1; expected 2 to 2" in capsys.readouterr().err


def test_a_folder_of_someone_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(jf.InputError, match="other files"):
        run_module.run_study(DEMO, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "study_tasks", lambda *given: pytest.fail("begun"))
    (tmp_path / "file").write_text("")
    with pytest.raises(jf.InputError, match="cannot be written"):
        run_module.run_study(DEMO, tmp_path / "file" / "study")
    with pytest.raises(jf.InputError, match=r"a file.*expected a folder"):
        run_module.run_study(DEMO, tmp_path / "file")


def test_json_is_valid(tmp_path):
    write_json(tmp_path / "a.json", {"x": [np.inf, np.float64(2.0), np.int64(3)], 6: (1, None)})
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": [None, 2.0, 3], "6": [1, None]}


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_demo_finds_what_is_true(tmp_path):
    """The README's first command, whole: order of the methods, parameters, and the hidden effect."""
    results = run_module.run_study(DEMO, tmp_path / "study")
    assert {"index.html", "study.json", "figure3.png", "figure4.png"} <= {
        p.name for p in (tmp_path / "study").iterdir()
    }
    six = {method: x["mean"] for method, x in results["bias"]["bias"]["in motion"]["6"].items()}
    assert six["LRM, JIO"] < 0.8 * min(six["LOG"], six["LRM, MISO"], six["LRM, MIMO"])
    assert max(six["LRM, JIO stacked"], six["auto"]) < six["LRM, JIO"]
    by = {(row["experiments"], row["method"]): row for row in results["parameters"]}
    direct, indirect = by[6, "LRM, JIO stacked"], by[6, "indirect"]
    assert direct["mean_bias"] < 0.04 and indirect["mean_bias"] < 0.01
    assert indirect["stiffness_bias"] < 0.002 and indirect["mean_bias"] < 0.5 * direct["mean_bias"]
    (entry,) = results["uncertain"]["summary"]
    for kind in ("stiffness", "damping"):
        errors = {what: x["median"] for what, x in entry["errors"][kind].items() if x is not None}
        assert errors["whole"] < 0.01 and errors["whole"] < 0.2 * errors["given"]
    assert entry["intervals"]["whole"]["hold"] >= 0.9 * entry["intervals"]["whole"]["of"] >= 9
    hidden = results["hidden"]
    (named,) = hidden["effects"]
    assert hidden["verdict"] == "named" and (named["name"], named["joint"]) == (HIDDEN.name, HIDDEN.joint)
    level = named["parameters"]["level"]
    assert level["low"] < HIDDEN.level < level["high"] < 1.2 * HIDDEN.level
    assert hidden["heldout"] == [2] and hidden["gap"]["after"] < 0.5 * hidden["gap"]["before"]
    assert hidden["torque"]["shoulder"]["after"] < 0.5 * hidden["torque"]["shoulder"]["before"]
    browser.assert_fine(tmp_path / "study" / "index.html")
    text = (tmp_path / "study" / "index.html").read_text()
    headings = ("Table I", "Table II", "When nothing is known exactly", "A hidden effect")
    assert all(heading in text for heading in headings) and data_of(text)["positions"][1] == "position 1"
