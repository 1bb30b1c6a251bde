"""A model of the user's own: what usually goes wrong in it, told without the words of JAX."""

import contextlib
import inspect
from collections.abc import Callable, Iterable, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from .._arguments import said
from .._errors import InputError, input_error
from .._text import nearest, shortened

_USUAL = (TypeError, ValueError, AttributeError, LookupError)  # errors of JAX's are TypeErrors


def check_callable(name: str, call: Callable, arguments: str, *counts: int) -> None:
    """Refuse what cannot be called with as many arguments as one of `counts`; a class is to be made first."""
    expected = f"a function, or an eqx.Module, called with {arguments}"
    if inspect.isclass(call):
        raise input_error(name, said(call), expected, f"Make one: {call.__name__}(...).")
    if not callable(call):
        raise input_error(name, said(call), expected, "Write one in jax.numpy.")
    if not any(_takes(call, count) for count in counts):
        raise input_error(name, "one with other arguments", expected, "Change its arguments.")


def _takes(call: Callable, count: int) -> bool:
    try:
        inspect.signature(call).bind(*range(count))
    except (TypeError, ValueError):  # the latter of what is written in C and does not say
        return False
    return True


@contextlib.contextmanager
def told(what: str, names: Iterable[str], result: str) -> Iterator[None]:
    """Errors of the user's own code as one `InputError` that says what to write instead, caused by what was raised.

    **Arguments:** `what`: the code. `names`: of the parameters that it is given. `result`: what it should give.
    """
    try:
        yield
    except InputError:
        raise
    except _USUAL as error:
        raise input_error(what, *_instead(error, list(names), result)) from error


def _instead(error: Exception, names: list[str], result: str) -> tuple[str, str, str]:
    """What was found, what was expected, what to do."""
    if isinstance(error, jax.errors.TracerArrayConversionError):
        numpy = "functions of NumPy, which see no numbers in a fit"
        return numpy, f"{result}, written in jax.numpy", "Write jnp.exp for np.exp (import jax.numpy as jnp)."
    if isinstance(error, jax.errors.TracerBoolConversionError):
        return (
            "a decision by a parameter or frequency (if, while, and, or, max)",
            "one formula for all values",
            "Write jnp.where(condition, this, that).",
        )
    if isinstance(error, jax.errors.JAXTypeError):
        plain = "a plain number made of a parameter or frequency (float, int, range)"
        return plain, "arrays of jax.numpy all through", "Leave float() and int() out."
    if isinstance(error, KeyError) and error.args and error.args[0] not in names:
        name = error.args[0]
        near = f"Did you mean {nearest(name, names)!r}?" if names else "Name it in the parameters."
        return f"the parameter {name!r}", f"one of {', '.join(names) or 'none'}", near
    text = shortened(str(error).partition("\n")[0])[1:-1]
    return f"{type(error).__name__}: {text}", result, "Try it by itself, with arrays of jax.numpy."


def as_response(G, n_freq: int) -> jax.Array:
    """What a model gave, where that is an array (freq, out, in).

    **Raises:** `jaxfrf.InputError` for anything else.
    """
    try:
        array = jnp.asarray(G)
        found = f"an array of shape {array.shape} at {n_freq} frequencies"
    except (TypeError, ValueError):
        array, found = jnp.zeros(0), said(G)
    if array.ndim != 3 or array.shape[0] != n_freq:
        raise input_error("result of the model", found, "(freq, out, in)", "Return an array, frequencies first.")
    return array


def response_shape(model, coordinates, frequency, point: PyTree) -> tuple[int, ...]:
    """(freq, out, in) of a model's response at one operating point, which is not computed: everything that a fit traces
    is traced.

    **Raises:** `jaxfrf.InputError` for a model that a fit cannot use.
    """

    def response(model, coordinates, frequency, x, point):
        return as_response(model.response(frequency, coordinates.values(x), point), len(frequency))

    frequency, x = jnp.asarray(frequency, float), jnp.asarray(coordinates.start())
    with told("model", model.parameters, "G, (freq, out, in)"):
        return eqx.filter_eval_shape(response, model, coordinates, frequency, x, point).shape
