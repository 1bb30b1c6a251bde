"""`jaxfrf example`."""

from ..io._formats import SAVED
from .arguments import check_target, command

EXAMPLES = (
    "jaxfrf example -o run.nc",
    "jaxfrf example -o run.mat --blocks 4 --seed 1",
)


def add(commands) -> None:
    parser = command(commands, "example", run, "Simulate a small closed-loop experiment and write its record.")
    parser.add_argument("-o", "--output", required=True, help="record to write: .nc, .mat or .npz")
    parser.add_argument("--blocks", type=int, default=2, help="blocks of two experiments (default 2)")
    parser.add_argument("--seed", type=int, default=0)


def run(given) -> dict:
    from ..examples import example
    from ..io import write

    check_target(given.output, SAVED)
    data = example(blocks=given.blocks, seed=given.seed)
    write(given.output, data)
    text = [
        f"two flexible axes in closed loop: {data.n_exp} experiments, {data.n_periods} steady periods of "
        f"{data.period / data.fs:g} s, {0 if data.lines is None else len(data.lines)} excited lines, seed {given.seed}",
        f"wrote {given.output}",
        f"next: jaxfrf estimate {given.output} -o frf.nc --report frf.html",
    ]
    return {"text": text, "output": given.output, "seed": given.seed, "experiments": data.n_exp}
