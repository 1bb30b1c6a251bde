"""What is done about records that are wrong: refused, warned of, told, or nothing; and how far the FRF moved for it.

    python benchmarks/bench_faults.py [--tune] [--only WORD] [-o FILE]

Machines, records and faults come from `_faults.py`, which shares nothing with the library. Every record is written to a
file and read with `jaxfrf.io.read`, then estimated with `jaxfrf.estimate` by the default method. A fault moved the FRF
where more than 5 % of its values left their own 95 % region around the value of the clean record. What is printed of
clean records is how many of them got any finding. `--tune` uses the machines on which thresholds were chosen; without
it, others.
"""

import argparse
import collections
import os
import pathlib
import tempfile
import time

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import _faults as f
import numpy as np
from _pinned import commit

import jaxfrf as jf

REPORT, TUNE = (101, 102), (1, 2)  # seeds of the machines
CLEAN_REPORT, CLEAN_TUNE = range(200, 217), range(20, 37)
KINDS = ("loop", "open", "rough")
UNSEEN = "cannot be seen"  # in principle: nothing in the record says so


def faults(kind: str, n_periods: int) -> list[tuple[str, object]]:
    """Names and functions; what needs several channels or experiments only where there are."""
    last = 0.9 if n_periods > 2 else 0.8
    several = [
        *((f"y lost {c} at {a:.0%}", f.lost(("y",), a, c)) for c in (1, 3, 40) for a in (0.3, last)),
        ("y 1 too many at 60 %", f.lost(("y",), 0.6, -1)),
        ("u lost 1 at 55 %", f.lost(("u",), 0.55, 1)),
        ("u lost 7 at 20 %", f.lost(("u",), 0.2, 7)),
        ("all lost 1 at 45 %", f.lost(("u", "y", "r"), 0.45, 1)),
        ("all lost 100 at 70 %", f.lost(("u", "y", "r"), 0.7, 100)),
        ("y held 30", f.stretch("y", 0.63, 30, "held")),
        ("y held 300", f.stretch("y", 0.13, 300, "held")),
        ("u zero 30", f.stretch("u", 0.8, 30, "zero")),
        ("u zero 400", f.stretch("u", 0.4, 400, "zero")),
        ("y noise 200", f.stretch("y", 0.7, 200, "noise")),
        *(
            (f"{s} gain drifts {g:.1%}", f.gain(s, "drift", g))
            for s, g in (("y", 0.01), ("y", 0.05), ("y", 0.2), ("u", 0.05))
        ),
        ("y gain steps 3 %", f.gain("y", "step", 0.03)),
        ("y offset drifts .1 rms", f.offset("y", "drift", 0.1)),
        ("y offset drifts 2 rms", f.offset("y", "drift", 2.0)),
        ("y offset steps .3 rms", f.offset("y", "step", 0.3)),
        *((f"{s} clipped at {c} rms", f.clip(s, c)) for s, c in (("y", 1.0), ("y", 2.0), ("u", 1.5), ("u", 2.2))),
        ("y clipped at 1.5 rms, noise", f.clip("y", 1.5, 0.003)),
        *((f"{s} on {q} levels", f.quantise(s, q)) for s, q in (("y", 6), ("y", 20), ("y", 300), ("u", 12))),
        ("y wraps at .7 of its range", f.wrap("y", 0.7)),
        ("u wraps at .9 of its range", f.wrap("u", 0.9)),
        ("y spike 3 rms", f.spike("y", 0.35, 3.0)),
        ("y spike 30 rms", f.spike("y", 0.85, 30.0)),
        ("u 20 spikes 5 rms", f.spike("u", 0.2, 5.0, 20)),
        ("y jitter .05", f.jitter("y", 0.05)),
        ("y jitter .5", f.jitter("y", 0.5)),
        ("u late by 1", f.shift("u", 1)),
        ("u late by 3", f.shift("u", 3)),
    ]
    if n_periods > 2:
        several += [
            ("period 3/2", f.period(1.5)),
            ("period + 1", f.period(by=1)),
            ("period - 1", f.period(by=-1)),
            ("period 1/2", f.period(0.5)),
            ("period 9/8", f.period(1.125)),
            ("record after itself", f.twice("record")),
        ]
    if kind in ("loop", "rough"):
        kinds = ["sign", "noise", "permuted", "late by 1", "late by 5", "gain 1.1", "gain 2"]
        kinds += ["swapped", "sign of one channel"] if kind == "loop" else []
        several += [(f"one experiment: {k}", f.foreign(k)) for k in kinds]
        several += [("an experiment twice", f.twice("experiment")), ("all experiments twice", f.twice("all"))]
    several += [
        (f"{UNSEEN}: y x 1.1", f.scale("y", 1.1)),
        (f"{UNSEEN}: all signs of y", f.scale("y", -1.0)),
        (f"{UNSEEN}: y late by 1", f.shift("y", 1)),
    ]
    if kind == "loop":
        several += [(f"{UNSEEN}: y channels swapped everywhere", f.exchange("y"))]
    return several


def read(record: dict, folder: str):
    """What a user does: a file, read and estimated; the FRF, warnings, and what was refused."""
    path = os.path.join(folder, "record.npz")
    np.savez(path, **record)
    try:
        data = jf.io.read(path)
        return jf.estimate(data, jf.Auto()), [w.replace(path, "").lstrip(": ") for w in data.warnings], None
    except jf.InputError as error:
        return None, [], str(error).replace(path, "").lstrip(": ")


def moved(frf, clean) -> tuple[float, float, float]:
    """Median relative change, part of the values outside their 95 % region, and median distance in its radii."""
    common, i, j = np.intersect1d(np.round(frf.frequency, 6), np.round(clean.frequency, 6), return_indices=True)
    if len(common) < 3:
        return np.nan, 1.0, np.nan
    step = np.abs(frf.G[:, i] - clean.G[:, j])
    radius = np.sqrt(-np.log(0.05)) * np.asarray(frf.std)[:, i]
    with np.errstate(all="ignore"):
        return (
            float(np.median(step / np.abs(clean.G[:, j]))),
            float(np.mean(step > radius)),
            float(np.median(step / radius)),
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tune", action="store_true", help="the machines on which thresholds were chosen")
    parser.add_argument("--only", default="", help="faults whose name holds this; no clean records")
    parser.add_argument("--verbose", action="store_true", help="print what was said")
    parser.add_argument("-o", "--output", type=pathlib.Path, help="keep what is printed in this file, too")
    given = parser.parse_args()
    lines: list[str] = []

    def say(text: str) -> None:
        print(text, flush=True)
        lines.append(text)

    start = time.monotonic()
    seeds = TUNE if given.tune else REPORT
    say(f"jaxfrf {jf.__version__}, commit {commit()}; machines {seeds}, method auto")
    say(f"{'record':16}{'fault':42}{'done':9}{'moved %':>9}{'outside %':>11}{'radii':>8}  findings")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for kind, seed in ((k, s) for k in KINDS for s in seeds):
            n_periods = 10 if seed == seeds[0] else 2
            record = f.machine_record(kind, np.random.default_rng(seed), n_periods)
            clean, said, refused = read(record, folder)
            label = f"{kind} P={n_periods}"
            say(f"{label:16}{'none':42}{_done(said, refused):9}{'':28}  {_kinds(said, refused)}")
            for name, fault in faults(kind, n_periods):
                if given.only in name:
                    rng = np.random.default_rng([seed, len(rows)])
                    rows.append(_row(label, name, read(fault(record, rng), folder), clean))
                    say(_line(rows[-1]))
                    if given.verbose:
                        say("\n".join("        " + w for w in rows[-1]["said"]))
        _summary(rows, say)
        if not given.only:
            _clean(CLEAN_TUNE if given.tune else CLEAN_REPORT, folder, say)
    say(f"{time.monotonic() - start:.0f} s")
    if given.output:
        given.output.write_text("\n".join(lines) + "\n")


def _row(label, name, found, clean) -> dict:
    frf, said, refused = found
    change = (np.nan,) * 3 if frf is None else moved(frf, clean)
    return {"record": label, "fault": name, "said": said + ([refused] if refused else []), "refused": refused,
            "done": _done(said, refused), "change": change}  # fmt: skip


def _done(said, refused) -> str:
    if refused:
        return "refused"
    return "warned" if said else "nothing"


def _kinds(said, refused) -> str:
    texts = said + ([refused] if refused else [])
    return "; ".join(t[:70] for t in texts)


def _line(row) -> str:
    relative, outside, radii = row["change"]
    numbers = f"{100 * relative:9.2f}{100 * outside:11.0f}{radii:8.2f}" if np.isfinite(relative) else " " * 28
    return f"{row['record']:16}{row['fault']:42}{row['done']:9}{numbers}  {_kinds(row['said'], None)}"


def _summary(rows, say) -> None:
    done = collections.Counter(r["done"] for r in rows)
    seeable = [r for r in rows if not r["fault"].startswith(UNSEEN)]
    silent = [r for r in seeable if r["done"] == "nothing" and r["change"][1] > 0.05]
    say(f"\n{len(rows)} faults: " + ", ".join(f"{n} {word}" for word, n in sorted(done.items())))
    harmless = sum(r["done"] == "nothing" and r["change"][1] <= 0.05 for r in seeable)
    say(f"nothing said, FRF within its 95 % interval: {harmless}")
    say(f"nothing said though the FRF moved by more than its 95 % interval: {len(silent)} of {len(seeable)}")
    for r in silent:
        say("    " + _line(r))


def _clean(seeds, folder, say) -> None:
    """Findings on clean records: machines of all kinds, with 2, 3 and 10 periods."""
    count, false = 0, []
    for kind in (*KINDS, "weak"):
        for seed in seeds:
            record = f.machine_record(kind, np.random.default_rng(seed), (2, 3, 10)[seed % 3])
            if kind == "weak":
                record.pop("lines")
            path = os.path.join(folder, "clean.npz")
            np.savez(path, **record)
            count += 1
            try:
                said = [w.replace(path, "").lstrip(": ") for w in jf.io.read(path).warnings]
            except jf.InputError as error:
                said = [str(error)]
            # A ratio below 10 dB is what the machine is like, and rightly told.
            said = [w for w in said if "signal-to-noise ratio" not in w]
            if said:
                false.append((kind, seed, said))
    say(f"\nclean records with a finding: {len(false)} of {count}")
    for kind, seed, said in false:
        say(f"    {kind} {seed}: {said[0][:150]}")


if __name__ == "__main__":
    main()
