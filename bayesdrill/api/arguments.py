"""What comes in from a notebook, judged before it goes on: every mistake by its name; and what jobs of
many fits may be told.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.entries import entries_of
from bayesdrill.basics.errors import InputError, Issue, did_you_mean, shown
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.registry import lookup
from bayesdrill.basics.values import Value, checked
from bayesdrill.config.job import Job
from bayesdrill.record.experiment import check_time, raise_if_any
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model
from bayesdrill.sampling.workers import available_processors

if TYPE_CHECKING:
    from bayesdrill.results.run_folder import Mode
    from bayesdrill.tasks.remote import RefitExecutor


MOST_PROCESSES = 256  # of which each takes the memory of an interpreter with all libraries


def series(place: str, values: Any, found: list[Issue]) -> Array:
    """`(T,)` numbers; what a mask hides is NaN.  Of anything else a problem is `found`."""
    try:
        masked = np.ma.getmaskarray(values) if isinstance(values, np.ma.MaskedArray) else None
        raw = np.asarray(values)
    except Exception:  # lists of different lengths, and whatever arrays of others raise
        raw, masked = np.array(None), None
    if raw.ndim == 2 and 1 in raw.shape:
        raw = raw.reshape(-1)
    if raw.dtype.kind in "mM":
        found.append(Issue(place, "these are dates or durations; give seconds, as numbers"))
    elif raw.dtype.kind not in "iufbO" or (raw.dtype.kind == "O" and raw.ndim == 0):
        kind = type(values).__name__ if raw.ndim == 0 else raw.dtype
        found.append(Issue(place, f"wanted is an array of numbers, not {kind}"))
    elif raw.ndim != 1:
        found.append(Issue(place, f"wanted is one row of numbers, not the shape {raw.shape}"))
    else:
        try:
            numbers = raw.astype(np.float64)
        except (TypeError, ValueError, OverflowError):
            found.append(Issue(place, "not all of these are numbers"))
        else:
            return numbers if masked is None else np.where(masked.reshape(-1), np.nan, numbers)
    return np.zeros(0)


def rig(value: Any) -> Model:
    """A model, or that of its name as it is by default."""
    kinds = tuple(MODELS.usable().values())
    if isinstance(value, kinds):
        _check_constants(value)
        _check_added(value)
        return value
    if isinstance(value, str):
        return known(MODELS, value, "rig", "model")()
    raise InputError.one(
        "rig", f"give a name ({', '.join(MODELS)}) or a model, such as MotorShaft()"
    )


def _check_constants(rig: Model) -> None:
    found = []
    for name, kind in entries_of(type(rig)).items():
        value = getattr(rig, name)
        plain = value.item() if getattr(value, "shape", None) == () else value
        try:
            TypeAdapter(kind).validate_python(plain, strict=True)
        except ValidationError as error:
            why = error.errors()[0]["msg"].removeprefix("Value error, ")
            found.append(Issue(f"rig.{name}", f"{shown(value)} cannot be this: {why}"))
    raise_if_any(found)


def _check_added(rig: Model) -> None:
    added = rig.added
    if not isinstance(added, tuple):
        raise InputError.one("rig.added", f"give a tuple of names, not {type(added).__name__}")
    for name in added:
        if name not in tuple(rig.offers):
            hint = did_you_mean(str(name), rig.offers)
            raise InputError.one("rig.added", f"{rig.name} has no {name!r} to add{hint}")


def known[T](registry: Mapping[str, T], name: Any, place: str, what: str) -> T:
    try:
        return lookup(registry, str(name), what)
    except ValueError as error:
        raise InputError.one(place, str(error)) from None


def whole(place: str, value: int, least: int) -> int:
    """Of 64 bits at most."""
    if not least <= value < 2**64:
        message = f"{shown(value)} is no whole number from {least} to 2**64 - 1"
        raise InputError.one(place, message)
    return int(value)


def mode(*, resume: bool, force: bool) -> Mode:
    if resume and force:
        raise InputError.one("", "--resume and --force exclude each other; give one of them")
    return "resume" if resume else "force" if force else "fresh"


def results_folder(folder: str | Path | None, usual: Path) -> Path:
    """The `usual` one where none is given."""
    return usual if folder is None else Path(folder).expanduser()


def workers(processes: int | None) -> int:
    """None: as many as there are processors."""
    if processes is None:
        return available_processors()
    found = whole("processes", processes, 1)
    if found > MOST_PROCESSES:
        raise InputError.one("processes", f"{found} are more than {MOST_PROCESSES}; give fewer")
    return found


@contextmanager
def crew(processes: Any, scheduler: str | None) -> Iterator[RefitExecutor]:
    """`processes` of this machine, see `workers`; or those of the Dask cluster of a scheduler."""
    from bayesdrill.tasks import remote

    if scheduler is None:
        with remote.local_executor(workers(processes)) as found:
            yield found
    else:
        with remote.dask_executor(scheduler) as found:
            yield found


def is_series(value: Any) -> bool:
    """Whether these are several numbers, or none at all."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return hasattr(value, "__len__") and not isinstance(value, str)


def number(place: str, value: Any, found: list[Issue], *, positive: bool = False) -> float:
    try:
        read = float(value) if not isinstance(value, str | bool | np.bool) else float("nan")
    except (TypeError, ValueError, OverflowError):
        read = float("nan")
    if not np.isfinite(read) or (positive and not read > 0):
        wanted = "a positive number" if positive else "a number"
        found.append(Issue(place, f"{shown(value)} is not {wanted}"))
    return read


def times(t: Any, found: list[Issue]) -> Array:
    """In s, increasing."""
    values = series("t", t, found)
    if not found and len(values) < 2:
        found.append(Issue("t", f"{len(values)} times; give at least two"))
    if not found:
        found += check_time("t", values, lambda index: f"sample {index + 1}")
    return values


@checked
@dataclass(frozen=True, slots=True, eq=False)
class ManyFits[T](Value):
    """`kind`: ends the name of its folder."""

    job: Job

    kind: ClassVar[str]

    def place(self, folder: str | Path | None = None) -> Path:
        """Where `run` leaves its results: `results/<name>-ladder` or `results/<name>-calibration` by
        default.
        """
        usual = Path("results") / f"{self.job.config.name}-{self.kind}"
        return results_folder(folder, usual)

    def run(
        self,
        folder: str | Path | None = None,
        *,
        resume: bool = False,
        force: bool = False,
        processes: int | None = 1,
        scheduler: str | None = None,
        report: Reporter | None = None,
    ) -> T:
        """`folder`: see `place`; `scheduler`: address of a Dask cluster; `processes`, `report`: see
        `Case.sample`.

        Raises `InputError`, and `Interrupted` when asked to stop; what is done is kept.
        """
        how, place = mode(resume=resume, force=force), self.place(folder)
        with crew(processes, scheduler) as executor:
            return self._run(place, how, executor, report or SILENT)

    @abstractmethod
    def _run(self, place: Path, how: Mode, executor: RefitExecutor, report: Reporter) -> T:
        """Do the job."""
