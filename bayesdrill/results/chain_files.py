"""Pieces of chain as files: `.npz` while it grows, emcee's HDF5 layout when it is whole."""

from __future__ import annotations

import hashlib
import struct
import threading
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.errors import InputError
from bayesdrill.engines.samplers.ensemble import Piece, State
from bayesdrill.engines.sampling import Opened

SEAL = "checksum"
# What NumPy, zipfile and HDF5 raise when bytes of a file are not what they were.
DAMAGED = (
    *(OSError, ValueError, KeyError, IndexError, TypeError, EOFError, RuntimeError, MemoryError),
    *(AttributeError, OverflowError, NotImplementedError, SyntaxError, struct.error),
    *(zipfile.BadZipFile, zlib.error),
)
AGAIN = "delete it and continue with --resume, which computes it again"
COMPUTED_AGAIN = f"is damaged; {AGAIN}"


def write_piece(path: Path, piece: Piece, run: str) -> None:
    """Zip keeps a checksum of each array; `run`: the mark of the run that it is a piece of."""
    kind, keys, *rest = piece.state.random
    np.savez(
        path,
        z=piece.z,
        log_p=piece.log_p,
        accepted=piece.accepted,
        failures=piece.failures,
        seconds=piece.seconds,
        run=run,
        end_z=piece.state.z,
        end_log_p=piece.state.log_p,
        random_kind=kind,
        random_keys=keys,
        random_rest=np.array(rest, dtype=np.float64),
    )


def read_piece(path: Path) -> tuple[Piece, str | None]:
    """And of which run it is; raises `InputError` where the file is damaged."""
    try:
        with path.open("rb") as raw, np.load(raw) as file:
            position, has_gauss, cached = file["random_rest"]
            kind, keys = str(file["random_kind"]), file["random_keys"]
            random = (kind, keys, int(position), int(has_gauss), cached)
            piece = _consistent(
                Piece(
                    z=file["z"],
                    log_p=file["log_p"],
                    accepted=file["accepted"],
                    failures=int(file["failures"]),
                    state=State(file["end_z"], file["end_log_p"], random),
                    seconds=float(file["seconds"]),
                )
            )
            return piece, str(file["run"]) if "run" in file else None
    except DAMAGED:
        raise InputError.one(str(path), COMPUTED_AGAIN) from None


def write_opened(path: Path, opened: Opened, pieces: Sequence[Sequence[Piece]]) -> None:
    """With a mark of the chain of these `pieces`, beyond which it was found."""
    draws = () if opened.draws is None else opened.draws
    np.savez(path, names=opened.names, pressed=opened.pressed, draws=draws, chain=_mark(pieces))


def read_opened(path: Path, pieces: Sequence[Sequence[Piece]]) -> Opened:
    """Raises `InputError` where the file is damaged, or of another chain."""
    try:
        with path.open("rb") as raw, np.load(raw) as file:
            names, pressed = (tuple(map(str, file[name])) for name in ("names", "pressed"))
            draws, mark = file["draws"].reshape(-1, pieces[0][0].z.shape[-1]), str(file["chain"])
        if mark != _mark(pieces):
            raise ValueError("of another chain")
        return Opened(names=names, draws=draws if draws.size else None, pressed=pressed)
    except DAMAGED:
        raise InputError.one(str(path), f"is of another chain, or {COMPUTED_AGAIN}") from None


def _mark(pieces: Sequence[Sequence[Piece]]) -> str:
    """Of a chain, however it was cut."""
    digest = hashlib.sha256()
    for chain in pieces:
        digest.update(np.concatenate([piece.log_p for piece in chain]))
    return digest.hexdigest()


def _consistent(piece: Piece) -> Piece:
    """Itself; raises `ValueError` or `TypeError` where what it holds is not of one ensemble."""
    steps, walkers, unknowns = piece.z.shape
    state = piece.state
    np.random.RandomState().set_state(state.random)
    for values, shape in (
        (piece.z, (steps, walkers, unknowns)),
        (piece.log_p, (steps, walkers)),
        (piece.accepted, (walkers,)),
        (state.z, (walkers, unknowns)),
        (state.log_p, (walkers,)),
    ):
        if values.shape != shape or not np.isfinite(values).all() or piece.seconds <= 0:
            raise ValueError("other numbers than a chain has")
    return piece


def chain_image(pieces: list[list[Piece]], attributes: Mapping[str, Any]) -> bytes:
    """The bytes of `chain.h5`, made in memory: HDF5 crashes the process when a disk fills up.

    One group `ensemble_<k>` each, as `emcee.backends.HDFBackend` lays it out.
    """
    import h5py

    # Two files of one name are never open at once, in memory either; the name is not in the bytes.
    name = f"chain.{threading.get_native_id()}.h5"
    with h5py.File(name, "w", driver="core", backing_store=False) as file:
        for ensemble, parts in enumerate(pieces):
            group = file.create_group(f"ensemble_{ensemble}")
            _write_ensemble(group, parts, attributes)
            seal(group)
        file.flush()
        return bytes(file.id.get_file_image())


def _write_ensemble(group: Any, parts: list[Piece], attributes: Mapping[str, Any]) -> None:
    z = np.concatenate([part.z for part in parts])
    n_steps, n_walkers, n_dim = z.shape
    # With checksums of their own, for whoever reads them with emcee.
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


def seal(group: Any) -> None:
    """A checksum of an ensemble as it stands: of all numbers, and of its attributes."""
    group.attrs[SEAL] = _checksum(_contents(group))


def _contents(group: Any) -> dict[str, Any]:
    """Attributes but the checksum, and datasets."""
    values = {name: value for name, value in group.attrs.items() if name != SEAL}
    return values | {name: group[name][:] for name in group}


def _checksum(contents: Mapping[str, Any]) -> str:
    digest = hashlib.sha256()
    for name in sorted(contents):
        value = np.ascontiguousarray(contents[name])
        digest.update(f"{name} {value.dtype.str} {value.shape} ".encode())
        digest.update(value)
    return digest.hexdigest()


def read_chain(path: Path, ensemble: int) -> tuple[Piece, str | None]:
    """One finished ensemble, and of which run it is; raises `InputError` where the file is damaged."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            group = file[f"ensemble_{ensemble}"]
            found = _contents(group)
            if group.attrs[SEAL] != _checksum(found):
                raise ValueError("the checksum does not fit")
        kind, keys, position, has_gauss, cached = (found[f"random_state_{k}"] for k in range(5))
        random = (str(kind), keys, int(position), int(has_gauss), cached)
        z, log_p = found["chain"], found["log_prob"]
        piece = _consistent(
            Piece(
                z=z,
                log_p=log_p,
                accepted=found["accepted"],
                failures=int(found["failures"]),
                state=State(z[-1], log_p[-1], random),
                seconds=1.0,
            )
        )
        return piece, found.get("run")
    except DAMAGED:
        raise InputError.one(str(path), COMPUTED_AGAIN) from None
