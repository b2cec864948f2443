"""Which further record of a bench tells most: what the fit of one promises, against fits.

The records do not come with the project: where they are absent, these tests are skipped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.io import loadmat
from scipy.stats import kendalltau
from support.document_blocks import DOCS, ROOT, files

import bayesdrill as bd
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.basics.arrays import Array

SHARED = ROOT.parent / "shared" / "data"
CARTS, SERVO = SHARED / "flexible_drive_waterloo_2022", SHARED / "hsm150_servo"
ABSENT = "a record that does not come with the project"
HERTZ = 1000  # of all records
CARTS_RECORDS = {  # files by name; the first is known
    "square_2": "velocity_response_2",
    "square_1_5": "velocity_response_1_5",
    **{f"sine_{f}": f"velocity_response_sine_{f}" for f in ("0_5", "1", "2", "3", "5", "8")},
    "loop_1": "2_1_kp_0_05",
    "loop_4": "2_4_kp_0_23",
}
Records = Mapping[str, Sequence[Mapping[str, Any]]]  # config entries of the repeats, by name


def log_sd(case: bd.Case, best: bd.Best) -> float:
    """Return the mean log sd of the rig's unknowns at a maximum, after the record of a case."""
    posterior = case.job.problem.posterior
    study = SensitivityStudy(posterior.likelihood)
    rows = study.with_nuisances(posterior.space.vector(best.values))
    m = len(study.unknowns)
    covariance = np.linalg.inv(rows.T @ rows + np.diag(study.prior_spreads**-2.0))[:m, :m]
    return float(np.linalg.slogdet(covariance)[1] / (2 * m))


def ranking(config: dict[str, Any], records: Records, folder: Path) -> Array:
    """Return log sds `(2, n)` of each further experiment, by the fit of the first record, and refitted.

    `records` has the repeats of each experiment, whose refits are averaged.
    """
    known, rows = None, []
    for name, repeats in records.items():
        both = []
        for number, entries in enumerate(repeats):
            path = folder / f"{name}_{number}.yaml"
            path.write_text(
                yaml.safe_dump(config | entries | {"record": config["record"] | entries["record"]})
            )
            case = bd.load(path)
            own = case.find_map(quick=True)
            known = known or own
            both.append([log_sd(case, best) for best in (known, own)])
        rows.append(np.mean(both, axis=0))
        print(f"{name}: promised {rows[-1][0]:.3f}, refitted {rows[-1][1]:.3f}", flush=True)
    out = np.array(rows).T
    print(f"tau {kendalltau(*out[:, 1:]).statistic:.2f} of {len(rows) - 1} further experiments")
    return out[:, 1:]


def carts(folder: Path) -> tuple[dict[str, Any], Records]:
    """Return the config of two carts, and their records: squares, sines, and loops without `v2`."""
    config = yaml.safe_load((ROOT / "benchmarks" / "real" / "waterloo.yaml").read_text())
    records = {}
    for name, stem in CARTS_RECORDS.items():
        mat = {k: np.ravel(x) for k, x in loadmat(CARTS / f"{stem}.mat").items() if k[0] != "_"}
        v1 = mat["v1"] if "v1" in mat else np.diff(mat["x1"], prepend=mat["x1"][0]) * HERTZ
        columns = {"t": np.arange(len(v1)) / HERTZ, "u": mat["u"], "v1": v1}
        channels = dict(config["record"]["channels"])
        if "v2" in mat:
            columns["v2"] = mat["v2"]
        else:
            del channels["v_cart_2"]
        table = np.column_stack([*columns.values()])
        header = ",".join(columns)
        np.savetxt(folder / f"{name}.csv", table, "%.9g", ",", header=header, comments="")
        records[name] = [{"record": {"file": f"{name}.csv", "channels": channels}}]
    del config["experiments"], config["shared"]
    config["map"] = {"starts": 2, "evaluations": 500}
    return config, records


def servo(folder: Path) -> tuple[dict[str, Any], Records]:
    """Return the config of a servo, and parts of its records about a step of the torque."""
    config = yaml.safe_load(files(DOCS / "rigs.md")["servo_repeats.yaml"])
    config["record"]["channels"]["w_2"]["noise"] = "ar1"
    del config["own"], config["experiments"]
    config["map"] = {"starts": 2, "evaluations": 500}
    rest = {"w_2": 0.0}
    parts: dict[str, tuple[list[int], Any]] = {
        "step": ([8, 14], "steady"), "start": ([0, 6], rest), "start_and_step": ([0, 14], rest),
    }  # fmt: skip
    records: dict[str, list[dict[str, Any]]] = {}
    for part, (window, initial) in parts.items():
        for path in sorted(SERVO.glob("*.mat"), reverse=True):
            (folder / path.name).unlink(missing_ok=True)
            (folder / path.name).symlink_to(path)
            level = path.stem.split("_")[2].replace(".", "_") if window[1] > 10 else "0_05"
            entry = {"record": {"file": path.name, "window": window}, "initial": initial}
            records.setdefault(f"{part}_{level}", []).append(entry)
    return config, records


@pytest.mark.slow
@pytest.mark.skipif(not CARTS.is_dir(), reason=ABSENT)
def test_a_square_wave_of_two_carts_ranks_further_records_as_refits_do(tmp_path: Path) -> None:
    promised, refitted = ranking(*carts(tmp_path), tmp_path)
    assert kendalltau(promised, refitted).statistic >= 0.8


@pytest.mark.slow
@pytest.mark.skipif(not SERVO.is_dir(), reason=ABSENT)
@pytest.mark.xfail(
    reason="tau is 0.33: records that begin at rest fit worse than the model promises"
)
def test_a_step_of_a_servo_ranks_further_records_as_refits_do(tmp_path: Path) -> None:
    promised, refitted = ranking(*servo(tmp_path), tmp_path)
    assert kendalltau(promised, refitted).statistic >= 0.8
