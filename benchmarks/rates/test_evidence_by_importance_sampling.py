"""The evidence of the bundled config by plain importance sampling, in coordinates of the physics.

Nothing of proposal, coordinates or chain density is shared with the package.
"""

import itertools
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

import bayesdrill as bd

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"
V = 8.0
LOOSE = ("j_1", "r_m", "c_m", "t_f")
CLOSE = 0.02  # of log Z
DRAWS, AT_ONCE = 600_000, 20_000
DEGREE, WIDER, FREEDOM = 3, 1.15, 8  # of the ridge, and of the Student t across it

Named = dict[str, np.ndarray]


def determined(p: Named) -> np.ndarray:
    """What a step response shows of the rig `(N, 5)`: two frequencies, the steady speed, two time
    constants.
    """
    damped = p["k_T"] * p["k_e"] + p["r_m"] * p["c_m"]
    speed = (V * p["k_T"] - p["r_m"] * p["t_f"]) / damped
    shown = (
        p["k_s"] / p["j_1"],
        p["k_s"] / p["j_m"],
        speed,
        p["r_m"] * p["j_m"] / damped,
        p["l_m"] / p["r_m"],
    )
    return np.log(np.stack(shown, axis=1))


def parameters(loose: Named, shown: np.ndarray) -> tuple[Named, np.ndarray]:
    """All nine, and log |d nine / d (four, shown)|."""
    stiff, light, speed, slow, quick = np.exp(shown).T
    p = dict(loose)
    p["k_s"] = stiff * p["j_1"]
    p["j_m"] = p["k_s"] / light
    p["l_m"] = quick * p["r_m"]
    damped = p["r_m"] * p["j_m"] / slow
    p["k_T"] = (speed * damped + p["r_m"] * p["t_f"]) / V
    p["k_e"] = (damped - p["r_m"] * p["c_m"]) / p["k_T"]
    volume = p["k_s"] * p["j_m"] * p["l_m"] * damped**2 * speed / (V * p["k_T"])
    return p, np.log(volume)


def monomials(x: np.ndarray) -> np.ndarray:
    """`(N, 4)` to `(N, terms)`."""
    chosen = [
        list(columns)
        for degree in range(DEGREE + 1)
        for columns in itertools.combinations_with_replacement(range(x.shape[1]), degree)
    ]
    return np.stack([x[:, columns].prod(axis=1) for columns in chosen], axis=1)


@cache
def case() -> bd.Case:
    return bd.load(CONFIG)


@cache
def run(seed: int) -> bd.Run:
    return case().sample(seed=seed)


def importance() -> tuple[float, float]:
    """Log evidence and its standard error."""
    posterior, names = case().job.problem.posterior, case().unknowns
    priors = posterior.space.priors
    draws = {name: x.ravel() for name, x in run(2013).draws.items()}
    low, high = (
        np.array([getattr(priors[name], end) for name in LOOSE]) for end in ("low", "high")
    )

    def scaled(p: Named) -> np.ndarray:
        return (np.stack([p[name] for name in LOOSE], axis=1) - low) / (high - low) * 2.0 - 1.0

    rows, shown = monomials(scaled(draws)), determined(draws)
    slopes = np.linalg.lstsq(rows, shown)[0]
    root = WIDER * np.linalg.cholesky(np.cov((shown - rows @ slopes).T))
    across = scipy.stats.multivariate_t(np.zeros(5), np.eye(5), df=FREEDOM)
    flat = math.log(float(np.prod(high - low)))
    rng = np.random.default_rng(11)
    log_w = []
    for _ in range(DRAWS // AT_ONCE):
        loose = dict(zip(LOOSE, (low + (high - low) * rng.random((AT_ONCE, 4))).T, strict=True))
        e = across.rvs(AT_ONCE, random_state=rng)
        p, volume = parameters(loose, monomials(scaled(loose)) @ slopes + e @ root.T)
        log_q = across.logpdf(e) - np.log(np.diag(root)).sum() - flat - volume
        log_w.append(posterior.density(np.stack([p[name] for name in names], axis=1)) - log_q)
    log_weights = np.concatenate(log_w)
    w = np.exp(log_weights - log_weights.max())
    return log_weights.max() + math.log(w.mean()), float(w.std() / w.mean() / math.sqrt(len(w)))


@pytest.mark.slow
def test_the_evidence_of_the_bundled_config_is_that_of_importance_sampling() -> None:
    log_z, error = importance()
    assert error < 0.2 * CLOSE
    results = [run(seed).evidence for seed in (2013, 1, 2)]
    for result in results:
        assert result is not None
        assert result.error < 0.3 * CLOSE
        assert abs(result.log_z - log_z) < CLOSE
    assert np.ptp([result.log_z for result in results if result is not None]) < CLOSE
