"""A robot with elastic joints: a chain, the motors and gears that drive it, and the springs in between."""

import dataclasses

import equinox as eqx
import numpy as np

from .._annotated import check_fields
from .._arguments import expect, said
from .._errors import input_error
from ..effects import AbstractEffect, AbstractStructure
from .chain import Chain
from .controller import Controller
from .drive import Drives, Spring
from .tolerances import Tolerances

_UNPACK = "Unpack a list: with_effects(*effects)."


class Robot(eqx.Module):
    """Chain, drive trains and springs; immutable, differentiable in every array.

    Coordinates are z = [q_m, q_a, q_e]: angles of the motors behind flexible transmissions (motor side), of
    all driven joints (arm side), of the compliant elastic joints. A rigid transmission (`stiffness = inf`)
    has no coordinate of its own, its motor turns with the arm; a stiff elastic joint stays at zero. The state
    is [z, z'], (*batch, 2 dof).

    **Arguments:**

    - `chain`: links and joints. `drives`: motors and gears of the driven joints.
    - `springs`: of the flexible transmissions, then of the compliant elastic joints.
    - `joint_names`: of all joints, base to tip. `driven`: whether a joint has a motor (elastic otherwise).
    - `stiff`: whether its transmission is rigid (driven), or it is locked (elastic).
    - `controller`, `sampling_frequency` (Hz): for the simulation.
    - `effects`: that act beside the robot's own laws; see `with_effects`.
    - `name`: in messages and reports. `tolerances`: how well its numbers are known.
    - `limits`: lowest and highest angle of every axis, rad or m, infinite where unknown; () where all are. Positions
      are chosen between them; the dynamics do not know them.

    **Raises:** `jaxfrf.InputError` where names, joints and motors differ in number.

    **Source:** Moberg, Wernholt, Hanssen & Brogardh, J. Dyn. Sys. Meas. Control 136, 2014 (extended flexible joint
    model).
    """

    chain: Chain
    drives: Drives
    springs: Spring
    joint_names: tuple[str, ...] = eqx.field(static=True)
    driven: tuple[bool, ...] = eqx.field(static=True)
    stiff: tuple[bool, ...] = eqx.field(static=True)
    controller: Controller | None = None
    effects: tuple[AbstractEffect, ...] = ()
    name: str = eqx.field(static=True, default="robot")
    sampling_frequency: float = eqx.field(static=True, default=2000.0)
    tolerances: Tolerances = eqx.field(static=True, default=Tolerances())
    limits: tuple[tuple[float, float], ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        check_fields(self)
        n = self.chain.n_joints
        for field in ("joint_names", "driven", "stiff"):
            if len(getattr(self, field)) != n:
                raise input_error(
                    field, f"{len(getattr(self, field))} entries", f"one for each of {n} joints", "Complete it."
                )
        for field, count, of in (
            ("motor_inertia", self.n_axes, self.drives.motor_inertia),
            ("stiffness", len(self.spring_names), self.springs.stiffness),
        ):
            if np.shape(of) != (count,):
                raise input_error(field, f"shape {np.shape(of)}", f"({count},)", "Give one for each axis or spring.")
        pairs = [low < high and np.isfinite(low) == np.isfinite(high) for low, high in self.limits]
        if self.limits and (len(pairs) != self.n_axes or not all(pairs)):
            raise input_error("limits", f"{self.limits}", "(lowest, highest) for each axis, or none", "Complete them.")

    def with_effects(self, *effects: AbstractEffect) -> "Robot":
        """The same robot with more effects (`jaxfrf.effects`), in the simulation and in the linearisation.

        An effect on the robot's own numbers or joints (`AbstractStructure`) becomes part of them; the others stand
        in `effects`.

        **Raises:** `jaxfrf.InputError` for what is no effect, where one names a joint that the robot does not have, or
        where it cannot act.
        """
        robot = self
        for effect in effects:
            if isinstance(effect, list | tuple):
                raise input_error("effects", said(effect), "effects, one after the other", _UNPACK)
            expect("effects", effect, AbstractEffect)
            if isinstance(effect, AbstractStructure):
                robot = effect.apply(robot)
            else:
                effect.check(robot)
                robot = dataclasses.replace(robot, effects=(*robot.effects, effect))
        return robot

    def with_tolerances(self, tolerances: Tolerances) -> "Robot":
        """The same robot, its numbers known better or worse: what is stated here goes before what was."""
        return dataclasses.replace(self, tolerances=self.tolerances.updated(tolerances))

    @property
    def axis_lengths(self) -> dict[str, int]:
        """How long axes of arrays are that are named for parts of the robot: {"axis": 6, "joint": 8, ...}."""
        arm = len(self.arm_joints)
        lengths = {"axis": self.n_axes, "arm": arm, "dof": self.dof, "state": 2 * self.dof}
        return lengths | {"motor": self.n_motors, "spring": len(self.spring_names), "joint": self.chain.n_joints}

    @property
    def n_axes(self) -> int:
        """Driven joints: inputs and outputs of the robot."""
        return sum(self.driven)

    @property
    def n_motors(self) -> int:
        """Motors with a coordinate of their own, behind flexible transmissions."""
        return len(self.flexible_axes)

    @property
    def n_elastic(self) -> int:
        return len(self.elastic_joints)

    @property
    def dof(self) -> int:
        return self.n_motors + self.n_axes + self.n_elastic

    @property
    def driven_joints(self) -> tuple[int, ...]:
        """Place in the chain of every axis."""
        return tuple(i for i, driven in enumerate(self.driven) if driven)

    @property
    def elastic_joints(self) -> tuple[int, ...]:
        """Place in the chain of every compliant elastic joint."""
        return tuple(
            i for i, (driven, stiff) in enumerate(zip(self.driven, self.stiff, strict=True)) if not (driven or stiff)
        )

    @property
    def arm_joints(self) -> tuple[int, ...]:
        """Place in the chain of [q_a, q_e]."""
        return self.driven_joints + self.elastic_joints

    @property
    def flexible_axes(self) -> tuple[int, ...]:
        """Axes (counted among the driven joints) whose transmission is flexible."""
        return tuple(axis for axis, joint in enumerate(self.driven_joints) if not self.stiff[joint])

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(self.joint_names[i] for i in self.driven_joints)

    @property
    def axis_units(self) -> tuple[str, ...]:
        """What the arm's side of every axis is counted in: rad, or m of one that slides."""
        return tuple("m" if self.chain.sliding[i] else "rad" for i in self.driven_joints)

    @property
    def spring_names(self) -> tuple[str, ...]:
        """Names of the joints that the springs belong to, in the order of `springs`."""
        flexible = tuple(self.driven_joints[axis] for axis in self.flexible_axes)
        return tuple(self.joint_names[i] for i in flexible + self.elastic_joints)
