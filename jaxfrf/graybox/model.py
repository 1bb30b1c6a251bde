"""Gray-box models: anything that gives a frequency response from parameters by name."""

import abc
import dataclasses
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Literal, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, PyTree

from .._arguments import expect, expect_number, expect_real, said
from .._errors import input_error
from .._types import Array
from ..robot import (
    Robot,
    ZeroOrderHold,
    frf_and_jacobian,
    parameter_unit,
    parameters as robot_parameters,
    with_parameters,
)
from ..units import expect_quantity
from .own import as_response, check_callable
from .parameter import Parameter, as_parameters, matching

Values = Mapping[str, jax.Array]


class AbstractModel(eqx.Module):
    """A gray-box model.

    `parameters`: name -> `Parameter`, everything that the response depends on and that may be fitted.

    A fit differentiates `response` by autodiff. Where its derivative is cheaper by hand, make it a `jax.custom_jvp` (or
    `equinox.filter_custom_jvp`, as `RobotModel` does): every cost then picks it up.
    """

    parameters: eqx.AbstractVar[dict[str, Parameter]]

    @abc.abstractmethod
    def response(self, frequency: Float[Array, "freq"], values: Values, point: PyTree) -> Complex[Array, "freq out in"]:
        """G at one operating point. `frequency` in Hz; `values`: every parameter by name; `point`: what tells
        operating points apart, e.g. the arm configuration (joint,)."""

    def reciprocal(self, names: Sequence[str]) -> bool:
        """Whether each of these parameters changes an element of log G and its mirror image, [a, b] and [b, a], by the
        same amount, as springs and dampers of a machine do whose G is symmetric: the fit then needs one of the two."""
        return False

    def points(self, q: Float[Array, "pos joint"] | None, n_pos: int) -> PyTree:
        """Operating points with a leading axis (pos, ...), from the arm configurations of an FRF."""
        return np.zeros((n_pos, 0)) if q is None else np.asarray(q)


class GrayBox(AbstractModel):
    """Your own model: any callable, most often an `eqx.Module`, with G = model(omega, values) or (omega, values, q).

    **Arguments:**

    - `model`: called with `omega` (freq,) in rad/s, `values` a dictionary of parameter values, and, where it takes a
      third argument (that must be given, or is called q), the arm configuration q (joint,) of the operating point. It
      returns G, (freq, out, in), complex, written in `jax.numpy`; (freq,) is accepted for one input and one output. It
      must be differentiable.
    - `parameters`: name -> `Parameter` (or a number: a positive parameter that starts there).

    **Raises:** `jaxfrf.InputError` for what cannot be called so, a start that is no positive number, and (in a fit) for
    names that are no parameters, NumPy or decisions in the model, and a result of another shape.

    **Source:** a definition: the model is yours.
    """

    model: Callable
    parameters: dict[str, Parameter]
    configured: bool = eqx.field(static=True)

    def __init__(self, model: Callable, parameters: Mapping[str, Parameter | float]):
        check_callable("model", model, "(omega, values) or (omega, values, q)", 2, 3)
        self.model = model
        self.parameters = as_parameters(parameters)
        self.configured = _takes_configuration(model)

    def response(self, frequency, values, point):
        omega = 2.0 * jnp.pi * jnp.asarray(frequency)
        G = self.model(omega, values, point) if self.configured else self.model(omega, values)
        G = G[:, None, None] if getattr(G, "shape", None) == omega.shape else G
        return as_response(G, len(omega)).astype(complex)


def _takes_configuration(model: Callable) -> bool:
    """Whether there is a third argument that must be given, or one that is called q."""
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    known = [p for p in inspect.signature(model).parameters.values() if p.kind in kinds]
    return len(known) >= 3 and (known[2].default is known[2].empty or known[2].name == "q")


def _spread(robot: Robot, name: str, value: float, asked: float | None) -> float:
    """Standard deviation of the logarithm of a number's starts."""
    if asked is not None:
        return asked
    tolerance = robot.tolerances.of(name)
    if tolerance.unknown:
        return 1.0
    return tolerance.std if tolerance.relative else tolerance.std / max(abs(value), 1e-9)


class RobotPoint(eqx.Module):
    """An operating point of a robot; `jaxfrf.graybox.robot_points` finds them in the records.

    **Fields:** `q`: arm angles, (*pos, axis), rad. `deflections`: of the springs about their rest during the
    experiment, (*pos, sample, spring), rad, over which a nonlinear spring's stiffness is averaged.
    """

    q: Float[Array, "*pos axis"]
    deflections: Float[Array, "*pos sample spring"]


class RobotModel(AbstractModel):
    """A `jaxfrf.robot.Robot` as a gray-box model: torque command to motor motion.

    Parameters are, for every spring, `<joint>.stiffness` (of a nonlinear spring: at high deflection, its shape being
    known) and `<joint>.damping`; for every axis `<axis>.effective_friction`, a nuisance: the viscous coefficient that
    all friction amounts to in the experiment, motor side; and, fixed unless freed, `<axis>.torque_gain` (true over
    assumed motor torque) and `<axis>.delay` (s, beside the hold; approximate to second order in it).

    **Arguments:**

    - `robot`: also says where the parameters start.
    - `quantity`: what y is: `position`, `velocity` or `acceleration`.
    - `hold`: the zero-order hold of the torque, and what is sampled then; `None`: continuous time. By default at the
      robot's sampling frequency, and speeds are those of a sensor, positions and accelerations those of an encoder:
      half-way to the sampling frequency the two are decibels apart. Speeds that were made from an encoder's positions
      ask for `ZeroOrderHold(fs, "position")`.
    - `slow_amplitude`: amplitude of the slow motion that keeps joints sliding, motor side, (axis,), rad/s: effective
      friction starts at f + 2 c/(pi A); without it at a guess.
    - `damping_spread`, `stiffness_spread`, `friction_spread`: standard deviation of ln of perturbed starts; by default
      the robot's tolerances of stiffness, damping and Coulomb friction (of what is unknown, a factor of e).

    Biased where the motion is large: it is linear about rest, a nonlinear spring or friction has one mean value in it.
    `fit_indirectly` takes that out.

    **Raises:** `jaxfrf.InputError` for another quantity or `hold`, an amplitude of another shape, and (in a fit) for an
    FRF without the arm configurations of the robot, or of another quantity.

    **Source:** Zimmermann & Moberg, section III.A; effective friction by the describing function of Gelb & Vander
    Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968.
    """

    robot: Robot
    parameters: dict[str, Parameter]
    quantity: str = eqx.field(static=True)
    hold: ZeroOrderHold | None

    def __init__(
        self,
        robot: Robot,
        *,
        quantity: str = "acceleration",
        hold: ZeroOrderHold | Literal["sampled"] | None = "sampled",
        slow_amplitude: Float[Array, "axis"] | None = None,
        stiffness_spread: float | None = None,
        damping_spread: float | None = None,
        friction_spread: float | None = None,
    ):
        expect("robot", robot, Robot)
        expect_quantity("quantity", quantity)
        self.robot, self.quantity, self.hold = robot, quantity, _hold(robot, quantity, hold)
        asked = {"stiffness": stiffness_spread, "damping": damping_spread, "coulomb_friction": friction_spread}
        spread = lambda name, value: _spread(robot, name, float(value), asked[name.rpartition(".")[2]])
        known = {
            name: Parameter(
                max(float(value), 1e-9), parameter_unit(robot, *name.rsplit(".", 1)), spread=spread(name, value)
            )
            for name, value in robot_parameters(robot).items()
        }
        friction = _effective_friction(robot, slow_amplitude)
        for axis, value in zip(robot.axis_names, friction, strict=True):
            own = spread(f"{axis}.coulomb_friction", value)
            unit = parameter_unit(robot, axis, "viscous_friction")
            known[f"{axis}.effective_friction"] = Parameter(value, unit, nuisance=True, spread=own)
        for axis in robot.axis_names:
            known[f"{axis}.torque_gain"] = Parameter(1.0, "1", free=False, spread=0.05)
        for axis in robot.axis_names:
            known[f"{axis}.delay"] = Parameter(
                0.0, "s", positive=False, free=False, spread=0.2, scale=1e-3, nuisance=True
            )
        self.parameters = known

    def response(self, frequency, values, point):
        return _robot_response(dict(values), frequency, point, self)

    def _command(self, frequency, values):
        """Gain and delay of every torque command, (freq, 1, axis)."""
        gain, delay = (self._by_axis(values, kind) for kind in ("torque_gain", "delay"))
        s = 2j * jnp.pi * jnp.asarray(frequency)[:, None, None]
        return gain * jnp.exp(-s * delay)

    def _by_axis(self, values, kind: str):
        return jnp.stack([jnp.asarray(values[f"{axis}.{kind}"]) for axis in self.robot.axis_names])

    def _inner(self, frequency, values, point):
        springs = [n for n in values if n.rpartition(".")[2] in ("stiffness", "damping")]
        robot = with_parameters(self.robot, {n: values[n] for n in springs})
        q, deflections = (point.q, point.deflections) if isinstance(point, RobotPoint) else (point, None)
        friction = self._by_axis(values, "effective_friction")
        return frf_and_jacobian(robot, q, frequency, self.quantity, self.hold, 0.0, friction, deflections)

    def _columns(self, frequency, values, point, names):
        """G, its derivative in these values, (freq, out, in, column), and their names in the order of the columns."""
        inner = self._inner(frequency, values, point)
        command = self._command(frequency, values)
        G = inner.G * command
        kept = [i for i, name in enumerate(inner.names) if name in names]
        slopes = inner.jacobian if len(kept) == len(inner.names) else inner.jacobian[..., np.array(kept, int)]
        columns, names_of = [slopes * command[..., None]], [inner.names[i] for i in kept]
        s = 2j * jnp.pi * jnp.asarray(frequency)[:, None]
        for axis, name in enumerate(self.robot.axis_names):
            changes = {f"{name}.torque_gain": 1 / values[f"{name}.torque_gain"], f"{name}.delay": -s}
            for parameter in [n for n in changes if n in names]:
                column = jnp.zeros_like(G).at[:, :, axis].set(changes[parameter] * G[:, :, axis])
                columns.append(column[..., None])
                names_of.append(parameter)
        return G, jnp.concatenate(columns, axis=-1), tuple(names_of)

    def reciprocal(self, names):
        kinds = {n.rpartition(".")[2] for n in names}
        return not self.robot.effects and kinds <= {"stiffness", "damping", "effective_friction"}

    def points(self, q, n_pos):
        if q is None or np.shape(q)[-1] != self.robot.n_axes:
            raise input_error(
                "q of the FRF",
                "none" if q is None else f"{np.shape(q)[-1]} angles",
                f"the {self.robot.n_axes} arm angles of {self.robot.name} at every operating point",
                "Store q with the records (see the experiment file), or give `points`.",
            )
        return np.asarray(q)

    def at(self, values: Mapping[str, float]) -> Robot:
        """The robot with these springs and dampers."""
        names = set(robot_parameters(self.robot))
        return with_parameters(self.robot, {n: v for n, v in values.items() if n in names})


@eqx.filter_custom_jvp
def _robot_response(values, frequency, point, model: RobotModel):
    return model._inner(frequency, values, point).G * model._command(frequency, values)


@_robot_response.def_jvp
def _robot_response_slope(primals, tangents):
    """By the outer products of `jaxfrf.robot.frf_and_jacobian` in the parameters, by autodiff in anything else."""
    (values, *others), (changes, *other_changes) = primals, tangents
    values, others = dict(values), tuple(others)
    change = 0.0
    names = tuple(n for n in values if changes[n] is not None)
    if names:
        G, columns, names = others[2]._columns(others[0], values, others[1], names)
        along = jnp.stack([changes[n] for n in names])
        # A real product each: under the vmap of jax.jacfwd a matrix product of half the size of a complex one.
        change = jax.lax.complex(columns.real @ along, columns.imag @ along)
    else:
        G = _robot_response(values, *others)
    if jax.tree.leaves(other_changes):
        plain = lambda *others: others[2]._inner(others[0], values, others[1]).G * others[2]._command(others[0], values)
        change = change + eqx.filter_jvp(plain, others, tuple(other_changes))[1]
    return G, change


def _hold(robot: Robot, quantity: str, hold: ZeroOrderHold | str | None) -> ZeroOrderHold | None:
    if hold is None or isinstance(hold, ZeroOrderHold):
        return hold
    if not isinstance(hold, str) or hold != "sampled":
        raise input_error("hold", said(hold), "'sampled', None or a ZeroOrderHold", "None is continuous time.")
    return ZeroOrderHold(robot.sampling_frequency, "velocity" if quantity == "velocity" else "position")


def _effective_friction(robot: Robot, amplitude) -> list[float]:
    if amplitude is not None:
        expect_real("slow_amplitude", amplitude)
        if np.shape(amplitude) not in ((), (robot.n_axes,)) or not np.all(np.asarray(amplitude) > 0):
            found = said(np.asarray(amplitude)) if np.ndim(amplitude) else said(amplitude)
            raise input_error("slow_amplitude", found, f"{robot.n_axes} amplitudes above 0, rad/s", "Check it.")
    friction = robot.drives.friction
    viscous = np.asarray(friction.viscous, float)
    coulomb = np.asarray(getattr(friction, "coulomb", np.zeros_like(viscous)), float)
    amplitude = np.full_like(viscous, 30.0) if amplitude is None else np.asarray(amplitude, float)
    guess = 0.01 * np.asarray(robot.drives.motor_inertia, float) * 2 * np.pi * 10.0  # small against the motor's inertia
    return [float(x) for x in np.maximum(viscous + 2 * coulomb / (np.pi * amplitude), guess)]


Model = TypeVar("Model", bound=AbstractModel)


def fix(model: Model, names: str | Iterable[str]) -> Model:
    """The same model with these parameters held at their start; `*` in a name stands for any text: `*.damping`.

    **Arguments:** `model`: with `parameters`, one of `jaxfrf.AbstractModel`. `names`: one or more, or patterns.

    **Returns:** the model with these parameters fixed.

    **Raises:** `jaxfrf.InputError` for a name that the model does not have.
    """
    return _changed(model, names, lambda p: dataclasses.replace(p, free=False))


def free(model: Model, names: str | Iterable[str]) -> Model:
    """The same model with these parameters fitted; `*` in a name stands for any text.

    **Arguments:** `model`: with `parameters`, one of `jaxfrf.AbstractModel`. `names`: one or more, or patterns.

    **Raises:** `jaxfrf.InputError` for a name that the model does not have.
    """
    return _changed(model, names, lambda p: dataclasses.replace(p, free=True))


def share(model: Model, names: str | Iterable[str]) -> Model:
    """The same model with one value for these parameters: that of the first one named.

    **Arguments:** `model`: with `parameters`, one of `jaxfrf.AbstractModel`. `names`: of parameters of one unit, or
    patterns.

    **Raises:** `jaxfrf.InputError` for a name that the model does not have, and for less than two.
    """
    expect("model", model, AbstractModel)
    found = matching(model.parameters, names)
    if len(found) < 2:
        raise input_error("share", ", ".join(found) or "none", "two parameters or more", "Name others, or a pattern.")
    first, *others = found
    return _changed(model, others, lambda p: dataclasses.replace(p, same_as=first))


def _changed(model: Model, names: str | Iterable[str], change: Callable[[Parameter], Parameter]) -> Model:
    expect("model", model, AbstractModel)
    chosen = matching(model.parameters, names)
    return _replaced(model, {n: change(p) if n in chosen else p for n, p in model.parameters.items()})


def starting_at(model: Model, values: Mapping[str, float]) -> Model:
    """The same model with its parameters starting at these values.

    **Arguments:** `model`: with `parameters`, one of `jaxfrf.AbstractModel`. `values`: {name: value}, in the units of
    the parameters; others keep their start.

    **Returns:** the model with these starts.

    **Raises:** `jaxfrf.InputError` for a name that the model does not have.
    """
    expect("model", model, AbstractModel)
    if not isinstance(values, Mapping):
        raise input_error("values", said(values), "a table {name: value}", 'E.g. {"k": 1e4}.')
    matching(model.parameters, values)
    for name, value in values.items():
        expect_number(f"start of {name}", value)
    new = {
        n: dataclasses.replace(p, start=np.float64(values[n])) if n in values else p
        for n, p in model.parameters.items()
    }
    return _replaced(model, new)


def _replaced(model: Model, parameters: dict[str, Parameter]) -> Model:
    return eqx.tree_at(
        lambda m: m.parameters, model, parameters, is_leaf=lambda x: isinstance(x, dict) and x is model.parameters
    )
