"""Links of a robot from a URDF, its drive trains from a TOML file."""

import os
import pathlib
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._arguments import expect_path
from .._errors import input_error
from .._files import check_readable
from .._text import number
from ..effects import AbstractEffect
from ..robot.robot import Robot
from ..robot.schema import robot_from_table
from .robots import read_robot_toml

_ROUNDED = 0.01  # of the sum of two moments: numbers in a file have few digits
_MOVING = ("revolute", "continuous", "prismatic")


def read_urdf(urdf: str | os.PathLike, drives: str | os.PathLike, own: Sequence[type[AbstractEffect]] = ()) -> Robot:
    """A robot with the links of a URDF (a serial chain) and the drive trains of a TOML file.

    The TOML file has the schema of a robot's file without the links: a `[[joint]]` table for every moving
    joint of the URDF, under its name there, with gear, motor, spring and friction; `type` is `driven` where
    it is left out, `gravity` [0, 0, -9.81]. Fixed joints join their links. `<dynamics damping friction>` of a
    joint is its motor's friction where the TOML file states none of that kind, over the gear ratio n: damping/n^2,
    friction/|n|; `<limit lower upper>` its `limits` likewise. Meshes and transmissions of the URDF are not read.

    **Arguments:** `urdf`, `drives`: paths of both files, in SI units. `own`: effects of your own that the TOML file may
    name.

    **Raises:** `jaxfrf.InputError` for a tree that is not a serial chain, joints of several freedoms, links without
    the numbers that the dynamics need or with some that no body has, and joints that only one of the two files has.
    """
    expect_path("urdf", urdf)
    expect_path("drives", drives)
    urdf, drives = pathlib.Path(urdf), pathlib.Path(drives)
    check_readable(urdf, "the URDF that the robot's file names")
    try:
        root = ET.parse(urdf).getroot()
    except (ET.ParseError, UnicodeError, LookupError, ValueError) as error:  # unknown encodings too
        raise input_error(urdf.name, f"{error}", "an XML file", "Export the URDF again (xacro files first).") from error
    table = {"name": root.get("name", urdf.stem), "gravity": [0.0, 0.0, -9.81], **read_robot_toml(drives)}
    table.pop("urdf", None)
    trains = _drive_trains(table, drives.name)
    links = _links(root, urdf.name)
    names = [link["name"] for link in links]
    for name in trains:
        if name not in names:
            raise input_error(
                f"{drives.name}: joint {name!r}",
                "a joint that the URDF does not move",
                f"one of {', '.join(names)}",
                "Take the joint's name from the URDF.",
            )
    for name in names:
        if name not in trains:
            raise input_error(
                f"{drives.name}",
                f"no [[joint]] named {name!r}",
                "one for every moving joint of the URDF",
                "Add it.",
            )
    told = {name: _friction(root, name, trains[name], urdf.name) | _limits(root, name, urdf.name) for name in names}
    table["joint"] = [{"type": "driven", **link, **told[link["name"]], **trains[link["name"]]} for link in links]
    return robot_from_table(table, drives.name, own)


def drives_beside(urdf: pathlib.Path) -> pathlib.Path:
    """The TOML file of the same name beside a URDF, with the drive trains.

    **Raises:** `jaxfrf.InputError` with the file to write, where there is none.
    """
    check_readable(urdf, "a robot, .toml or .urdf")
    drives = urdf.with_suffix(".toml")
    if drives.is_file():
        return drives
    try:
        names = [joint.get("name") for joint in ET.parse(urdf).getroot().iter("joint") if joint.get("type") in _MOVING]
    except (ET.ParseError, UnicodeError, LookupError, ValueError) as error:
        raise input_error(urdf.name, f"{error}", "an XML file", "Export the URDF again (xacro files first).") from error
    rows = " ".join(f'[[joint]] name = "{name}" ...' for name in names[:7])
    raise input_error(
        urdf.name,
        f"no {drives.name} beside it: a URDF says nothing of motors and gears",
        f"its drive trains in {drives}",
        f"Write one table for every joint that moves ({rows}) with gear_ratio, motor_inertia, stiffness (inf is "
        "rigid), damping, coulomb_friction, viscous_friction and, to simulate, velocity_gain with [controller].",
    )


def _drive_trains(table: Mapping[str, Any], source: str) -> dict[str, Mapping[str, Any]]:
    trains = {}
    for i, joint in enumerate(table.get("joint", [])):
        if not isinstance(joint.get("name"), str):
            raise input_error(f"{source}: joint {i + 1}", "no name", "the joint's name in the URDF", "Add name = ...")
        for key in ("slides", "axis", "offset", "mass", "com", "inertia"):
            if key in joint:
                raise input_error(
                    f"{source}: joint {joint['name']!r}",
                    f"{key}, which the URDF states",
                    "only what belongs to the drive train",
                    "State it in one of the two files.",
                )
        trains[joint["name"]] = joint
    return trains


def _friction(root: ET.Element, name: str, train: Mapping[str, Any], source: str) -> dict[str, float]:
    """Friction of a joint as its motor feels it."""
    dynamics = _part(root, name, "dynamics")
    gear = train.get("gear_ratio")
    if dynamics is None or not isinstance(gear, int | float) or gear == 0:
        return {}
    found: dict[str, float] = {}
    for key, kind, by in (("damping", "viscous_friction", gear**2), ("friction", "coulomb_friction", abs(gear))):
        try:
            value = float(dynamics.get(key, "0"))
        except ValueError:
            value = -1.0
        if not 0.0 <= value < np.inf:
            raise input_error(
                f"{source}: joint {name!r}: {key}", repr(dynamics.get(key)), "a number, 0 or more", "Correct it there."
            )
        found |= {kind: value / by} if value else {}
    return found


def _limits(root: ET.Element, name: str, source: str) -> dict[str, list[float]]:
    """Of a joint that has some: equal ones, as 0 and 0 of many exporters, state none."""
    limit = _part(root, name, "limit")
    if limit is None or not {"lower", "upper"} <= set(limit.keys()):
        return {}
    try:
        low, high = (float(limit.get(key, "")) for key in ("lower", "upper"))
    except ValueError:
        low, high = np.inf, -np.inf
    if not low <= high:
        raise input_error(
            f"{source}: joint {name!r}: limit",
            f"lower {limit.get('lower')!r}, upper {limit.get('upper')!r}",
            "two numbers, the lower one first",
            "Correct them there.",
        )
    return {"limits": [low, high]} if low < high else {}


def _part(root: ET.Element, name: str, tag: str) -> ET.Element | None:
    """What a joint has of this kind."""
    return next(joint.find(tag) for joint in root.findall("joint") if joint.get("name") == name)


def _links(root: ET.Element, source: str) -> list[dict[str, Any]]:
    """The moving links, base to tip, all frames parallel to the base with the joints at zero."""
    tree = _Tree(root, source)
    rows: list[dict[str, Any]] = []
    link, rotation, place = tree.base(), np.eye(3), np.zeros(3)
    while True:
        bodies, ahead = tree.rigid_group(link, rotation, place)
        if rows:
            rows[-1] |= _joined(bodies)
        if len(ahead) > 1:
            names = ", ".join(str(joint.get("name")) for joint, _, _ in ahead)
            raise input_error(
                f"{source}: link {link!r}",
                f"{len(ahead)} joints that move ({names})",
                "a serial chain",
                "Fix all but one.",
            )
        if not ahead:
            break
        joint, rotation, offset = ahead[0]
        row = {"name": joint.get("name"), "axis": tree.axis(joint, rotation), "offset": offset.tolist()}
        rows.append(row | ({"slides": True} if joint.get("type") == "prismatic" else {}))
        link, place = tree.link(joint, "child"), np.zeros(3)
    if not rows:
        raise input_error(
            source, "no joint that moves", "at least one revolute or prismatic joint", "Check the joint types."
        )
    if not rows[-1]["mass"] and not any(rows[-1]["inertia"]):
        raise input_error(
            f"{source}: link {link!r}",
            f"no mass that joint {rows[-1]['name']!r} moves",
            "an <inertial> of the last link, or of one that is fixed to it; a mesh states none",
            "State it, or fix the joint.",
        )
    return rows


class _Tree:
    """Links and joints of a URDF by name, with the file's name for messages."""

    def __init__(self, root: ET.Element, source: str):
        self.source = source
        if root.tag != "robot":
            raise input_error(source, f"<{root.tag}> as the outermost element", "<robot>", "Export the URDF again.")
        self.links = self._named(root, "link")
        self.joints: dict[str, list[ET.Element]] = {}
        carried: dict[str, str] = {}  # by which joint: one each, or the tree has a circle
        for name, joint in self._named(root, "joint").items():
            self.joints.setdefault(self.link(joint, "parent"), []).append(joint)
            child = self.link(joint, "child")
            if child in carried:
                raise input_error(
                    f"{source}: link {child!r}",
                    f"two joints that carry it ({carried[child]}, {name})",
                    "one, in a tree without circles",
                    "Loops of links cannot be read: cut the loop at one joint.",
                )
            carried[child] = name

    def _named(self, root: ET.Element, kind: str) -> dict[str, ET.Element]:
        """All links or joints by name."""
        named: dict[str, ET.Element] = {}
        for i, element in enumerate(root.findall(kind), 1):
            name = element.get("name")
            if not name:
                raise input_error(f"{self.source}: {kind} {i}", "no name", f"a name for every {kind}", "Name it.")
            if name in named:
                raise input_error(
                    f"{self.source}: {kind} {name!r}", "the name twice", f"a name for each {kind}", "Rename one."
                )
            named[name] = element
        return named

    def base(self) -> str:
        children = {self.link(joint, "child") for joints in self.joints.values() for joint in joints}
        bases = [name for name in self.links if name not in children]
        if len(bases) != 1:
            raise input_error(
                self.source,
                f"{len(bases)} links without a parent" + (f" ({', '.join(bases[:5])})" if bases else ""),
                "one base",
                "Leave one robot in the file." if bases else "The joints form a circle: cut it at one of them.",
            )
        return bases[0]

    def link(self, joint: ET.Element, end: str) -> str:
        element = joint.find(end)
        name = None if element is None else element.get("link")
        if name not in self.links:
            raise input_error(
                f"{self.source}: joint {joint.get('name')!r}",
                f"the {end} link {name!r}",
                "the name of a link in the file",
                "Correct the name.",
            )
        return name

    def axis(self, joint: ET.Element, rotation) -> list[float]:
        element = joint.find("axis")
        axis = self._numbers(joint, "axis", "1 0 0" if element is None else element.get("xyz"))
        if not np.linalg.norm(axis) > 1e-9:
            raise input_error(
                f"{self.source}: joint {joint.get('name')!r}: axis", f"{axis.tolist()}", "a direction", "Correct it."
            )
        return (rotation @ (axis / np.linalg.norm(axis))).tolist()

    def rigid_group(self, link: str, rotation, place):
        """Inertials (mass, com, tensor) of a link and of all links fixed to it, and the moving joints on
        them, each with its rotation and place."""
        bodies, ahead, waiting = [], [], [(link, rotation, place)]
        while waiting:  # a tree of any depth
            link, rotation, place = waiting.pop()
            bodies.append(self._inertial(self.links[link], rotation, place))
            for joint in self.joints.get(link, []):
                shift, turn = self._origin(joint)
                behind = rotation @ turn, place + rotation @ shift
                if joint.get("type") in _MOVING:
                    self._check_free(joint)
                    ahead.append((joint, *behind))
                elif joint.get("type") == "fixed":
                    waiting.append((self.link(joint, "child"), *behind))
                else:
                    raise input_error(
                        f"{self.source}: joint {joint.get('name')!r}",
                        f"type {joint.get('type')!r}",
                        "revolute, continuous, prismatic or fixed",
                        "Joints of several freedoms are not supported: fix this one, or write it as several.",
                    )
        return bodies, ahead

    def _check_free(self, joint: ET.Element) -> None:
        mimic = joint.find("mimic")
        if mimic is not None:
            raise input_error(
                f"{self.source}: joint {joint.get('name')!r}",
                f"one that follows joint {mimic.get('joint')!r} (<mimic>)",
                "joints that move on their own",
                'Fix it (type="fixed"), as fingers of a gripper may be; a linkage is no serial chain.',
            )

    def _inertial(self, link: ET.Element, rotation, place):
        inertial = link.find("inertial")
        if inertial is None:
            return 0.0, np.zeros(3), np.zeros((3, 3))
        if len(link.findall("inertial")) > 1:
            raise input_error(
                f"{self.source}: link {link.get('name')!r}",
                f"{len(link.findall('inertial'))} <inertial>",
                "one",
                "Leave one, or make a link of each, fixed to this one.",
            )
        mass, tensor = inertial.find("mass"), inertial.find("inertia")
        if mass is None or tensor is None:
            raise input_error(
                f"{self.source}: link {link.get('name')!r}",
                "an <inertial> without <mass> or <inertia>",
                "both",
                "State them, or leave <inertial> out for a massless link.",
            )
        xx, yy, zz, xy, xz, yz = (
            float(self._numbers(link, name, tensor.get(name, "0"), 1)[0])
            for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        low, middle, high = np.linalg.eigvalsh(own)
        if low >= 0.0 and high > (1.0 + _ROUNDED) * (low + middle):
            raise input_error(
                f"{self.source}: link {link.get('name')!r}: inertia",
                f"principal moments {number(low, 4)}, {number(middle, 4)} and {number(high, 4)} kg m^2",
                "the largest at most the sum of the others, as of any body",
                "Check the numbers and their units: about the centre of mass, in axes of its <origin>.",
            )
        shift, turn = self._origin(inertial)
        turn = rotation @ turn
        about_centre = turn @ own @ turn.T
        return (
            float(self._numbers(link, "mass", mass.get("value"), 1)[0]),
            place + rotation @ shift,
            about_centre,
        )

    def _origin(self, element: ET.Element):
        origin = element.find("origin")
        if origin is None:
            return np.zeros(3), np.eye(3)
        roll, pitch, yaw = self._numbers(element, "rpy", origin.get("rpy", "0 0 0"))
        return self._numbers(element, "xyz", origin.get("xyz", "0 0 0")), _turn(yaw, 2) @ _turn(pitch, 1) @ _turn(
            roll, 0
        )

    def _numbers(self, element: ET.Element, key: str, text: str | None, size: int = 3) -> np.ndarray:
        try:
            values = np.array([float(x) for x in (text or "").split()])
        except ValueError:
            values = np.zeros(0)
        if values.shape != (size,) or not np.isfinite(values).all():
            raise input_error(
                f"{self.source}: {element.tag} {element.get('name', '')!r}: {key}",
                repr(text),
                f"{size} finite number{'s' if size > 1 else ''}",
                "Correct it there.",
            )
        return values


def _turn(angle: float, about: int) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    i, j = (about + 1) % 3, (about + 2) % 3
    turn = np.eye(3)
    turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
    return turn


def _joined(bodies) -> dict[str, Any]:
    """Several bodies as one: mass, com and inertia of a link's table (parallel axes)."""
    mass = sum(m for m, _, _ in bodies)
    com = sum((m * c for m, c, _ in bodies), np.zeros(3)) / mass if mass else np.zeros(3)
    tensor = np.zeros((3, 3))
    for m, c, about_centre in bodies:
        d = c - com
        tensor += about_centre + m * (d @ d * np.eye(3) - np.outer(d, d))
    elements = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    return {"mass": mass, "com": com.tolist(), "inertia": [float(x) for x in elements]}
