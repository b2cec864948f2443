"""Fit each record of a bench alone, and say what it leaves of all of them, in per cent.

`python -m benchmarks.real.crossed waterloo|tokyo [--without SYMBOL ...]`: `waterloo` of each channel's
spread, held-out records included; `tokyo` of the excited lines, as its free rig drifts.  A last row has
the records that the bench fits together.  `--without` takes parameters out of the config first.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from ruamel.yaml import YAML

import bayesdrill as bd
from bayesdrill.inference import residual_checks
from benchmarks.real.bench import HERE, Bench
from benchmarks.real.benches import TOKYO, WATERLOO

TOGETHER = "together"
LINES_FROM = 5  # s: what came before is not steady yet
Row = dict[str, tuple[float, float]]  # of each record, what is left of both channels


def described(bench: Bench, without: Sequence[str] = ()) -> dict[str, Any]:
    """The config of a bench, which may stand in any folder."""
    data: dict[str, Any] = YAML(typ="safe").load(bench.config)
    for experiment in data["experiments"].values():
        experiment["record"]["file"] = str(HERE / experiment["record"]["file"])
    for name in without:
        del data["parameters"][name], data["nominal"][name]
    return data


def fitted(data: Mapping[str, Any]) -> tuple[bd.Case, bd.Best]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "alone.yaml"
        path.write_text(json.dumps(data), encoding="utf-8")  # which is YAML too
        case = bd.load(path)
    return case, case.find_map(quick=True)


def of_records(data: dict[str, Any], name: str) -> tuple[bd.Best, Row]:
    """Fit one record, hold out the others, and say what is left of each."""
    for label, experiment in data["experiments"].items():
        if name != TOGETHER:
            experiment["held_out"] = label != name
    case, best = fitted(data)
    posterior = case.job.problem.posterior
    likelihood, row = posterior.likelihood, Row()
    every = (*likelihood.observations, *likelihood.held_out)
    joint = dataclasses.replace(likelihood, observations=every, held_out=())
    left = residual_checks.residual_summaries(joint, posterior.space.vector(best.values))
    for first, second in zip(left[::2], left[1::2], strict=True):
        row[first.experiment] = (first.share, second.share)
    return best, row


def of_lines(data: dict[str, Any], name: str) -> tuple[bd.Best, Row]:
    """Fit one record, and say what its two inertias leave of the excited lines of each."""
    files = {label: one["record"]["file"] for label, one in data["experiments"].items()}
    if name != TOGETHER:
        alone = data.pop("experiments")[name]["record"]
        del data["shared"]
        data["record"]["file"] = alone["file"]
        data["record"]["channels"]["theta_load"] |= alone["channels"]["theta_load"]
    _, best = fitted(data)
    v = best.values
    row = Row()
    for label, file in files.items():
        hertz, current, angles = lines(file)
        s = 2j * np.pi * hertz
        shaft = v["k_coupling"] + v["c_coupling"] * s
        motor = v["j_motor"] * s**2 + v["c_motor"] * s + shaft
        load = v["j_load"] * s**2 + v["c_load"] * s + shaft
        model = np.array([load, shaft]) / (motor * load - shaft**2) * np.exp(-s * v["t_0"])
        left = np.linalg.norm(angles - model * current, axis=1) / np.linalg.norm(angles, axis=1)
        row[label] = (float(left[0]), float(left[1]))
    return best, row


def lines(file: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies of a multisine of 1 s, and means over its periods: current, both angles."""
    record = scipy.io.loadmat(file)
    names, signs = ("iq_refx", "iq_adx", "theta_mx", "theta_my"), (1, 1, 1, -1)
    periods = np.array(
        [sign * record[name].reshape(20, -1) for name, sign in zip(names, signs, strict=True)]
    )
    asked, current, *angles = np.fft.rfft(periods[:, LINES_FROM:].mean(axis=1))
    excited = np.flatnonzero(np.abs(asked) > 0.1 * np.abs(asked).max())
    return excited.astype(float), current[excited], np.array(angles)[:, excited]


def table(bench: Bench, without: Sequence[str]) -> Iterator[str]:
    """A line for each record that is fitted, its values at the maximum, and what is left."""
    left = of_records if bench is WATERLOO else of_lines
    for name in (*described(bench)["experiments"], TOGETHER):
        best, row = left(described(bench, without), name)
        cells = "; ".join(
            f"{label} {100 * a:.3g}, {100 * b:.3g} %" for label, (a, b) in row.items()
        )
        found = ", ".join(
            f"{c.name} {c.figure(best.values):.5g}" for c in bench.criteria if not without
        )
        values = ", ".join(f"{key} {value:.4g}" for key, value in best.values.items())
        yield f"{name}: leaves {cells}\n    {found or values}"
        yield f"    log posterior {best.mode.log_posterior:.1f}"


def main(given: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.real.crossed", description=__doc__)
    parser.add_argument("name", choices=[WATERLOO.name, TOKYO.name])
    parser.add_argument("--without", nargs="*", default=[], metavar="SYMBOL")
    options = parser.parse_args(given)
    for line in table(WATERLOO if options.name == WATERLOO.name else TOKYO, options.without):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
