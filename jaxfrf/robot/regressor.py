"""Joint torques as a linear function of the links' masses, first moments and moments of inertia."""

import numpy as np
from jaxtyping import Float

from .chain import Chain

PER_LINK = 10  # mass, m c (3), inertia about the joint's origin (xx, yy, zz, xy, xz, yz)


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
    axes, places = np.zeros((n, 3, count)), np.zeros((n, 3, count))
    Y = np.zeros((n, n, PER_LINK, count))
    for i in range(n):
        arm = np.einsum("abt,b->at", turn, offset[i])
        axes[i] = np.einsum("abt,b->at", turn, axis[i])
        if slides[i]:
            arm = arm + axes[i] * angle[i]
        a = a + _cross(dw, arm) + _cross(w, _cross(w, arm))
        place = place + arm
        places[i] = place
        if slides[i]:
            a = a + axes[i] * acceleration[i] + 2.0 * _cross(w, axes[i] * rate[i])
        else:
            dw = dw + axes[i] * acceleration[i] + _cross(w, axes[i] * rate[i])
            w = w + axes[i] * rate[i]
            turn = np.einsum("abt,bct->act", turn, _rotation(axis[i], angle[i]))
        own = lambda x, turn=turn: np.einsum("bat,bt->at", turn, x)
        force, moment = _wrenches(own(w), own(dw), own(a))
        for j in range(i + 1):
            lever = axes[j] if slides[j] else _cross(axes[j], place - places[j])
            Y[j, i] = np.einsum("pat,at->pt", force, own(lever))
            if not slides[j]:
                Y[j, i] += np.einsum("pat,at->pt", moment, own(axes[j]))
    return Y


def link_parameters(mass, com, inertia) -> Float[np.ndarray, "parameter"]:
    """The ten parameters of a link from its mass, centre and inertia about the centre."""
    x, y, z = np.asarray(com, float)
    square = np.array([y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z])
    return np.concatenate([[mass], mass * np.array([x, y, z]), np.asarray(inertia, float) + mass * square])


def _wrenches(w, dw, a):
    """Force and moment about the joint's origin that each parameter needs, (parameter, 3, sample), own frame."""
    count = w.shape[1]
    force, moment = np.zeros((PER_LINK, 3, count)), np.zeros((PER_LINK, 3, count))
    force[0] = a
    for k in range(3):
        unit = np.zeros((3, 1))
        unit[k] = 1.0
        unit = np.broadcast_to(unit, (3, count))
        force[1 + k] = _cross(dw, unit) + _cross(w, _cross(w, unit))
        moment[1 + k] = _cross(unit, a)
    for p, (k, m) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]):
        shape = np.zeros((3, 3))
        shape[k, m] = shape[m, k] = 1.0
        moment[4 + p] = shape @ dw + _cross(w, shape @ w)
    return force, moment


def _cross(a, b):
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _rotation(axis, angle):
    """Rodrigues' rotation, (3, 3, sample)."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, turned = np.sin(angle), 1.0 - np.cos(angle)
    return np.eye(3)[..., None] + skew[..., None] * sine + (skew @ skew)[..., None] * turned
