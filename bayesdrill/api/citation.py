"""How what was computed is cited."""

from __future__ import annotations

from pathlib import Path

from bayesdrill.basics import citation as citing
from bayesdrill.basics.checked import checked
from bayesdrill.basics.citation import Citation
from bayesdrill.basics.errors import InputError


@checked
def citation(folder: str | Path | None = None) -> Citation:
    """How to cite what is installed, or what the run in `folder` was made with.

    Raises `InputError` where no run is finished.
    """
    if folder is None:
        return citing.citation()
    from bayesdrill.results.run_folder import read_run

    place = Path(folder).expanduser()
    made_with = (read_run(place) or {}).get("versions")
    if not isinstance(made_with, dict):
        raise InputError.one(str(place), "no finished run is here; give the folder of one, or none")
    return citing.citation(made_with)
