"""Designed experiments tell models apart, as simulated records and fits of both confirm."""

from pathlib import Path

import numpy as np
import pytest
from support.array_cases import BOX, NOMINAL, two
from support.case_tables import slow_except
from support.command_line import assert_refused, cli, small_config

import bayesdrill as bd
from bayesdrill.design.responses import ComingExperiment
from bayesdrill.design.rivals import fitted_rivals
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.gauss_newton import gauss_newton

USUAL = dict.fromkeys(NOMINAL, "nominal") | {"k_s": BOX, "t_f": BOX}
RIVALS = {
    "motor": {"parameters": USUAL | {"k_e": 1.0125 * NOMINAL["k_e"]}},
    "gear": {"rig": bd.MotorShaft(i_m=1 / 7.9)},  # another structure, which is compiled for it
}


@pytest.mark.parametrize("name", slow_except(("motor",), RIVALS))
def test_a_designed_experiment_tells_a_rival_apart_as_it_promises(name: str) -> None:
    """Fits of both models to noisy records have the promised log odds, within their scatter."""
    ours, rival = two(), two(**RIVALS[name])
    numbers = {"high": 12.0, "hold": 0.25, "duration": 1.0, "draws": 1}
    designed = ours.design(tell=rival, **numbers)
    odds = designed.design.log_odds
    assert odds["designed"] >= max(odds[name] for name in ("step", "prbs", "chirp", "steps"))
    source = designed.design.request.source
    own, other = (
        ComingExperiment.from_observation(case.job.problem.observations[0], source).posterior(
            designed.levels
        )
        for case in (ours, rival)
    )
    truth, rng = own.space.vector(own.space.start)[None], np.random.default_rng(7)
    observation = own.likelihood.only_observation
    signals, differences = observation.signals(own.space.full(truth)), []
    for _ in range(8):
        record = observation.draw(signals, truth, rng)[0]
        fits = [_height(each.edit(records=[record]), truth) for each in (own, other)]
        differences.append(fits[0] - fits[1])
    # The log odds of a record scatter by the root of twice their mean.
    scatter = np.sqrt(2.0 * odds["designed"] / len(differences))
    assert np.mean(differences) == pytest.approx(odds["designed"], abs=4.0 * scatter + 1.0)


def _height(posterior: Posterior, start: np.ndarray) -> float:
    """Return the largest log density, of a search from `start`."""
    surface = LogDensity(posterior, physical=True)
    return float(gauss_newton(surface, posterior.coordinates.from_physical(start), 30).value[0])


def test_a_model_is_fitted_away_by_itself_and_refused_as_a_rival() -> None:
    case = two()
    posterior = case.job.problem.posterior
    draws = posterior.space.draw(2, np.random.default_rng(1))
    squares, fits = fitted_rivals(posterior, posterior, draws, [draws[[1]], draws[[0]]])
    assert squares.max() < 1e-6
    np.testing.assert_allclose(fits, draws, rtol=1e-4)
    with pytest.raises(bd.InputError, match="nothing distinguishes the two"):
        case.design(tell=case, high=12.0, hold=0.5, duration=1.0, draws=1)


def test_a_rival_needs_the_same_channels_and_no_targets(tmp_path: Path) -> None:
    config = small_config(tmp_path)
    fewer = two(channels={"w_1": bd.Channel(two().columns["w_1"], "rad/s", sigma=0.1)})
    with pytest.raises(bd.InputError, match="the channels w_1 are not those of the config"):
        two().design(tell=fewer, draws=1)
    command = ("design", config, "--tell", config)
    assert_refused(cli(*command, "--learn", "k_e"), "give only one")
