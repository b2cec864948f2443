"""The results folder: files appear whole, pieces of chain outlive a crash, one run at a time."""

from __future__ import annotations

import json
import os
import shutil
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from filelock import FileLock, Timeout

from bayesdrill.errors import InputError, Problem
from bayesdrill.samplers.ensemble import Piece, State

Mode = Literal["fresh", "resume", "force", "report"]  # report: nothing is added to the chain

PIECES = ".pieces"
CHAIN = "chain.h5"
RUN = "run.json"
VERSION_OF = "the version of "  # begins the names of fingerprints that a report may differ in
LONGEST = 120  # letters of a value in a message
OWN = (
    CHAIN,
    f"{PIECES}/*.npz",
    "map.json",
    "config.yaml",
    "config.resolved.yaml",
    "posterior.nc",
    "summary.*",
    "derived.csv",
    "verdict.csv",
    "figures/corner.*",
    "figures/trace.*",
    "figures/fit.*",
    "figures/prior_posterior.*",
    "figures/ridge.*",
    "figures/invariants.*",
    RUN,
)  # what a run writes; last the file that says whose it is

# What NumPy, zipfile and HDF5 raise when bytes of a file are not what they were.
DAMAGED = (
    *(OSError, ValueError, KeyError, IndexError, TypeError, EOFError, RuntimeError, MemoryError),
    *(AttributeError, OverflowError, NotImplementedError, SyntaxError, struct.error),
    *(zipfile.BadZipFile, zlib.error),
)


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A path to write to, renamed to `path` when the block ends well and removed otherwise."""
    aside = path.with_name(f".{path.stem}.{os.getpid()}.aside{path.suffix}")
    try:
        yield aside
        with aside.open("rb") as file:
            os.fsync(file.fileno())
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


@dataclass(slots=True)
class Folder:
    """`results/<name>`, locked while open. `fingerprint`: what a resumed run must share.

    `own`: patterns of what the work here writes, and so what --force may take away.
    """

    path: Path
    mode: Mode
    fingerprint: Mapping[str, Any]
    own: Sequence[str] = OWN
    _lock: FileLock | None = None

    def __enter__(self) -> Self:
        """Raises `InputError` when results are in the way, differ, or are being written."""
        self._refuse()
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            message = "a file is in the way; give another --output"
            raise InputError.one(str(self.path), message) from None
        lock = FileLock(self.path / ".lock")
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise InputError.one(
                str(self.path), "another run is writing here; wait for it or give --output"
            ) from None
        self._lock = lock
        for left in self.path.rglob(".*.aside.*"):  # by a run that was killed while it wrote
            left.unlink()
        if self.mode == "force":
            self._clear()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._lock is not None:
            self._lock.release()

    def _refuse(self) -> None:
        """Results are neither overwritten nor reused unasked; a folder of others is left alone."""
        if not (self.path / RUN).exists():
            others = [p.name for p in self._items() if not p.name.startswith(".")]
            if others:
                message = f"this folder holds other files ({others[0]}); give another --output"
                raise InputError.one(str(self.path), message)
            return
        if self.mode == "fresh":
            raise InputError.one(
                str(self.path),
                "results exist already; continue them with --resume, or start over with --force",
            )
        if self.mode in ("resume", "report"):
            old = (read_run(self.path) or {}).get("fingerprint", {})
            changes = _changes(old, self.fingerprint, versions=self.mode == "resume")
            if changes:
                way_out = "put this back, start over with --force, or give another --output"
                told = [*(f"cannot resume: {change}" for change in changes), way_out]
                raise InputError([Problem(str(self.path), line) for line in told])

    def _items(self) -> list[Path]:
        return sorted(self.path.iterdir()) if self.path.is_dir() else []

    def _clear(self) -> None:
        """Take away what a run has written, and nothing else.

        `run.json` is replaced and never missing: without it the rest would be taken for a folder
        of others by the next run, were this one killed here.
        """
        for item in (path for name in self.own if name != RUN for path in self.path.glob(name)):
            item.unlink()
        for folder in {self.path / name for name in self.own if "/" in name}:
            with suppress(OSError):  # not there, or something of others is in it
                folder.parent.rmdir()
        self._write_entries({"status": "running"})

    def write_text(self, name: str, text: str) -> None:
        with whole(self.path / name) as path:
            path.write_text(text, encoding="utf-8")

    def write_run(self, **entries: Any) -> None:
        """Update `run.json`."""
        self._write_entries({**(read_run(self.path) or {}), **entries})

    def _write_entries(self, entries: Mapping[str, Any]) -> None:
        # A report under other versions leaves those that made the chain.
        whole_run = {"fingerprint": dict(self.fingerprint), **entries}
        self.write_text(RUN, json.dumps(whole_run, indent=2) + "\n")

    def save(self, ensemble: int, first_step: int, piece: Piece) -> None:
        """One file a piece: an interrupted run loses at most the pieces under way."""
        (self.path / PIECES).mkdir(exist_ok=True)
        target = self.path / PIECES / f"ensemble_{ensemble}_{first_step:09d}.npz"
        kind, keys, *rest = piece.state.random
        with whole(target) as path:
            np.savez(
                path,
                z=piece.z,
                log_p=piece.log_p,
                accepted=piece.accepted,
                failures=piece.failures,
                seconds=piece.seconds,
                end_z=piece.state.z,
                end_log_p=piece.state.log_p,
                random_kind=kind,
                random_keys=keys,
                random_rest=np.array(rest, dtype=np.float64),
            )

    def pieces(self, ensemble: int) -> list[Piece]:
        """What was saved so far, in order: a finished chain first, then the pieces after it."""
        found = []
        if (self.path / CHAIN).exists():
            found.append(read_chain(self.path / CHAIN, ensemble))
        have = sum(len(piece.z) for piece in found)
        for path in sorted((self.path / PIECES).glob(f"ensemble_{ensemble}_*.npz")):
            first = path.stem.rsplit("_", 1)[1]
            if first == f"{have:09d}":  # others are not ours
                found.append(_read_piece(path))
                have += len(found[-1].z)
        return found

    def finish_chain(self, pieces: list[list[Piece]], attributes: Mapping[str, Any]) -> None:
        """`chain.h5` in emcee's layout, one group `ensemble_<k>` each; then the pieces go."""
        if not any((self.path / PIECES).glob("*.npz")):
            return  # nothing is new
        with whole(self.path / CHAIN) as path:
            path.write_bytes(_chain_image(pieces, attributes))
        shutil.rmtree(self.path / PIECES)


def read_run(folder: Path) -> dict[str, Any] | None:
    """`run.json`, or None where there is none."""
    try:
        text = (folder / RUN).read_text(encoding="utf-8")
        run = json.loads(text)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (ValueError, RecursionError):
        run = None
    if not isinstance(run, dict) or not isinstance(run.get("fingerprint", {}), dict):
        raise InputError.one(str(folder / RUN), "this file is damaged; start over with --force")
    return run


def _changes(old: Mapping[str, Any], new: Mapping[str, Any], *, versions: bool) -> list[str]:
    """What differs between two fingerprints, with both values; `versions` too, or not."""
    return [
        f"{name} was {_value(old, name)} and is {_value(new, name)}"
        for name in {**old, **new}
        if old.get(name) != new.get(name) and (versions or not name.startswith(VERSION_OF))
    ]


def _value(marks: Mapping[str, Any], name: str) -> str:
    value = str(marks.get(name, "not there"))
    return value if len(value) <= LONGEST else f"{value[: LONGEST - 3]}..."


def _read_piece(path: Path) -> Piece:
    try:
        with path.open("rb") as raw, np.load(raw) as file:
            position, has_gauss, cached = file["random_rest"]
            kind, keys = str(file["random_kind"]), file["random_keys"]
            random = (kind, keys, int(position), int(has_gauss), cached)
            return Piece(
                z=file["z"],
                log_p=file["log_p"],
                accepted=file["accepted"],
                failures=int(file["failures"]),
                state=State(file["end_z"], file["end_log_p"], random),
                seconds=float(file["seconds"]),
            )
    except DAMAGED:
        message = "is damaged; delete it and continue with --resume, which computes it again"
        raise InputError.one(str(path), message) from None


def _chain_image(pieces: list[list[Piece]], attributes: Mapping[str, Any]) -> bytes:
    """The bytes of `chain.h5`, made in memory: HDF5 crashes the process when a disk fills up."""
    import h5py

    with h5py.File("chain.h5", "w", driver="core", backing_store=False) as file:
        for ensemble, parts in enumerate(pieces):
            _write_ensemble(file.create_group(f"ensemble_{ensemble}"), parts, attributes)
        file.flush()
        return bytes(file.id.get_file_image())


def _write_ensemble(group: Any, parts: list[Piece], attributes: Mapping[str, Any]) -> None:
    """As `emcee.backends.HDFBackend` lays out a group."""
    z = np.concatenate([part.z for part in parts])
    n_steps, n_walkers, n_dim = z.shape
    # With checksums: a damaged byte is an error when it is read, not a wrong number.
    group.create_dataset("chain", data=z, maxshape=(None, n_walkers, n_dim), fletcher32=True)
    log_p = np.concatenate([part.log_p for part in parts])
    group.create_dataset("log_prob", data=log_p, maxshape=(None, n_walkers), fletcher32=True)
    group.create_dataset("accepted", data=np.sum([part.accepted for part in parts], axis=0))
    own = {"failures": sum(part.failures for part in parts), **attributes}
    layout = {
        "version": version("emcee"),
        "nwalkers": n_walkers,
        "ndim": n_dim,
        "has_blobs": False,
        "iteration": n_steps,
    }
    group.attrs.update({**layout, **own})
    for index, value in enumerate(parts[-1].state.random):
        group.attrs[f"random_state_{index}"] = value


def read_chain(path: Path, ensemble: int) -> Piece:
    """One finished ensemble; raises `InputError` where the file is damaged."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            group = file[f"ensemble_{ensemble}"]
            steps = int(group.attrs["iteration"])
            z, log_p = group["chain"][:], group["log_prob"][:]
            if len(z) != steps or len(log_p) != steps:
                raise ValueError(f"{len(z)} steps where {steps} are announced")
            kind, keys, position, has_gauss, cached = (
                group.attrs[f"random_state_{index}"] for index in range(5)
            )
            random = (str(kind), keys, int(position), int(has_gauss), cached)
            return Piece(
                z=z,
                log_p=log_p,
                accepted=group["accepted"][:],
                failures=int(group.attrs["failures"]),
                state=State(z[-1], log_p[-1], random),
                seconds=1.0,
            )
    except DAMAGED as error:
        raise InputError.one(
            str(path), f"the chain cannot be read ({error}); start over with --force"
        ) from None
