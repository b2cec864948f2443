"""Runs compared by evidence and by distance, and experiments compared with each other."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
from support.case_tables import run_cases
from support.compared_models import model, problem
from support.figure_checks import posterior as figure_draws
from support.missing_physics import best
from support.scipy_oracles import NOMINAL, ORDER
from support.small_problems import experiment, likelihood_of, unknown, vector

from bayesdrill.analysis.comparison import (
    PosteriorSummary,
    RepeatedProduct,
    RunSummary,
    Word,
    decide,
    differing,
    overlay_rows,
    probabilities,
    repeats,
)
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.report.sections.comparison import comparison_table, comparison_verdict, odds
from bayesdrill.report.sections.nominal import repeats_sentence, repeats_table
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.linear import Response

GIVEN = model("given", 0.0)
FRICTION, RED = {"rig": "rubbing"}, {"noise": "ar1"}
BOTH = {**FRICTION, **RED}


def models(friction: float, red: float, both: float | None = None) -> list[RunSummary]:
    """Return the given model, and three others with these log evidences."""
    more = [] if both is None else [model("d", both, **BOTH)]
    return [GIVEN, model("b", friction, **FRICTION), model("c", red, **RED), *more]


WORDS: dict[str, tuple[list[RunSummary], Word, str]] = {
    "too little": (models(2.0, 1.0), "neither", "b"),
    "the first": (models(-5.0, -6.0), "neither", "given"),
    "by chance": ([GIVEN, model("b", 4.0, **FRICTION, error=1.0)], "neither", "b"),
    "friction": (models(40.0, 20.0), "model", "b"),
    "red noise": (models(20.0, 40.0), "noise", "c"),
    "friction or noise": (models(41.0, 40.0), "either", "b"),
    "both": (models(20.0, 30.0, 60.0), "both", "d"),
    "friction, and red noise that is not needed": (models(59.0, 30.0, 60.0), "model", "d"),
    "red noise, and friction that is not needed": (models(20.0, 59.0, 60.0), "noise", "d"),
    "priors": ([GIVEN, model("b", 10.0)], "priors", "b"),
}


@run_cases("models, word, best", WORDS.values(), WORDS)
def test_the_word_follows_from_the_odds(models: list[RunSummary], word: Word, best: str) -> None:
    result = decide(models)
    assert (result.word, models[result.best].name) == (word, best)
    sentence = next(iter(comparison_verdict(models)))
    shown = {"both": "MODEL AND NOISE", "either": "MODEL OR NOISE"}.get(word, word.upper())
    assert sentence.startswith(f"verdict: {shown}")


def test_odds_are_those_of_the_evidence() -> None:
    shares = probabilities([model("a", -3000.0), model("b", -3000.0 + math.log(3.0))])
    assert shares == pytest.approx((0.25, 0.75))
    texts = [odds(x) for x in (0.0, math.log(7.5), math.log(120.4), 35.2)]
    assert texts == ["1", "7.5", "120", "e^35"]


@run_cases(
    "other, named",
    [
        (model("b", -4.0, vague="c_s"), ("c_s",)),
        (model("b", -40.0, vague="c_s"), ()),
        (model("b", -4.0, vague="k_s"), ()),
        (model("b", -4.0, vague="k_s", prior="another"), ("k_s",)),
    ],
    ["lost by little", "lost by far", "a prior of both", "another prior"],
)
def test_vague_priors_are_named_where_they_may_have_decided(
    other: RunSummary, named: tuple[str, ...]
) -> None:
    assert decide([model("best", 0.0, vague="k_s"), other]).vague == named


def test_models_that_must_not_be_believed_are_named_with_the_reasons() -> None:
    stopped = [GIVEN, model("stopped", 30.0, **FRICTION, rms=2.0)]
    text = "\n".join(comparison_verdict(stopped))
    assert "more than noise: none of these models explains the whole record" in text
    assert "stopped did not converge" in text
    table = comparison_table(stopped)
    assert [line[0] for line in table.lines] == ["stopped (NOT CONVERGED)", "given"]
    reasons = ("w_1 is off", "and coloured")
    layer = replace(GIVEN.layer, warning="DOES NOT FIT: much", reasons=reasons)
    doubted = [replace(GIVEN, layer=layer), model("best", 30.0, **FRICTION)]
    text = "\n".join(comparison_verdict(doubted))
    warning = "  DO NOT BELIEVE given: DOES NOT FIT: much\n    - w_1 is off\n    - and coloured"
    assert warning in text
    assert "BELIEVE best" not in text


def layer(name: str, shift: float = 0.0, stretch: float = 1.0, **settings: str) -> PosteriorSummary:
    """Return draws that are moved by `shift` sds, and stretched about their means."""
    x = figure_draws(3000)[:, :9]
    mean, sd = x.mean(axis=0), x.std(axis=0, ddof=1)
    draws = mean + stretch * (x - mean) + shift * sd
    return PosteriorSummary(name=name, mark=name, problem=problem(), draws=draws, settings=settings)


@run_cases("shift, stretch", [(2.0, 1.0), (-0.7, 1.0), (3.0, 4.0)])
def test_the_distance_of_shifted_draws_is_the_shift(shift: float, stretch: float) -> None:
    """In root mean squares of both sds."""
    for row in overlay_rows([layer("a"), layer("b", shift, stretch)]):
        assert row.distance == pytest.approx(abs(shift) / np.sqrt((1 + stretch**2) / 2))
        first, second = row.places
        assert second.sd == pytest.approx(stretch * first.sd)
        assert first.low < first.mean < first.high


def test_of_several_runs_the_farthest_two_are_named() -> None:
    for row in overlay_rows([layer("a", 0.2), layer("b", -1.0), layer("c", 1.5)]):
        assert row.pair == (1, 2)
        assert row.distance == pytest.approx(2.5)


def test_settings_that_are_not_the_same_everywhere_are_named() -> None:
    layers = [layer("a", seed="1", k_s="normal"), layer("b", seed="1", k_e="held")]
    assert differing(layers) == {"k_s": ("normal", None), "k_e": (None, "held")}
    assert differing([layer("a", seed="1"), layer("b", seed="1")]) == {}


SIGMA, FREE = 0.05, ("k_e", "k_s", "j_1")
MEASURES = {"theta_1": {"theta_1": 1.0}, "w_1": {"w_1": 1.0}}


def compared(stiffer: float, seed: int = 0) -> tuple[RepeatedProduct, ...]:
    """Return the comparison of experiments, in the last of which the shaft is so much stiffer."""
    rng, pairs = np.random.default_rng(seed), []
    for k, volt in enumerate((3.0, 8.0, 5.0)):
        clean = experiment(200, 0.01, constant={"v": volt, "t_1": 0.0}, measures=MEASURES)
        k_s = NOMINAL["k_s"] * (stiffer if k == 2 else 1.0)
        y = Response(MotorShaft(), clean).signals(vector({**NOMINAL, "k_s": k_s})[None])[0]
        record = replace(clean, y=y + SIGMA * rng.standard_normal(y.shape))
        noisy = [NoisyChannel(channel=c, sigma=SIGMA, start=SIGMA) for c in record.channels]
        pairs.append((Response(MotorShaft(), record), White.from_channels(noisy, len(y))))
    priors = {name: Uniform(0.5 * NOMINAL[name], 2 * NOMINAL[name]) for name in FREE}
    unknowns = tuple(unknown(name, prior) for name, prior in priors.items())
    fixed = {name: NOMINAL[name] for name in ORDER if name not in FREE}
    space = ParameterSpace(model=ORDER, unknowns=unknowns, fixed=fixed)
    likelihood = likelihood_of(space, *pairs)
    labelled = [
        replace(one, label=f"run_{k}") for k, one in enumerate(likelihood.observations, start=1)
    ]
    likelihood = dataclasses.replace(likelihood, observations=tuple(labelled))
    theta = best(Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates))
    return repeats(SensitivityStudy(likelihood), theta, [(1, 0, 0), (0, 1, -1), (0, 0, 1)])


@pytest.mark.slow
def test_experiments_with_one_rig_hardly_ever_differ() -> None:
    """Over 16 sets p is uniform enough."""
    p = np.array([[product.p for product in compared(1.0, seed)] for seed in range(16)])
    assert 0.3 < p.mean() < 0.7
    assert (p < 0.01 / 3).sum() <= 2


def test_a_shaft_that_changes_between_experiments_is_noticed_with_its_size() -> None:
    """4 % more stiffness in one of three: a standard deviation of the logs of 0.0226."""
    products = compared(1.04)
    k_e, ratio, _ = products
    assert ratio.differs
    assert not k_e.differs
    assert ratio.labels == ("run_1", "run_2", "run_3")
    apart = np.array(ratio.apart)
    assert apart[2] - apart[:2].mean() == pytest.approx(np.log(1.04), abs=4 * max(ratio.sds))
    assert ratio.spread == pytest.approx(np.log(1.04) / np.sqrt(3), rel=0.4)
    text = repeats_sentence(products, FREE)
    assert "do not show the same rig" in text
    assert "k_s/j_1" in text.replace(" ", "")
    assert len(repeats_table(products, FREE).lines) == 3
