"""Damaged files for every reader: whole ones, of which bytes, words and lengths are changed by a numbered draw.

python tests/reference/fuzzing.py SECONDS [READER] [NUMBER]     all of them in turn, or one reader, or one draw again
"""

import contextlib
import pathlib
import random
import re
import signal
import sys
import tempfile
import time
import warnings

import numpy as np

import jaxfrf as jf
from jaxfrf.frf.catalogue import METHODS, method
from jaxfrf.io import _matlab
from jaxfrf.io._container import Variable
from jaxfrf.io.record_arguments import parse_factor, parse_map, parse_values
from jaxfrf.robot.tolerances import tolerances_from
from jaxfrf.simulation import read_positions

HANG = 60  # s
NUMBERS = "0 -0 1 -1 2 7 0.5 1e308 1e400 1e-400 nan inf -inf 99999999999999999999 1e12 1_0 0x1 1. .5 1,5 2147483648"
WORDS = f"{NUMBERS} [ ] [[ ]] {{ }} ( ) , ; : ' \" = # % < > </ /> & ^ u y r q t fs period lines true null x".split()


def corpus(folder: pathlib.Path) -> dict[str, tuple[bytes, str, object]]:
    """For every reader a whole file's bytes, its suffix, and what reads it."""
    rng = np.random.default_rng(0)
    u = np.tile(rng.standard_normal((1, 2, 40, 2)), (1, 1, 3, 1))
    data = jf.Experiment(u, np.roll(u, 2, 2), 100.0, 40, r=u, q=[[0.1, 0.2]], y_quantity="position")
    G = rng.standard_normal((1, 9, 2, 2)) + 1j
    frf = jf.io.frf_from_arrays(G, np.arange(1.0, 10.0), q=[[0.1, 0.2]])
    found = {}

    def add(name, suffix, write, read):
        path = folder / f"{name}{suffix}"
        write(path)
        found[name] = path.read_bytes(), suffix, read

    for kind in ("nc", "mat", "npz"):
        add(f"record-{kind}", f".{kind}", lambda p: jf.io.write(p, data), jf.io.read)
        add(f"frf-{kind}", f".{kind}", lambda p: jf.io.write_frf(p, frf), jf.io.read_frf)
    variables = {"u": Variable(("time", "in"), u[0, 0]), "y": Variable(("time", "out"), u[0, 1])}
    add("record-v73", ".mat", lambda p: _matlab.save_v73(p, variables, {"fs": 100.0, "period": 40}), jf.io.read)
    rows = ["t,u,y", "s,N m,rad/s", *(f"{0.01 * i:.2f},{a:.4f},{b:.4f}" for i, (a, b) in enumerate(u[0, 0]))]
    text = "\n".join(rows).encode()
    add("record-csv", ".csv", lambda p: p.write_bytes(text), jf.io.read)
    add("record-utf16", ".csv", lambda p: p.write_bytes(text.decode().encode("utf-16")), jf.io.read)
    add("frf-uff", ".uff", lambda p: jf.io.write_uff(p, frf), jf.io.read_uff)
    source = pathlib.Path(jf.__file__).parent
    robot = (source / "robot" / "r3x.toml").read_bytes()
    add("robot", ".toml", lambda p: p.write_bytes(robot), jf.io.read_robot)
    design = b"""fs = 2000.0\nperiod = 4000\nrms = 1\n[lines]\ngrid = "log-odd"\nband = [4.0, 80.0]\npoints = 30
[multisine]\nrms = [2.0, 1.0]\nphases = "random"\n[slow_sine]\nlines = [3, 5]\namplitude = [3.0, 4.0]\n"""
    design = design.replace(b"rms = 1\n", b"blocks = 2\nseed = 3\n", 1)
    add("design", ".toml", lambda p: p.write_bytes(design), lambda p: jf.reference(jf.io.read_design(p)))
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0 0 .1" rpy="0 .1 0"/><mass value="2"/>'
        f'<inertia ixx="1" iyy="1" izz="1" ixy="0"/></inertial></link>'
        for i in range(4)
    )
    kinds = ("revolute", "fixed", "prismatic")
    joints = "".join(
        f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="0 1 0"/>'
        f'<origin xyz="0 0 .2"/></joint>'
        for i, kind in enumerate(kinds)
    )
    drives = "".join(
        f'[[joint]]\nname = "j{i}"\ngear_ratio = 50.0\nmotor_inertia = 1e-4\nstiffness = inf\n' for i in (0, 2)
    )
    (folder / "drives.toml").write_text(drives)
    urdf = f'<?xml version="1.0"?><robot name="arm">{links}{joints}</robot>'.encode()
    add("urdf", ".urdf", lambda p: p.write_bytes(urdf), lambda p: jf.io.read_urdf(p, folder / "drives.toml"))
    angles = b"# j1, j2\n0.1, 0.2\n-0.3, 1e-1\n"
    add("positions", ".csv", lambda p: p.write_bytes(angles), lambda p: read_positions(p, 2))
    for name, text, read in _arguments(robot):
        add(
            name,
            ".txt",
            lambda p, t=text: p.write_bytes(t),
            lambda p, f=read: f(p.read_bytes().decode(errors="replace")),
        )
    return found


def _arguments(robot: bytes):
    """Texts of the command line, as if they were files."""
    yield "map", b"u=[a;b'],y=rec.vel[0:3],r=c[2],fs=rate", parse_map
    yield "set", b"fs=2500,period=2.5e3,samples=0:18720,lines=13:250:4,q=0;0.5,y_quantity=position", parse_values
    yield "scale", b"y=[0.0174532925;-1],u=2,t=1e-6", parse_factor

    def option(text):
        name, *pairs = text.split() or [""]
        if name not in METHODS:
            raise jf.InputError(name)
        return method(name, dict(pair.split("=", 1) for pair in pairs if "=" in pair))

    yield "option", b"lpm order=2 width=34 variable=index transient=2", option
    yield "tolerance", b"links=0.02", lambda t: tolerances_from({t.partition("=")[0]: t.partition("=")[2]}, ("a",), "x")


def damaged(whole: bytes, suffix: str, draw: random.Random) -> bytes:
    """One to some changes."""
    data = bytearray(whole)
    text = suffix not in (".nc", ".mat", ".npz")
    for _ in range(draw.choice((1, 1, 2, 3, 8))):
        change = draw.choice(_TEXT if text and draw.random() < 0.7 else _BYTES)
        data = bytearray(change(data, draw))
    return bytes(data)


def _flip(data, draw):
    if data:
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    return data


def _value(data, draw):
    """A length or an offset, somewhere."""
    at = draw.randrange(len(data) + 1)
    size = draw.choice((1, 2, 4, 8))
    value = draw.choice((0, 1, 0x7F, 0x80, 0xFF, 2**15, 2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1)) % 256**size
    return data[:at] + value.to_bytes(size, draw.choice(("little", "big"))) + data[at + size :]


def _cut(data, draw):
    return data[: draw.randrange(len(data) + 1)]


def _drop(data, draw):
    at = draw.randrange(len(data) + 1)
    return data[:at] + data[at + draw.choice((1, 2, 8, 100)) :]


def _double(data, draw):
    at, size = draw.randrange(len(data) + 1), draw.choice((1, 8, 100, 1000))
    return data[:at] + data[at : at + size] * draw.choice((2, 3, 50)) + data[at + size :]


def _zero(data, draw):
    at, size = draw.randrange(len(data) + 1), draw.choice((8, 100, 1000))
    return data[:at] + bytes(len(data[at : at + size])) + data[at + size :]


def _swap_word(data, draw):
    """A word, a number or a sign of a text for another."""
    found = list(re.finditer(rb"[A-Za-z_]+|[-+.\deE]+|[^\s\w]", bytes(data)))
    if not found:
        return data
    word = draw.choice(found)
    new = draw.choice(WORDS).encode() if draw.random() < 0.7 else draw.choice(found).group()
    return data[: word.start()] + new + data[word.end() :]


def _swap_lines(data, draw):
    lines = bytes(data).split(b"\n")
    a, b = draw.randrange(len(lines)), draw.randrange(len(lines))
    lines[a] = draw.choice((lines[b], b"", lines[a] + lines[b]))
    return bytearray(b"\n".join(lines))


def _nest(data, draw):
    at = draw.randrange(len(data) + 1)
    return data[:at] + draw.choice((b"[", b"{", b"<a>", b"a.", b'"')) * draw.choice((2, 2000)) + data[at:]


_BYTES = (_flip, _flip, _value, _value, _cut, _drop, _double, _zero)
_TEXT = (_swap_word, _swap_word, _swap_word, _swap_lines, _nest)


class Hang(BaseException):
    """Not an `Exception`: no reader may take it for a damaged file."""


@contextlib.contextmanager
def limited(seconds: int):
    def late(*_):
        raise Hang(f"longer than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def read_damaged(folder: pathlib.Path, name: str, case, number: int) -> bool:
    """Read draw `number` of a reader; whether it was refused. Anything but an `InputError` goes through."""
    whole, suffix, read = case
    path = folder / f"damaged{suffix}"
    path.write_bytes(damaged(whole, suffix, random.Random(f"{name} {number}")))
    with limited(HANG), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read(path)
        except jf.InputError as error:
            assert str(error) or name == "option"
            return True
    return False


def main(seconds: float, only: str = "", number: int | None = None) -> None:
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        cases = {name: case for name, case in corpus(folder).items() if only in ("", name)}
        if number is not None:
            print(read_damaged(folder, only, cases[only], number))
            return
        refused, tried, begun, i = dict.fromkeys(cases, 0), 0, time.monotonic(), 0
        while time.monotonic() < begun + seconds:
            for name, case in cases.items():
                print(f"{name} {i}", file=sys.stderr, flush=True) if "-v" in sys.argv else None
                try:
                    refused[name] += read_damaged(folder, name, case, i)
                except BaseException:
                    print(f"draw {i} of {name}", file=sys.stderr, flush=True)
                    raise
                tried += 1
            i += 1
        print(f"{tried} damaged files, refused:", ", ".join(f"{name} {n}/{i}" for name, n in refused.items()))


if __name__ == "__main__":
    arguments = [a for a in sys.argv[1:] if not a.startswith("-")]
    main(float(arguments[0]), *arguments[1:2], *(int(n) for n in arguments[2:3]))
