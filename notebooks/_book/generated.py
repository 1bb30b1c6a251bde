"""The pages of the book that come from the program itself: reference and library of effects.

They are written to `notebooks/reference/` when the book is built; docstrings are Markdown already. A public name in
backticks, anywhere in the book, becomes a link to its place in the reference.
"""

import ast
import dataclasses
import inspect
import itertools
import pathlib
import re
import sys
import types
import typing

import jaxfrf as jf
from jaxfrf.robot.tolerances import KINDS

ROOMS = {
    "excitation": "Excitation",
    "experiment": "Records",
    "screening": "Records",
    "spectra": "Spectra",
    "frf": "FRFs",
    "simulation": "Simulation",
    "examples": "Simulation",
    "graybox": "Gray-box fits",
    "calibration": "Whole robots",
    "identification": "Gray-box fits",
    "machine": "Machines of your own",
    "robot": "Robots",
    "effects": "Effects",
    "gap": "Missing effects",
    "io": "Files",
    "plot": "Pictures",
    "report": "Pages",
    "trajectory": "Robots along a motion",
    "batch": "Many files and long runs",
    "parts": "Many files and long runs",
    "units": "Units",
    "study": "Study",
    "_errors": "Errors and status",
    "_status": "Errors and status",
}
"""The page on which the public names of a module stand; pages in this order."""


def setup(app):
    """What Sphinx calls."""
    app.connect("builder-inited", lambda app: write(pathlib.Path(app.srcdir) / "reference"))
    app.connect("source-read", lambda app, name, source: _linked(source))
    return {"version": jf.__version__, "parallel_read_safe": True}


def write(folder: pathlib.Path) -> None:
    """Write the generated pages into a folder; files that would not change are left alone."""
    folder.mkdir(exist_ok=True)
    texts = pages()
    for old in folder.glob("*.md"):
        if old.name not in texts:
            old.unlink()
    for name, text in texts.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def pages() -> dict[str, str]:
    """File name and text of every generated page."""
    texts = {_file(title): _reference_page(title) for title in dict.fromkeys(ROOMS.values())}
    texts["library.md"] = _effects_page()
    listed = "\n".join(_file(title) for title in dict.fromkeys(ROOMS.values()))
    texts["index.md"] = f"# Reference\n\n{_HOW}\n\n```{{toctree}}\n:maxdepth: 1\n\n{listed}\n```\n"
    return texts


_HOW = """Every public name, from its docstring. `jaxfrf` is imported as `jf`; names that stand in a namespace
(`jf.effects`, `jf.io`, ...) are written with it. Axes are named: `pos` operating point, `exp` experiment, `freq`
excited line, `out` output, `in` input, `time` sample; `...` stands for any number of them. Wrong arguments raise
`jaxfrf.InputError`, which says what was found, what was expected and what to do."""


def public() -> dict[str, tuple[str, object]]:
    """Public names with the page and the object of each; what two namespaces share stands once, at the shorter name."""
    found, seen = {}, set()
    spaces = [("", jf._PUBLIC), *((space, None) for space in jf._NAMESPACES)]
    for space, names in spaces:
        home = getattr(jf, space) if space else jf
        for name in names or [n for n in dir(home) if not n.startswith("_")]:
            value = getattr(home, name)
            if isinstance(value, types.ModuleType) or id(value) in seen:
                continue
            seen.add(id(value))
            found[f"jaxfrf.{space}.{name}" if space else f"jaxfrf.{name}"] = (
                ROOMS[space or names[name].partition(".")[0]],
                value,
            )
    return found


def _file(title: str) -> str:
    return f"{title.lower().replace(' ', '-')}.md"


def _reference_page(title: str) -> str:
    blocks = [f"# {title}"]
    spaces = [space for space, room in ROOMS.items() if room == title and space in jf._NAMESPACES]
    entries = {name: value for name, (room, value) in public().items() if room == title}
    for space in spaces:
        blocks.append(_docstring(getattr(jf, space)))
    for name, value in entries.items():
        blocks += [f"## {name.removeprefix('jaxfrf.')}", _entry(name, value)]
    return "\n\n".join(blocks) + "\n"


# --- one name


def _entry(name: str, value: object) -> str:
    if inspect.isclass(value):
        return _class(name, value)
    if inspect.isfunction(value) or hasattr(value, "__wrapped__"):
        return _directive("function", f"{name}{_signature(value)}", [_docstring(value), _shapes(value)])
    return _directive("data", name, [_comment(name, value), _described(value)])


def _class(name: str, kind: type) -> str:
    body = [_docstring(kind)]
    if dataclasses.is_dataclass(kind):
        fields = [f"`{f.name}`: {_type(f.type)}" for f in dataclasses.fields(kind) if not f.name.startswith("_")]
        body.append(f"*Types*: {'; '.join(fields)}." if fields else "")
    body += [_member(key, member) for key, member in vars(kind).items() if _shown(key, member)]
    signature = "" if inspect.isabstract(kind) or issubclass(kind, Exception | int) else _signature(kind)
    return _directive("class", f"{name}{signature}", body)


def _shown(key: str, member: object) -> bool:
    plain = getattr(member, "fget", None) or getattr(member, "__func__", member)
    documented = callable(plain) and inspect.getdoc(plain) and getattr(plain, "__doc__", None)
    return bool(documented) and not isinstance(member, type) and (not key.startswith("_") or key == "__call__")


def _member(key: str, member: object) -> str:
    if isinstance(member, property):
        function = member.fget
        return _directive("property", key, [_docstring(function), _shapes(function)])
    function = getattr(member, "__func__", member)
    return _directive("method", f"{key}{_signature(function)}", [_docstring(function), _shapes(function)])


def _directive(kind: str, signature: str, body: list[str]) -> str:
    text = "\n\n".join(part for part in body if part)
    fence = "`" * (3 + max((len(run) - 2 for run in re.findall(r"`{3,}", text)), default=0))
    return f"{fence}{{py:{kind}}} {signature}\n{text}\n{fence}"


def _docstring(value: object) -> str:
    return inspect.getdoc(value) or ""


def _signature(value) -> str:
    """Names and defaults; types are told below, where there is room for shapes."""
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return "()"
    plain = [
        p.replace(annotation=p.empty, default=_default(p)) for p in signature.parameters.values() if p.name != "self"
    ]
    return str(signature.replace(parameters=plain, return_annotation=signature.empty))


class _Text:
    """Prints as it is meant to be read."""

    def __init__(self, text: str):
        self.text = text

    def __repr__(self) -> str:
        return self.text


def _default(parameter):
    if parameter.default is parameter.empty:
        return parameter.empty
    text = repr(parameter.default)
    if callable(parameter.default):
        text = getattr(parameter.default, "__name__", text)
    return _Text(text if len(text) < 60 and " at 0x" not in text else "...")


def _shapes(function) -> str:
    """Types of arguments and result, with the axes of arrays."""
    notes = getattr(function, "__annotations__", {})
    told = [f"`{key}`: {_type(note)}" for key, note in notes.items() if key != "return" and note is not None]
    result = notes.get("return")
    if result is not None and result is not inspect.Signature.empty:
        told.append(f"returns {_type(result)}")
    return f"*Types*: {'; '.join(told)}." if told else ""


def _type(note: object) -> str:
    """An annotation as people write it: `complex (pos, freq, out, in)`."""
    if note is None or note is type(None):
        return "None"
    if isinstance(note, str):
        return f"`{note}`"
    if hasattr(note, "dim_str") and hasattr(note, "dtype"):
        kind = note.__name__.split("[")[0].lower()
        axes = ", ".join(note.dim_str.split())
        return f"{kind} array ({axes})" if axes else f"{kind}"
    parts = getattr(note, "__args__", ())
    if typing.get_origin(note) in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type(part) for part in parts))
    text = note.__name__ if isinstance(note, type) and not parts else str(note)
    return f"`{re.sub(r'(?:[a-z_]+[.])+(?=[A-Za-z])', '', text)}`"


def _comment(name: str, value: object) -> str:
    """The string below the line that gives a constant its value, in whichever module that stands."""
    own = name.rpartition(".")[2]
    for module in [m for key, m in sys.modules.items() if key.startswith("jaxfrf.") and vars(m).get(own) is value]:
        body = ast.parse(inspect.getsource(module)).body
        for line, after in itertools.pairwise(body):
            names = line.targets if isinstance(line, ast.Assign) else [getattr(line, "target", None)]
            text = getattr(getattr(after, "value", None), "value", None)
            if any(isinstance(n, ast.Name) and n.id == own for n in names) and isinstance(text, str):
                return inspect.cleandoc(text)
    return ""


def _described(value: object) -> str:
    """A constant as people read it: a table of what it holds."""
    if isinstance(value, dict):
        return _table((key, _value(x, key)) for key, x in value.items())
    if isinstance(value, jf.study.Settings):
        return _table((key, _value(x)) for key, x in value.as_dict().items())
    if isinstance(value, list | tuple):
        return "\n".join(f"- {_value(x)}" for x in value)
    return _value(value)


def _table(rows) -> str:
    return "\n".join(["| | |", "|---|---|", *(f"| `{key}` | {_cell(text)} |" for key, text in rows)])


def _value(value: object, key: str = "") -> str:
    if isinstance(value, jf.robot.Tolerance):
        if value.exact or value.unknown:
            return "exact" if value.exact else "unknown"
        absolute = "absolute" if KINDS[key] == "1" else KINDS[key]
        return f"{value.std:.3g}, {'relative' if value.relative else absolute}"
    if isinstance(value, jf.study.Settings):
        return f"`jaxfrf.study.{value.name.upper()}`"
    if inspect.isclass(value):
        return f"`{next((n for n, (_, x) in _known().items() if x is value), value.__name__)}`"
    return value if isinstance(value, str) else f"`{value!r}`"


# --- links


_NAMES = re.compile(r"(?<![`\w{])`(?:jf|jaxfrf)\.([A-Za-z_][\w.]*)(\([^`\n]*\))?`(?!`)")


def _linked(source: list[str]) -> None:
    """Public names in backticks become links; code blocks and headings stay as they are."""
    known = _known()

    def link(found):
        name = f"jaxfrf.{found[1]}"
        return f"{{py:obj}}`{found[0][1:-1]} <{name}>`" if name in known else found[0]

    inside, lines = False, []
    for line in source[0].split("\n"):
        fenced = line.lstrip().startswith("```")
        inside ^= fenced and not line.lstrip().startswith("```{py:") and not (not inside and "{" in line)
        lines.append(line if inside or fenced or line.startswith("#") else _NAMES.sub(link, line))
    source[0] = "\n".join(lines)


_found: dict[str, tuple[str, object]] = {}


def _known() -> dict[str, tuple[str, object]]:
    if not _found:
        _found.update(public())
    return _found


# --- effects


def _effects_page() -> str:
    rows = ["| effect | acts as | parameters | what it does to data |", "|---|---|---|---|"]
    for name, kind in jf.effects.library().items():
        units = ", ".join(f"`{key}` ({unit or '-'})" for key, unit in kind.units.items())
        rows.append(f"| [{name}](#{name.replace('_', '-')}) | {_base(kind)} | {units} | {_cell(kind.signature)} |")
    return "\n\n".join([_EFFECTS, "\n".join(rows), *(_effect(kind) for kind in jf.effects.library().values())]) + "\n"


_EFFECTS = """# The library of effects

What a robot's model may lack, by the names that files, reports and diagnoses use. This page is made from the classes of
`jaxfrf.effects`; [what they look like](../effects.ipynb) shows each of them in the torque of a motor."""


def _effect(kind) -> str:
    low_high = [f"- `{key}`: {unit or 'no unit'}, {_bound(kind.bounds[key])}" for key, unit in kind.units.items()]
    alike = [f"- *{other}*: {what}" for other, what in kind.confusable.items()]
    joint = "" if "joint" not in {f.name for f in dataclasses.fields(kind)} else 'joint = "joint2"\n'
    example = (
        f'```toml\n[[effect]]\nname = "{kind.name}"\n{joint}' + "".join(f"{key} = ...\n" for key in kind.units) + "```"
    )
    blocks = [
        f"## {kind.name.replace('_', ' ')}",
        inspect.getdoc(kind),
        f"In data: {kind.signature}.",
        "\n".join(low_high),
        f"Easily confused with:\n\n{chr(10).join(alike)}" if alike else "",
        example,
    ]
    return "\n\n".join(block for block in blocks if block)


def _base(kind) -> str:
    base = next(b for b in kind.__mro__ if b.__name__.startswith("Abstract"))
    words = re.findall(r"[A-Z][a-z]+", base.__name__.removeprefix("Abstract"))
    return " ".join(words).lower()


def _bound(bounds) -> str:
    return f"{bounds[0]:g} to {bounds[1]:g}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
