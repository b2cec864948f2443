"""Run the jobs whose numbers a move of code must keep, and compare them with those of before.

`make baseline` runs `bayesdrill posterior` for each config of `configs/` and nine records of the
zoo, and compares the results with `benchmarks/baseline.json`; `ARGS=--write` writes that file anew.
What a move may change has limits, and beyond them the exit status is 1:

- the log posterior density stays within 1e-9 max(1, |log density|) at 1,000 points (`spread`);
- means, sds and the log evidence stay within 5 standard errors of both runs together;
- the conclusions that are printed, the exit status and the names of all quantities stay the same.

Files of other bytes are named, and are beyond the limits with `--bytes` only: the last bits of a
chain depend on the processor, too.  The tool asks the package for what users can ask: by the command
line, by `import bayesdrill`, and in the files of a results folder.
"""

from __future__ import annotations

import argparse
import base64
import csv
import dataclasses
import difflib
import hashlib
import json
import math
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

import bayesdrill as bd
from benchmarks.zoo import entries, folder, rows
from benchmarks.zoo.texts import as_csv, changed

Array = NDArray[np.float64]
Numbers = dict[str, list[float]]  # mean, sd and the standard errors of both, by quantity
Measured = dict[str, Any]  # what `measure` returns of a job, as JSON has it

ROOT = Path(__file__).parents[1]
STORED = ROOT / "benchmarks" / "baseline.json"
POINTS, DRAWS = 1000, 32  # where densities are compared; draws that are stored to make them
DENSITY_TOLERANCE, MOST_ERRORS = 1e-9, 5.0
TABLES = {"summary.csv": "name", "derived.csv": "name", "verdict.csv": "quantity"}
LEFT_OUT = re.compile(
    r"sampling: |results: | +\d+ %  |  .* \.\.\.$|  still working, "
)  # of a run's lines
ROUNDING = 1e-12  # relative, of means and sds with no Monte Carlo error


class Variant(NamedTuple):
    """A row of the zoo with other entries at dotted places, and times moved by parts of a step."""

    row: str
    changes: dict[str, Any] | None = None
    jitter: float = 0.0


FREE = dict.fromkeys(("j_m", "k_e", "k_s"), entries.box())
SIZE = {"prior": "log_uniform", "low": 1e-3, "high": 10}
TIME = {"prior": "log_uniform", "low": 0.01, "high": 10}
LOAD_LEFT_OUT = {
    "inputs": {"v": 8.0},
    "missing_torque": {"at": "rotor_1", "smoothness": "3/2", "size": SIZE, "time": TIME},
    "parameters": entries.parameters("nominal", **FREE),
}
WINDOWS = {"early": [0.0, 4.0], "late": [5.0, 9.0]}
PARTS = {name: {"record": {"window": window}} for name, window in WINDOWS.items()}
TWO_EXPERIMENTS = {"initial": {"time": 0.0}, "own": ["c_m"], "experiments": PARTS}
VARIANTS = {
    "friction": Variant("rubs_stick_slip"),
    "jitter": Variant("chirp", jitter=0.3),
    "ar1": Variant("coloured_sensors"),
    "latent_torque": Variant("load_measured", LOAD_LEFT_OUT),
    "twelve_states": Variant("train_six_discs"),
    "two_experiments": Variant("load_constant", TWO_EXPERIMENTS),
    "misfit": Variant("wrong_noise"),
    "lags": Variant("two_lags"),
    "long_record": Variant("random_steps_100000"),
}
CONFIGS = {path.stem: path for path in sorted((ROOT / "configs").glob("*.yaml"))}
NAMES = (*CONFIGS, *VARIANTS)


def prepare(name: str, place: Path) -> Path:
    """Return the config of a job; a variant is written to `place`, with its record."""
    if name in CONFIGS:
        return CONFIGS[name]
    variant = VARIANTS[name]
    (row,) = rows.chosen([variant.row])
    config, _ = folder.write(row, place)
    if variant.jitter:
        _move_times(config, place / "records" / f"{row.name}.csv", variant.jitter, row.seed)
    varied = dataclasses.replace(row, config=changed(row.config, variant.changes or {}))
    config.write_text(folder.text(varied, row.seed), encoding="utf-8")
    return config


def _move_times(config: Path, record: Path, jitter: float, seed: int) -> None:
    """Simulate the record again, at other times and the same inputs."""
    names = record.read_text(encoding="utf-8").partition("\n")[0].split(",")
    columns = dict(zip(names, np.loadtxt(record, delimiter=",", skiprows=1).T, strict=True))
    t = columns["t"]
    moved = np.random.default_rng(seed).uniform(-jitter, jitter, len(t)) * (t[1] - t[0])
    columns["t"] = t + np.where(t > t[0], moved, 0.0)
    record.write_text(as_csv(columns), encoding="utf-8")
    bd.simulate(config, record.with_name("moved.csv"), seed=seed)
    record.with_name("moved.csv").replace(record)


def measure(name: str, stored: dict[str, str] | None) -> Measured:
    """Run a job in a temporary folder; one that fails has only a status and what it printed.

    `stored`: packed draws of an earlier run, which make the points of the log density; or its own do.
    """
    with tempfile.TemporaryDirectory() as place:
        begun, output = time.perf_counter(), Path(place) / "results"
        config = prepare(name, Path(place))
        command = [sys.executable, "-m", "bayesdrill", "posterior", str(config), "--processes", "1"]
        piped: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        done = subprocess.run([*command, "--output", str(output)], cwd=ROOT, **piped)
        printed = done.stdout.replace(str(output), "results")  # the place differs each time
        found: Measured = {"status": done.returncode, "conclusions": conclusions(printed)}
        if (output / "summary.csv").exists():
            found |= read(config, output, stored)
        return found | {"seconds": time.perf_counter() - begun}


def conclusions(printed: str) -> list[str]:
    """Return the lines of a run but for its progress and tables, whose numbers `_numbers` compares."""
    paragraphs = [text for text in printed.strip("\n").split("\n\n") if not text.startswith(" ")]
    lines = [line for text in paragraphs for line in text.split("\n")]
    return [line for line in lines if not LEFT_OUT.match(line)]


def read(config: Path, output: Path, stored: dict[str, str] | None) -> Measured:
    """Return what a results folder holds, and the log density of its config at points (`measure`)."""
    run = bd.open(output)
    draws = {name: np.ravel(values) for name, values in run.draws.items()}
    if stored is None:
        some = np.linspace(0, next(iter(draws.values())).size - 1, DRAWS).astype(int)
        stored = {name: packed(values[some]) for name, values in draws.items()}
    contents = {path.name: path.read_bytes() for path in sorted(output.glob("*.csv"))}
    contents["draws"] = b"".join(values.tobytes() for values in draws.values())
    sha256 = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
    quantities = _quantities(output)
    if run.evidence is not None:
        quantities["log evidence"] = [run.evidence.log_z, 0.0, run.evidence.error, 0.0]
    found: Measured = {"sha256": sha256, "quantities": quantities, "draws": stored}
    points = spread({name: unpacked(text) for name, text in stored.items()})
    try:
        return found | {"log_density": packed(bd.load(config).log_density(points))}
    except bd.InputError:  # the job has other unknowns than those that are stored
        return found


def _quantities(output: Path) -> Numbers:
    """Return mean and sd of each quantity, and the Monte Carlo standard errors of both.

    That of an sd is sd sqrt((kurtosis - 1) / (4 n)), with n effective draws.  What follows from the
    unknowns is taken to have as many as the worst of them.
    """
    with h5py.File(output / "posterior.nc", "r") as file:
        groups = [file[name] for name in ("posterior", "derived") if name in file]
        kurtosis = {name: _kurtosis(group[name][:]) for group in groups for name in group}
    found, least = Numbers(), math.inf
    for table, key in TABLES.items():
        path = output / table
        for row in csv.DictReader(path.read_text().splitlines() if path.exists() else ()):
            n = min(float(row.get("ess_bulk", least)), float(row.get("ess_tail", least)))
            least = min(least, n)
            name, mean, sd = row[key], float(row["mean"]), float(row["sd"])
            tails = kurtosis.get(name, max(kurtosis.values()))
            errors = sd / math.sqrt(n), sd * math.sqrt((tails - 1.0) / (4.0 * n))
            found.setdefault(name, [mean, sd, *(float(f"{error:.3g}") for error in errors)])
    return found


def _kurtosis(values: Array) -> float:
    kept = values[np.isfinite(values)]
    off = kept - np.mean(kept) if len(kept) else np.zeros(1)
    return float(np.mean(off**4) / np.mean(off**2) ** 2) if off.any() else 3.0


def spread(draws: Mapping[str, Array]) -> dict[str, Array]:
    """Return `POINTS` points: `DRAWS` draws, and points 1/64 of the way from one to another.

    Means are geometric where all draws of an unknown are positive.  So points lie within all priors
    and near curved ridges, and square roots give the same bits on every machine.
    """
    first, second = np.nonzero(~np.eye(DRAWS, dtype=bool))
    points = {}
    for name, values in draws.items():
        start, point, positive = values[first], values[second], values.min() > 0.0
        for _ in range(6):
            point = np.sqrt(start * point) if positive else 0.5 * (start + point)
        points[name] = np.concatenate([values, point])[:POINTS]
    return points


def packed(values: Array) -> str:
    """Return numbers as text without loss: their bytes, those of equal weight together, compressed."""
    content = np.asarray(values, "<f8").view(np.uint8).reshape(-1, 8).T.tobytes()
    return base64.b85encode(zlib.compress(content, 9)).decode("ascii")


def unpacked(text: str) -> Array:
    """Return the numbers that were `packed`."""
    content = np.frombuffer(zlib.decompress(base64.b85decode(text)), np.uint8)
    return np.ascontiguousarray(content.reshape(8, -1).T).view("<f8").ravel()


class Difference(NamedTuple):
    """What differs, by how much; `beyond` the limits of what a move may change."""

    text: str
    beyond: bool = True


def compare(old: Measured, new: Measured, *, same_bytes: bool = False) -> Iterator[Difference]:
    """Yield all that differs between two results of a job; `same_bytes`: files must not."""
    if old["status"] != new["status"]:
        yield Difference(f"exit status {old['status']}, now {new['status']}")
    lines = difflib.ndiff(old["conclusions"], new["conclusions"])
    if said := [f"\n    {line}" for line in lines if line.startswith(("-", "+"))]:
        yield Difference(f"conclusions:{''.join(said)}")
    before, now = old.get("sha256", {}), new.get("sha256", {})
    if other := [name for name in before | now if before.get(name) != now.get(name)]:
        yield Difference(f"other bytes: {', '.join(other)}", same_bytes)
    if ("log_density" in old) != ("log_density" in new):
        yield Difference("log density: only one of both runs has one at the stored points")
    elif "log_density" in old:
        stored = unpacked(old["log_density"])
        off = np.abs(unpacked(new["log_density"]) - stored) / np.maximum(1.0, np.abs(stored))
        if off.any():
            text = f"{off.max():.1e} max(1, |log density|) at {np.count_nonzero(off)} points"
            yield Difference(f"log density: {text}", bool(off.max() > DENSITY_TOLERANCE))
    yield from _numbers(old.get("quantities", {}), new.get("quantities", {}))


def _numbers(old: Numbers, new: Numbers) -> Iterator[Difference]:
    if alone := sorted(old.keys() ^ new.keys()):
        yield Difference(f"quantities of one run only: {', '.join(alone)}")
    for what, k in (("means", 0), ("sds", 1)):
        both = {name: (old[name], new[name]) for name in sorted(old.keys() & new.keys())}
        off = {name: distance(a[k], b[k], a[k + 2], b[k + 2]) for name, (a, b) in both.items()}
        beyond = [name for name in off if off[name] > MOST_ERRORS]
        if any(off.values()):
            names = beyond or [max(off, key=lambda name: off[name])]
            said = ", ".join(f"{name} {off[name]:.2g}" for name in names)
            yield Difference(f"{what}, in standard errors: {said}", bool(beyond))


def distance(old: float, new: float, *errors: float) -> float:
    """Return how far two estimates are apart, in standard errors of both; infinite for one NaN."""
    if old == new or (math.isnan(old) and math.isnan(new)):
        return 0.0
    apart = abs(old - new) / math.hypot(*errors, ROUNDING * old, sys.float_info.min)
    return math.inf if math.isnan(apart) else apart


def main(given: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.baseline", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=NAMES, metavar="NAME", default=NAMES)
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="at a time")
    parser.add_argument("--write", action="store_true", help="store the results as the baseline")
    parser.add_argument("--bytes", action="store_true", help="files must have the same bytes")
    options = parser.parse_args(given)
    stored = json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else {}
    draws = [None if options.write else stored.get(name, {}).get("draws") for name in options.only]
    failed = [name for name in stored if name not in NAMES]  # its config is gone
    with ProcessPoolExecutor(options.jobs, multiprocessing.get_context("spawn")) as pool:
        for name, new in zip(options.only, pool.map(measure, options.only, draws), strict=True):
            seconds, found = new.pop("seconds"), [Difference("is not stored; write it: --write")]
            if options.write:
                stored[name] = new
            if name in stored:
                found = list(compare(stored[name], new, same_bytes=options.bytes))
            failed += [name] if any(beyond for _, beyond in found) else []
            said = "written" if options.write else "differs" if found else "the same"
            print(f"{name}: {said} ({seconds:.0f} s)", flush=True)
            print(*(f"  {'BEYOND ' * beyond}{text}\n" for text, beyond in found), sep="", end="")
    if options.write:
        kept = {name: stored[name] for name in NAMES if name in stored}
        STORED.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
        return 0
    print(f"beyond the limits of a move: {', '.join(failed) or 'nothing'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
