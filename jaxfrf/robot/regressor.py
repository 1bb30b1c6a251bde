"""Joint torques as a linear function of the links' masses, first moments and moments of inertia."""

import numpy as np
from jaxtyping import Float

from .chain import Chain

PER_LINK = 10  # mass, m c (3), inertia about the joint's origin (xx, yy, zz, xy, xz, yz)
_MIXED = ((0, 1), (0, 2), (1, 2))


def link_regressor(
    chain: Chain,
    angle: Float[np.ndarray, "joint sample"],
    rate: Float[np.ndarray, "joint sample"],
    acceleration: Float[np.ndarray, "joint sample"],
) -> Float[np.ndarray, "joint joint parameter sample"]:
    """Torque of each joint that each of a link's ten parameters needs for a motion, N m: torque = Y pi.

    The parameters of a link are its mass, its first moment m c and its inertia about the origin of its joint's frame,
    in that frame: torques are linear in them (Atkeson, An & Hollerbach, Int. J. Robotics Research 5(3), 1986). Y is
    [joint that pushes, link, parameter, sample]; a joint pushes only what hangs on it. Newton and Euler in every link,
    gravity as an acceleration of the base.

    **Arguments:** of all joints in chain order, rad, rad/s, rad/s^2 (m, ... of those that slide).
    """
    n, count = angle.shape
    axis, offset, slides = np.asarray(chain.axis, float), np.asarray(chain.offset, float), chain.sliding
    turn, place = np.broadcast_to(np.eye(3)[..., None], (3, 3, count)), np.zeros((3, count))
    w, dw, a = np.zeros((3, count)), np.zeros((3, count)), -np.asarray(chain.gravity, float)[:, None] * np.ones(count)
    axes, places = np.zeros((3, n, count)), np.zeros((3, n, count))
    sliding = np.array(slides)[:, None]
    Y = np.zeros((n, n, PER_LINK, count))
    for i in range(n):
        arm, along = _turned(turn, offset[i]), _turned(turn, axis[i])
        if slides[i]:
            arm = arm + along * angle[i]
        a = a + _cross(dw, arm) + _cross(w, _cross(w, arm))
        place = place + arm
        axes[:, i], places[:, i] = along, place
        if slides[i]:
            a = a + along * acceleration[i] + 2.0 * _cross(w, along * rate[i])
        else:
            dw = dw + along * acceleration[i] + _cross(w, along * rate[i])
            w = w + along * rate[i]
            turn = _turned(turn[:, :, None], _rotation(axis[i], angle[i]))
        pushing, place_of = axes[:, : i + 1], place[:, None] - places[:, : i + 1]
        lever = np.where(sliding[: i + 1], pushing, _cross(pushing, place_of))
        turned = np.where(sliding[: i + 1], 0.0, pushing)
        own = [_turned_back(turn, x) for x in (w[:, None], dw[:, None], a[:, None], lever, turned)]
        Y[: i + 1, i] = np.moveaxis(_needed(*own), 0, 1)
    return Y


def link_parameters(mass, com, inertia) -> Float[np.ndarray, "parameter"]:
    """The ten parameters of a link from its mass, centre and inertia about the centre."""
    x, y, z = np.asarray(com, float)
    square = np.array([y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z])
    return np.concatenate([[mass], mass * np.array([x, y, z]), np.asarray(inertia, float) + mass * square])


def _needed(w, dw, a, lever, axis) -> Float[np.ndarray, "parameter push sample"]:
    """Torque about axes with these levers that each parameter needs, all in the link's own frame, (3, push, sample).

    The force is m a + dw x c + w x (w x c), the moment about the origin c x a + J dw + w x J w, with c for m c: sums of
    products with lever and axis, ordered by the parameters."""
    first = _cross(lever, dw) + w * _product(w, lever) - lever * _product(w, w) + _cross(a, axis)
    across = _cross(axis, w)
    squares = axis * dw + across * w
    mixed = [axis[k] * dw[m] + axis[m] * dw[k] + across[k] * w[m] + across[m] * w[k] for k, m in _MIXED]
    return np.stack([_product(lever, a), *first, *squares, *mixed])


def _product(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _turned(turn, x):
    """A vector of the frame, the same at all samples, or the columns of another turn within it."""
    return turn[:, 0] * x[0] + turn[:, 1] * x[1] + turn[:, 2] * x[2]


def _turned_back(turn: Float[np.ndarray, "3 3 sample"], x: Float[np.ndarray, "3 push sample"]):
    return turn[0][:, None] * x[0] + turn[1][:, None] * x[1] + turn[2][:, None] * x[2]


def _cross(a, b):
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _rotation(axis, angle):
    """Rodrigues' rotation, (3, 3, sample)."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, turned = np.sin(angle), 1.0 - np.cos(angle)
    return np.eye(3)[..., None] + skew[..., None] * sine + (skew @ skew)[..., None] * turned
