"""The study: its measures against plain loops, the paper's claims on the paper's own numbers, interrupted runs."""

import json

import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.study import DEMO, PAPER, Settings, claims as claims_module, run as run_module
from jaxfrf.study.bias import amplitude_bias, level_error, weights
from jaxfrf.study.claims import claims
from jaxfrf.study.run import Task, mean_bias, summarise, write_json
from jaxfrf.study.settings import PUBLISHED_BIAS, PUBLISHED_PARAMETERS, design, methods
from jaxfrf.study.summary import summary_lines


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


def test_summary_has_both_tables():
    text = "\n".join(summary_lines(published()))
    assert "125.2 (125.2)" in text and "4.80 (4.8)" in text and "9 of 9 claims" in text


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
    monkeypatch.setattr(run_module, "write_study_page", lambda path, results, curves: path.write_text("page"))
    said = []
    with pytest.raises(KeyboardInterrupt):
        run_module.run_study(DEMO, tmp_path / "study", said.append)
    assert done == [0, 1, "interrupted"]
    run_module.run_study(DEMO, tmp_path / "study", said.append)
    assert done == [0, 1, "interrupted", 2, 3]
    assert "2 of 4 steps are done already" in said and "left" in said[-1]
    assert json.loads((tmp_path / "study" / "study.json").read_text())["ok"] is None
    with pytest.raises(jf.InputError, match="another study"):
        run_module.run_study(PAPER, tmp_path / "study")


def test_a_folder_of_someone_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(jf.InputError, match="other files"):
        run_module.run_study(DEMO, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_json_is_valid(tmp_path):
    write_json(tmp_path / "a.json", {"x": [np.inf, np.float64(2.0), np.int64(3)], 6: (1, None)})
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": [None, 2.0, 3], "6": [1, None]}


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_a_small_study_from_end_to_end(tmp_path):
    """Two positions, one block: everything is written, and the fit through the experiment is near the truth."""
    small = Settings(
        "small", positions=2, fit_positions=2, blocks=1, seeds=(0,), through=(6,), starts=3, ablations=False
    )
    results = run_module.run_study(small, tmp_path / "study")
    assert {"index.html", "study.json", "figure3.png", "figure4.png"} <= {
        p.name for p in (tmp_path / "study").iterdir()
    }
    by = {(row["experiments"], row["method"]): row for row in results["parameters"]}
    assert by[6, "through the experiment"]["stiffness_bias"] < 0.01
    assert by[6, "through the experiment"]["mean_bias"] < by[6, "LRM, JIO"]["mean_bias"]
    text = (tmp_path / "study" / "index.html").read_text()
    assert "Table I" in text and "Table II" in text and "http://" not in text
