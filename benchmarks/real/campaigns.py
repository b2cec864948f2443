"""Campaigns of measured records: do intervals of the next run hold the run that was left out?

`python -m benchmarks.real.campaigns [NAME ...]` fits each campaign (minutes), and weighs its population
without each run.  Intervals of that next run are compared with the run's own estimate.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from ruamel.yaml import YAML

import bayesdrill as bd
from bayesdrill.campaigns.fit import PopulationFit
from benchmarks.real.bam_records import FOLDER, convert
from benchmarks.real.bench import DATA, HERE
from benchmarks.real.servos import BAM

BUILD = HERE / "build"
SERVO = """
record:
  time: {variable: data, column: 1, unit: s}
  window: [8, 14]
  decimate: {factor: 20}
  channels:
    w_2: {variable: data, column: 4, unit: rad/s, sigma: {prior: log_uniform, low: 0.01, high: 10}}
inputs:
  t_m: {variable: data, column: 5, unit: N*m}
initial: steady
model: {name: motor}
nominal: {j_m: 1.2e-4, c_m: 7.03e-5, tolerance: 0.1}
parameters:
  j_m: {prior: log_normal, median: 1, sd_log: 1, relative: true}
  c_m: {prior: log_normal, median: 1, sd_log: 1, relative: true}
  t_f: {prior: uniform, low: 0.001, high: 0.06}
"""
SINES = ("0_5", "1", "1_5", "2", "2_5", "3", "3_5", "4", "4_5", "5")


@dataclass(frozen=True, slots=True)
class MeasuredCampaign:
    """A campaign of measured records has a base config and entries of its runs, when they are there."""

    name: str
    make: Callable[[], tuple[dict[str, Any], list[dict[str, Any]]]]
    noted: tuple[str, ...] = ()


def single(name: str) -> dict[str, Any]:
    """Return the config of a bench of several records, as that of one of them."""
    entries: dict[str, Any] = YAML(typ="safe").load(HERE / f"{name}.yaml")
    return {key: x for key, x in entries.items() if key not in ("experiments", "own", "shared")}


def servo() -> tuple[dict[str, Any], list[dict[str, Any]]]:
    files = [DATA / "hsm150_servo" / f"idf_pos_0.065_{k}.mat" for k in (1, 2, 3)]
    return YAML(typ="safe").load(SERVO), [{"file": str(file)} for file in files]


def waterloo() -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Square waves of 1.5 and 2 V, and sines of 2.5 V up to 5 Hz, above which little is determined."""
    names = ["2", "1_5", *(f"sine_{each}" for each in SINES)]
    folder = DATA / "flexible_drive_waterloo_2022"
    return single("waterloo"), [
        {"file": str(folder / f"velocity_response_{name}.mat"), "name": name} for name in names
    ]


def servo_with_pendulum() -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The motor warms up from 28 to 39 degrees, while the gain rises from 100 to 800."""
    runs: list[dict[str, Any]] = []
    for source in map(BAM.place, BAM.files):
        record = json.loads(source.read_text("utf-8"))
        on = [entry["temp"] for entry in record["entries"] if entry["torque_enable"]]
        noted = {"temperature": float(np.mean(on))}
        file = str(convert(source, FOLDER))
        runs.append({"file": file, "time": float(len(runs)), "noted": noted})
    return single("bam"), runs


CAMPAIGNS = (
    MeasuredCampaign("servo", servo),
    MeasuredCampaign("waterloo", waterloo),
    MeasuredCampaign("bam", servo_with_pendulum, ("temperature",)),
)


def fitted(campaign: MeasuredCampaign) -> PopulationFit:
    """Run a campaign, or continue it, and return its population."""
    folder = BUILD / "campaigns" / campaign.name
    folder.mkdir(parents=True, exist_ok=True)
    base, runs = campaign.make()
    base["record"]["file"] = runs[0]["file"]
    base |= {"name": f"{campaign.name}_run", "seed": 1}
    yaml = YAML()
    yaml.dump(base, folder / "base.yaml")
    entries = {"name": campaign.name, "base": "base.yaml", "runs": runs, "seed": 1}
    yaml.dump(entries | {"noted": [*campaign.noted]}, folder / "campaign.yaml")
    outcome = bd.campaign(folder / "campaign.yaml").run(folder / "results", resume=True)
    return outcome.record.population


def describe(population: PopulationFit) -> str:
    """Return a table: interval of the next run, times that of a run, and runs that it holds."""
    lines = [f"{len(population.runs)} runs; converged: {population.convergence.converged}"]
    own = 2 * 1.645 * np.median([run.alone_sd for run in population.runs], axis=0)
    off = np.abs(np.array([run.ranks for run in population.runs]) - 0.5)
    for k, product in enumerate(population.populations):
        width = product.next_run.high_90 - product.next_run.low_90
        held = (off[:, k] < 0.25).sum(), (off[:, k] < 0.45).sum()
        lines.append(
            f"{product.product}: spread {product.spread.mean:.1%}, own 90 % width {own[k]:.1%}, of the "
            f"next run {width:.1%}, {width / own[k]:.0f} times; held {held[0]} in 50 %, "
            f"{held[1]} in 90 %"
        )
    lines += [
        f"{effect.column} explains {effect.share.mean:.0%} ({effect.share.low_90:.0%} to "
        f"{effect.share.high_90:.0%}) of {effect.product}, slope {effect.slope.mean:+.1%} +- "
        f"{effect.slope.sd:.1%}"
        for effect in population.noted
    ]
    outliers = [run.name for run in population.runs if run.outlier]
    histories = [(chart.product, chart.history.best) for chart in population.charts]
    badly = population.misdescribed
    return "\n".join(
        [*lines, f"outliers {outliers}, described badly {badly}, histories {histories}"]
    )


def main() -> None:
    if not DATA.is_dir():
        print(f"skipped, {DATA} is not there; `benchmarks.real --fetch` gets most of it")
        return
    for campaign in CAMPAIGNS:
        if campaign.name in sys.argv[1:] or len(sys.argv) == 1:
            print(f"{campaign.name}: {describe(fitted(campaign))}", flush=True)


if __name__ == "__main__":
    main()
