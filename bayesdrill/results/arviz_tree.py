"""The result as an ArviZ tree: `chain` is an ensemble, draws are nearly independent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from arviz_base import from_dict
from numpy.typing import NDArray
from xarray import DataTree

from bayesdrill.basics.symbols import INPUTS
from bayesdrill.engines.sampling import Sampled
from bayesdrill.inference.problem import Problem
from bayesdrill.insight.derived import Derived

Array = NDArray[np.float64]

PRIOR_DRAWS = 2000


def make_tree(
    problem: Problem,
    sampled: Sampled,
    predictive_draws: int,
    rng: np.random.Generator,
    prior_rng: np.random.Generator,
    attributes: Mapping[str, Any],
    derived: Derived,
) -> DataTree:
    """Groups as in the ArviZ schema; units and meanings as attributes of the variables.

    `derived` follows from `posterior`, draw by draw; NaN where a draw has no such value.
    `log_likelihood` (pointwise) and `posterior_predictive` hold `predictive_draws` draws of every
    chain, evenly spaced; their `draw` coordinate says which.
    """
    draws = sampled.draws
    chosen = np.unique(np.linspace(0, draws.shape[1] - 1, predictive_draws).astype(int))
    experiment = problem.experiment
    predictive, pointwise = _predict(problem, draws[:, chosen], rng)
    prior = problem.posterior.space.draw(PRIOR_DRAWS, prior_rng)[None]
    time = {name: ["time"] for name in experiment.names}
    inputs = {name: np.asarray(value) for name, value in experiment.constant.items()}
    tree: DataTree = from_dict(
        {
            "posterior": _named(problem, draws),
            "sample_stats": {"lp": sampled.log_p},
            "prior": _named(problem, prior),
            "derived": {
                symbol.name: derived.values[..., q] for q, symbol in enumerate(derived.symbols)
            },
        }
    )
    tree["sample_stats"].attrs["lp"] = "log density over the sampler's coordinates, unnormalised"
    tree["sample_stats"]["lp"].attrs.update(units="1", long_name="log posterior density")
    tree["sample_stats"].attrs["acceptance_rate"] = sampled.acceptance
    rest: DataTree = from_dict(
        {
            "posterior_predictive": predictive,
            "log_likelihood": pointwise,
            "observed_data": dict(zip(experiment.names, experiment.y.T, strict=True)),
            "constant_data": {**inputs, **experiment.series},
        },
        dims={**time, **{name: ["time"] for name in experiment.series}},
        coords={"time": experiment.t, "draw": chosen},
    )
    for name, group in rest.children.items():
        tree[name] = group.copy()
    _describe(tree, problem)
    for symbol in derived.symbols:
        tree["derived"][symbol.name].attrs.update(units=symbol.unit, long_name=symbol.meaning)
    tree.attrs.update(attributes)
    tree["posterior"].attrs.update(attributes)
    return tree


def _predict(
    problem: Problem, draws: Array, rng: np.random.Generator
) -> tuple[dict[str, NDArray[np.float32]], dict[str, NDArray[np.float32]]]:
    """Predictive samples and pointwise log likelihood `(E, N, T)` per channel, in 32 bits."""
    likelihood = problem.posterior.likelihood
    shape = (*draws.shape[:2], len(problem.experiment.t))
    names = problem.experiment.names
    predictive = {name: np.empty(shape, np.float32) for name in names}
    pointwise = {name: np.empty(shape, np.float32) for name in names}
    for chain, theta in enumerate(draws):
        signals = likelihood.signals(theta)
        sigma = likelihood.own(theta)
        fresh = likelihood.noise.draw(signals, sigma, rng)
        log_p = likelihood.noise.pointwise(problem.experiment.y - signals, sigma)
        for k, name in enumerate(names):
            predictive[name][chain] = fresh[..., k]
            pointwise[name][chain] = log_p[..., k]
    return predictive, pointwise


def _named(problem: Problem, draws: Array) -> dict[str, Array]:
    return {name: draws[..., d] for d, name in enumerate(problem.names)}


def _describe(tree: DataTree, problem: Problem) -> None:
    for group in ("posterior", "prior"):
        for symbol in problem.symbols:
            tree[group][symbol.name].attrs.update(units=symbol.unit, long_name=symbol.meaning)
    for group in ("posterior_predictive", "observed_data"):
        for channel in problem.experiment.channels:
            tree[group][channel.name].attrs["units"] = channel.unit
    for channel in problem.experiment.channels:
        said = f"log density of each sample of {channel.name} in {channel.unit}"
        tree["log_likelihood"][channel.name].attrs.update(units="1", long_name=said)
    for name, values in tree["constant_data"].data_vars.items():
        symbol = INPUTS[str(name)]
        values.attrs.update(units=symbol.unit, long_name=symbol.meaning)
    for group in ("posterior_predictive", "log_likelihood", "observed_data", "constant_data"):
        if "time" in tree[group].coords:
            tree[group].coords["time"].attrs["units"] = "s"
