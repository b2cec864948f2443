"""Write the folder of a run: atomic files, chain segments that survive a crash, and a lock."""

from __future__ import annotations

import dataclasses
import hashlib
import re
import shutil
import threading
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from filelock import FileLock, Timeout

from bayesdrill import output_files
from bayesdrill.basics.errors import InputError, Issue, count_noun, report_damage, shortened
from bayesdrill.basics.json_records import from_data
from bayesdrill.output_files import LOCK, PIECES, RUN, Kind, atomic_write
from bayesdrill.sampling.samplers.ensemble import ChainSegment, State

SEAL = "checksum"
AGAIN = "delete it and continue with --resume, which computes it again"
COMPUTED_AGAIN = f"is damaged; {AGAIN}"


def chain_mark(chains: Sequence[Sequence[ChainSegment]]) -> str:
    """Return a digest of a chain that does not depend on the lengths of its segments."""
    digest = hashlib.sha256()
    for chain in chains:
        digest.update(np.concatenate([piece.log_p for piece in chain]))
    return digest.hexdigest()


def _consistent(piece: ChainSegment) -> ChainSegment:
    """Return the segment; raises `ValueError` or `TypeError` if its shapes or numbers are wrong."""
    steps, walkers, unknowns = piece.z.shape
    np.random.RandomState().set_state(piece.state.random)
    for values, shape in (
        (piece.z, (steps, walkers, unknowns)),
        (piece.log_p, (steps, walkers)),
        (piece.accepted, (walkers,)),
    ):
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError("the segment has wrong shapes or values that are not finite")
    return piece


def chain_image(chains: list[list[ChainSegment]], attributes: Mapping[str, Any]) -> bytes:
    """Return the HDF5 file of a chain or segment as bytes, since HDF5 crashes on a full disk.

    Each ensemble is a group `ensemble_<k>` in the layout of `emcee.backends.HDFBackend`.
    """
    import h5py

    # HDF5 cannot open two files with one name, even in memory; the bytes do not contain the name.
    name = f"chain.{threading.get_native_id()}.h5"
    with h5py.File(name, "w", driver="core", backing_store=False) as file:
        for ensemble, parts in enumerate(chains):
            group = file.create_group(f"ensemble_{ensemble}")
            _write_ensemble(group, parts, attributes)
            seal(group)
        file.flush()
        return bytes(file.id.get_file_image())


def _write_ensemble(group: Any, parts: list[ChainSegment], attributes: Mapping[str, Any]) -> None:
    z = np.concatenate([part.z for part in parts])
    n_steps, n_walkers, n_dim = z.shape
    # Fletcher checksums protect these datasets when emcee reads them.
    group.create_dataset("chain", data=z, maxshape=(None, n_walkers, n_dim), fletcher32=True)
    log_p = np.concatenate([part.log_p for part in parts])
    group.create_dataset("log_prob", data=log_p, maxshape=(None, n_walkers), fletcher32=True)
    group.create_dataset("accepted", data=np.sum([part.accepted for part in parts], axis=0))
    summary = {"failures": sum(part.failures for part in parts), **attributes}
    layout = {
        "version": version("emcee"),
        "nwalkers": n_walkers,
        "ndim": n_dim,
        "has_blobs": False,
        "iteration": n_steps,
    }
    group.attrs.update({**layout, **summary})
    for index, value in enumerate(parts[-1].state.random):
        group.attrs[f"random_state_{index}"] = value


def seal(group: Any) -> None:
    """Add a checksum of all data and attributes to the group of an ensemble."""
    group.attrs[SEAL] = _checksum(_contents(group))


def _contents(group: Any) -> dict[str, Any]:
    """Return the datasets and attributes of a group, without the checksum."""
    values = {name: value for name, value in group.attrs.items() if name != SEAL}
    return values | {name: group[name][:] for name in group}


def _checksum(contents: Mapping[str, Any]) -> str:
    digest = hashlib.sha256()
    for name in sorted(contents):
        value = np.ascontiguousarray(contents[name])
        digest.update(f"{name} {value.dtype.str} {value.shape} ".encode())
        digest.update(value)
    return digest.hexdigest()


def read_chain(path: Path, ensemble: int) -> tuple[ChainSegment, str | None]:
    """Read an ensemble and the mark of its run (see `mark`); raises `InputError` if damaged."""
    import h5py

    with report_damage(str(path), COMPUTED_AGAIN):
        with h5py.File(path, "r") as file:
            group = file[f"ensemble_{ensemble}"]
            contents = _contents(group)
            if group.attrs[SEAL] != _checksum(contents):
                raise ValueError("the checksum does not fit")
        z, log_p = contents["chain"], contents["log_prob"]
        kind, keys, *numbers, cached = (contents[f"random_state_{k}"] for k in range(5))
        piece = ChainSegment(
            z=z,
            log_p=log_p,
            accepted=contents["accepted"],
            failures=int(contents["failures"]),
            state=State(z[-1], log_p[-1], (str(kind), keys, *map(int, numbers), cached)),
            seconds=1.0,
        )
        return _consistent(piece), contents.get("run")


# "report" adds nothing to the chain, and "read" writes nothing.
WriteMode = Literal["fresh", "resume", "force", "report", "read"]

CHAIN = "chain.h5"
VERSION_OF = "the version of "  # prefix of fingerprint entries that may differ in a new report
LONGEST = 120  # largest number of characters of a value in a message


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderEntries:
    """The `run.json` of every folder has these entries.

    job: the command that made the folder
    fingerprint: all values that determine the chain, by name
    status: running, interrupted or finished
    seed: the seed of all random numbers
    versions: of bayesdrill, Python and the libraries
    seconds: how long the parts of the run took [s]
    missing: tables and figures that could not be made, and why
    files: digests of all files that were written, by name
    checksum: of all other entries
    """

    job: str
    fingerprint: Mapping[str, str]
    status: str = ""
    seed: int | None = None
    versions: Mapping[str, str] = field(default_factory=dict)
    seconds: Mapping[str, float] | float = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    checksum: str = ""


def dump_record(record: Any, form: int, **others: Any) -> str:
    """Return checksummed JSON: the dataclass `record`, its format version `form`, and `others`."""
    fields = dataclasses.asdict(record)
    return output_files.dumps_checksummed({"form": form, **others, **fields})


def load_record[T](path: Path, kind: type[T], form: int) -> tuple[T, dict[str, Any]]:
    """Read a file of `dump_record`; raises `InputError` if damaged or of another format version."""
    why = COMPUTED_AGAIN
    try:
        data = output_files.loads_checksummed(path.read_bytes())
        if data.get("form", 1) != form:  # files of the first version have no number
            why = f"was written by another version of bayesdrill; {AGAIN}"
        return from_data(kind, data, strict=True), data
    except ValueError:
        raise InputError.at(str(path), why) from None


@dataclass(slots=True)
class Folder:
    """The folder of a run is locked while open; a resumed run must have the same `fingerprint`.

    In mode `read`, a folder without a lock file is not locked, since it may be write-protected.
    No result is changed before `begin`, so a refused run leaves all results unchanged.
    """

    path: Path
    mode: WriteMode
    fingerprint: Mapping[str, Any]
    kind: Kind
    _open: ExitStack = field(default_factory=ExitStack)
    _chains: dict[int, list[ChainSegment]] = field(default_factory=dict)

    def __enter__(self) -> Self:
        """Lock the folder; raises `InputError` if `check` does, or if another run writes to it."""
        self.check()
        reading = self.mode == "read"
        if not reading:
            self.path.mkdir(parents=True, exist_ok=True)
        elif not (self.path / LOCK).exists():
            return self
        lock = FileLock(self.path / LOCK)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            message = "another run is writing here; wait for it or give --output"
            raise InputError.at(str(self.path), message) from None
        except OSError:
            if not reading:
                raise
        else:
            self._open.callback(lock.release)
            try:
                self.check()  # again, as another run may have finished here in the meantime
            except InputError:
                self._open.close()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def check(self) -> None:
        """Raise `InputError` if the folder cannot be used in this mode, before any work is done.

        Results are not replaced or reused without a request, and foreign files are never touched.
        """
        if self.mode != "read":
            output_files.refuse_unwritable(self.path, self.kind.folders)
        if obstacles := output_files.misplaced_paths(self.path, self.kind):
            raise InputError(obstacles)
        run = read_run(self.path)
        if run is None:
            items = sorted(self.path.iterdir()) if self.path.is_dir() else []
            others = [item.name for item in items if not item.name.startswith(".")]
            others += output_files.output_names(self.path, self.kind)
            if RUN in others:  # another run has begun in the meantime
                self.check()
            elif others:
                message = f"this folder holds other files ({others[0]}); give another --output"
                raise InputError.at(str(self.path), message)
            return
        if run.get("job") != self.kind.job:
            message = f"these are results of `bayesdrill {run.get('job')}`; give another --output"
            raise InputError.at(str(self.path), message)
        if self.mode == "fresh":
            raise InputError.at(str(self.path), f"results exist already; {self.kind.continue_hint}")
        if self.mode != "force":
            self._refuse_changes(run.get("fingerprint", {}))

    def _refuse_changes(self, old: Mapping[str, Any]) -> None:
        """Raise `InputError` if the fingerprint has changed; versions matter only for resuming."""
        fingerprint, versions = self.fingerprint, self.mode == "resume"
        changes = [
            f"cannot resume: {name} was {_value(old, name)} and is {_value(fingerprint, name)}"
            for name in {**old, **fingerprint}
            if old.get(name) != fingerprint.get(name)
            and (versions or not name.startswith(VERSION_OF))
        ]
        if changes:
            way_out = "restore this, start over with --force, or give another --output"
            raise InputError([Issue(str(self.path), line) for line in (*changes, way_out)])

    def begin(self, **entries: Any) -> None:
        """Begin to write: with --force the files of an earlier run are removed first.

        `run.json` gets these `entries` and is never missing. Without it, the folder of a
        run that is killed now would seem to belong to another program.
        """
        output_files.clean_up(self.path, self.kind)
        if self.mode == "force":
            self._open.enter_context(output_files.renewed(self.path, self.kind))
            self._write_entries(entries)
        elif entries:
            self.write_run(**entries)

    @property
    def run(self) -> str:
        """Return the mark that identifies this run."""
        return mark(self.fingerprint)

    def refuse_foreign(self, name: str, run: str | None) -> None:
        """Raise `InputError` if the file `name`, which has the mark `run`, is of another run.

        Files of older versions have no mark; they are accepted if `run.json` has their digest.
        """
        path = self.path / name
        if run == self.run:
            return
        known = (read_run(self.path) or {}).get("files", {})
        if run is None and output_files.digest(path) == known.get(name):
            return
        whose = f"run {run}" if run else "an unknown run (an older version wrote it)"
        message = f"is of {whose}, not of run {self.run}; put back its own, or {AGAIN}"
        raise InputError.at(str(path), message)

    def path_of(self, name: str) -> Path:
        """Return the path of an output; raises `KeyError` if this kind of run does not have it."""
        if not self.kind.is_output(name):
            raise KeyError(name)
        return self.path / name

    def digests(self) -> dict[str, str]:
        """Return the digests of all finished files of this run, by name."""
        names = output_files.output_names(self.path, self.kind)
        return {n: output_files.digest(self.path / n) for n in names if n != self.kind.mark}

    def remove_stale(self, names: Collection[str]) -> None:
        """Remove the files `names`, which only an earlier report wrote."""
        for name in {*output_files.output_names(self.path, self.kind)} & {*names}:
            self.path_of(name).unlink()

    def write_text(self, name: str, text: str) -> None:
        """Write a text file of this run."""
        output_files.write_text(self.path_of(name), text)

    def take_over(self, name: str, other: Path) -> None:
        """Copy the file with this name from the folder `other`."""
        target = self.path_of(name)
        target.parent.mkdir(exist_ok=True)
        with atomic_write(target) as path:
            shutil.copyfile(other / name, path)

    def write_run(self, **entries: Any) -> None:
        """Update entries of `run.json`."""
        self._write_entries({**(read_run(self.path) or {}), **entries})

    def _write_entries(self, entries: Mapping[str, Any]) -> None:
        # The fingerprint keeps the versions that made the chain, even if others make the report.
        marks = {"job": self.kind.job, "fingerprint": dict(self.fingerprint)}
        self.write_text(RUN, output_files.dumps_checksummed({**marks, **entries}))

    @property
    def sampled(self) -> bool:
        """Return whether there is a chain, or a segment of one."""
        return bool(self._unfinished()) or (self.path / CHAIN).exists()

    def _unfinished(self) -> list[str]:
        """Return the names of files with segments that the chain does not contain yet."""
        return [
            n for n in output_files.output_names(self.path, output_files.UNFINISHED) if n != RUN
        ]

    def save(self, ensemble: int, first_step: int, piece: ChainSegment) -> None:
        """Save a segment in its own file, so that an interruption loses at most one segment."""
        (self.path / PIECES).mkdir(exist_ok=True)
        path = self.path_of(_piece_name(ensemble, first_step))
        output_files.write(path, chain_image([[piece]], {"run": self.run}))

    def read_ahead(self, ensembles: int, shape: tuple[int, int]) -> None:
        """Read all chains for `segments`, so that damage is found before any work is done.

        `shape` is (walkers, unknowns); raises `InputError` if a chain has another shape.
        """
        self._chains = {ensemble: self._read(ensemble) for ensemble in range(ensembles)}
        others = {p.z.shape[1:] for chain in self._chains.values() for p in chain} - {shape}
        for walkers, unknowns in others:
            chain = f"a chain of {walkers} walkers in {count_noun(unknowns, 'unknown')}"
            expected = f"this run has {shape[0]} in {shape[1]}"
            message = f"holds {chain}, and {expected}; put back its own, or start over with --force"
            raise InputError.at(str(self.path), message)

    def segments(self, ensemble: int) -> list[ChainSegment]:
        """Return the saved segments of an ensemble in order, the finished chain first."""
        return self._chains.pop(ensemble, None) or self._read(ensemble)

    def _read(self, ensemble: int) -> list[ChainSegment]:
        read_pieces: list[ChainSegment] = []

        def take(name: str, group: int) -> None:
            piece, run = read_chain(self.path / name, group)
            self.refuse_foreign(name, run)
            read_pieces.append(piece)

        if (self.path / CHAIN).exists():
            take(CHAIN, ensemble)
        for name in self._unfinished():
            have = sum(len(piece.z) for piece in read_pieces)
            if name == _piece_name(ensemble, have):  # files of other ensembles are skipped
                take(name, 0)
        return read_pieces

    def finish_chain(self, chains: list[list[ChainSegment]], attributes: Mapping[str, Any]) -> None:
        """Write `chain.h5` in emcee's layout, and remove the files of segments."""
        if not self._unfinished():
            return  # the chain is already complete
        output_files.write(
            self.path_of(CHAIN), chain_image(chains, {"run": self.run, **attributes})
        )
        output_files.remove_outputs(self.path, output_files.UNFINISHED)


def _piece_name(ensemble: int, first_step: int) -> str:
    return f"{PIECES}/ensemble_{ensemble}_{first_step:09d}.h5"


def mark(fingerprint: Mapping[str, Any]) -> str:
    """Return the mark of a run: 12 hex digits of the hash of its fingerprint without versions."""
    settings = sorted(
        (n, value) for n, value in fingerprint.items() if not n.startswith(VERSION_OF)
    )
    lines = [f"{name}: {value}" for name, value in settings]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:12]


def read_run(folder: Path) -> dict[str, Any] | None:
    """Read `run.json`; return None if it is missing, raise `InputError` if damaged or foreign."""
    path = folder / RUN
    if not output_files.path_kind(path):
        return None
    output_files.refuse_endless(path)
    try:
        entries = output_files.loads_checksummed(path.read_bytes())
        from_data(FolderEntries, entries, strict=True)
        return entries
    except ValueError:
        message = "is damaged, or not of this bayesdrill; put back a copy, or give another folder"
        raise InputError.at(str(path), message) from None


def _value(marks: Mapping[str, Any], name: str) -> str:
    if name.endswith("the kind of noise") and re.fullmatch("[0-9a-f]{12}", str(marks.get(name))):
        return f"written by an older version, as the digest {marks[name]},"
    return shortened(str(marks.get(name, "not there")), LONGEST)
