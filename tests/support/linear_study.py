"""A study that is exactly linear, and the exact posterior of any record of it; what a record shows."""

import itertools
import math
from collections.abc import Collection

import numpy as np
from support.scipy_oracles import NOMINAL

from bayesdrill.analysis.identifiability.information import Information, root_of, simple_exponents
from bayesdrill.analysis.identifiability.structure import ScalingStructure
from bayesdrill.analysis.identifiability.study import IdentifiabilityStudy, KnownProduct, products
from bayesdrill.analysis.verdict import Verdict, judge
from bayesdrill.config.schema.config import IdentifySpec

N = 4000
RNG = np.random.default_rng(8)
PRIOR_SD = 0.3
NAMES = ("k_s", "j_1", "r_m")
TABLE = {name: NOMINAL[name] for name in NAMES}
# The record sees k_s/j_1 to 1 % and r_m to 2 %, and k_s and j_1 not by themselves.
ROOT = root_of(np.array([[100.0, -100.0, 0.0], [0.0, 0.0, 50.0]]))


def linear_study(prior_sd: np.ndarray) -> IdentifiabilityStudy:
    known = Information(NAMES, ROOT)
    words = IdentifySpec()
    joint = known.with_priors(prior_sd)

    def product(exponents: tuple[int, ...]) -> KnownProduct:
        e = np.array(exponents, dtype=float)
        sd, before = joint.bound(e), float(np.linalg.norm(prior_sd * e))
        return KnownProduct(
            exponents=exponents,
            sd=sd,
            prior_sd=before,
            bound=known.bound(e),
            word=words.classify(sd / before),
        )

    return IdentifiabilityStudy(
        names=NAMES,
        at="the start",
        of_interest=NAMES,
        structure=ScalingStructure(
            names=NAMES, symmetries=((1, 1, 0),), invariants=((0, 0, 1), (1, -1, 0)), unexplained=0
        ),
        parameters=tuple(product(e) for e in ((1, 0, 0), (0, 1, 0), (0, 0, 1))),
        products=products(known, prior_sd, simple_exponents(3), words),
        information=known,
        remedies=(),
    )


LINEAR = linear_study(np.full(3, PRIOR_SD))
PRIOR = np.exp(PRIOR_SD * RNG.standard_normal((5000, 3))) * list(TABLE.values())


def gaussian(truth: dict[str, float], rng: np.random.Generator, n: int = N) -> np.ndarray:
    """Return exact posterior draws of one record of a rig at `truth`, with priors in logs."""
    log_truth = np.log([truth[name] / TABLE[name] for name in NAMES])
    precision = ROOT.T @ ROOT + np.eye(3) / PRIOR_SD**2
    data = ROOT.T @ (ROOT @ log_truth + rng.standard_normal(3))
    mean = np.linalg.solve(precision, data)
    root = np.linalg.cholesky(np.linalg.inv(precision))
    return np.exp(mean + rng.standard_normal((n, 3)) @ root.T) * list(TABLE.values())


def verdict(
    draws: np.ndarray, tolerance: float = 0.0, pressed: tuple[str, ...] = (), *, fits: bool = True
) -> Verdict:
    limits = dict.fromkeys(NAMES, tolerance)
    return judge(LINEAR, draws, PRIOR, TABLE, limits, pressed, IdentifySpec(), model_fits=fits)


def off_by(study: IdentifiabilityStudy, named: Collection[str], off: float) -> dict[str, float]:
    """Return by how many sigmas the record shows each of the `named` that is `off` relatively.

    The most over all products of up to three of them, with powers up to two, that no symmetry changes
    and that the record brings below half of the prior: counted one by one, no basis among them.
    """
    priors = np.array([parameter.prior_sd for parameter in study.parameters])
    root = study.information.root
    covariance = np.linalg.inv(root.T @ root + np.diag(priors**-2.0))
    symmetries = np.array(study.structure.symmetries, dtype=float).reshape(-1, len(priors))
    columns = [study.names.index(name) for name in named]
    sigmas = dict.fromkeys(named, 0.0)
    for size in (1, 2, 3):
        for chosen in itertools.combinations(columns, size):
            for powers in itertools.product((1, -1, 2, -2), repeat=size):
                e = np.zeros(len(priors))
                e[list(chosen)] = powers
                sd = math.sqrt(e @ covariance @ e)
                if (symmetries @ e).any() or sd > 0.5 * np.linalg.norm(e * priors):
                    continue
                for column, power in zip(chosen, powers, strict=True):
                    name = study.names[column]
                    sigmas[name] = max(sigmas[name], abs(power) * math.log1p(off) / sd)
    return sigmas


K_S, J_1, R_M, RATIO = (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -1, 0)  # exponents of k_s, j_1, r_m


def words(result: Verdict) -> dict[tuple[int, ...], str]:
    return {q.exponents: q.says for q in (*result.products, *result.parameters)}


def draws_of(seed: int, **factors: float) -> np.ndarray:
    """Return draws of the posterior of a rig whose values are `factors` times those of the table."""
    truth = {name: value * factors.get(name, 1.0) for name, value in TABLE.items()}
    return gaussian(truth, np.random.default_rng(seed))
