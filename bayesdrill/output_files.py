"""The files that bayesdrill writes: exact names, atomic writes, checksummed JSON, limits of size.

Everything that replaces or removes a file goes through here, and touches nothing else: no file of
another name, nothing through a link, no folder that holds something of others.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import stat
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesdrill.basics.errors import InputError, Issue, encodable
from bayesdrill.basics.registry import Registry

RUN = "run.json"  # says whose a folder is
LOCK = ".lock"
FIGURES = "figures"
PIECES = ".pieces"
REFITS = ".refits"
RECOMMENDED = "recommended.yaml"  # of a ladder
RECORD = "record.csv"  # of a case that was made without any file
CONFIG_FILE, RESOLVED_FILE = "config.yaml", "config.resolved.yaml"
CONFIGS = (CONFIG_FILE, RESOLVED_FILE)


MADE_ANEW = "make them anew with --force, or give another --output"


@dataclass(frozen=True, slots=True)
class Kind:
    """What `bayesdrill <job>` writes into its folder; `#` stands for a number.

    `mark`: by this file, which is never taken away, the folder is known; `nested`: folders of runs
    of their own; `continue_hint`: what can be done where results exist; `kept_files`: what it writes
    once and no later run takes away.
    """

    job: str
    files: tuple[str, ...]
    mark: str = RUN
    nested: tuple[str, ...] = ()
    continue_hint: str = "continue them with --resume, or start over with --force"
    kept_files: tuple[str, ...] = ()

    @property
    def folders(self) -> tuple[str, ...]:
        """The folders below the one of the run."""
        return (*{name.split("/")[0]: None for name in self.files if "/" in name}, *self.nested)

    def is_output(self, name: str) -> bool:
        """Whether such a run writes a file of this name."""
        return _matches(name, (self.mark, *self.files, *self.kept_files))


def numbered[T](stem: str, items: Sequence[T]) -> dict[str, T]:
    """By the stems of files: one keeps the name, several have numbers, as `#` in a `Kind` has it."""
    if len(items) == 1:
        return {stem: items[0]}
    return {f"{stem}_{k}": item for k, item in enumerate(items, start=1)}


FORMATS = ("pdf", "png", "svg")  # of figures
DEFAULT_FORMATS = FORMATS[:2]


def figure_files(*stems: str, formats: Iterable[str] = DEFAULT_FORMATS) -> tuple[str, ...]:
    """Return the names of figures with these stems, in each format."""
    return tuple(f"{FIGURES}/{stem}.{end}" for stem in stems for end in formats)


def shown_path(formats: Iterable[str]) -> str:
    """Of these, the one that a page can show best."""
    return min(formats, key=("png", "svg", "pdf").index)


def formats_of(stem: str, asked: Sequence[str] | None, *, pdf: bool) -> tuple[str, ...]:
    """Return the formats of a figure of a run: those `asked` for, or PNG, and PDF of corner plots.

    `pdf`: whether all figures are written as PDF too.
    """
    formats = asked or (DEFAULT_FORMATS if stem in CORNER_PLOTS else ("png",))
    return tuple(dict.fromkeys([*formats, *(["pdf"] if pdf else [])]))


UNFINISHED = Kind("posterior", (f"{PIECES}/ensemble_#_#.npz",))

# What a report is made from, beside the config with all defaults.
GROUND = Kind("posterior", ("chain.h5", "map.json", CONFIG_FILE, *UNFINISHED.files))


# Figures of a run; those on request are drawn where a config names them.
USUALLY_DRAWN = (
    "rig",  # where the config describes it
    *("corner", "invariants", "ridge", "trace", "prior_posterior", "friction", "torque"),
    "residuals",  # where more than noise is left, or by name
    "fit",  # last: its draws take a while
)
ON_REQUEST = ("rank", "autocorrelation", "predictive_check", "frequency_response")
OWN_FIGURES = USUALLY_DRAWN + ON_REQUEST
CORNER_PLOTS = ("corner", "invariants")
# Those of draws alone, which are drawn while the analysis of a run looks at its draws.
OF_DRAWS = ("rig", "corner", "trace", "prior_posterior")
# Those of which each of several experiments has one.
EACH = ("fit", "friction", "torque", "residuals", "frequency_response")
RUN_FIGURES: Registry[str] = Registry("figure", dict.fromkeys(OWN_FIGURES, ""))
# Files of older versions, which a report or --force takes away.
OUTDATED = ("opened.npz", *figure_files("energy", "energy_#", formats=FORMATS))


POSTERIOR = Kind(
    "posterior",
    (
        *("chain.h5", "map.json", *CONFIGS, "posterior.nc", "summary.csv", "summary.md", *OUTDATED),
        *("derived.csv", "verdict.csv", "torque.csv", "table.tex", "report.html"),
        *figure_files(*RUN_FIGURES, *(f"{stem}_#" for stem in EACH), formats=FORMATS),
        *UNFINISHED.files,
    ),
    kept_files=(RECORD,),  # its config may be started over from this very folder
)
CALIBRATE = Kind(
    "calibrate",
    (
        *(*CONFIGS, "ranks.csv", "summary.md", "report.html"),
        *(*figure_files("calibration", formats=FORMATS), f"{REFITS}/#.json"),
    ),
)
OVERLAY = Kind(
    "report",
    ("overlay.csv", "overlay.md", "report.html", *figure_files("corner", "intervals")),
    continue_hint=MADE_ANEW,
)
COMPARE = Kind(
    "compare",
    ("comparison.csv", "comparison.md", "report.html", *figure_files("comparison")),
    continue_hint=MADE_ANEW,
)
MAP = Kind(
    "map",
    (
        *("map.json", "map.md", "map.csv", "report.html"),
        *("prediction.csv", "prediction_#.csv"),
        *CONFIGS,
        *figure_files("fit", "fit_#", formats=FORMATS),
    ),
    continue_hint=MADE_ANEW,
    kept_files=(RECORD,),
)
IDENTIFY = Kind("identify", figure_files("spectrum", "profiles", formats=FORMATS), "identify.md")


LADDER = Kind(  # models of one record, each of which has a posterior in a folder of its own
    "ladder",
    (*COMPARE.files, *CONFIGS, RECOMMENDED),
    nested=tuple(f"model_{k}" for k in range(1, 10)),
)


def present(folder: Path, kind: Kind) -> list[str]:
    """Files and folders in `folder` that bear a name of this kind, whatever they are."""
    names = _names(folder, ("", *kind.folders))
    return [name for name in names if kind.is_output(name) and not _matches(name, kind.kept_files)]


def existing_outputs(folder: Path, kind: Kind) -> list[Issue]:
    """Links, folders, devices and pipes where a run has its files, and files where its folders."""
    files = dict.fromkeys((LOCK, *present(folder, kind)), ("a file", "which no run writes"))
    folders = dict.fromkeys(kind.folders, ("a folder", "where a run has a folder of its own"))
    return [
        Issue(str(folder / name), f"{there}, {why}; move it, or give another --output")
        for name, (wanted, why) in (files | folders).items()
        if (there := what(folder / name)) not in ("", wanted)
    ]


def _files(folder: Path, kind: Kind) -> list[str]:
    """As `present`, but no folders, links, devices and pipes."""
    return [name for name in present(folder, kind) if what(folder / name) == "a file"]


def remove_outputs(folder: Path, kind: Kind) -> None:
    """What such a run has written, all but its mark; then its folders, where nothing is left."""
    for name in {*_files(folder, kind)} - {kind.mark}:
        (folder / name).unlink()
    for name in kind.folders:
        if what(folder / name) == "a folder":
            with suppress(OSError):  # something of others is in it
                (folder / name).rmdir()


@contextmanager
def renewed(folder: Path, kind: Kind) -> Iterator[None]:
    """Takes away what such a run has written; what the block writes anew has the mode bits of before."""
    before = {name: (folder / name).lstat().st_mode for name in _files(folder, kind)}
    remove_outputs(folder, kind)
    try:
        yield
    finally:
        for name, mode in before.items():
            if what(folder / name) == "a file":
                (folder / name).chmod(stat.S_IMODE(mode))


def clean_up(folder: Path, kind: Kind) -> None:
    """What a run that was killed had begun to write; the folder must be locked."""
    for name in _names(folder, ("", *kind.folders)):
        aside = re.fullmatch(r"((?:.*/)?)\.(.*)\.\d+\.aside(\.[^./]*)", name)  # see `atomic_write`
        if aside and kind.is_output("".join(aside.groups())) and what(folder / name) == "a file":
            (folder / name).unlink()


def digest(path: Path) -> str:
    """Of what a file holds."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A path that replaces `path`, with its mode bits, when the block ends well; else it is removed."""
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
    with atomic_write(path) as aside:
        aside.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """A whole file in UTF-8."""
    write(path, encodable(text).encode())


def refuse_other_than_file(path: Path) -> None:
    """Raises `InputError` for links, folders, devices and pipes."""
    if (kind := what(path)) not in ("", "a file"):
        message = f"{kind}, which is never replaced; give another --output"
        raise InputError.at(str(path), message)


def refuse_replacing(read: Iterable[Path], written: Iterable[Path]) -> None:
    """Raises `InputError` where a command would replace a file that it reads, by whatever name."""
    there = [path for path in read if path.is_file()]
    for path in written:
        if path.exists() and any(path.samefile(other) for other in there):
            message = "is read by this command, or named by its config, and never replaced"
            raise InputError.at(str(path), f"{message}; give another --output")


def refuse_existing(path: Path, read: Iterable[Path] = (), *, force: bool) -> None:
    """Raises `InputError` where a file is, unless by `force`, and of those `read` anyway."""
    refuse_replacing(read, [path])
    if path.exists() and not force:
        raise InputError.at(str(path), "exists already; give --force or another --output")
    if not path.parent.is_dir():
        raise InputError.at(str(path.parent), "this folder does not exist; make it first")
    refuse_unwritable(path.parent)


def refuse_unwritable(folder: Path, below: Iterable[str] = ()) -> None:
    """Raises `InputError` where no file can be made in `folder`, or in those `below` that are there.

    It is tried, as mode bits do not know of read-only disks; nothing is left behind, and no folder made.
    """
    parents = (folder, *folder.absolute().parents)
    nearest = next(parent for parent in parents if os.path.lexists(parent))
    for path in (nearest, *(folder / name for name in below if (folder / name).is_dir())):
        if not path.is_dir():
            raise InputError.at(str(folder), "a file is in the way; give another --output")
        try:
            with tempfile.TemporaryFile(dir=path):
                pass
        except OSError as error:
            message = f"nothing can be written here ({error.strerror}); give another --output"
            raise InputError.at(str(path), message) from None


def refuse_endless(path: Path) -> None:
    """Raises `InputError` for devices and pipes, also behind links: opening may never end."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # it is not there, or has a NUL in its path, as its reader says
        return
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise InputError.at(str(path), "is a device or a pipe, which may have no end; give a file")


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
    names = []
    for name in below:
        if what(folder / name) == "a folder" or (not name and folder.is_dir()):
            names += [f"{name}/{entry}" if name else entry for entry in os.listdir(folder / name)]
    return sorted(names)


def _matches(name: str, patterns: Iterable[str]) -> bool:
    """Whether it is one of these, in which `#` stands for a number."""
    forms = (re.escape(pattern).replace(r"\#", r"\d+") for pattern in patterns)
    return any(re.fullmatch(form, name, re.ASCII) for form in forms)


LARGEST_FILE = 1_000_000_000  # bytes of a record: fifty million numbers as text are about as many
LARGEST_GUESSED = 100_000_000  # bytes of one that `init` looks at, for up to half a minute
MOST_COLUMNS = 300  # each of which `init` may hold against each other
MOST_SAMPLES = 20_000_000
MOST_MEASURED = 50_000_000  # numbers of a record: samples times channels
MOST_GUESSED = 1_000_000  # samples that `init` looks at
MOST_OF_CHAIN = 64_000_000  # numbers of a chain, half a gigabyte
LEAST_STEPS = 200  # that a chain must have room for
MOST_PREDICTED = 20_000_000  # numbers, 80 MB; as many log likelihoods go with them
LEAST_PREDICTED = 25  # draws of each ensemble: of tails, fewer tell their extremes alone


def check_file(path: Path, largest: int = LARGEST_FILE) -> None:
    """Raises `InputError` beyond `largest` bytes or without an end; a missing one is for its reader."""
    refuse_endless(path)
    try:
        size = path.stat().st_size
    except (OSError, ValueError):
        return
    if size > largest:
        most = f"has {size / 1e6:.0f} MB; at most {largest / 1e6:.0f} MB are read"
        way_out = "resample to a lower rate, shorten the record, or save fewer variables"
        raise InputError.at(str(path), f"{most}: {way_out}")


def check_record(samples: float, channels: int) -> None:
    """Raises `ValueError` with a message for the user."""
    if samples > MOST_SAMPLES or samples * channels > MOST_MEASURED:
        most = f"at most {MOST_SAMPLES} samples and {MOST_MEASURED} numbers are taken"
        way_out = "resample to a lower rate, or shorten the record"
        raise ValueError(f"{samples:.6g} samples of {channels} channels; {most}: {way_out}")


def check_guessed(samples: int, columns: int) -> None:
    """Raises `ValueError` with a message for the user."""
    if samples > MOST_GUESSED or columns > MOST_COLUMNS:
        many = f"{samples} samples of {columns} columns are too many"
        most = f"`init` looks at {MOST_GUESSED} samples and {MOST_COLUMNS} columns at most"
        way_out = "Save the columns of the rig alone, at a lower rate or for a shorter time"
        raise ValueError(f"{many}: {most}. {way_out}, or write a config by hand")


def check_chain(ensembles: int, walkers: int, unknowns: int) -> None:
    """Raises `ValueError` with a message for the user."""
    if steps_of_chain(ensembles, walkers, unknowns) < LEAST_STEPS:
        many = f"{ensembles} ensembles of {walkers} walkers with {unknowns} unknowns are too many"
        most = f"{LEAST_STEPS} steps would be more than {MOST_OF_CHAIN} numbers"
        raise ValueError(f"{many}: {most}, all that a chain may hold. Take fewer")


def steps_of_chain(ensembles: int, walkers: int, unknowns: int) -> int:
    """As many as a chain may have."""
    return MOST_OF_CHAIN // (ensembles * walkers * unknowns)


def predictive_draws(wanted: int, ensembles: int, numbers: int) -> int:
    """Of each ensemble: `wanted`, or as many as there is room for; none where those would be few."""
    room = MOST_PREDICTED // (ensembles * numbers)
    return wanted if wanted <= room else room if room >= LEAST_PREDICTED else 0


SEAL = "checksum"


def dumps_checksummed(data: Mapping[str, Any]) -> str:
    """As text, with a checksum of all entries as the last of them."""
    return json.dumps({**data, SEAL: _checksum(data)}, indent=2) + "\n"


def loads_checksummed(content: bytes) -> dict[str, Any]:
    """The entries of what `sealed` gave; raises `ValueError` where they are not the same."""
    try:
        data = json.loads(content.decode("utf-8"))
        seal = data.pop(SEAL, None) if isinstance(data, dict) else None
        if seal is None or seal != _checksum(data):
            raise ValueError("the checksum does not fit")
    except RecursionError:
        raise ValueError("nested too deep") from None
    return dict(data)


def _checksum(data: Mapping[str, Any]) -> str:
    # Over the text that reading and writing again gives: tuples have become lists by then.
    text = json.dumps(json.loads(json.dumps(data)), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
