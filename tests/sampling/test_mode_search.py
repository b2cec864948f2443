"""The search for the MAP, on a problem with a known answer: where it ends, and what is said of it."""

import dataclasses
import math

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import noisy_step, posterior, replace_only, with_start

from bayesdrill.inference.laplace import TAIL_MASS
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.noise.mixed import ChannelNoise, Mixed
from bayesdrill.inference.noise.student_t import StudentT
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import HalfNormal, Prior, Uniform
from bayesdrill.sampling import mode_search
from bayesdrill.sampling.mode_search import LocalMaximum, Mode, Search
from bayesdrill.sampling.optimisers.nelder_mead import NelderMead

SIGMA = np.array([0.02, 0.03, 0.05, 0.04])
RECORD = noisy_step(SIGMA, n=200)
# Goes to the very maximum without any slopes.
THOROUGH = NelderMead(enough=1e-3, per_unknown=math.inf)


def two_unknowns(**priors: Prior) -> Posterior:
    return posterior(RECORD, SIGMA, free=("k_e", "k_s"), priors=priors)


def search(target: Posterior, evaluations: int = 4000, **start: float) -> Search:
    theta = target.space.vector({**NOMINAL, **start})
    return mode_search.searches(target, THOROUGH, evaluations, theta[None])[0]


def test_searches_agree_where_the_record_determines_everything() -> None:
    target = two_unknowns()
    starts = mode_search.starts(target, 4, np.random.default_rng(9))
    searches = mode_search.searches(target, THOROUGH, 4000, starts)
    mode = mode_search.summarise(target, tuple(searches))
    assert len(mode.highest) >= 2
    assert mode.wandering == ()
    assert mode.gain < 1e-6
    assert mode.at_bound == ()
    assert mode.others == ()
    assert mode.values["k_e"] == pytest.approx(NOMINAL["k_e"], rel=2e-3)
    assert max(abs(slope) for slope in mode.slope.values()) < 1e-3


def test_searches_that_end_in_another_maximum_do_not_wander() -> None:
    def ended(k_e: float, k_s: float) -> Search:
        end = {"k_e": k_e, "k_s": k_s}
        return Search(start=end, end=end, log_posterior=5.0, evaluations=1, settled=True)

    here, there, astray = ended(0.06, 0.26), ended(0.08, 0.26), ended(0.06, 0.3)
    flat = Mode(
        values=here.end, log_posterior=5.0, slope={}, gain=0.0, at_bound=(), searches=(here, there)
    )  # fmt: skip
    assert flat.wandering == ("k_e",)
    other = LocalMaximum(values=there.end, log_posterior=5.0)
    two = dataclasses.replace(flat, others=(other,))
    assert two.wandering == ()
    assert [top.values["k_e"] for top in two.maxima] == [0.06, 0.08]
    three = dataclasses.replace(two, searches=(here, there, astray))
    assert three.wandering == ("k_s",)
    assert len(three.highest) == 3


def test_starts_begin_with_the_configured_one() -> None:
    target = with_start(two_unknowns(), {"k_e": 0.05, "k_s": 0.3})
    starts = mode_search.starts(target, 3, np.random.default_rng(1))
    assert starts[0] == pytest.approx([0.05, 0.3])
    assert np.isfinite(target.density(starts)).all()


def test_a_start_is_improved_with_normal_noise_if_tails_are_heavy() -> None:
    """Otherwise all of a record but a few samples may count as outliers."""
    target = two_unknowns()
    noisy = [
        NoisyChannel(channel=c, sigma=s, start=s, entries={"degrees": 3.0})
        for c, s in zip(RECORD.channels, SIGMA.tolist(), strict=True)
    ]
    heavy, bad = StudentT.from_channels(noisy, 200), {"k_e": 0.08, "k_s": 0.15}
    for noise in (heavy, Mixed((ChannelNoise(heavy, (0, 1, 2, 3)),))):
        likelihood = replace_only(target.likelihood, noise=noise)
        tailed = with_start(dataclasses.replace(target, likelihood=likelihood), bad)
        (start,) = mode_search.starts(tailed, 1, np.random.default_rng(1))
        assert start == pytest.approx([NOMINAL["k_e"], NOMINAL["k_s"]], rel=0.01)


def test_a_search_that_ends_on_a_slope_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    target = two_unknowns()
    off = {"k_e": NOMINAL["k_e"] * 1.01, "k_s": NOMINAL["k_s"]}
    density = target.density(target.space.vector(off)[None])[0]
    stuck = dataclasses.replace(search(target, 1, **off), end=off, log_posterior=density)
    assert mode_search.summarise(target, (stuck,)).gain < 1e-6
    monkeypatch.setattr(mode_search, "POLISH_STEPS", 0)
    mode = mode_search.summarise(target, (stuck,))
    assert mode.values == pytest.approx(off)
    assert mode.gain > 1.0
    assert abs(mode.slope["k_e"]) > 1.0


def test_a_maximum_on_the_bound_is_named() -> None:
    """A prior that ends before the best k_s; the record determines k_e far below its own prior."""
    end = 0.9 * NOMINAL["k_s"]
    target = two_unknowns(k_s=Uniform(0.1, end), k_e=Uniform(0.0, 1e5 * NOMINAL["k_e"]))
    mode = mode_search.summarise(target, (search(target, k_s=0.2),))
    assert mode.at_bound == ("k_s",)
    assert 1 - 1e-6 < mode.values["k_s"] / end <= 1
    assert mode.slope["k_s"] == 0.0
    assert abs(mode.slope["k_e"]) < 1e-2
    assert mode.gain < 1e-4


@run_cases("logs", [True, None], ["log", "linear"])
def test_a_search_for_a_zero_ends_where_its_prior_does(logs: bool | None) -> None:
    """The record is of a rig with negative damping, so the less c_m the better, down to nothing."""
    prior = HalfNormal(2 * NOMINAL["c_m"])
    target = posterior(RECORD, SIGMA, free=("c_m", "k_s"), priors={"c_m": prior}, logs=logs)
    assert target.coordinates.logs == (bool(logs), True)
    y = target.likelihood.signals(np.array([[-2e-3, NOMINAL["k_s"]]]))[0]
    response = target.likelihood.only_observation.response.with_record(y)
    likelihood = replace_only(target.likelihood, response=response)
    target = dataclasses.replace(target, likelihood=likelihood)
    end = search(target)
    assert float(prior.quantile(np.array(TAIL_MASS))) <= end.end["c_m"] < 1e-3 * NOMINAL["c_m"]
    assert end.settled
    mode = mode_search.summarise(target, (end,))
    assert mode.at_bound == ("c_m",)
    assert np.isfinite(mode.gain)
