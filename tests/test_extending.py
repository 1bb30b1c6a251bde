"""One new file and one line: an estimator and a record format of one's own, from the file to the command line.

The file is what a person would write into the package; the line is the entry of the table that lists its kind.
"""

import importlib.util
import sys

import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf.__main__ import main

ESTIMATOR = '''
"""H1 with a ridge."""

import jax.numpy as jnp

from .method import AbstractMethod, Estimate


class RidgeH1(AbstractMethod):
    """G = Y U^H (U U^H + ridge I)^-1, biased low by the ridge."""

    ridge: float = 1e-12

    def check(self, spectra):
        pass

    def block_size(self, spectra):
        return spectra.n_in

    def residual_dof(self, signals):
        return float(signals.n_exp - signals.n_in)

    def at_point(self, signals, lines=None):
        U, Y = (jnp.moveaxis(x, 0, -1) for x in (signals.U, signals.Y))
        G = Y @ jnp.conj(U.mT) @ jnp.linalg.inv(U @ jnp.conj(U.mT) + self.ridge * jnp.eye(signals.n_in))
        n, vec = len(G), G.shape[1] * G.shape[2]
        cov = jnp.full((n, vec, vec), jnp.nan + 0j)
        none, all_lines = jnp.zeros(n, int), jnp.ones(n)
        return Estimate(G, cov, self.residual_dof(signals) * all_lines, none, all_lines, none > 0)
'''

FORMAT = '''
"""Records of a logger that writes `name;unit` lines above columns of numbers."""

import numpy as np

from ._container import Variables

KIND = "a log of numbers"


def load(path):
    text = path.read_text(encoding="utf-8").splitlines()
    names = [line[1:].split(";") for line in text if line.startswith("#")]
    columns = np.loadtxt([line for line in text if not line.startswith("#")], ndmin=2)
    units = {name: unit for name, unit in names if unit}
    return Variables({name: columns[:, i] for i, (name, _) in enumerate(names)}, units)
'''


@pytest.fixture
def new_file(tmp_path, monkeypatch):
    """Stands for a file of the package: gives its module."""

    def made(name, text):
        path = tmp_path / f"{name.rpartition('.')[2]}.py"
        path.write_text(text)
        spec = importlib.util.spec_from_file_location(name, path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, module)
        spec.loader.exec_module(module)
        return module

    return made


def test_an_estimator(new_file, tmp_path, monkeypatch, capsys):
    """Its name, its option and its place in means are known to the command line."""
    from jaxfrf.frf.catalogue import METHODS, method

    module = new_file("jaxfrf.frf.ridge", ESTIMATOR)
    monkeypatch.setitem(METHODS, "ridge", ("H1 with a ridge", module.RidgeH1()))  # the line
    run, frf = str(tmp_path / "run.npz"), str(tmp_path / "frf.npz")
    data = jf.example(blocks=2)
    jf.io.write(run, data)
    assert main(["estimate", run, "-o", frf, "--method", "ridge", "--option", "ridge=1e-9"]) == 0
    assert "RidgeH1(ridge=1e-09)" in capsys.readouterr().out
    np.testing.assert_allclose(jf.io.read_frf(frf).G, jf.estimate(data, jf.H1()).G, rtol=1e-3)
    assert main(["estimate", run, "-o", frf, "--method", "ridge", "--option", "ridgee=1"]) == 2
    assert "some of ridge" in capsys.readouterr().err
    mean = jf.estimate(data, jf.ArithmeticMean(method("ridge")))
    np.testing.assert_allclose(mean.G, jf.estimate(data, jf.ArithmeticMean()).G, rtol=1e-3)


def test_a_record_format(new_file, tmp_path, monkeypatch, capsys):
    """Names, units, other files beside it and messages come with it."""
    from jaxfrf.io._container import _FORMATS

    new_file("jaxfrf.io._log", FORMAT)
    monkeypatch.setitem(_FORMATS, ".log", "_log")  # the line
    t = np.arange(1000) / 500.0
    table = np.column_stack([np.sin(40 * t), np.cos(40 * t), 3 * t])
    rows = "\n".join(" ".join(map(repr, row.tolist())) for row in table)
    path = tmp_path / "motor.log"
    path.write_text("#torque;mNm\n#speed;deg/s\n#odd;\n" + rows)
    data = jf.io.read(path, names={"u": "torque", "y": "speed"}, values={"fs": 500})
    np.testing.assert_allclose(np.asarray(data.u)[0, 0, :, 0], 1e-3 * table[:, 0], rtol=1e-12)
    np.testing.assert_allclose(np.asarray(data.y)[0, 0, :, 0], np.radians(table[:, 1]), rtol=1e-12)
    assert data.y_quantity == "velocity" and data.sources[0].name == "motor.log"
    arguments = ["estimate", str(path), "-o", str(tmp_path / "frf.npz"), "--map", "u=torqe,y=speed", "--set", "fs=500"]
    assert main(arguments) == 2
    assert "The file has torque (1000,), speed (1000,)" in capsys.readouterr().err
