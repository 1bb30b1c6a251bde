"""The book and the README: every block of code and every command runs, every page is built, every name has its place.

A page runs in a folder of its own, with the files that it takes for granted (`book_files.py`), from top to bottom:

- blocks of `python`, one after the other in one namespace;
- blocks without a language, and of `sh`: commands;
- a block of `toml` or `python` whose first line is `# file: NAME` is written to that file;
- `<!-- not run: why -->` above a block leaves it out, `<!-- data: FOLDER -->` needs that folder of `$JAXFRF_DATA`.

Blocks of other languages, and indented ones (what a command prints), are only read.
"""

import copy
import importlib.util
import os
import pathlib
import re
import shlex
import shutil
import subprocess
import sys
from typing import NamedTuple

import jax
import pytest

import jaxfrf as jf

ROOT = pathlib.Path(jf.__file__).parents[1]
BOOK = ROOT / "notebooks"
PAGES = [ROOT / "README.md", *sorted(p for p in BOOK.rglob("*.md") if "reference" not in p.parts)]


class Block(NamedTuple):
    """A fenced block of a page: what stands above it, its language and its text."""

    remark: str
    language: str
    text: str


def blocks(page: pathlib.Path) -> list[Block]:
    fenced = re.finditer(r"(?ms)^(?:<!-- ([^\n]*) -->\n)?```([^\n`]*)\n(.*?)^```$", page.read_text(encoding="utf-8"))
    return [Block(found[1] or "", found[2].strip(), found[3]) for found in fenced]


def commands(text: str) -> list[str]:
    lines = text.replace("\\\n", " ").split("\n")
    return [line.strip() for line in lines if line.strip() and not line.startswith("#")]


# --- everything runs


RUN = [page for page in PAGES if any(b.language in ("", "sh", "python") for b in blocks(page))]


@pytest.fixture
def double_precision():
    """Comes back behind a page that was begun without."""
    yield
    jax.config.update("jax_enable_x64", True)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", RUN, ids=lambda page: str(page.relative_to(ROOT)))
def test_everything_on_the_page_runs(page, tmp_path, monkeypatch, capsys, double_precision):
    import book_files

    monkeypatch.chdir(tmp_path)
    for name in ("jaxfrf", "benchmarks"):
        (tmp_path / name).symlink_to(ROOT / name)
    book_files.write(tmp_path, "\n".join(b.text for b in blocks(page)))
    space, left = {"__name__": "__main__"}, []
    before = [b for b in blocks(page) if b.language == "python"][:1]
    for block in blocks(page):
        if block.remark.startswith("not run: "):
            continue
        if block.text.startswith("# file: "):
            (tmp_path / block.text.split("\n")[0].removeprefix("# file: ")).write_text(block.text)
            continue
        if block.remark.startswith("data: ") and not _linked(block.remark.removeprefix("data: "), tmp_path):
            left.append(block.remark)
        elif block.language == "python":
            if block in before:  # as a fresh Python has it: the page says what to set
                jax.config.update("jax_enable_x64", False)
            exec(compile(block.text, f"{page.name}", "exec"), space)
        elif block.language in ("", "sh"):
            for line in commands(block.text):
                _run(line, capsys)
    if left:
        pytest.skip(f"JAXFRF_DATA is not set: left out {', '.join(left)}; all else ran.")


NOTEBOOKS = sorted(BOOK.glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_and_print_what_they_hold(path, tmp_path, monkeypatch):
    """The same words and pictures, the same numbers within a tenth: other machines round otherwise.

    `jupyter execute --inplace notebooks/NAME.ipynb` makes what they hold."""
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    kept = nbformat.read(path, 4)
    if "JAXFRF_DATA" in str(kept.cells) and "JAXFRF_DATA" not in os.environ:
        pytest.skip("JAXFRF_DATA is not set: `python tests/data.py` says where its data are to be had.")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.delenv("MPLBACKEND", raising=False)  # pictures stand in the page
    made, where = copy.deepcopy(kept), {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(made, timeout=1500, kernel_name="python3", resources=where).execute()
    for number, (then, now) in enumerate(zip(kept.cells, made.cells, strict=True)):
        (words, numbers, pictures), (words_now, numbers_now, pictures_now) = _held(then), _held(now)
        assert (words_now, pictures_now) == (words, pictures), f"{path.stem}, cell {number}"
        off = [(a, b) for a, b in zip(numbers, numbers_now, strict=True) if not _close(a, b)]
        assert not off, f"{path.stem}, cell {number}: {off}"


_NUMBER = r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?|[-+]?\.\d+(?:e[-+]?\d+)?"


def _held(cell) -> tuple[list[str], list[str], int]:
    """Words, numbers and how many pictures a cell shows."""
    outputs = cell.get("outputs", [])
    text = "".join(o.text for o in outputs if o.output_type == "stream")
    words = re.sub(_NUMBER, " ", re.sub(r"[\[\]().,]", " ", text)).split()
    return words, re.findall(_NUMBER, text), sum("image/png" in o.get("data", {}) for o in outputs)


def _close(then: str, now: str) -> bool:
    """Within a tenth, or one in the last digit that is printed."""
    mantissa, _, exponent = then.partition("e")
    last = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return abs(float(now) - float(then)) <= 0.1 * abs(float(then)) + 1.001 * last


def _linked(folder: str, here: pathlib.Path) -> bool:
    if "JAXFRF_DATA" not in os.environ:
        return False
    for path in (pathlib.Path(os.environ["JAXFRF_DATA"]) / folder).iterdir():
        if not (here / path.name).exists():
            (here / path.name).symlink_to(path.resolve())
    return True


def _run(line: str, capsys) -> None:
    """A line of `jaxfrf` alone in this process, any other by the shell."""
    from jaxfrf.__main__ import main

    if line.startswith("jaxfrf ") and not re.search(r"[|;$`<>]", re.sub(r"'[^']*'|\"[^\"]*\"", "", line)):
        code = main(shlex.split(line)[1:])
        said = capsys.readouterr()
        assert code == 0, f"{line}\n{said.err}"
        return
    program = f'jaxfrf() {{ {shlex.quote(sys.executable)} -m jaxfrf "$@"; }}\n{line}'
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        ["bash", "-euc", program], env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True, timeout=1500
    )
    assert done.returncode == 0, f"{line}\n{done.stderr}"


def test_what_is_left_out_says_why():
    """Few blocks, each with a reason; remarks are spelt as they are read."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        remarks = re.findall(r"(?m)^<!-- (.*) -->$", text)
        remarks = [r for r in remarks if not re.fullmatch(r"table: \w+|end of table", r)]
        used = [b.remark for b in blocks(page) if b.remark]
        assert remarks == used, f"{page.name}: a remark stands above no block"
        assert all(re.fullmatch(r"not run: .{5,}|data: \w+", r) for r in remarks), page.name
        assert not any(
            b.language not in ("", "sh", "python", "toml", "matlab") and "{" not in b.language for b in blocks(page)
        )


# --- every name has its place


def generated():
    spec = importlib.util.spec_from_file_location("generated", BOOK / "_book" / "generated.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_public_name_has_its_place():
    """In the reference once; effects on the page of the library, too."""
    book = generated()
    texts = book.pages()
    for name, (room, _) in book.public().items():
        page = texts[book._file(room)]
        assert len(re.findall(rf"(?m)^```+{{py:\w+}} {re.escape(name)}(?=[(\n])", page)) == 1, name
    known = {name.removeprefix("jaxfrf.") for name in book.public()}
    assert set(jf._PUBLIC) <= known
    assert set(book.ROOMS) >= set(jf._NAMESPACES) | {module.partition(".")[0] for module in jf._PUBLIC.values()}
    for name in jf.effects.library():
        assert f'name = "{name}"' in texts["library.md"]


def test_names_on_the_pages_exist():
    """Of `jf.X` and `jaxfrf.X`, in code and in text."""
    for page in PAGES:
        for name in re.findall(
            r"(?<![\w/])(?:jf|jaxfrf)\.([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?)", page.read_text(encoding="utf-8")
        ):
            first, _, second = name.partition(".")
            if first in ("nc", "toml", "md"):
                continue
            assert hasattr(jf, first), f"{page.name}: {name}"
            assert not second or hasattr(getattr(jf, first), second), f"{page.name}: {name}"


def test_imports_on_the_pages_are_of_public_names():
    """`from jaxfrf.X import Y` takes what stands in the reference: Y of the namespace X."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        lines = re.findall(r"(?m)^(?:from jaxfrf(\.[\w.]+)? import|import jaxfrf\.([\w.]+)) ?(.*)$", text)
        for space, module, names in lines:
            assert (space.removeprefix(".") or module) in (*jf._NAMESPACES, ""), f"{page.name}: {space}{module}"
            home = getattr(jf, space.removeprefix(".")) if space else jf
            assert all(hasattr(home, name.split(" ")[0]) for name in names.split(", ") if name), f"{page.name}: {names}"


def test_constants_of_the_reference_say_what_they_hold():
    book = generated()
    texts = book.pages()
    for name, (room, value) in book.public().items():
        if not callable(value):
            entry = texts[book._file(room)].split(f"{{py:data}} {name}\n")[1].split("```")[0]
            held = [str(key) for key in value] if isinstance(value, dict) else []
            assert entry.strip() and all(f"`{key}`" in entry for key in held), name
    status = texts[book._file("Errors and status")]
    assert all(f"`{flag.name}`, {flag.value}:" in status for flag in jf.Status)


def test_pages_are_listed():
    """Every page of the book stands in its table of contents."""
    listed = re.findall(r"(?ms)^```{toctree}\n(.*?)^```", (BOOK / "index.md").read_text())
    names = {line for block in listed for line in block.split("\n") if line and not line.startswith(":")}
    pages = {str(p.relative_to(BOOK).with_suffix("")) for kind in ("md", "ipynb") for p in BOOK.rglob(f"*.{kind}")}
    pages = {p for p in pages if not p.startswith("reference/") and "checkpoint" not in p} - {"index"}
    assert pages == {n for n in names if not n.startswith("reference/")}


def test_links_lead_somewhere():
    """Of pages that are read as they are, on a forge."""
    for page in [*PAGES, ROOT / "CONTRIBUTING.md"]:
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            if "://" not in target and "reference/" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_measured_figures_are_those_of_the_kept_results():
    done = subprocess.run(
        [sys.executable, ROOT / "benchmarks" / "measured.py", "--check"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_the_book_is_built_without_a_warning(tmp_path):
    for name in ("sphinx", "myst_nb", "furo", "sphinx_copybutton"):
        pytest.importorskip(name, reason=f"{name} is not installed: pip install -e '.[docs]'")
    shutil.copytree(BOOK, tmp_path / "notebooks", ignore=shutil.ignore_patterns("reference"))
    shutil.copytree(ROOT / "benchmarks" / "results", tmp_path / "benchmarks" / "results")
    for name in ("README.md", "CONTRIBUTING.md", "benchmarks/README.md"):
        shutil.copy(ROOT / name, tmp_path / name)
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "notebooks", "book"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert done.returncode == 0, done.stderr
    for name in ("index", "start", "effects", "own_model", "reference/frfs", "reference/library"):
        assert (tmp_path / "book" / f"{name}.html").is_file(), name
