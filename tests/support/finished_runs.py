"""Finished runs of the small experiment, made once for a whole run of the suite, and copied."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
from pathlib import Path

import pytest
from support import command_line

from bayesdrill.tasks import conclusions


def posterior(
    factory: pytest.TempPathFactory,
    place: Path,
    name: str,
    *changes: tuple[str, str],
    causes: bool = True,
) -> command_line.CommandResult:
    """Put config, record and results of `bayesdrill posterior` into `place`; return what it said.

    The results are in the folder `name`, the config in `name`.yaml.  The first worker that needs a
    config makes its run, while others wait; the run of another config is another one.  Without
    `causes` those of a bad fit are not ranked, which takes a minute.
    """
    text = command_line.small_config(place, *changes, name=f"{name}.yaml").read_bytes()
    shared = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:  # each worker has a folder of its own in that of all
        shared = shared.parent
    made = shared / "finished" / hashlib.sha256(text + bytes([causes])).hexdigest()[:16]
    made.mkdir(parents=True, exist_ok=True)
    with (made / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (made / "status").exists():
            config = command_line.small_config(made, *changes)
            with pytest.MonkeyPatch.context() as patch:
                if not causes:
                    patch.setattr(conclusions, "causes", lambda *_: None)
                ran = command_line.cli("posterior", config, "-o", made / "out", "--processes", "1")
            for part in ("out", "err"):
                (made / f"{part}.txt").write_text(getattr(ran, part), encoding="utf-8")
            (made / "status").write_text(str(ran.status))
    shutil.copytree(made / "out", place / name)
    out, err = (
        (made / f"{part}.txt").read_text("utf-8").replace(str(made / "out"), str(place / name))
        for part in ("out", "err")
    )
    return command_line.CommandResult(int((made / "status").read_text()), out, err)
