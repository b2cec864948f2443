"""A servo with a pendulum (BAM): what each of five models leaves of its records.

`python -m benchmarks.real.bam` fits the models to all records, and two of them by gain (minutes).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

import bayesdrill as bd
from bayesdrill.inference import residual_checks
from benchmarks.real.bam_records import convert_all
from benchmarks.real.bench import HERE
from benchmarks.real.servos import BAM

BUILD = HERE / "build"
GAINS = (100, 200, 400, 800)


def variant(config: Path, *, dry: bool, eta: bool, own: bool, noise: str, gain: int = 0) -> Path:
    """Write a config of fewer parts or records than the bench's, and return its path."""
    yaml = YAML()
    entries: dict[str, Any] = yaml.load(config)
    parameters, experiments = entries["parameters"], entries["experiments"]
    if not dry:
        del parameters["t_c_motor"]
    if not eta:
        del parameters["eta_box"]
    if not own:
        del entries["own"]
    if noise == "ar1":
        entries["record"]["channels"]["angle"]["noise"] = "ar1"
        entries["shared"].append("rho_angle")
    for name in [n for n in experiments if gain and not n.startswith(f"kp{gain}_")]:
        del experiments[name]
    for experiment in experiments.values():
        experiment["record"]["file"] = experiment["record"]["file"].removeprefix("build/")
    path = BUILD / "variant.yaml"
    yaml.dump(entries, path)
    return path


def fitted(path: Path) -> str:
    """Return a line: log-likelihood, BIC, sd and share of what is left, and what was found."""
    case = bd.load(path)
    best = case.find_map(quick=True)
    posterior = case.job.problem.posterior
    theta, likelihood = posterior.space.vector(best.values), posterior.likelihood
    left = sorted(one.share for one in residual_checks.residual_summaries(likelihood, theta))
    log_likelihood = float(np.ravel(likelihood(theta[None]))[0])
    samples = sum(
        int(observation.experiment.is_measured.sum()) for observation in likelihood.observations
    )
    bic = len(theta) * math.log(samples) - 2 * log_likelihood
    v = best.values
    resistances = [r for name, r in v.items() if name.startswith("r_motor")]
    shown = [f"{name} {v[name]:.3g}" for name in ("k_T_motor", "j_motor", "t_0") if name in v]
    shown += [f"{name} {v[name]:.3g}" for name in ("t_c_motor", "eta_box") if name in v]
    ratios = " ".join(f"{v['k_T_motor'] / r:.4f}" for r in resistances)
    return (
        f"log L {log_likelihood:.0f}, BIC {bic:.0f}, sigma {v['sigma_angle']:.4f} rad, left "
        f"{left[0]:.1%} to {left[-1]:.1%}, median {np.median(left):.1%}; {', '.join(shown)}; "
        f"k_T/R {ratios}"
    )


def main() -> None:
    convert_all(BAM)
    dry: dict[str, Any] = {"dry": True, "eta": False, "own": False, "noise": "white"}
    models: dict[str, dict[str, Any]] = {
        "linear": {**dry, "dry": False},
        "dry friction": dry,
        "dry friction, own r": {**dry, "own": True},
        "eta": {**dry, "eta": True},
        "eta, own r": {**dry, "eta": True, "own": True},
        "dry friction, ar1": {**dry, "noise": "ar1"},
        "eta, ar1": {**dry, "eta": True, "noise": "ar1"},
    }
    for name in ("dry friction", "eta"):
        models |= {f"{name}, gain {gain}": {**models[name], "gain": gain} for gain in GAINS}
    for name, parts in models.items():
        print(f"{name}: {fitted(variant(BAM.config, **parts))}", flush=True)


if __name__ == "__main__":
    main()
