"""What a torque residual goes with: speed, its sign and size, angle, load; in words."""

import equinox as eqx
import numpy as np

from .torque_score import family_wise, projector, score

_LEVEL = 0.05
_WORTH = 0.1  # of the residual's power: less is not worth a sentence


class Remainder(eqx.Module):
    """`share` of the residual of an axis that goes with `signature`, its `slope` (N m per unit of it) and `p_value`."""

    joint: str = eqx.field(static=True)
    signature: str = eqx.field(static=True)
    share: float
    slope: float
    p_value: float
    says: str = eqx.field(static=True)


def remainder(evidence, fitted, motions, draws: int, seed: int) -> tuple[Remainder, ...]:
    """Signatures that the residual goes with (family-wise, after projection); the strongest of each axis."""
    robot, left = fitted.state.robot(), fitted.residual
    project, block, n = projector(fitted.slopes), evidence.blocks(left), len(robot.axis_names)
    found = []
    for axis, joint in enumerate(robot.axis_names):
        for name in _SIGNATURES:
            torques = []
            for m in motions:
                x = np.zeros((len(m.speed), n))
                x[:, axis] = _SIGNATURES[name](m.angle[:, axis], m.speed[:, axis], m.torque[:, axis])
                torques.append(x)
            found.append((joint, name, score(left, evidence.rows(torques)[:, None], project, block)))
    p = family_wise([x[2] for x in found], draws, seed)
    told = []
    for joint in robot.axis_names:
        own = [(s, name, float(q)) for (at, name, s), q in zip(found, p, strict=True) if at == joint and q <= _LEVEL]
        own = sorted((x for x in own if x[0].explained > _WORTH), key=lambda x: -x[0].explained)
        told += [_said(robot, joint, name, s, q) for s, name, q in own[:1]]
    return tuple(told)


_SIGNATURES = {
    "constant": lambda q, v, u: np.ones_like(v),
    "sign of speed": lambda q, v, u: np.sign(v),
    "speed": lambda q, v, u: v,
    "|speed|": lambda q, v, u: np.abs(v),
    "speed |speed|": lambda q, v, u: v * np.abs(v),
    "angle": lambda q, v, u: q,
    "|torque| sign of speed": lambda q, v, u: np.abs(u) * np.sign(v),
}


def _said(robot, joint: str, name: str, s, p: float) -> Remainder:
    slope = float(s.change[0])
    text = f"{joint}: what remains goes with {name} ({s.explained:.0%} of it, slope {slope:.4g})."
    if name == "|speed|":
        own = float(robot.drives.friction.viscous[robot.axis_names.index(joint)])
        text += f" Viscous friction differs by direction: {own + slope:.4g} forward, {own - slope:.4g} backward."
    return Remainder(joint, name, s.explained, slope, p, text)
