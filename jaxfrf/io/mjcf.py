"""A robot as an MJCF model, for MuJoCo."""

import math
import os
import pathlib
import xml.etree.ElementTree as ET

import numpy as np

from .._arguments import expect, expect_path
from .._errors import input_error
from .._files import replacing
from ..robot.drive import Friction, Spring, ViscousFrictionLaw
from ..robot.robot import Robot


def mjcf(robot: Robot, friction: bool = True, timestep: float = 1e-4) -> str:
    """The flexible robot as MJCF text.

    Rotors are bodies of their own, transmissions tendons with spring and damper. A motor's joint is called
    `motor:` and the name of its axis, its actuator as the axis; the actuator's control is the motor torque. A
    massless link shares a body with the next one. A rigid transmission becomes armature and a geared
    actuator. The springs must be linear: MuJoCo's are. Effects that became numbers of the robot (a payload) go along;
    those that stand in `robot.effects` have no place there.

    **Arguments:** `friction`: include viscous friction as damping and Coulomb friction as frictionloss (which
    is not smoothed there). `timestep`: s.

    **Raises:** `jaxfrf.InputError` for what MuJoCo cannot do: effects, nonlinear springs, play, a law of friction of
    your own, a massless last link, a link with mass whose inertia no body can have.
    """
    expect("robot", robot, Robot)
    _check_laws(robot, friction)
    root = ET.Element("mujoco", model=robot.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    option = ET.SubElement(
        root, "option", timestep=f"{timestep!r}", gravity=_text(robot.chain.gravity), integrator="RK4"
    )
    ET.SubElement(option, "flag", contact="disable")
    world = ET.SubElement(root, "worldbody")
    _arm(world, robot, friction)
    tendons, actuators = ET.SubElement(root, "tendon"), ET.SubElement(root, "actuator")
    for axis, name in enumerate(robot.axis_names):
        _drive(world, tendons, actuators, robot, axis, name, friction)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def write_mjcf(path: str | os.PathLike, robot: Robot, friction: bool = True, timestep: float = 1e-4) -> None:
    """Write `mjcf(robot)` to a file. Nothing half written is left.

    **Arguments:** `path`: of the XML file. `robot`, `friction`, `timestep` (s): as of `mjcf`.

    **Raises:** as `mjcf`, and `jaxfrf.InputError` if the folder is not there.
    """
    expect_path("path", path)
    expect("robot", robot, Robot)
    with replacing(pathlib.Path(path)) as draft:
        draft.write_text(mjcf(robot, friction, timestep), encoding="utf-8")


def _check_laws(robot: Robot, friction: bool) -> None:
    if robot.effects:
        raise input_error(
            f"{robot.name}: effects",
            ", ".join(dict.fromkeys(effect.name for effect in robot.effects)),
            "none: MuJoCo has no such laws",
            "Write the robot without: dataclasses.replace(robot, effects=()).",
        )
    if friction and not isinstance(robot.drives.friction, Friction | ViscousFrictionLaw):
        raise input_error(
            f"{robot.name}: friction",
            type(robot.drives.friction).__name__,
            "Friction or ViscousFrictionLaw, which MuJoCo has",
            "Write the robot without: friction=False.",
        )
    play = getattr(robot.springs, "backlash", None)
    if play is not None and np.any(np.asarray(play) > 0.0):
        raise input_error(f"{robot.name}: springs", "play", "none: MuJoCo has no such law", "Set backlash to None.")
    if not isinstance(robot.springs, Spring) or np.any(np.asarray(robot.springs.stiffness_ratio) != 1.0):
        raise input_error(
            f"{robot.name}: springs",
            "nonlinear ones",
            "linear springs, the only ones that MuJoCo has",
            "Set each stiffness_ratio to 1 (`with_parameters`), and each stiffness to its `local_stiffness`.",
        )


def _arm(world: ET.Element, robot: Robot, friction: bool) -> None:
    chain = robot.chain
    parent, origin, waiting = (
        world,
        np.zeros(3),
        [],
    )  # joints that wait for a link with mass, with their origins
    for i, name in enumerate(robot.joint_names):
        origin = origin + np.asarray(chain.offset[i])
        waiting.append((i, origin))
        if float(chain.mass[i]) == 0.0 and not np.any(np.asarray(chain.inertia[i])):
            continue
        _check_inertia(robot, i)
        body = ET.SubElement(parent, "body", name=name, pos=_text(origin))
        for j, place in waiting:
            if robot.driven[j] or not robot.stiff[j]:
                _joint(body, robot, j, place - origin, friction)
        ET.SubElement(
            body,
            "inertial",
            pos=_text(chain.com[i]),
            mass=f"{float(chain.mass[i])!r}",
            fullinertia=_text(chain.inertia[i]),
        )
        parent, origin, waiting = body, np.zeros(3), []
    if waiting:
        raise input_error(
            f"{robot.name}: {robot.joint_names[-1]}",
            "a massless link at the tip",
            "a mass",
            "Give it mass and inertia.",
        )


def _check_inertia(robot: Robot, i: int) -> None:
    xx, yy, zz, xy, xz, yz = np.asarray(robot.chain.inertia[i])
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    flat = moments[0] + moments[1] < moments[2] * (1.0 - 1e-9)  # more than a plane lamina can have
    if float(robot.chain.mass[i]) <= 0.0 or moments[0] <= 0.0 or flat:
        raise input_error(
            f"{robot.name}: {robot.joint_names[i]}",
            f"mass {float(robot.chain.mass[i]):g} kg and principal inertias {moments.tolist()}",
            "positive ones of which none exceeds the other two together (or all zero: a massless link)",
            "MuJoCo simulates physical bodies only: complete the link's numbers.",
        )


def _joint(body: ET.Element, robot: Robot, i: int, place, friction: bool) -> None:
    name = robot.joint_names[i]
    kind = "slide" if robot.chain.sliding[i] else "hinge"
    joint = ET.SubElement(body, "joint", name=name, type=kind, pos=_text(place), axis=_text(robot.chain.axis[i]))
    if not robot.driven[i]:
        spring = robot.spring_names.index(name)
        joint.set("stiffness", f"{float(robot.springs.stiffness[spring])!r}")
        joint.set("damping", f"{float(robot.springs.damping[spring])!r}")
    elif robot.stiff[i]:
        axis = robot.axis_names.index(name)
        gear = float(robot.drives.gear_ratio[axis])
        joint.set("armature", f"{gear**2 * float(robot.drives.motor_inertia[axis])!r}")
        _rub(joint, robot, axis, gear, friction)


def _rub(joint: ET.Element, robot: Robot, axis: int, gear: float, friction: bool) -> None:
    law = robot.drives.friction
    if not friction:
        return
    joint.set("damping", f"{gear**2 * float(law.viscous[axis])!r}")
    if isinstance(law, Friction):
        joint.set("frictionloss", f"{abs(gear) * float(law.coulomb[axis])!r}")


def _drive(world, tendons, actuators, robot: Robot, axis: int, name: str, friction: bool) -> None:
    drives = robot.drives
    gear, limit = float(drives.gear_ratio[axis]), float(drives.torque_limit[axis])
    driven, ratio = f"motor:{name}", 1.0
    if axis in robot.flexible_axes:
        rotor = ET.SubElement(world, "body", name=driven)
        _rub(ET.SubElement(rotor, "joint", name=driven, type="hinge", axis="0 0 1"), robot, axis, 1.0, friction)
        inertia = f"{float(drives.motor_inertia[axis])!r}"
        # The mass lies on the axis and has no effect; MuJoCo wants one.
        ET.SubElement(rotor, "inertial", pos="0 0 0", mass="1", diaginertia=" ".join([inertia] * 3))
        _transmission(tendons, robot, name, driven, gear)
    else:
        driven, ratio = name, gear
    actuator = ET.SubElement(actuators, "motor", name=name, joint=driven, gear=f"{ratio!r}")
    if math.isfinite(limit):
        actuator.set("ctrlrange", f"{-limit!r} {limit!r}")


def _transmission(tendons, robot: Robot, name: str, motor: str, gear: float) -> None:
    spring = robot.spring_names.index(name)
    tendon = ET.SubElement(
        tendons,
        "fixed",
        name=name,
        stiffness=f"{float(robot.springs.stiffness[spring])!r}",
        damping=f"{float(robot.springs.damping[spring])!r}",
        springlength="0",
    )
    ET.SubElement(tendon, "joint", joint=motor, coef=f"{1.0 / gear!r}")
    ET.SubElement(tendon, "joint", joint=name, coef="-1")


def _text(values) -> str:
    return " ".join(repr(float(x)) for x in np.asarray(values))
