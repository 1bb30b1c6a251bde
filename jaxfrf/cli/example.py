"""`jaxfrf example`."""

import pathlib

from ..io._formats import SAVED
from .arguments import check_target, command

EXAMPLES = (
    "jaxfrf example -o run.nc",
    "jaxfrf example -o run.mat --blocks 4 --seed 1",
    "jaxfrf example -o run.nc --robot-out robot.toml",
)


def add(commands) -> None:
    parser = command(commands, "example", run, "Simulate a small closed-loop experiment and write its record.")
    parser.add_argument("-o", "--output", required=True, help=f"record to write: {' '.join(SAVED)}")
    parser.add_argument(
        "--robot-out", metavar="ROBOT.toml", help="write the two axes as a robot, too, with guesses to be identified"
    )
    parser.add_argument("--blocks", type=int, default=2, help="blocks of two experiments (default 2)")
    parser.add_argument("--seed", type=int, default=0)


def run(given) -> dict:
    from .._files import replacing
    from ..examples import example, example_robot
    from ..io import write

    check_target(given.output, SAVED)
    if given.robot_out:
        check_target(given.robot_out, (".toml",))
    data = example(blocks=given.blocks, seed=given.seed)
    write(given.output, data)
    if given.robot_out:
        with replacing(pathlib.Path(given.robot_out)) as draft:
            draft.write_text(example_robot(), encoding="utf-8")
    written = [given.output, *([given.robot_out] if given.robot_out else [])]
    suffix = pathlib.Path(given.output).suffix
    text = [
        f"two flexible axes in closed loop: {data.n_exp} experiments, {data.n_periods} steady periods of "
        f"{data.period / data.fs:g} s, {0 if data.lines is None else len(data.lines)} excited lines, seed {given.seed}",
        f"wrote {', '.join(written)}",
        f"next: jaxfrf estimate {given.output} -o frf{suffix} --report frf.html",
    ]
    if given.robot_out:
        text[-1] += f"; jaxfrf identify {given.output} --robot {given.robot_out} -o fit.json --report fit.html"
    summary = {"text": text, "output": given.output, "seed": given.seed, "experiments": data.n_exp}
    return summary | ({"robot": given.robot_out} if given.robot_out else {})
