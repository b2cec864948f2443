"""Two experiments with one rig, simulated: what sensors add, how they begin, what they share."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

from bayesdrill.config import loading
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import simulation
from bayesdrill.config.yaml_source import parse

# Both in users' units; a lag and an offset in common, noise known.
PAIR = """\
name: pair
seed: 7
record:
  time: {column: t, unit: s}
  channels:
    theta_1: {column: theta_1, unit: deg, sigma: 2, offset: {prior: normal, mean: 0, sd: 10},
              lag: {prior: normal, mean: 0, sd: 20, unit: ms}}
    w_1: {column: w_1, unit: rad/s, sigma: 0.1}
inputs:
  v: 8.0
experiments:
  slow: {record: {file: slow.csv}, inputs: {v: 4.0}}
  fast: {record: {file: fast.csv}}
shared: [lag_theta_1, offset_theta_1]
parameters:
  j_m: nominal
  c_m: nominal
  k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}
  k_T: nominal
  r_m: nominal
  l_m: nominal
  k_s: nominal
  j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}
  t_f: nominal
map: {starts: 2, evaluations: 500}
sampler: {walkers: 16, r_hat: 1.2, n_tau: 5, ess: 100, max_steps: 500}
output: {predictive_draws: 10, figures: []}
calibration: {refits: 10, draws: 19, n_tau: 5, ess: 50, max_steps: 500}
simulation: {duration: 4, rate: 25, truth: {lag_theta_1: 15, offset_theta_1: -6}}
"""
TRUTH = {"lag_theta_1": 0.015, "offset_theta_1": -0.10471975511965977}

# All kinds of numbers that may be unknown beside the rig; one experiment moves at its start.
RICH = """\
name: rich
seed: 11
record:
  time: {column: t, unit: s}
  missing: drop
  channels:
    twist: {column: twist, unit: deg, measures: theta_1 - theta_2,
            gain: {prior: log_normal, median: 1, sd_log: 0.1},
            lag: {prior: uniform, low: 0, high: 60, unit: ms},
            sigma: {prior: uniform, low: 0.01, high: 5}}
    w_2: {column: w_2, unit: rpm, sigma: 0.5, offset: {prior: normal, mean: -1, sd: 2}}
inputs:
  v: {value: 8, unit: V, offset: {prior: truncated_normal, mean: 0.1, sd: 0.3, low: -1, high: 1}}
experiments:
  late:
    record: {file: late.csv}
    inputs: {v: {gain: {prior: normal, mean: 1, sd: 0.05}}, t_0: {prior: normal, mean: 0.1, sd: 0.05}}
  moving:
    record: {file: moving.csv, channels: {w_2: {sigma: {prior: log_uniform, low: 0.05, high: 5}}}}
    inputs: {v: -5.0}
    initial: {w_1: {prior: normal, mean: 30, sd: 5, unit: rpm}, w_2: free, theta_1: -0.2}
shared: [gain_twist, sigma_twist]
own: [t_f]
parameters:
  j_m: nominal
  c_m: nominal
  k_e: {prior: normal, mean: 1, sd: 0.2, relative: true}
  k_T: nominal
  r_m: nominal
  l_m: nominal
  k_s: {prior: uniform, low: 0.5, high: 1.5, relative: true}
  j_1: nominal
  t_f: {prior: half_normal, scale: 2, relative: true}
map: {starts: 2, evaluations: 600}
sampler: {walkers: 32, ess: 1000, n_tau: 20}
simulation: {duration: 2.5, rate: 40, sigma: {twist: 0.4, w_2: 0.6},
  truth: {gain_twist: 0.93, lag_twist: 21, offset_w_2: 1.5, offset_v_late: 0.3,
    t_0: 0.12, w_1_0: 33, w_2_0: 2.9, t_f_moving: 0.05}}
"""


@functools.cache
def records(text: str) -> dict[str, str]:
    """By file name, what `simulate` makes of the config `text`, once."""
    case = loading.validate(parse(Path("all.yaml"), text))
    made = simulation.simulate_all(case, case.config.seed)
    return {path.name: record for path, record in made.items()}


def write(folder: Path, *changes: tuple[str, str], text: str = PAIR) -> Path:
    """A config with the records of `text`, changed by replacements of what stands in it once."""
    for name, record in records(text).items():
        (folder / name).write_text(record, encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the config"
        text = text.replace(old, new)
    (folder / "all.yaml").write_text(text, encoding="utf-8")
    return folder / "all.yaml"


@functools.cache
def rich_job() -> Job:
    """With samples missing in the twist of the first experiment."""
    with tempfile.TemporaryDirectory() as place:
        config = write(Path(place), text=RICH)
        lines = (config.parent / "late.csv").read_text().splitlines()
        for row in (12, 13, 14, 40):
            t, _, w = lines[row].split(",")
            lines[row] = f"{t},,{w}"
        (config.parent / "late.csv").write_text("\n".join(lines) + "\n")
        return prepare(config)
