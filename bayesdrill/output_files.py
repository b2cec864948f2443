"""Write bayesdrill's files: exact names, atomic writes, JSON with checksums, and limits of size.

All code that replaces or removes files is in this module. It only touches files that a
`Kind` lists or a caller names, follows no links, and removes no folder that contains other files.
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

from bayesdrill.basics.errors import InputError, Issue, count_noun, encodable
from bayesdrill.basics.registry import Registry

RUN = "run.json"  # contains the name of the command that wrote the folder
LOCK = ".lock"
FIGURES = "figures"
PIECES = ".pieces"
REFITS = ".refits"
DRAWS = "draws"  # subfolder of a campaign, with the draws of each run
PAGES = "pages"  # subfolder of a campaign, with the pages of runs
RECOMMENDED = "recommended.yaml"  # config that a ladder recommends
RECORD = "record.csv"  # the record of a case that was built from arrays
CONFIG_FILE, RESOLVED_FILE = "config.yaml", "config.resolved.yaml"
CONFIGS = (CONFIG_FILE, RESOLVED_FILE)


MADE_ANEW = "make them anew with --force, or give another --output"


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of results lists the files that `bayesdrill <job>` writes; `#` stands for a number.

    The file `mark` identifies the folder; `nested` are folders of further runs; `continue_hint` is
    the advice if results already exist. No later run removes `kept_files`.
    """

    job: str
    files: tuple[str, ...]
    mark: str = RUN
    nested: tuple[str, ...] = ()
    continue_hint: str = "continue them with --resume, or start over with --force"
    kept_files: tuple[str, ...] = ()

    @property
    def folders(self) -> tuple[str, ...]:
        """Return the names of folders inside the run's folder."""
        return (*{name.split("/")[0]: None for name in self.files if "/" in name}, *self.nested)

    def is_output(self, name: str) -> bool:
        """Return whether a run of this kind writes a file of this name."""
        return _matches(name, (self.mark, *self.files, *self.kept_files))


def numbered[T](stem: str, items: Sequence[T]) -> dict[str, T]:
    """Return items by file stem: a single item has the plain stem, several items are numbered."""
    if len(items) == 1:
        return {stem: items[0]}
    return {f"{stem}_{k}": item for k, item in enumerate(items, start=1)}


FORMATS = ("pdf", "png", "svg")  # file formats of figures
DEFAULT_FORMATS = FORMATS[:2]


def figure_files(*stems: str, formats: Iterable[str] = DEFAULT_FORMATS) -> tuple[str, ...]:
    """Return the names of figures with these stems, in each format."""
    return tuple(f"{FIGURES}/{stem}.{end}" for stem in stems for end in formats)


def preferred_format(formats: Iterable[str]) -> str:
    """Return the format that HTML and Markdown pages show best."""
    return min(formats, key=("png", "svg", "pdf").index)


def formats_of(stem: str, asked: Sequence[str] | None, *, pdf: bool) -> tuple[str, ...]:
    """Return a figure's formats: `asked`, or else PNG (corner plots: also PDF); `pdf` adds PDF."""
    formats = asked or (DEFAULT_FORMATS if stem in CORNER_PLOTS else ("png",))
    return tuple(dict.fromkeys([*formats, *(["pdf"] if pdf else [])]))


UNFINISHED = Kind("posterior", (f"{PIECES}/ensemble_#_#.h5",))

# Files from which a report is made, in addition to the config with all defaults.
REPORT_SOURCES = Kind("posterior", ("chain.h5", "map.json", CONFIG_FILE, *UNFINISHED.files))


# Figures of a run; those of `ON_REQUEST` are drawn only if a config names them.
USUALLY_DRAWN = (
    "rig",  # if the config describes the rig
    *("corner", "invariants", "ridge", "trace", "prior_posterior", "friction", "torque"),
    "residuals",  # if residuals are more than noise, or if a config names the figure
    "fit",  # last, since predictions of many draws take time
)
ON_REQUEST = ("rank", "autocorrelation", "predictive_check", "frequency_response")
OWN_FIGURES = USUALLY_DRAWN + ON_REQUEST
CORNER_PLOTS = ("corner", "invariants")
# Figures that need no analysis, so they are drawn while a run is analysed.
FROM_DRAWS = ("rig", "corner", "trace", "prior_posterior")
# Figures that are drawn once for each experiment.
PER_EXPERIMENT = ("fit", "friction", "torque", "residuals", "frequency_response")
RUN_FIGURES: Registry[str] = Registry("figure", dict.fromkeys(OWN_FIGURES, ""))
# Files of older versions, which a report or --force removes.
_FIGURES_OF_ENERGY = figure_files("energy", "energy_#", formats=FORMATS)
OUTDATED = ("opened.npz", f"{PIECES}/ensemble_#_#.npz", *_FIGURES_OF_ENERGY)


POSTERIOR = Kind(
    "posterior",
    (
        *("chain.h5", "map.json", *CONFIGS, "posterior.nc", "summary.csv", "summary.md", *OUTDATED),
        *("derived.csv", "verdict.csv", "torque.csv", "table.tex", "report.html"),
        *figure_files(*RUN_FIGURES, *(f"{stem}_#" for stem in PER_EXPERIMENT), formats=FORMATS),
        *UNFINISHED.files,
    ),
    kept_files=(RECORD,),  # needed if a run starts over from the config in this folder
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
DESIGN = Kind(
    "design",
    ("waveform.csv", "coming.yaml", "design.csv", *figure_files("design", formats=FORMATS)),
    "design.md",
)


CAMPAIGN = Kind(
    "campaign",
    (
        *("campaign.yaml", "campaign.json", "reference.json", "population.csv", "runs.parquet"),
        *("summary.md", "report.html", f"{DRAWS}/#.parquet"),
        *(f"{PAGES}/#.html", f"{PAGES}/#.json"),
        *figure_files("runs", formats=FORMATS),
    ),
)
LADDER = Kind(  # models of one record, each with a posterior in its own folder
    "ladder",
    (*COMPARE.files, *CONFIGS, RECOMMENDED),
    nested=tuple(f"model_{k}" for k in range(1, 10)),
)


def output_names(folder: Path, kind: Kind) -> list[str]:
    """Return entries of `folder`, also links, named as files of this kind but not `kept_files`."""
    names = _names(folder, ("", *kind.folders))
    return [name for name in names if kind.is_output(name) and not _matches(name, kind.kept_files)]


def misplaced_paths(folder: Path, kind: Kind) -> list[Issue]:
    """Return an issue for each path of a run's file or folder that is something else."""
    files = dict.fromkeys((LOCK, *output_names(folder, kind)), ("a file", "which no run writes"))
    folders = dict.fromkeys(kind.folders, ("a folder", "where a run has a folder of its own"))
    return [
        Issue(str(folder / name), f"{actual}, {why}; move it, or give another --output")
        for name, (wanted, why) in (files | folders).items()
        if (actual := path_kind(folder / name)) not in ("", wanted)
    ]


def _files(folder: Path, kind: Kind) -> list[str]:
    """Return those `output_names` that are plain files."""
    return [name for name in output_names(folder, kind) if path_kind(folder / name) == "a file"]


def remove_outputs(folder: Path, kind: Kind) -> None:
    """Remove a run's files except its mark, then its folders if they are empty."""
    for name in {*_files(folder, kind)} - {kind.mark}:
        (folder / name).unlink()
    for name in kind.folders:
        if path_kind(folder / name) == "a folder":
            with suppress(OSError):  # it contains other files
                (folder / name).rmdir()


@contextmanager
def renewed(folder: Path, kind: Kind) -> Iterator[None]:
    """Remove a run's files; files that the block writes again get their former mode bits."""
    before = {name: (folder / name).lstat().st_mode for name in _files(folder, kind)}
    remove_outputs(folder, kind)
    try:
        yield
    finally:
        for name, mode in before.items():
            if path_kind(folder / name) == "a file":
                (folder / name).chmod(stat.S_IMODE(mode))


def clean_up(folder: Path, kind: Kind) -> None:
    """Remove temporary files of a killed run; the folder must be locked."""
    for name in _names(folder, ("", *kind.folders)):
        aside = re.fullmatch(r"((?:.*/)?)\.(.*)\.\d+\.aside(\.[^./]*)", name)  # see `atomic_write`
        if (
            aside
            and kind.is_output("".join(aside.groups()))
            and path_kind(folder / name) == "a file"
        ):
            (folder / name).unlink()


def digest(path: Path) -> str:
    """Return a digest of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path; after a success, this file replaces `path` and gets its mode bits."""
    refuse_other_than_file(path)
    # No two threads, of any processes, have the same number, so the name is unique.
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
    """Write a file from memory; libraries that write files themselves fail badly on a full disk."""
    with atomic_write(path) as aside:
        aside.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8."""
    write(path, encodable(text).encode())


def refuse_other_than_file(path: Path) -> None:
    """Raise `InputError` for links, folders, devices and pipes."""
    if (kind := path_kind(path)) not in ("", "a file"):
        message = f"{kind}, which is never replaced; give another --output"
        raise InputError.at(str(path), message)


def refuse_replacing(read: Iterable[Path], written: Iterable[Path]) -> None:
    """Raise `InputError` if a path of `written` is one of the files `read`, also through a link."""
    files = [path for path in read if path.is_file()]
    for path in written:
        if path.exists() and any(path.samefile(other) for other in files):
            message = "is read by this command, or named by its config, and is never replaced"
            raise InputError.at(str(path), f"{message}; give another --output")


def refuse_existing(path: Path, read: Iterable[Path] = (), *, force: bool) -> None:
    """Raise `InputError` if a file is one of those `read`, or exists while `force` is false."""
    refuse_replacing(read, [path])
    if path.exists() and not force:
        raise InputError.at(str(path), "exists already; give --force or another --output")
    if not path.parent.is_dir():
        raise InputError.at(str(path.parent), "this folder does not exist; make it first")
    refuse_unwritable(path.parent)


def refuse_unwritable(folder: Path, below: Iterable[str] = ()) -> None:
    """Raise `InputError` if no file can be made in `folder`, or in existing folders `below` it.

    The test writes a temporary file, since mode bits do not show read-only disks.
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


def refuse_other_text(folder: Path, kind: Kind, *, force: bool) -> None:
    """Raise `InputError` if text and figures of a kind would replace other files.

    With `force`, they may replace results whose text begins with `text_mark(kind)`.
    """
    refuse_unwritable(folder, kind.folders)
    if obstacles := misplaced_paths(folder, kind):
        raise InputError(obstacles)
    present, text = output_names(folder, kind), folder / kind.mark
    if present and not force:
        message = "exists already; give --force or another --output"
        raise InputError.at(str(folder / present[0]), message)
    if present and not (text.exists() and text.read_bytes().startswith(text_mark(kind).encode())):
        message = f"was not written by `bayesdrill {kind.job}`; give another --output"
        raise InputError.at(str(folder / present[0]), message)


def text_mark(kind: Kind) -> str:
    """Return the first line of the text in a folder of this kind, which identifies the folder."""
    return f"<!-- bayesdrill {kind.job} -->"


def refuse_endless(path: Path) -> None:
    """Raise `InputError` for devices and pipes, also behind links: opening them may never end."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # the file's reader reports a missing file or a NUL in the path
        return
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise InputError.at(str(path), "is a device or a pipe, which may have no end; give a file")


def path_kind(path: Path) -> str:
    """Return `a file`, `a folder` and so on; empty if nothing exists. Links are not followed."""
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
    """Return the entries of each subfolder in `below` that is no link; `""` stands for `folder`."""
    names = []
    for name in below:
        if path_kind(folder / name) == "a folder" or (not name and folder.is_dir()):
            names += [f"{name}/{entry}" if name else entry for entry in os.listdir(folder / name)]
    return sorted(names)


def _matches(name: str, patterns: Iterable[str]) -> bool:
    """Return whether a name matches one of the patterns, in which `#` stands for a number."""
    forms = (re.escape(pattern).replace(r"\#", r"\d+") for pattern in patterns)
    return any(re.fullmatch(form, name, re.ASCII) for form in forms)


LARGEST_FILE = 1_000_000_000  # bytes of a record, about fifty million numbers as text
LARGEST_GUESSED = 100_000_000  # bytes of a record that `init` reads, in at most half a minute
MOST_COLUMNS = 300  # columns of a record for `init`, which compares all pairs
MOST_SAMPLES = 20_000_000  # samples of a record
MOST_MEASURED = 50_000_000  # numbers of a record: samples times channels
MOST_GUESSED = 1_000_000  # samples that `init` reads
MOST_OF_CHAIN = 64_000_000  # numbers of a chain, half a gigabyte
LEAST_STEPS = 200  # steps for which a chain must have room
MOST_PREDICTED = 20_000_000  # predicted numbers (80 MB); the same number of log likelihoods is kept
LEAST_PREDICTED = 25  # predicted draws per ensemble; fewer draws do not resolve the tails


def check_file(path: Path, largest: int = LARGEST_FILE) -> None:
    """Raise `InputError` for devices, pipes and files above `largest` bytes; skip missing files."""
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
    """Raise `ValueError`, with a message for the user, if a record is too large."""
    if samples > MOST_SAMPLES or samples * channels > MOST_MEASURED:
        most = f"at most {MOST_SAMPLES} samples and {MOST_MEASURED} numbers are accepted"
        way_out = "resample to a lower rate, or shorten the record"
        raise ValueError(
            f"{samples:.6g} samples of {count_noun(channels, 'channel')}; {most}: {way_out}"
        )


def check_guessed(samples: int, columns: int) -> None:
    """Raise `ValueError`, with a message for the user, if a record is too large for `init`."""
    if samples > MOST_GUESSED or columns > MOST_COLUMNS:
        many = f"{samples} samples of {count_noun(columns, 'column')} are too many"
        most = f"`init` looks at {MOST_GUESSED} samples and {MOST_COLUMNS} columns at most"
        way_out = "Save only the columns of the rig, at a lower rate or for a shorter time"
        raise ValueError(f"{many}: {most}. {way_out}, or write a config by hand")


def check_chain(ensembles: int, walkers: int, unknowns: int) -> None:
    """Raise `ValueError`, with a message for the user, if a chain has no room for `LEAST_STEPS`."""
    if steps_of_chain(ensembles, walkers, unknowns) < LEAST_STEPS:
        size = f"{walkers} walkers with {count_noun(unknowns, 'unknown')}"
        many = f"{ensembles} ensembles of {size} are too many"
        most = f"{LEAST_STEPS} steps would be more than {MOST_OF_CHAIN} numbers"
        raise ValueError(f"{many}: {most}, the limit of a chain. Use fewer walkers or ensembles")


def steps_of_chain(ensembles: int, walkers: int, unknowns: int) -> int:
    """Return the largest number of steps of a chain."""
    return MOST_OF_CHAIN // (ensembles * walkers * unknowns)


def predictive_draws(n_draws: int, ensembles: int, numbers: int) -> int:
    """Return how many draws per ensemble are predicted, at most `n_draws`; 0 if memory is short."""
    room = MOST_PREDICTED // (ensembles * numbers)
    return n_draws if n_draws <= room else room if room >= LEAST_PREDICTED else 0


CHECKSUM = "checksum"


def dumps_checksummed(data: Mapping[str, Any]) -> str:
    """Return entries as JSON text, with their checksum as the last entry."""
    return json.dumps({**data, CHECKSUM: _checksum(data)}, indent=2) + "\n"


def loads_checksummed(content: bytes) -> dict[str, Any]:
    """Return entries dumped with a checksum; raises `ValueError` if the checksum does not match."""
    try:
        data = json.loads(content.decode("utf-8"))
        seal = data.pop(CHECKSUM, None) if isinstance(data, dict) else None
        if seal is None or seal != _checksum(data):
            raise ValueError("the checksum does not match")
    except RecursionError:
        raise ValueError("nested too deeply") from None
    return dict(data)


def _checksum(data: Mapping[str, Any]) -> str:
    # The data is read back first, so that tuples have become lists.
    text = json.dumps(json.loads(json.dumps(data)), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
