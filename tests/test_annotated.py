"""Robots and excitation: public functions and constructors refuse what they are not annotated with, in one sentence."""

import dataclasses
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

import jaxfrf as jf
from jaxfrf._annotated import check_fields, checked
from jaxfrf._types import Array

R, E = jf.robot, jf.excitation
ARM = R.r3x()
Q, Z = np.zeros(ARM.chain.n_joints), np.zeros(ARM.dof)
DESIGN = jf.Multisine(1000.0, 100, [3, 5, 7], n_in=2)
WRONG = {
    "None": None,
    "text": "abc",
    "an object": object(),
    "a list of text": ["a"],
    "another shape": np.ones((2, 3, 7, 11)),
    "a ragged list": [[1, 2], [3]],
}
TWO = dict.fromkeys(("stiffness", "damping", "stiffness_ratio", "stiffness_knee"), np.ones(2))
CHAIN = {name: getattr(ARM.chain, name) for name in ("axis", "offset", "mass", "com", "inertia", "gravity")}
DRIVES = {name: getattr(ARM.drives, name) for name in ("motor_inertia", "gear_ratio", "torque_limit", "friction")}
GOOD = {
    R.Chain: CHAIN,
    R.Spring: TWO,
    R.Friction: {"viscous": np.ones(2), "coulomb": np.ones(2), "smoothing": 0.1},
    R.ViscousFrictionLaw: {"viscous": np.ones(2)},
    R.Drives: DRIVES,
    R.Robot: {x: getattr(ARM, x) for x in ("chain", "drives", "springs", "joint_names", "driven", "stiff")},
    R.Tolerance: {"std": 0.1},
    R.ZeroOrderHold: {"sampling_frequency": 1000.0, "measured": "velocity", "order": 4},
    R.forward_kinematics: {"chain": ARM.chain, "q": Q},
    R.mass_matrix: {"chain": ARM.chain, "q": Q},
    R.inverse_dynamics: {"chain": ARM.chain, "q": Q, "rate": Q, "acceleration": Q},
    R.bias_forces: {"chain": ARM.chain, "q": Q, "rate": Q},
    R.potential_energy: {"chain": ARM.chain, "q": Q},
    R.effective_friction: {"friction": ARM.drives.friction, "amplitude": 1.0},
    R.operating_point: {"robot": ARM, "arm_angles": np.zeros(6)},
    R.forward_dynamics: {"robot": ARM, "state": np.zeros(2 * ARM.dof), "torque": np.zeros(6)},
    R.generalised_forces: {"robot": ARM, "z": Z, "rate": Z, "torque": np.zeros(6)},
    R.deflections: {"robot": ARM, "z": Z},
    R.motor_values: {"robot": ARM, "z": Z},
    R.parameters: {"robot": ARM},
    R.with_parameters: {"robot": ARM, "values": {}},
    R.table_from_robot: {"robot": ARM},
    R.tolerances_from: {"table": {"mass": 0.1}},
    E.Multisine: {"fs": 1000.0, "period": 100, "lines": [3, 5], "seed": 1},
    E.SlowSine: {"lines": [1, 2], "amplitude": [1.0, 1.0]},
    E.band_lines: {"low": 1.0, "high": 10.0, "fs": 1000.0, "period": 1000},
    E.detection_lines: {"lines": np.array([1, 3, 5, 9])},
    E.reference_spectra: {"design": DESIGN},
    E.reference_levels: {"reference": E.reference(DESIGN)},
    E.shaped_amplitude: {"frequency": np.array([2.0]), "corners": [1.0, 10.0], "levels": [1.0, 2.0]},
    E.schroeder_phases: {"amplitude": np.ones(3), "lines": np.array([1, 3, 5])},
    E.rms: {"x": np.ones((5, 2))},
}
RIGHT = {("rms", "x", "another shape"), ("detection_lines", "lines", "another shape")}  # of any batch, flattened


@pytest.mark.filterwarnings("ignore:A JAX array is being set as static")  # that is what is wrong
@pytest.mark.parametrize("function", GOOD, ids=lambda x: x.__name__)
def test_wrong_kinds_and_shapes(function):
    given = GOOD[function]
    for name in given:
        for what, wrong in WRONG.items():
            if (function.__name__, name, what) not in RIGHT:
                with pytest.raises(jf.InputError, match=r"found .+; expected .+\."):
                    function(**{**given, **({"names": ()} if function is R.tolerances_from else {}), name: wrong})


def test_lists_are_arrays():
    """Driven joints first, then elastic ones, each at its place in the chain; gravity's stiffness of two points."""
    driven = [name for name, has_motor in zip(ARM.joint_names, ARM.driven, strict=True) if has_motor]
    elastic = [name for name in ARM.joint_names if name not in driven]
    angle = {name: i for i, name in enumerate(driven + elastic)}
    found = R.chain_angles(ARM, list(range(len(ARM.arm_joints))))
    np.testing.assert_array_equal(found, [angle[name] for name in ARM.joint_names])
    n = len(ARM.arm_joints)
    assert R.gravity_stiffness(ARM, [[0] * n, [1] * n]).shape == (2, n, n)
    assert np.all(np.linalg.eigvalsh(R.arm_inertia(ARM, [0] * n)) > 0.0)


def test_axes_of_one_name_are_as_long():
    @checked
    def product(a: Float[Array, "*batch row"], b: Float[Array, "row"] | float = 1.0) -> float:
        return a @ (b * jnp.ones(3))

    assert product(np.ones(3)) == 3.0 and product(np.ones((2, 3)), np.arange(3.0)).shape == (2,)
    with pytest.raises(
        jf.InputError, match=r"b: found an array of shape \(2,\); expected numbers of shape \(row,\), row"
    ):
        product(np.ones(3), np.ones(2))
    with pytest.raises(TypeError, match="missing"):
        product()
    assert inspect.signature(product).parameters["a"].name == "a"
    assert jax.jit(product)(jnp.ones(3)) == 3.0 and jax.vmap(product)(jnp.ones((2, 3))).shape == (2,)
    assert jax.grad(product)(jnp.ones(3)).shape == (3,)


def test_fields_of_a_module():
    class Pair(eqx.Module):
        a: Float[Array, "x"]
        b: Float[Array, "x"] | None = None

        def __check_init__(self):
            check_fields(self)

    assert Pair(np.ones(2), np.ones(2)).a.size == 2 and Pair([1.0]).b is None
    with pytest.raises(jf.InputError, match=r"b: .+ x = 2"):
        Pair(np.ones(2), np.ones(3))


METHODS = [
    cls
    for cls in (getattr(jf, name) for name in dir(jf))
    if inspect.isclass(cls) and issubclass(cls, jf.AbstractMethod) and not inspect.isabstract(cls)
]


@pytest.mark.parametrize("method", METHODS)
def test_options_of_methods(method):
    for field in dataclasses.fields(method):
        for wrong in (*WRONG.values(), float("nan"), int):
            try:
                method(**{field.name: wrong})
            except jf.InputError as error:
                assert str(error).startswith(field.name)
            else:
                assert wrong is None or (field.type is str and wrong == "abc")
