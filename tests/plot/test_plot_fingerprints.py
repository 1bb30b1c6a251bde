"""Fingerprints of effects: spectra, courses and shares against closed forms, and cards that say what they show."""

import types

import numpy as np
import pytest

import jaxfrf as jf
from jaxfrf import effects as fx
from jaxfrf.plot.fingerprints import families, family, fingerprint, fingerprints

FS, PERIOD, LINES = 500.0, 4000, 640
TIME = np.arange(PERIOD) / FS


@pytest.fixture(scope="module")
def robot():
    return jf.robot.r3x()


@pytest.fixture(scope="module")
def scene(robot):
    """A motion in closed form: motor i turns as 5 sin(2 pi f_i t) with f_i = 1/4, 3/8, ... Hz; torque of all is 2 cos
    at line 40 (5 Hz)."""
    rate = 2 * np.pi * (2 + np.arange(6)) / 8.0
    phase = TIME[:, None] * rate
    return types.SimpleNamespace(
        robot=robot,
        period=PERIOD,
        fs=FS,
        gear=np.asarray(robot.drives.gear_ratio),
        angle=(5 * np.sin(phase))[None],
        speed=(5 * rate * np.cos(phase))[None],
        acceleration=(-5 * rate**2 * np.sin(phase))[None],
        load=np.cos(2 * np.pi * 7.625 * TIME)[None, :, None] * np.ones(6),
        command=2 * np.cos(2 * np.pi * 5.0 * TIME)[None, :, None] * np.ones(6),
    )


def lines(course):
    """(exp, line, axis) of a torque on the third motor alone."""
    torque = np.zeros((1, PERIOD, 6))
    torque[..., 2] = course
    return np.fft.rfft(torque, axis=1)[:, :LINES] / PERIOD


def test_spectrum_and_course(robot, scene):
    """Half an amplitude stands in a line; the course goes through the samples of the record."""
    this = fingerprint(fx.TorqueDelay("joint3", 3e-4), lines(0.3 * np.sin(2 * np.pi * 12.5 * TIME)), scene)
    assert this.axis == 2
    assert this.frequency[100] == 12.5
    assert np.abs(this.more[100]) == pytest.approx(0.15) and np.abs(this.base[40]) == pytest.approx(1.0)
    assert np.sum(np.abs(this.more) > 1e-9) == 1
    instants = np.arange(2048) * PERIOD / FS / 2048
    np.testing.assert_allclose(this.course, 0.3 * np.sin(2 * np.pi * 12.5 * instants), atol=1e-9)
    rate = this.signals["rate of the command (N m/s)"]
    np.testing.assert_allclose(rate, -20 * np.pi * np.sin(10 * np.pi * instants), atol=1e-9)


@pytest.mark.parametrize("signal", ["speed", "acceleration", "load"])
def test_share_knows_what_the_torque_depends_on(robot, scene, signal):
    """A cubic of one signal is told by it. Of others in a quarter of phase or at another frequency, chance leaves
    (bins - 1)/samples, about 1 %."""
    x = getattr(scene, signal)[0, :, 2]
    this = fingerprint(fx.CoulombFriction("joint3", 0.1), lines((x / np.max(np.abs(x))) ** 3), scene)
    shares = {name: this.share(name) for name in this.signals}
    told = {"speed": "motor speed", "acceleration": "motor acceleration", "load": "load"}
    own = next(name for name in shares if name.startswith(told[signal]))
    assert shares[own] > 0.97
    alike = {"acceleration": ("arm angle", "within a")}.get(signal, ())  # a sine's acceleration is its angle
    assert all(share < 0.03 for name, share in shares.items() if name != own and not name.startswith(alike))


def test_an_effect_without_joint_is_shown_where_it_is_largest(scene):
    assert fingerprint(fx.Payload(1.0), lines(np.sin(2 * np.pi * TIME)), scene).axis == 2


def test_families_are_those_of_the_library():
    """Every effect of the library has one, play and hardening too, and each its own colour."""
    colours = families()
    assert {family(kind) for kind in fx.library().values()} == set(colours)
    assert family(fx.Backlash) == "springs" and len(set(colours.values())) == len(colours)


def test_cards(robot, scene, tmp_path):
    """Three pictures and the words of every effect; the drawn spectrum is the rms of the lines within 1 Hz."""
    wave = 0.3 * np.sin(2 * np.pi * 12.5 * TIME)
    shown = [fx.Backlash("joint3", 1e-4), fx.FrictionAsymmetry("joint3", 0.1), fx.ViscousFriction("joint3", 1e-3)]
    prints = [fingerprint(e, lines(y), scene) for e, y in zip(shown, (wave, 0.1, scene.speed[0, :, 2]), strict=True)]
    figure, axes = fingerprints(prints, robot.axis_names)
    assert axes.shape == (3, 3)
    words = [" ".join(text.get_text().split()) for text in figure.texts]
    for effect in shown:
        assert f"{effect.name.replace('_', ' ')}, joint3" in words
        assert effect.signature in words
        assert any(all(x.replace("_", " ") in text for x in effect.confusable) for text in words)
    assert all(f"\u25a0 {name}" in words for name in families())
    (drawn,) = axes[0, 0].lines
    assert drawn.get_color() == families()["springs"]
    assert np.max(drawn.get_ydata()) == pytest.approx(0.15 / np.sqrt(8))  # one line of eight within 1 Hz
    assert axes[1, 1].get_title("right") == "constant"
    assert axes[2, 1].get_title("right") == "100 %"
    jf.plot.save(figure, tmp_path / "cards.png")
    assert (tmp_path / "cards.png").stat().st_size > 10_000
