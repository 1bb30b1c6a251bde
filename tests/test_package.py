"""The house: public names, what importing costs, directions of the imports, and how JAX is used."""

import ast
import importlib
import inspect
import os
import pathlib
import re
import subprocess
import sys
import textwrap
import types

import pytest

import jaxfrf as jf

ROOT = pathlib.Path(jf.__file__).parents[1]
PACKAGE = ROOT / "jaxfrf"
MODULES = sorted(PACKAGE.rglob("*.py"))


def run(code, **environment):
    """Output of a fresh interpreter without the settings of this one, but how much XLA optimises; `None` takes a
    variable out."""
    unset = {name: None for name in os.environ if name.startswith("JAX_") or name == "NPROC"}
    cache = {"JAX_COMPILATION_CACHE_DIR": os.environ["JAX_COMPILATION_CACHE_DIR"]}
    both = os.environ | unset | {"JAX_PLATFORMS": "cpu", "PYTHONPATH": str(ROOT)} | cache | environment
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env={name: value for name, value in both.items() if value is not None},
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


# --- public names


def defined_in(namespace):
    """Public names of a namespace that come from this package: no submodules, no imported libraries."""
    for name in dir(namespace):
        value = getattr(namespace, name)
        if not name.startswith("_") and not isinstance(value, types.ModuleType):
            yield name, value


def all_public():
    yield from ((f"jaxfrf.{name}", getattr(jf, name)) for name in jf._PUBLIC)
    for space in jf._NAMESPACES:
        yield from ((f"jaxfrf.{space}.{name}", value) for name, value in defined_in(getattr(jf, space)))


PUBLIC = dict(all_public())


def test_public_names_are_unique_and_listed():
    assert len(set(jf.__all__)) == len(jf.__all__)
    assert set(jf.__all__) <= set(dir(jf))
    for space in jf._NAMESPACES:
        assert inspect.getdoc(getattr(jf, space)), f"jaxfrf.{space} has no docstring"
    assert re.fullmatch(r"\d+\.\d+\.\d+", jf.__version__)


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_are_documented(name):
    value = PUBLIC[name]
    assert not isinstance(value, types.ModuleType), f"{name} is a module"
    if not callable(value):
        return  # a table: its comment stands in the source
    text = inspect.getdoc(value) or ""
    assert len(text) > 20, f"{name}: {text!r}"
    # An equinox module without a docstring shows its signature instead of one.
    assert not inspect.isclass(value) or "__doc__" in vars(value)
    first = text.split("\n\n")[0].rstrip()
    assert first[-1] in ".:", f"{name}: the first paragraph ends with {first[-20:]!r}"


def functions():
    """Public functions as they were written, without what decorators put around them."""
    for name, value in PUBLIC.items():
        function = inspect.unwrap(value) if callable(value) else value
        if inspect.isfunction(function):
            yield name, function


def test_docstrings_say_what_is_raised():
    """Every public function that raises, or checks its arguments, says so."""
    for name, function in functions():
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        calls = {
            node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        if any(isinstance(node, ast.Raise) for node in ast.walk(tree)) or calls & {"expect", "input_error"}:
            assert "**Raises:**" in inspect.getdoc(function), name


def test_arguments_have_types():
    """Every argument of a public function; results too, but for pictures."""
    for name, function in functions():
        signature = inspect.signature(function)
        for argument in signature.parameters.values():
            assert argument.annotation is not argument.empty, f"{name}: {argument.name}"
        if signature.return_annotation is signature.empty:
            assert name.startswith("jaxfrf.plot."), f"{name}: what it returns"
            assert "**Returns:**" in inspect.getdoc(function), name


UNITS = (
    r"\b(Hz|rad|N m|kg|J|SI|units?|dB|degrees?|bytes|inches|samples?|lines?|periods?|indices|relative|tolerances)\b"
    r"|[0-9. ](m|s)\b"
)


def test_arrays_have_shapes_and_units():
    """Shapes stand in the annotation; units, or that there is none, in the docstring."""
    for name, function in functions():
        signature = inspect.signature(function)
        told = [str(x.annotation) for x in signature.parameters.values()] + [str(signature.return_annotation)]
        for text in told:
            bare = re.sub(r"\w+\[[\w.]+, '[^']+'\]|(Key|UInt32)\[[^]]*\]", "", text)
            assert not re.search(r"\b(Array|ndarray)\b", bare) or re.search(r"(Mapping|dict)\[str", bare), (
                f"{name}: {text}"
            )
        if any(re.search(r"(Float|Complex)\[", text) for text in told):
            assert re.search(UNITS, inspect.getdoc(function)), f"{name}: units"


SOURCE = r"\b(19|20)\d\d\b|Zimmermann|paper"

WITHOUT_SOURCE = """
    InputError Status Reference Experiment Source Finding Spectra FRF Levels Distortion ModalModel Mode Feature
    AbstractMethod AbstractModel Parameter Fit Quality Calibration Identification
    concatenate select_periods segments select_band select_positions concatenate_positions describe_method Parts
""".split()
"""Containers and bases, then what only joins, cuts or describes them: all others compute something."""

WITHOUT_SOURCE_BESIDE = {
    "batch": "Chosen each estimate_to outcomes simulate_to",
    "calibration": "numbers with_numbers",
    "effects": "effect_from_table effect_to_table library",
    "graybox": "Coordinates fix free share starting_at starting_near",
    "robot": """Chain Controller Drives Tolerances chain_angles motor_directions motor_inertia motor_values
    parameter_names parameter_unit parameters robot_from_table spring_directions table_from_robot to_control
    tolerances_from with_parameters""",
    "simulation": "read_positions",
    "study": "Settings run_study",
    "trajectory": "fewer",
    "units": "differentiated expect_quantity input_unit known_unit output_unit quantity_of response_unit",
}
"""Of each namespace, what only reads, writes, picks, renames or holds something. Records, whose docstrings list their
fields, and bases need no source anywhere."""

PLAIN_SPACES = {"io", "plot", "report"}
"""Readers and writers, pictures, pages."""


def is_record_or_base(value) -> bool:
    if not inspect.isclass(value):
        return not callable(value)  # a table
    return inspect.isabstract(value) or "**Fields:**" in inspect.getdoc(value) or "Abstract" in value.__name__


def with_a_source():
    seen = {id(getattr(jf, name)) for name in jf._PUBLIC}
    yield from ((name, getattr(jf, name)) for name in jf._PUBLIC if name not in WITHOUT_SOURCE)
    for space in sorted(set(jf._NAMESPACES) - PLAIN_SPACES):
        plain = WITHOUT_SOURCE_BESIDE.get(space, "").split()
        for name, value in defined_in(getattr(jf, space)):
            if id(value) not in seen and name not in plain and not is_record_or_base(value):
                yield f"{space}.{name}", value


def test_what_computes_something_says_where_it_comes_from():
    """Its docstring ends with a paragraph that begins with "Source": a reference, or that there is none."""
    assert set(WITHOUT_SOURCE) <= set(jf._PUBLIC)
    for space, names in WITHOUT_SOURCE_BESIDE.items():
        assert set(names.split()) <= set(dir(getattr(jf, space))), space
    for name, value in with_a_source():
        last = (inspect.getdoc(value) or "").split("\n\n")[-1]
        assert re.match(r"\*\*Source:\*\* \S.{5,}", last), f"{name}: ends with {last[:60]!r}"


def test_estimators_say_when_they_are_biased_and_where_they_come_from():
    for name, value in PUBLIC.items():
        if inspect.isclass(value) and issubclass(value, jf.AbstractMethod) and value is not jf.AbstractMethod:
            assert re.search(r"bias|fails|consistent", inspect.getdoc(value), re.IGNORECASE), name
            assert re.search(SOURCE, inspect.getdoc(value)), f"{name}: source"


def test_public_names_have_annotated_arguments_or_speaking_defaults():
    """No public function swallows options that it does not name."""
    for name, value in PUBLIC.items():
        if inspect.isfunction(value):
            kinds = {p.kind for p in inspect.signature(value).parameters.values()}
            assert inspect.Parameter.VAR_KEYWORD not in kinds, name


def test_a_public_name_lives_in_no_module_of_that_name():
    """`import jaxfrf.x`, anywhere, would put the module in the place of a public name `x` that is something else."""
    modules = {path.stem if path.is_file() else path.name for path in PACKAGE.iterdir()}
    assert not modules & set(jf._PUBLIC), "give the module another name, e.g. with an underscore"


def test_unknown_names():
    with pytest.raises(AttributeError, match="no attribute 'estimat'"):
        jf.estimat  # noqa: B018


def test_type_checkers_see_the_same_names():
    """The imports under TYPE_CHECKING say the same as the table that the lazy imports use."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    assert block.test.id == "TYPE_CHECKING"
    seen, spaces = {}, []
    for node in block.body:
        for alias in node.names:
            assert alias.asname == alias.name, f"{alias.name}: re-export it as `X as X`"
            if node.module is None:
                spaces.append(alias.name)
            else:
                seen[alias.name] = node.module
    assert seen == jf._PUBLIC
    assert sorted(spaces) == sorted(jf._NAMESPACES)


# --- what importing costs


def test_importing_is_free():
    """No jax, no numpy, nothing printed, nothing configured."""
    says = run(
        "import os, sys, warnings\n"
        "before = dict(os.environ), list(warnings.filters)\n"
        "import jaxfrf\n"
        "assert (dict(os.environ), list(warnings.filters)) == before\n"
        "heavy = {'jax', 'jaxlib', 'numpy', 'scipy', 'equinox', 'matplotlib', 'xarray', 'logging'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    assert says == ""


def test_names_open_no_device_and_change_no_setting():
    """Every public name and namespace, and every submodule, can be imported without starting a backend."""
    modules = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in MODULES]
    says = run(
        "import importlib, os, jax\n"
        "def settings():\n"
        "    return {k: v for k, v in jax.config.values.items()}, dict(os.environ)\n"
        "before = settings()\n"
        "import jaxfrf\n"
        f"for name in {modules}:\n"
        "    importlib.import_module(name.removesuffix('.__init__'))\n"
        "for name in jaxfrf.__all__:\n"
        "    getattr(jaxfrf, name)\n"
        "jaxfrf.LogMean(jaxfrf.JointInputOutput(jaxfrf.LRM()))\n"
        "assert settings() == before\n"
        "from jax._src import xla_bridge\n"
        "assert not xla_bridge.backends_are_initialized()\n"
    )
    assert says == ""


# --- directions of the imports

LOWEST = {"errors", "text"}
BASE = LOWEST | {
    "alive",
    "types",
    "status",
    "environment",
    "files",
    "arguments",
    "annotated",
    "memory",
    "compile",
    "device",
    "threads",
    "units",
}
EXCITATION = BASE | {"excitation", "periodic"}
EXPERIMENT = EXCITATION | {"experiment"}
SPECTRA = EXPERIMENT | {"spectra"}
FRF = SPECTRA | {"screening", "frf"}
ROBOT = BASE | {"effects", "robot"}
SIMULATION = EXPERIMENT | ROBOT | {"simulation"}
TRAJECTORY = SIMULATION | {"periodic", "spectra", "trajectory"}
GRAYBOX = FRF | SIMULATION | {"graybox"}
IO = GRAYBOX | {"parts", "io"}
WHOLE = IO | {"trajectory", "calibration", "pipeline"}

MAY_IMPORT = {
    **{name: set() for name in LOWEST},
    **{name: LOWEST for name in BASE - LOWEST},
    **{name: LOWEST | {"arguments"} for name in ("annotated", "units")},
    "threads": LOWEST | {"environment"},
    "parts": LOWEST | {"files", "parts"},
    "excitation": BASE | {"excitation"},
    "periodic": BASE | {"periodic"},
    "experiment": BASE | {"periodic", "experiment"},
    "spectra": BASE | {"periodic", "experiment", "spectra"},
    "screening": BASE | {"periodic", "experiment", "spectra", "screening"},
    "frf": FRF - {"excitation"},
    "examples": EXPERIMENT,
    "effects": BASE | {"effects"},
    "robot": ROBOT,
    "simulation": SIMULATION,
    "graybox": GRAYBOX,
    "trajectory": TRAJECTORY,
    "calibration": TRAJECTORY | {"parts", "calibration"},
    "machine": GRAYBOX | {"machine"},
    "gap": GRAYBOX | {"parts", "trajectory", "calibration", "gap"},
    "io": IO,
    "plot": IO | {"trajectory", "calibration", "plot"},
    "pipeline": IO,
    "identification": WHOLE | {"identification"},
    "report": WHOLE | {"plot", "identification", "gap", "report"},
    "study": WHOLE | {"plot", "identification", "report", "gap", "batch", "study"},
    "batch": WHOLE | {"report", "batch"},
    "cli": WHOLE | {"examples", "plot", "identification", "report", "study", "gap", "batch", "cli"},
}
"""Which rooms a room may import from. Data flow from excitation over experiment and spectra to the FRF, which know no
robot; the robot knows no FRF. Files and pictures stand above all containers, the command line above everything, and
nothing imports it. A new room gets its own line here."""


def plain(name):
    """A module's name without the underscore that says that it is nobody's business."""
    return re.sub(r"^_(?!_)", "", name.removesuffix(".py"))


def room(path):
    return plain(path.relative_to(PACKAGE).parts[0])


def imported(path):
    """(module, at module level or not) of every import in a file, absolute, but for those that a type checker alone
    sees."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    inside = {id(node) for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) for node in ast.walk(f)}
    here = ("jaxfrf", *path.relative_to(PACKAGE).parts[:-1])
    for node in ast.walk(tree):
        top = id(node) not in inside
        if isinstance(node, ast.Import):
            yield from ((alias.name, top) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else ()
            base = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((f"{base}.{alias.name}" if base == "jaxfrf" else base, top) for alias in node.names)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_import_directions(path):
    here = room(path)
    if here in ("__init__", "__main__"):
        return
    assert here in MAY_IMPORT, f"{here} is a new room: say in MAY_IMPORT what it stands above"
    for name, _ in imported(path):
        parts = name.split(".")
        if parts[0] == "jaxfrf" and parts[1] != "__version__":
            assert plain(parts[1]) in MAY_IMPORT[here], f"{here} imports {name}, which stands above it"


def test_directions_have_no_circle():
    """What a room may import may not import it back (but through itself)."""
    for here, below in MAY_IMPORT.items():
        for other in below - {here}:
            assert here not in MAY_IMPORT[other], f"{here} and {other} may import each other"


def test_every_room_of_the_table_exists():
    assert set(MAY_IMPORT) == {room(path) for path in MODULES} - {"__init__", "__main__"}


OPTIONAL = {
    "matplotlib",
    "xarray",
    "h5py",
    "h5netcdf",
    "pymatreader",
    "pyuff",
    "control",
    "mujoco",
    "distributed",
    "zarr",
}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_optional_libraries_are_imported_where_they_are_used(path):
    for name, top in imported(path):
        assert not (top and name.split(".")[0] in OPTIONAL), f"{path.name} imports {name} at module level"
    assert "from __future__ import annotations" not in path.read_text()


def test_works_without_the_extras():
    """A plain install estimates and saves; with the optional libraries blocked all names import, and say what to do."""
    says = run(
        "import sys\n"
        f"for name in {sorted(OPTIONAL)}:\n"
        "    sys.modules[name] = None\n"
        "import jaxfrf as jf, tempfile, os\n"
        "for name in jf.__all__:\n"
        "    getattr(jf, name)\n"
        "where = os.path.join(tempfile.mkdtemp(), 'a.npz')\n"
        "jf.io.write(where, jf.example(blocks=1, periods=1))\n"
        "frf = jf.estimate(jf.dft(jf.io.read(where)), jf.LRM())\n"
        "jf.io.write_frf(where, frf)\n"
        "assert jf.io.read_frf(where).G.shape == frf.G.shape\n"
        "for use in (lambda: jf.plot.bode([frf], ['a']), lambda: jf.io.write_frf(where[:-3] + 'nc', frf)):\n"
        "    try:\n"
        "        use()\n"
        "    except ImportError as error:\n"
        "        print(error)\n",
        JAX_ENABLE_X64="1",
    )
    assert "pip install 'jaxfrf[plot]'" in says and "pip install 'jaxfrf[io]'" in says


# --- the README and the pages beside it


def readme_commands():
    """Everything after `jaxfrf` in the pages' code: indented and fenced blocks, and code within the text."""
    pages = [ROOT / "README.md", *sorted((ROOT / "notebooks").glob("*.md"))]
    text = "\n".join(page.read_text() for page in pages).replace("\\\n", " ")
    code = re.findall(r"(?m:^ {4}.*$)|(?ms:^```.*?^```$)|`[^`\n]+`", text)
    return [call for block in code for call in re.findall(r"(?<!import )\bjaxfrf ([a-z][^\n`|&;#]*)", block)]


def test_commands_in_the_readme_exist():
    """Every command and long option that the README shows is known to the command line."""
    from jaxfrf.__main__ import _parser

    (commands,) = (a for a in _parser()._actions if isinstance(a.choices, dict))
    calls = readme_commands()
    assert {"example", "estimate"} <= {call.split()[0] for call in calls}
    for call in calls:
        name, *rest = call.split()
        assert name in commands.choices, f"README: jaxfrf {call}"
        known = {text for action in commands.choices[name]._actions for text in action.option_strings}
        for option in (word for word in rest if word.startswith("--")):
            assert option.split("=")[0] in known, f"README: jaxfrf {name} {option}"


def test_the_installed_command_is_main():
    text = (ROOT / "pyproject.toml").read_text()
    target = re.search(r'^jaxfrf = "([\w.]+):(\w+)"$', text, re.MULTILINE)
    assert callable(getattr(importlib.import_module(target[1]), target[2]))
    assert f'version = "{jf.__version__}"' in text


# --- how JAX is used

SPECTRA_2000 = """
import numpy as np, jaxfrf as jf
rng = np.random.default_rng(0)
n = lambda *shape: rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
U, R = n(1, 1, 2000, 3), n(1, 1, 2000, 3)
lines = np.arange(1, 2001)
spectra = jf.Spectra(U=U, Y=U @ n(3, 3) + 0.1 * n(1, 1, 2000, 3), R=R, lines=lines, frequency=lines * 1.0, noise=None)
"""


@pytest.mark.slow
@pytest.mark.parametrize("devices", [1, 2, 4])
def test_thousands_of_windows_return(devices):
    """Batched LAPACK calls share a thread pool and can wait for each other for ever; these are the methods with several
    equations a window. With the environment as it is (no NPROC, no OPENBLAS_NUM_THREADS) and on several virtual
    devices: the library alone must return, time limit above."""
    says = run(
        SPECTRA_2000 + "import jax\n"
        f"assert len(jax.devices()) == {devices}\n"
        "for method in (jf.JointInputOutput(jf.MisoLRM()), jf.JointInputOutput(jf.LRM()), jf.LRM(), jf.MisoLRM()):\n"
        "    for device in jax.devices():\n"
        "        with jax.default_device(device):\n"
        "            frf = jf.estimate(spectra, method)\n"
        "        assert np.isfinite(frf.G).all() and frf.G.shape == (1, 2000, 3, 3)\n"
        "    print(type(method).__name__)\n"
        "four = {name: getattr(spectra, name).reshape(4, -1, 500, 3) for name in 'UYR'}\n"
        "four = jf.Spectra(**four, lines=lines[:500], frequency=lines[:500] * 1.0, noise=None)\n"
        "for _ in range(5):\n"
        "    assert np.isfinite(jf.estimate(four, jf.JointInputOutput(jf.MisoLRM())).G).all()\n"
        "U, R = n(1, 12, 400, 6), n(1, 12, 400, 6)\n"
        "Y, lines = U @ n(6, 6) + 0.1 * n(1, 12, 400, 6), lines[:400]\n"
        "spectra = jf.Spectra(U=U, Y=Y, R=R, lines=lines, frequency=lines * 1.0, noise=None)\n"
        "print(jf.estimate(spectra, jf.Auto()).G.shape[1])\n",
        JAX_ENABLE_X64="1",
        OPENBLAS_NUM_THREADS=None,
        XLA_FLAGS=f"--xla_force_host_platform_device_count={devices}",
    )
    assert says.split() == ["JointInputOutput", "JointInputOutput", "LRM", "MisoLRM", "400"]


@pytest.mark.slow
def test_lines_that_are_solved_again_return():
    """As above on a pool of two threads: QR and singular values of one window can wait for each other, too. An output
    that copies another makes every window rank deficient."""
    says = run(
        SPECTRA_2000 + "pos = lambda x: x.reshape(1, 4, 500, -1)\n"
        "U, Y, R = map(pos, (spectra.U, spectra.Y, spectra.R))\n"
        "Y = np.concatenate([Y, Y[..., :1]], axis=-1)\n"
        "spectra = jf.Spectra(U=U, Y=Y, R=R, lines=lines[:500], frequency=lines[:500] * 1.0, noise=None)\n"
        "for method in (jf.LRM(), jf.JointInputOutput(jf.LRM()), jf.Auto(widths=(16, 40))):\n"
        "    for _ in range(5):\n"
        "        frf = jf.estimate(spectra, method)\n"
        "    assert np.isfinite(frf.G).all() and (frf.status & int(jf.Status.REFINED)).any()\n"
        "    print(type(method).__name__)\n",
        JAX_ENABLE_X64="1",
        NPROC="2",
        OPENBLAS_NUM_THREADS=None,
    )
    assert says.split() == ["LRM", "JointInputOutput", "Auto"]


def test_single_precision_is_refused():
    """The library never switches JAX to 64 bit by itself; it says who must, and how."""
    says = run(
        SPECTRA_2000 + "import jax\n"
        "try:\n"
        "    jf.estimate(spectra, jf.LRM())\n"
        "except ValueError as error:\n"
        "    print(error)\n"
        "assert not jax.config.jax_enable_x64\n",
        JAX_ENABLE_X64=None,
    )
    assert re.search(r"estimate needs 64-bit numbers.*JAX_ENABLE_X64=1.*jax_enable_x64", says, re.DOTALL)


def test_tests_stand_where_the_package_has_its_rooms():
    rooms = {x.name for x in PACKAGE.iterdir() if x.is_dir()} | {"reference", "benchmarks"}
    folders = {x.parent for x in (ROOT / "tests").rglob("*.py")} - {ROOT / "tests"}
    assert {x.relative_to(ROOT / "tests").as_posix() for x in folders} <= rooms
    files = [*(ROOT / "tests").rglob("*.py"), *(ROOT / "benchmarks").glob("*.py")]
    assert [x.name for x in files if "sys.path" + "." in x.read_text()] == []
