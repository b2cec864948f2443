"""Promised sds are those of samples under the priors as they are, with their ends."""

import csv
from pathlib import Path

import numpy as np
import scipy

import bayesdrill as bd
from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.sampling.samplers.elliptical_slices import elliptical_slices

PUBLISHED = Path("results/published/nominal_step")


def test_elliptical_slices_sample_a_gaussian_with_ends() -> None:
    """Two directions of a correlated Gaussian are cut to a band, and follow the exact moments."""
    covariance = np.array([[1.0, 0.8], [0.8, 1.0]])
    root = np.linalg.cholesky(covariance).T

    def within(points: Array, here: Indices) -> Array:
        return np.where((points[:, 0] > -0.2) & (points[:, 0] < 2.0), 0.0, -np.inf)

    rng = np.random.default_rng(2)
    path = elliptical_slices(np.repeat(root[None], 2000, axis=0), within, 60, rng)[30:]
    cut = scipy.stats.truncnorm(-0.2, 2.0)
    x, y = path.reshape(-1, 2).T
    assert abs(x.mean() - cut.mean()) < 0.02
    assert abs(x.std() / cut.std() - 1.0) < 0.02
    assert abs(y.mean() - 0.8 * cut.mean()) < 0.02
    assert abs(y.std() / np.sqrt(0.64 * cut.var() + 0.36) - 1.0) < 0.02


def test_the_promise_for_the_bundled_record_is_what_its_published_run_has() -> None:
    """`k_e` depends by a curve on `c_m`, which stays between the ends of its prior."""
    published = {}
    for table in ("summary.csv", "derived.csv"):
        with (PUBLISHED / table).open(encoding="utf-8") as file:
            rows = csv.DictReader(file)
            published |= {row["name"]: float(row["sd"]) / abs(float(row["mean"])) for row in rows}
    case = bd.load("configs/nominal_step.yaml")
    formulas = {"k_s_over_j_1": "k_s/j_1", "k_T_over_r_m_k_s": "k_T/(r_m*k_s)"}
    formulas |= {"j_m_over_k_s": "j_m/k_s", "k_e": "k_e"}
    designed = case.design([*formulas.values()], hold=1.0, family="step", draws=1)
    for (name, formula), target in zip(formulas.items(), designed.design.targets, strict=True):
        assert target.name == formula
        assert abs(target.after["as recorded"] / published[name] - 1.0) < 0.05, formula
