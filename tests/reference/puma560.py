"""The Puma 560 after Armstrong, Khatib & Burdick (1986) as in Corke & Armstrong-Helouvry, "A search for
consensus among model parameters reported for the PUMA 560 robot arm", ICRA 1994: standard Denavit-Hartenberg
frames, SI units."""

import jax.numpy as jnp
import numpy as np

from jaxfrf.robot import Chain, Drives, Friction, Robot, Spring

ALPHA = np.array([np.pi / 2, 0, -np.pi / 2, np.pi / 2, -np.pi / 2, 0])
A = np.array([0, 0.4318, 0.0203, 0, 0, 0])
D = np.array([0, 0, 0.15005, 0.4318, 0, 0])
MASS = np.array([0, 17.4, 4.8, 0.82, 0.34, 0.09])
COM = np.array(
    [[0, 0, 0], [-0.3638, 0.006, 0.2275], [-0.0203, -0.0141, 0.070], [0, 0.019, 0], [0, 0, 0], [0, 0, 0.032]]
)
INERTIA = np.array(
    [
        [0, 0.35, 0],
        [0.13, 0.524, 0.539],
        [0.066, 0.086, 0.0125],
        [1.8e-3, 1.3e-3, 1.8e-3],
        [0.3e-3, 0.4e-3, 0.3e-3],
        [0.15e-3, 0.15e-3, 0.04e-3],
    ]
)
MOTOR_INERTIA = np.array([200e-6, 200e-6, 200e-6, 33e-6, 33e-6, 33e-6])
GEAR = np.array([-62.6111, 107.815, -53.7063, 76.0364, 71.923, 76.686])


def _frame(i):
    c, s = np.cos(ALPHA[i]), np.sin(ALPHA[i])
    return np.array([[1, 0, 0, A[i]], [0, c, -s, 0], [0, s, c, D[i]], [0, 0, 0, 1]])


def puma560(complete_first_link=False) -> Robot:
    """The rigid robot (all transmissions rigid). The first link's published numbers are those that have an
    effect; `complete_first_link` adds mass on the axis and inertia across it, which have none, to make it a
    body."""
    mass, com, inertia = MASS.copy(), COM.copy(), [np.diag(x) for x in INERTIA]
    if complete_first_link:
        mass[0], inertia[0] = 1.0, np.diag([0.3, 0.35, 0.3])
    before = np.eye(4)
    axes, offsets, coms, tensors = [], [], [], []
    origin = np.zeros(3)
    for i in range(6):
        after = before @ _frame(i)
        axes.append(before[:3, 2])
        offsets.append(before[:3, 3] - origin)
        origin = before[:3, 3]
        coms.append(after[:3, :3] @ com[i] + after[:3, 3] - origin)
        tensors.append(after[:3, :3] @ inertia[i] @ after[:3, :3].T)
        before = after
    tensors = np.array(tensors)
    elements = np.stack([tensors[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], axis=1)
    none = jnp.zeros(0)
    return Robot(
        chain=Chain(*(jnp.array(x) for x in (axes, offsets, mass, coms, elements)), jnp.array([0, 0, -9.81])),
        drives=Drives(
            jnp.array(MOTOR_INERTIA),
            jnp.array(GEAR),
            jnp.full(6, jnp.inf),
            Friction(jnp.zeros(6), jnp.zeros(6), jnp.array(0.2)),
        ),
        springs=Spring(none, none, none, none),
        joint_names=tuple(f"joint{i + 1}" for i in range(6)),
        driven=(True,) * 6,
        stiff=(True,) * 6,
        name="Puma 560",
    )
