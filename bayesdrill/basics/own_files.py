"""What is ours to write, by exact name: the files of each kind of run, and what stands in their way.

Everything that replaces or removes a file goes through here, and touches nothing else: no file of
another name, nothing through a link, no folder that holds something of others.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import tempfile
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from bayesdrill.basics.errors import InputError, Problem, encodable
from bayesdrill.basics.registry import Registry

RUN = "run.json"  # says whose a folder is
LOCK = ".lock"
FIGURES = "figures"
PIECES = ".pieces"
REFITS = ".refits"
RECOMMENDED = "recommended.yaml"  # of a ladder
OPENED = "opened.npz"  # draws beyond ends of priors, where these are in the way
RECORD = "record.csv"  # of a case that was made without any file
CONFIG_FILE, RESOLVED_FILE = "config.yaml", "config.resolved.yaml"
CONFIGS = (CONFIG_FILE, RESOLVED_FILE)


@dataclass(frozen=True, slots=True)
class Kind:
    """What `bayesdrill <job>` writes into its folder; `#` stands for a number.

    `mark`: by this file, which is never taken away, the folder is known; `nested`: folders of runs
    of their own; `again`: what can be done where results exist; `kept`: what it writes once and no
    later run takes away.
    """

    job: str
    mark: str
    files: tuple[str, ...]
    nested: tuple[str, ...] = ()
    again: str = "continue them with --resume, or start over with --force"
    kept: tuple[str, ...] = ()

    @property
    def folders(self) -> tuple[str, ...]:
        return (*{name.split("/")[0]: None for name in self.files if "/" in name}, *self.nested)

    def made(self, name: str) -> bool:
        return _among(name, (self.mark, *self.files, *self.kept))


def numbered[T](stem: str, every: Sequence[T]) -> dict[str, T]:
    """By the stems of files: one keeps the name, several have numbers, as `#` in a `Kind` has it."""
    if len(every) == 1:
        return {stem: every[0]}
    return {f"{stem}_{k}": one for k, one in enumerate(every, start=1)}


FORMATS = ("pdf", "png", "svg")  # of figures
USUAL = FORMATS[:2]


def figures(*stems: str, formats: Iterable[str] = USUAL) -> tuple[str, ...]:
    return tuple(f"{FIGURES}/{stem}.{end}" for stem in stems for end in formats)


def shown(formats: Iterable[str]) -> str:
    """Of these, the one that a page can show best."""
    return min(formats, key=("png", "svg", "pdf").index)


UNFINISHED = Kind("posterior", RUN, (f"{PIECES}/ensemble_#_#.npz",))

# What a report is made from, beside the config with all defaults.
GROUND = Kind("posterior", RUN, ("chain.h5", "map.json", CONFIG_FILE, *UNFINISHED.files))


# Of a run, by name; `report.figures` says what each shows.  Those on request are drawn where a config
# names them.
ON_REQUEST = ("rank", "autocorrelation", "predictive_check")
RUN_FIGURES: Registry[None] = Registry(
    "figure",
    dict.fromkeys(
        (
            *(
                "corner",
                "invariants",
                "ridge",
                "trace",
                "prior_posterior",
                "friction",
                "energy",
                "torque",
                "fit",
            ),
            *ON_REQUEST,
        )
    ),
)


POSTERIOR = Kind(
    "posterior",
    RUN,
    (
        *("chain.h5", OPENED, "map.json", *CONFIGS, "posterior.nc", "summary.csv", "summary.md"),
        *("derived.csv", "verdict.csv", "torque.csv", "table.tex", "report.html"),
        *figures(*RUN_FIGURES, "fit_#", "friction_#", "energy_#", "torque_#", formats=FORMATS),
        *UNFINISHED.files,
    ),
    kept=(RECORD,),  # its config may be started over from this very folder
)
CALIBRATE = Kind(
    "calibrate",
    RUN,
    (
        *(*CONFIGS, "ranks.csv", "summary.md", "report.html"),
        *(*figures("calibration", formats=FORMATS), f"{REFITS}/#.json"),
    ),
)
OVERLAY = Kind(
    "report",
    RUN,
    ("overlay.csv", "overlay.md", "report.html", *figures("corner", "intervals")),
    again="make them anew with --force, or give another --output",
)
COMPARE = Kind(
    "compare",
    RUN,
    ("comparison.csv", "comparison.md", "report.html", *figures("comparison")),
    again="make them anew with --force, or give another --output",
)
MAP = Kind(
    "map",
    RUN,
    (
        *("map.json", "map.md", "map.csv", "report.html"),
        *("prediction.csv", "prediction_#.csv"),
        *CONFIGS,
        *figures("fit", "fit_#", formats=FORMATS),
    ),
    again="make them anew with --force, or give another --output",
    kept=(RECORD,),
)
IDENTIFY = Kind("identify", "identify.md", figures("spectrum", "profiles", formats=FORMATS))


def ladder(rungs: Sequence[str]) -> Kind:
    """Of models of one record, each of which has a posterior in a folder of its own."""
    return Kind(
        "ladder",
        RUN,
        (*COMPARE.files, *CONFIGS, RECOMMENDED),
        nested=tuple(rungs),
    )


def paper(records: Sequence[str]) -> Kind:
    """Of the studies of the paper; each of `records` has a posterior in a folder of its own."""
    tables = (
        *("table_1", "inconsistencies", "matrix", "integrator", "table_2", "implied", "lengths"),
        *("simultaneous", "control", "misfits", "shaft"),
        *(f"{stem}_{name}" for name in records for stem in ("table_3", "products", "verdict")),
    )
    drawn = (
        *("rig", "heuristic", "matrix", "table_2", "simultaneous", "convergence"),
        *(f"{stem}_{name}" for name in records for stem in ("fit", "table_3")),
    )
    return Kind(
        "paper",
        RUN,
        (
            *(f"{stem}.{end}" for stem in tables for end in ("csv", "md")),
            *("report.md", "report.html", *figures(*drawn)),
        ),
        nested=tuple(records),
        again="make them anew with --force, or give another --output",
    )


def present(folder: Path, kind: Kind) -> list[str]:
    """Files and folders in `folder` that bear a name of this kind, whatever they are."""
    names = _names(folder, ("", *kind.folders))
    return [name for name in names if kind.made(name) and not _among(name, kind.kept)]


def in_the_way(folder: Path, kind: Kind) -> list[Problem]:
    """Links, folders, devices and pipes where a run has its files, and files where its folders."""
    wrong = [
        Problem(
            str(folder / name), f"{found}, which no run writes; move it, or give another --output"
        )
        for name in (LOCK, *present(folder, kind))
        if (found := _no_file(folder / name))
    ]
    for name in kind.folders:
        found = what(folder / name)
        if found not in ("", "a folder"):
            message = (
                f"{found}, where a run has a folder of its own; move it, or give another --output"
            )
            wrong.append(Problem(str(folder / name), message))
    return wrong


def take_away(folder: Path, kind: Kind) -> None:
    """What such a run has written, all but its mark; then its folders, where nothing is left."""
    for name in present(folder, kind):
        if name != kind.mark and what(folder / name) == "a file":
            (folder / name).unlink()
    for name in kind.folders:
        if what(folder / name) == "a folder":
            with suppress(OSError):  # something of others is in it
                (folder / name).rmdir()


@contextmanager
def renewed(folder: Path, kind: Kind) -> Iterator[None]:
    """Takes away what such a run has written; what the block writes anew has the mode bits of before."""
    before = {
        name: (folder / name).lstat().st_mode
        for name in present(folder, kind)
        if what(folder / name) == "a file"
    }
    take_away(folder, kind)
    try:
        yield
    finally:
        for name, mode in before.items():
            if what(folder / name) == "a file":
                (folder / name).chmod(stat.S_IMODE(mode))


def tidy(folder: Path, kind: Kind) -> None:
    """What a run that was killed had begun to write; the folder must be locked."""
    for name in _names(folder, ("", *kind.folders)):
        if (of := _finished(name)) and kind.made(of) and what(folder / name) == "a file":
            (folder / name).unlink()


def digest(path: Path) -> str:
    """Of what a file holds."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A path to write to, renamed to `path` when the block ends well and removed otherwise.

    What it replaces hands its mode bits on.
    """
    refuse_other_than_file(path)
    # Of this thread, and so of this process too.
    aside = path.with_name(f".{path.stem}.{threading.get_native_id()}.aside{path.suffix}")
    try:
        yield aside
        with aside.open("rb") as file:
            os.fsync(file.fileno())
        if path.exists():
            shutil.copymode(path, aside)
        aside.replace(path)
    except OSError as error:
        error.filename = str(path)
        raise
    finally:
        aside.unlink(missing_ok=True)


def write(path: Path, content: bytes) -> None:
    """A whole file, made in memory: libraries that write themselves fall over where a disk fills up."""
    with whole(path) as aside:
        aside.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """A whole file in UTF-8."""
    write(path, encodable(text).encode())


def refuse_other_than_file(path: Path) -> None:
    """Raises `InputError` for links, folders, devices and pipes."""
    if found := _no_file(path):
        message = f"{found}, which is never replaced; give another --output"
        raise InputError.one(str(path), message)


def refuse_unwritable(folder: Path, below: Iterable[str] = ()) -> None:
    """Raises `InputError` where no file can be made in `folder`, or in those `below` that are there.

    It is tried, as mode bits do not know of read-only disks; nothing is left behind, and no folder made.
    """
    parents = (folder, *folder.absolute().parents)
    nearest = next(one for one in parents if os.path.lexists(one))
    for place in (nearest, *(folder / name for name in below if (folder / name).is_dir())):
        if not place.is_dir():
            raise InputError.one(str(folder), "a file is in the way; give another --output")
        try:
            with tempfile.TemporaryFile(dir=place):
                pass
        except OSError as error:
            message = f"nothing can be written here ({error.strerror}); give another --output"
            raise InputError.one(str(place), message) from None


def refuse_endless(path: Path) -> None:
    """Raises `InputError` for devices and pipes, also behind links: opening may never end."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # it is not there, or has a NUL in its path, as its reader says
        return
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise InputError.one(str(path), "is a device or a pipe, which may have no end; give a file")


def what(path: Path) -> str:
    """`a file`, `a folder`, ...; empty where there is nothing.  Links are not followed."""
    try:
        mode = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: a NUL in the name
        return ""
    if stat.S_ISREG(mode):
        return "a file"
    if stat.S_ISDIR(mode):
        return "a folder"
    return "a link" if stat.S_ISLNK(mode) else "a device or pipe"


def _names(folder: Path, below: Iterable[str]) -> list[str]:
    """What lies in `folder` and those `below` that are no links, as relative names."""
    found = []
    for name in below:
        if what(folder / name) == "a folder" or (not name and folder.is_dir()):
            found += [f"{name}/{one}" if name else one for one in os.listdir(folder / name)]
    return sorted(found)


def _among(name: str, patterns: Iterable[str]) -> bool:
    return any(_pattern(one).fullmatch(name) for one in patterns)


def _finished(name: str) -> str:
    """The file that something left aside by `whole` was to become."""
    match = re.fullmatch(r"((?:.*/)?)\.(.*)\.\d+\.aside(\.[^./]*)", name)
    return "".join(match.groups()) if match else ""


def _pattern(name: str) -> re.Pattern[str]:
    return re.compile(re.escape(name).replace(r"\#", r"\d+"), re.ASCII)


def _no_file(path: Path) -> str:
    """What `path` is, unless it is a file or nothing."""
    found = what(path)
    return "" if found == "a file" else found
