"""Where the real measurements are to be had that some tests need; none is part of this repository.

    python tests/data.py

prints every set, where its files come from, where they should lie under `JAXFRF_DATA`, and whether they are there.
"""

import dataclasses
import os
import pathlib
import sys
from urllib.parse import quote

KUKA = "data/recorded_trajectories/2020-10-21 10s FF {} 08ms/data.mat"


@dataclasses.dataclass(frozen=True)
class DataSet:
    """`name`: of its folder. `what`: it is, with its licence. `source`: who measured it. `files`: place in the folder,
    and in the repository at this commit."""

    name: str
    what: str
    source: str
    repository: str
    commit: str
    files: dict[str, str]

    def address(self, file: str) -> str:
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{quote(self.files[file])}"

    def missing(self, folder: pathlib.Path | None) -> list[str]:
        return [file for file in self.files if folder is None or not (folder / self.name / file).is_file()]


SETS = (
    DataSet(
        "emps",
        "electro-mechanical positioning system, 1 kHz; the files state no licence",
        "A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS, 2019; nonlinearbenchmark.org",
        "forgi86/sysid-neural-continuous",
        "956aa7ecd73061b0321c6f6098d74c9e4a7ce67a",
        {f"{name}.mat": f"examples/EMPS/data/{name}.mat" for name in ("DATA_EMPS", "DATA_EMPS_PULSES")},
    ),
    DataSet(
        "staubli_tx40",
        "six-axis arm on an exciting trajectory, 5 kHz; the files state no licence",
        "the example staubli_TX40 of FIGAROH (CNRS)",
        "thanhndv212/figaroh-examples",
        "c0b5c7f0fda10078be55104f9ee76ac106b7a5ee",
        {
            "curr_data.csv": "examples/staubli_TX40/data/curr_data.csv",
            "pos_read_data.csv": "examples/staubli_TX40/data/pos_read_data.csv",
            "tx40_mdh_modified.urdf": "examples/staubli_TX40/urdf/tx40_mdh_modified.urdf",
        },
    ),
    DataSet(
        "two_mass_bench",
        "motor, flexible coupling and load under multisines, 2.5 kHz; MIT",
        "T. Beauduin, W. Ohnishi, FdiTools, Hori-Fujimoto Lab, The University of Tokyo",
        "HoriFujimotoLab/FdiTools",
        "5925fae7e65f091b4111b1ba123e08dd869cb590",
        {f"MultisineType{kind}.mat": f"Examples/private/MultisineType{kind}.mat" for kind in "AB"},
    ),
    DataSet(
        "kuka_kr300",
        "six-axis arm with encoders behind the gears, 4 ms; MIT",
        "J. Weigand, J. Ulmen, A. Janot, M. Ruskowski, Robot Identification, 2021",
        "JonasWeigand/Robot_Identification",
        "9e403c07d9dadbb391a9f3921e8d219f714636a8",
        {f"2020-10-21_10s_FF_{run}_08ms/data.mat": KUKA.format(run) for run in "ABC"},
    ),
)


def lines(folder: pathlib.Path | None) -> list[str]:
    """What is said of every set, its files in this folder."""
    text = [f"JAXFRF_DATA is {'not set' if folder is None else folder}"]
    for one in SETS:
        missing = one.missing(folder)
        text += ["", f"{one.name}: {'missing' if missing else 'there'}", f"  {one.what}", f"  {one.source}"]
        for file in one.files:
            text += [f"  {one.name}/{file}{' (missing)' if file in missing else ''}", f"    {one.address(file)}"]
    return text


def main() -> int:
    """Exit code 1 where a file is missing."""
    named = os.environ.get("JAXFRF_DATA")
    folder = pathlib.Path(named) if named else None
    print("\n".join(lines(folder)))
    return int(any(one.missing(folder) for one in SETS))


if __name__ == "__main__":
    sys.exit(main())
