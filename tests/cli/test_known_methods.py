"""What is wrong in names is said before JAX is loaded, and only what is wrong."""

import subprocess
import sys

import numpy as np
import pytest

from jaxfrf.cli import known_methods
from jaxfrf.frf import catalogue


def test_names_and_options_are_those_of_the_catalogue(monkeypatch):
    monkeypatch.setattr(known_methods, "_LOADED", "")
    assert known_methods._keys("METHODS") == list(catalogue.METHODS)
    assert known_methods._keys("ALIASES") == list(catalogue.ALIASES)
    for name in (*catalogue.METHODS, *catalogue.ALIASES):
        chosen = catalogue.METHODS[catalogue.ALIASES.get(name, name)][1]
        known_methods.check_method(name, dict.fromkeys(catalogue._option_names(chosen), "1"))


def test_nothing_is_refused_where_the_source_is_not_at_hand(tmp_path, monkeypatch):
    monkeypatch.setattr(known_methods, "_LOADED", "")
    monkeypatch.setattr(known_methods, "_ROOM", tmp_path)
    known_methods.check_method("lmr", {"ordr": "2"})
    (tmp_path / "catalogue.py").write_text("METHODS = dict(a=1)\nALIASES = {**x}\n")
    known_methods.check_method("lmr", {"ordr": "2"})


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("estimate a.npz -o b.nc --method lmr", "found 'lmr'; expected one of auto,"),
        ("estimate a.npz -o b.nc --option ordr=2", "option ordr: found one that no method has"),
        ("estimate a.npz -o b.nc --option ordr", "expected KEY=VALUE"),
        ("estimate a.npz -o b.nc --periods 9-8", "--periods: found '9-8'"),
        ("estimate a.npz -o b.nc --band 9", "--band: found '9'"),
        ("estimate none.npz -o b.nc", "none.npz: found no such file"),
        ("distortion a.npz --method lmr", "Did you mean lpm?"),
        ("identify a.npz --robot r.toml -o x.json", "r.toml: found no valid TOML"),
        ("diagnose a.npz --robot r.toml -o x.json", "r.toml: found no valid TOML"),
        ("diagnose a.npz --robot s.toml -o x.json", "s.toml: found no such file"),
    ],
)
def test_wrong_names_are_told_before_jax_is_loaded(tmp_path, options, says):
    u = np.tile(np.random.default_rng(0).standard_normal((50, 1)), (3, 1))
    np.savez(tmp_path / "a.npz", u=u, y=np.roll(u, 1, axis=0), fs=1000.0, period=50)
    (tmp_path / "r.toml").write_text("nonsense")
    code = (
        f"import sys; from jaxfrf.__main__ import main; code = main({options.split()})\n"
        "print(code, sorted({'jax', 'scipy', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert says in done.stderr and done.stdout.strip() == "2 []"
