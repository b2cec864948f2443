"""Records with every nuisance at once: jitter, gaps, gain, offset, lag, and a rig in motion.

Made by other code than ours: a fine grid that holds all times, one matrix exponential of it, and a loop.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.linalg import expm
from support.scipy_oracles import NOMINAL, matrices

DT, FINE, N = 0.01, 40, 150  # s, steps of the fine grid in a sample, samples
LATE, GAIN = 96, 0.97  # steps of the fine grid, 2.4 samples
FREE = ("j_m", "k_e", "k_s", "j_1")
SIGMA = {"alpha": 0.3, "theta": 0.5, "w": 0.5}  # deg, deg, rpm
NAMES = ("slow", "quick", "mixed")

CONFIG = """
name: nuisances
seed: {seed}
record:
  time: {{column: time, unit: ms}}
  channels:
    alpha: {{column: alpha, unit: deg, measures: theta_1 - theta_2, sigma: 0.3{alpha}}}
    theta_2: {{column: theta, unit: deg, sigma: 0.5{theta}}}
    w_2: {{column: w, unit: rpm, sigma: 0.5}}
inputs:
  v: {{column: v, unit: V{supply}}}
{initial}
experiments:
  slow: {{record: {{file: slow.csv}}, inputs: {{v: {{file: slow_v.csv}}}}}}
  quick: {{record: {{file: quick.csv}}, inputs: {{v: {{file: quick_v.csv}}}}}}
  mixed: {{record: {{file: mixed.csv}}, inputs: {{v: {{file: mixed_v.csv}}}}}}
{shared}
nominal: tables_2_3
parameters:
  {{j_m: {{prior: uniform, low: 0.5, high: 1.5, relative: true}}, c_m: nominal,
   k_e: {{prior: uniform, low: 0.5, high: 1.5, relative: true}},
   k_T: nominal, r_m: nominal, l_m: nominal,
   k_s: {{prior: uniform, low: 0.5, high: 1.5, relative: true}},
   j_1: {{prior: uniform, low: 0.5, high: 1.5, relative: true}}, t_f: 1.0e-3}}
map: {{starts: 2, evaluations: 500}}
sampler: {{walkers: 64, ess: 400, n_tau: 20}}
"""

TOLD = {
    "alpha": ", gain: {prior: normal, mean: 1, sd: 0.05}, "
    "lag: {prior: uniform, low: 0, high: 50, unit: ms}",
    "theta": ", offset: {prior: normal, mean: 0, sd: 5}",
    "supply": ", offset: {prior: normal, mean: 0, sd: 0.2}",
    "initial": "initial: {state: free, theta_1: 0.0}",
    "shared": "shared: [gain_alpha, lag_alpha, offset_theta_2, offset_v]",
}


def write(folder: Path, seed: int, *, told: bool) -> tuple[Path, dict[str, float]]:
    """Files of three experiments and their config; the truths of what is unknown in it, SI.

    `told`: whether the config knows of the nuisances.
    """
    rng = np.random.default_rng([seed, 1])
    truth = {**NOMINAL, "t_f": 1e-3}
    truth |= {name: NOMINAL[name] * rng.uniform(0.5, 1.5) for name in FREE}
    offset, supply = np.radians(5 * rng.standard_normal()), 0.2 * rng.standard_normal()
    found = {name: truth[name] for name in FREE}
    found |= {"gain_alpha": GAIN, "lag_alpha": LATE * DT / FINE}
    found |= {"offset_theta_2": offset, "offset_v": supply}
    for number, name in enumerate(NAMES):
        states, given, t = _moved(truth, number, supply, rng)
        first = 60 * FINE
        zero = states[first, 0]  # where an angle begins to count is nobody's business
        states[:, :2] -= zero
        found |= {
            f"{state}_0_{name}": float(states[first, k])
            for k, state in enumerate(("theta_1", "theta_2", "w_1", "w_2", "i"))
            if state != "theta_1"
        }
        _write(folder, name, states, given, t, first, offset, rng)
    words = TOLD if told else dict.fromkeys(TOLD, "")
    path = folder / "nuisances.yaml"
    path.write_text(CONFIG.format(seed=seed, **words))
    return path, found


def _moved(
    p: dict[str, float], number: int, supply: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States on the fine grid, from rest, and the voltage that was recorded."""
    n = (60 + N) * FINE
    sample = np.arange(n) // FINE
    phase, amplitude = rng.uniform(0, 6), rng.uniform(3, 7)
    given = (
        amplitude * np.sign(np.sin(2 * np.pi * (0.6 + 0.7 * number) * DT * sample + phase)) + 0.5
    )
    matrix, by_voltage, _, friction = matrices(p)
    augmented = np.zeros((7, 7))
    augmented[:5, :5], augmented[:5, 5], augmented[:5, 6] = matrix, by_voltage, friction
    step = expm(augmented * DT / FINE)
    states = np.zeros((n, 5))
    for k in range(n - 1):
        z = np.concatenate([states[k], [given[k] + supply, 1.0]])
        states[k + 1] = (step @ z)[:5]
    return states, given, DT / FINE * np.arange(n)


def _write(
    folder: Path,
    name: str,
    states: np.ndarray,
    given: np.ndarray,
    t: np.ndarray,
    first: int,
    offset: float,
    rng: np.random.Generator,
) -> None:
    places = first + FINE * np.arange(N)
    at = places + np.append(0, rng.integers(-12, 13, N - 1))
    alpha = GAIN * (states[at - LATE, 0] - states[at - LATE, 1])
    columns = {
        "time": 1e3 * t[at],
        "alpha": np.degrees(alpha) + SIGMA["alpha"] * rng.standard_normal(N),
        "theta": np.degrees(states[at, 1] + offset) + SIGMA["theta"] * rng.standard_normal(N),
        "w": states[at, 3] * 30 / np.pi + SIGMA["w"] * rng.standard_normal(N),
    }
    kept = np.ones(N, dtype=bool)
    for gap in rng.integers(5, N - 6, 3):
        kept[gap : gap + 3] = False
    table = np.stack([*columns.values()], axis=-1)[kept]
    head = ",".join(columns)
    np.savetxt(folder / f"{name}.csv", table, "%.7f", ",", header=head, comments="")
    inputs = np.append(places, places[-1] + FINE - 1)
    rows = np.stack([1e3 * t[inputs], given[inputs]], axis=-1)
    np.savetxt(folder / f"{name}_v.csv", rows, "%.7f", ",", header="time,v", comments="")
