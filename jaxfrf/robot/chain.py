"""Rigid-body dynamics of a serial chain of joints that turn or slide.

Everything is written in world axes about the world origin, so that sums along the chain are cumulative sums
and only the orientations need a recursion. Inside, arrays are component first and batch last, (joint, 3, ...,
batch): one instruction then works on many configurations. Nothing is unrolled into scalars, which XLA would
take minutes to compile.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._annotated import check_fields, checked
from .._errors import input_error
from .._types import Array, traced

Angles = Float[Array, "*batch joint"]


class Chain(eqx.Module):
    """A serial chain of joints, base to tip, each with one freedom; massless links are allowed.

    Wherever angles of joints are spoken of, a sliding (prismatic) joint has its travel in m, and force in N for torque.

    With all joints at zero every frame is parallel to the base frame. That loses no generality: constant
    rotations between joints only turn the constants below.

    **Arguments:**

    - `axis`: unit vector that every joint turns about or slides along, (joint, 3).
    - `offset`: origin of the joint's frame in the frame of the joint before it, (joint, 3), m.
    - `mass`: (joint,), kg. `com`: centre of mass in the joint's frame, (joint, 3), m.
    - `inertia`: tensor elements Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass in the joint's frame,
      (joint, 6), kg m^2.
    - `gravity`: (3,), m/s^2.
    - `slides`: whether each joint slides; none does where it is left out.
    """

    axis: Float[Array, "joint 3"]
    offset: Float[Array, "joint 3"]
    mass: Float[Array, "joint"]
    com: Float[Array, "joint 3"]
    inertia: Float[Array, "joint 6"]
    gravity: Float[Array, "3"]
    slides: tuple[bool, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        check_fields(self)
        if len(self.slides) not in (0, self.n_joints):
            raise input_error(
                "slides", f"{len(self.slides)} entries", f"one for each of {self.n_joints} joints", "Complete it."
            )

    @property
    def axis_lengths(self) -> dict[str, int]:
        """How long axes of arrays are that are named for parts of the chain."""
        return {"joint": self.n_joints}

    @property
    def n_joints(self) -> int:
        return np.shape(self.axis)[0]

    @property
    def sliding(self) -> Float[np.ndarray, "joint"]:
        """1 for joints that slide, 0 for those that turn."""
        return np.array(self.slides or (False,) * self.n_joints, float)

    def with_hinge(self, at: int, axis: Float[Array, "3"]) -> "Chain":
        """The same chain with one more joint before joint number `at`, with a massless link of its own: it turns about
        `axis` where that joint was, and that joint sits at its origin."""
        lib = jnp if traced((self, axis)) else np  # which needs no programs for it
        insert = lambda x, row: jnp.asarray(lib.insert(lib.asarray(x, float), at, row, axis=0))
        axis = lib.asarray(axis, float)
        here = np.arange(self.n_joints)[:, None] == at
        return dataclasses.replace(
            self,
            axis=insert(self.axis, axis / lib.linalg.norm(axis)),
            offset=insert(lib.where(here, 0.0, lib.asarray(self.offset)), self.offset[at]),
            mass=insert(self.mass, 0.0),
            com=insert(self.com, np.zeros(3)),
            inertia=insert(self.inertia, np.zeros(6)),
            slides=(*self.slides[:at], False, *self.slides[at:]) if self.slides else (),
        )


class Frames(eqx.Module):
    """Frames of the links in the world.

    **Fields:** `rotation`: (*batch, joint, 3, 3). `position`: of the origins, (*batch, joint, 3), m.
    """

    rotation: Float[Array, "*batch joint 3 3"]
    position: Float[Array, "*batch joint 3"]


@checked
@eqx.filter_jit
def forward_kinematics(chain: Chain, q: Angles) -> Frames:
    """Orientation and origin of every joint's frame in the world.

    R_i = R_{i-1} exp(q_i [axis_i]x), p_i = p_{i-1} + R_{i-1} offset_i of a joint that turns,
    R_i = R_{i-1}, p_i = p_{i-1} + R_{i-1} (offset_i + q_i axis_i) of one that slides.

    **Arguments:** `chain`: links and joints. `q`: joint angles, (*batch, joint), rad.

    **Returns:** `Frames` in the base frame: rotations, (*batch, joint, 3, 3), and positions, (*batch, joint, 3), m.

    **Raises:** `jaxfrf.InputError` for another number of angles than joints.

    **Source:** the equations above; the turns by Rodrigues' formula.
    """
    (angles,), batch = _columns(chain, q)
    rotation, position = _frames(chain, angles)
    return Frames(
        jnp.moveaxis(rotation, -1, 0).reshape(*batch, chain.n_joints, 3, 3),
        jnp.moveaxis(position, -1, 0).reshape(*batch, chain.n_joints, 3),
    )


@checked
@eqx.filter_jit
def mass_matrix(chain: Chain, q: Angles) -> Float[Array, "*batch joint joint"]:
    """Joint-space inertia by composite bodies (CRBA), M_ij = s_i . I_c(max(i, j)) s_j; kg m^2.

    **Arguments:** `chain`: links and joints. `q`: joint angles, (*batch, joint), rad.

    **Returns:** M(q), (*batch, joint, joint), kg m^2.

    **Raises:** `jaxfrf.InputError` for another number of angles than joints.

    **Source:** Featherstone, Rigid Body Dynamics Algorithms, 2008, section 6.2, here in world axes.
    """
    (angles,), batch = _columns(chain, q)
    matrix = _mass_matrix(_bodies(chain, angles))
    return jnp.moveaxis(matrix, -1, 0).reshape(*batch, chain.n_joints, chain.n_joints)


@checked
@eqx.filter_jit
def inverse_dynamics(chain: Chain, q: Angles, rate: Angles, acceleration: Angles) -> Angles:
    """Joint torque of a motion, tau = M(q) q'' + c(q, q') + g(q), by recursive Newton-Euler (RNEA); N m.

    **Arguments:** `chain`: links and joints. `q`: joint angles, (*batch, joint), rad. `rate`, `acceleration`: of the
    joints, of that shape, rad/s and rad/s^2.

    **Returns:** (*batch, joint), N m.

    **Raises:** `jaxfrf.InputError` for another number of angles, rates or accelerations than joints.

    **Source:** Featherstone, Rigid Body Dynamics Algorithms, 2008, section 5.3, here in world axes.
    """
    (angles, rates, accelerations), batch = _columns(chain, q, rate, acceleration)
    return _rows(_newton_euler(chain, _bodies(chain, angles), rates, accelerations), batch)


@checked
@eqx.filter_jit
def bias_forces(chain: Chain, q: Angles, rate: Angles) -> Angles:
    """Torque at zero acceleration, c(q, q') + g(q); (*batch, joint), N m.

    **Arguments:** `chain`: links and joints. `q`: joint angles, (*batch, joint), rad. `rate`: of that shape, rad/s.

    **Returns:** (*batch, joint), N m.

    **Raises:** `jaxfrf.InputError` for another number of angles or rates than joints.

    **Source:** as of `inverse_dynamics`.
    """
    (angles, rates), batch = _columns(chain, q, rate)
    return _rows(_newton_euler(chain, _bodies(chain, angles), rates, jnp.zeros_like(angles)), batch)


@checked
@eqx.filter_jit
def gravity_forces(chain: Chain, q: Angles) -> Angles:
    """Torque that holds the chain at rest, g(q) = d potential_energy / dq; (*batch, joint), N m.

    **Arguments:** `chain`: links and joints. `q`: joint angles, (*batch, joint), rad.

    **Returns:** (*batch, joint), N m.

    **Raises:** `jaxfrf.InputError` for another number of angles than joints.

    **Source:** as of `inverse_dynamics`, at rest.
    """
    (angles,), batch = _columns(chain, q)
    return _rows(_gravity(chain, _bodies(chain, angles)), batch)


@checked
@eqx.filter_jit
def mass_and_bias(chain: Chain, q: Angles, rate: Angles) -> tuple[Float[Array, "*batch joint joint"], Angles]:
    """Both `mass_matrix`, kg m^2, and `bias_forces`, N m, from one pass over the kinematics: what a time step needs.

    **Arguments:** `chain`: links and joints. `q`: joint angles, (*batch, joint), rad. `rate`: of that shape, rad/s.

    **Returns:** (*batch, joint, joint), kg m^2, and (*batch, joint), N m.

    **Raises:** `jaxfrf.InputError` for another number of angles or rates than joints.

    **Source:** as of `mass_matrix` and `inverse_dynamics`.
    """
    (angles, rates), batch = _columns(chain, q, rate)
    bodies = _bodies(chain, angles)
    matrix = jnp.moveaxis(_mass_matrix(bodies), -1, 0).reshape(*batch, chain.n_joints, chain.n_joints)
    return matrix, _rows(_newton_euler(chain, bodies, rates, jnp.zeros_like(angles)), batch)


@checked
def mass_and_bias_columns(
    chain: Chain, q: Float[Array, "joint run"], rate: Float[Array, "joint run"]
) -> tuple[Float[Array, "joint joint run"], Float[Array, "joint run"]]:
    """As `mass_and_bias`, of many runs with the runs last.

    **Arguments:** `chain`: links and joints. `q`: (joint, run), rad. `rate`: (joint, run), rad/s.

    **Returns:** (joint, joint, run), kg m^2, and (joint, run), N m.

    **Source:** as of `mass_and_bias`.
    """
    bodies = _bodies(chain, q)
    return _mass_matrix(bodies), _newton_euler(chain, bodies, rate, jnp.zeros_like(q))


@checked
@eqx.filter_jit
def potential_energy(chain: Chain, q: Angles) -> Float[Array, "*batch"]:
    """Energy of the links in gravity, -sum_i m_i gravity . c_i(q); (*batch,), J.

    **Arguments:** `chain`: links and joints. `q`: joint angles, (*batch, joint), rad.

    **Returns:** (*batch,), J; 0 with every centre of mass at the height of the base frame's origin.

    **Raises:** `jaxfrf.InputError` for another number of angles than joints.

    **Source:** the equation above.
    """
    frames = forward_kinematics(chain, q)
    centres = frames.position + jnp.einsum("...nij,nj->...ni", frames.rotation, chain.com)
    return -jnp.einsum("...ni,n,i->...", centres, chain.mass, chain.gravity)


class _Bodies(eqx.Module):
    """Joint axes and links in world axes about the world origin, batch last.

    A joint moves the world by the twist (`axis`, `moment`): (a, position x a) where it turns about a, (0, a) where it
    slides along a. A link's momentum follows from its `mass`, first moment `first` = m c and second moment `second`
    (3 x 3).
    """

    axis: jax.Array
    moment: jax.Array
    mass: jax.Array
    first: jax.Array
    second: jax.Array


def _columns(chain: Chain, *angles):
    """Angles (*batch, joint) as (joint, flat batch), and the batch shape they share."""
    batch = jnp.broadcast_shapes(*(jnp.shape(x)[:-1] for x in angles))
    flat = (jnp.broadcast_to(x, (*batch, chain.n_joints)).reshape(-1, chain.n_joints) for x in angles)
    return tuple(x.T for x in flat), batch


def _rows(columns, batch):
    return columns.T.reshape(*batch, columns.shape[0])


def _cross(a, b):
    return jnp.cross(a, b, axis=-2)


def _skew(v):
    """[v]x of vectors (joint, 3)."""
    zero = jnp.zeros_like(v[:, 0])
    x, y, z = v[:, 0], v[:, 1], v[:, 2]
    return jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)


def _frames(chain: Chain, q):
    """Rotation (joint, 3, 3, batch) and position (joint, 3, batch) of every frame."""
    k, offset = _skew(jnp.asarray(chain.axis)), jnp.asarray(chain.offset, q.dtype)[..., None]
    if any(chain.slides):
        slide = chain.sliding[:, None]
        offset = offset + jnp.asarray(chain.axis)[..., None] * (slide * q)[:, None]
        q = (1.0 - slide) * q
    sine, versine = jnp.sin(q)[:, None, None], 2.0 * jnp.square(jnp.sin(0.5 * q))[:, None, None]
    turns = jnp.eye(3)[..., None] + k[..., None] * sine + (k @ k)[..., None] * versine  # Rodrigues

    def step(frame, joint):
        rotation, position = frame
        turn, offset = joint
        position = position + jnp.sum(rotation * offset[None], axis=1)
        rotation = jnp.sum(rotation[:, :, None] * turn[None], axis=1)
        return (rotation, position), (rotation, position)

    # The start takes its type from `turns`, so that a batch axis that vmap adds is carried along.
    start = jnp.zeros_like(turns[0]) + jnp.eye(3, dtype=turns.dtype)[..., None], jnp.zeros_like(turns[0, 0])
    _, frames = jax.lax.scan(step, start, (turns, offset))
    return frames


def _bodies(chain: Chain, q) -> _Bodies:
    rotation, position = _frames(chain, q)
    axis = jnp.sum(rotation * chain.axis[:, None, :, None], axis=2)
    centre = position + jnp.sum(rotation * chain.com[:, None, :, None], axis=2)
    xx, yy, zz, xy, xz, yz = jnp.asarray(chain.inertia).T
    tensor = jnp.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
    turned = jnp.sum(rotation[:, :, :, None] * tensor[:, None, :, :, None], axis=2)
    about_centre = jnp.sum(turned[:, :, None] * rotation[:, None], axis=3)
    spread = (
        jnp.sum(centre * centre, axis=1)[:, None, None] * jnp.eye(3)[..., None] - centre[:, :, None] * centre[:, None]
    )
    mass, moment = jnp.asarray(chain.mass), _cross(position, axis)
    if any(chain.slides):
        slide = jnp.asarray(chain.sliding[:, None, None])
        axis, moment = (1.0 - slide) * axis, (1.0 - slide) * moment + slide * axis
    return _Bodies(
        axis=axis,
        moment=moment,
        mass=mass,
        first=mass[:, None, None] * centre,
        second=about_centre + mass[:, None, None, None] * spread,
    )


def _from_tip(x):
    """Sum over the joint itself and all joints after it."""
    return jnp.flip(jnp.cumsum(jnp.flip(x, 0), axis=0), 0)


def _momentum(bodies: _Bodies, angular, linear):
    """Momentum about the world origin of links that move with the twists (angular, linear)."""
    about_origin = jnp.sum(bodies.second * angular[:, None], axis=2) + _cross(bodies.first, linear)
    return about_origin, bodies.mass[:, None, None] * linear + _cross(angular, bodies.first)


def _project(bodies: _Bodies, moment, force):
    """Torque about each joint of the wrenches on it and on all that it carries: (joint, batch)."""
    return jnp.sum(bodies.axis * _from_tip(moment), axis=1) + jnp.sum(bodies.moment * _from_tip(force), axis=1)


def _mass_matrix(bodies: _Bodies):
    composite = _Bodies(
        bodies.axis, bodies.moment, _from_tip(bodies.mass), _from_tip(bodies.first), _from_tip(bodies.second)
    )
    angular, linear = _momentum(composite, bodies.axis, bodies.moment)
    full = jnp.sum(bodies.axis[:, None] * angular[None], axis=2) + jnp.sum(
        bodies.moment[:, None] * linear[None], axis=2
    )
    # s_i . I_c(j) s_j is the element where joint i carries composite body j, that is for i <= j.
    upper = np.triu(np.ones(full.shape[:2], bool))[..., None]
    return jnp.where(upper, full, jnp.swapaxes(full, 0, 1))


def _newton_euler(chain: Chain, bodies: _Bodies, rate, acceleration):
    rate, acceleration = rate[:, None], acceleration[:, None]
    turn, shift = bodies.axis * rate, bodies.moment * rate
    angular, linear = jnp.cumsum(turn, axis=0), jnp.cumsum(shift, axis=0)
    # A joint's twist is fixed in its link, so its rate of change is (link twist) x (joint twist).
    angular_rate = jnp.cumsum(bodies.axis * acceleration + _cross(angular, turn), axis=0)
    linear_rate = jnp.cumsum(bodies.moment * acceleration + _cross(angular, shift) + _cross(linear, turn), axis=0)
    linear_rate = linear_rate - jnp.asarray(chain.gravity)[:, None]
    about_origin, momentum = _momentum(bodies, angular, linear)
    moment, force = _momentum(bodies, angular_rate, linear_rate)
    moment = moment + _cross(angular, about_origin) + _cross(linear, momentum)
    force = force + _cross(angular, momentum)
    return _project(bodies, moment, force)


def _gravity(chain: Chain, bodies: _Bodies):
    upward = -jnp.asarray(chain.gravity)[:, None]
    return _project(bodies, _cross(bodies.first, upward[None]), bodies.mass[:, None, None] * upward)
