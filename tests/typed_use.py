"""What a user's type checker sees of the public names: checked by mypy (`mypy`), never run."""

from typing import assert_type

import numpy as np

import jaxfrf as jf


def first_steps() -> None:
    data = jf.io.read("run.nc")
    assert_type(data, jf.Experiment)
    spectra = jf.dft(data)
    assert_type(spectra, jf.Spectra)
    frf = jf.estimate(spectra, jf.JointInputOutput(jf.LRM(order=2)))
    assert_type(frf, jf.FRF)
    jf.io.write_frf("frf.nc", frf)
    assert_type(jf.io.read_frf("frf.nc"), jf.FRF)
    assert_type(jf.features(frf), list[jf.Feature])


def parameters(data: jf.Experiment, frf: jf.FRF) -> None:
    robot = jf.io.read_robot("robot.toml")
    model = jf.RobotModel(robot)
    assert_type(jf.fit(model, frf), jf.Fit)
    assert_type(jf.fit_indirectly(model, data).fit, jf.Fit)
    found = jf.calibrate(robot, data)
    assert_type(found, jf.Calibration)
    assert_type(found.determined_by("joint1.mass"), str)


def simulated(robot: jf.robot.Robot) -> jf.Experiment:
    import jax.random as jr

    design = jf.Multisine(fs=500.0, period=1000, lines=np.arange(7, 121, 2), rms=np.ones(2))
    return jf.simulate(robot, design, jf.random_positions(3, jr.key(0), 2), key=jr.key(1))
