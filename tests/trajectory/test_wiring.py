"""A sign, a factor or an exchange of torque channels is told as what it is."""

import dataclasses

import jax.random as jr
import numpy as np
import pytest
from small_arm import Q
from uncertain_arm import design, machine, model

import jaxfrf as jf
from jaxfrf.trajectory.evidence import Evidence
from jaxfrf.trajectory.measured import measured
from jaxfrf.trajectory.wiring import miswired


@pytest.fixture(scope="module")
def data():
    return jf.simulate(machine(), design(0), Q[:1], key=jr.key(4), run_in=3.0, noise=2e-5)


def wired(data, change):
    return dataclasses.replace(data, u=change(np.array(data.u)))


def opposite(u):
    u[..., 1] *= -1
    return u


def of_the_joint(u):
    u[..., 0] *= float(machine().drives.gear_ratio[0])
    return u


MISTAKES = {
    "as it is": (lambda u: u, []),
    "sign": (opposite, ["elbow is like the opposite"]),
    "exchanged": (lambda u: u[..., ::-1], ["shoulder is like that of elbow", "elbow is like that of shoulder"]),
    "gear": (of_the_joint, ["times what it needs (its gear"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_hints(data, mistake):
    change, expected = MISTAKES[mistake]
    record = measured(wired(data, change))
    said = miswired(model(), record.U[:, :, 1:], Evidence(model(), record).U[:, :, 1:])
    assert len(said) == len(expected)
    for text, part in zip(said, expected, strict=True):
        assert part in text


@pytest.mark.slow
def test_identify_and_diagnose_say_it(data):
    wrong = wired(data, opposite)
    assert any("is its sign wrong?" in text for text in jf.calibrate(model(), wrong).doubts())
    found = jf.diagnose(model(), wrong)
    assert found.verdict == "unexplained" and "is its sign wrong?" in found.says


@pytest.mark.slow
def test_identify_and_diagnose_say_that_motors_stand_elsewhere(data):
    told = "The logged positions of the motors are not those of q: elbow stands"
    moved = dataclasses.replace(data, q=data.q + np.array([0.0, 0.2]))
    assert told.lower() in " ".join(jf.calibrate(model(), moved).doubts()).lower()
    assert told in jf.diagnose(model(), moved).says
