"""The folder that a study is written to."""

import pathlib

from .._errors import output_error
from .._files import check_writable

_OURS = ("index.html", "study.json", "figure3.png", "figure4.png")


def prepared(folder: pathlib.Path) -> pathlib.Path:
    """The folder, made where it is not there yet; nothing in it is ever deleted.

    **Raises:** `jaxfrf.InputError` for a folder that holds something else than a study, and where nothing can be
    written.
    """
    if folder.exists() and not folder.is_dir():
        raise output_error(str(folder), "a file", "a folder, or nothing", "Choose another name (-o).")
    if folder.exists() and (others := [p.name for p in folder.iterdir() if p.name not in _OURS]):
        raise output_error(
            str(folder), f"a folder with other files ({others[0]})", "an empty one, or a study", "Choose another (-o)."
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(
            str(folder), f"a place that cannot be written ({error.strerror})", "one that can", "Choose another (-o)."
        ) from error
    check_writable(folder / "study.json")
    return folder
