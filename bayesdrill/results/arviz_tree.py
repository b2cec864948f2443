"""Make the ArviZ tree of a result; each chain has nearly independent draws of one ensemble."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from arviz_base import from_dict
from numpy.typing import NDArray
from xarray import DataTree

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.derived import Derived
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.unknowns import labelled_name
from bayesdrill.sampling.ensembles import SamplingResult

PRIOR_DRAWS = 2000  # number of draws in the group `prior`


def make_tree(
    problem: Problem,
    sampled: SamplingResult,
    predictive_draws: int,
    rng: np.random.Generator,
    prior_rng: np.random.Generator,
    attributes: Mapping[str, Any],
    derived: Derived,
) -> DataTree:
    """Return the groups of the ArviZ schema, with units and meanings as attributes of variables.

    The group `derived` has a value for each draw of `posterior`, or NaN. The pointwise
    `log_likelihood` and `posterior_predictive` have `predictive_draws` evenly spaced draws of every
    chain, numbered by the coordinate `draw`. With `predictive_draws` = 0, both groups are missing.
    """
    draws = sampled.draws
    used_draws = np.unique(np.linspace(0, draws.shape[1] - 1, predictive_draws).astype(int))
    columns = _columns(problem)
    predicted = {}
    if predictive_draws:
        predictive, pointwise = _predict(problem, columns, draws[:, used_draws], rng)
        predicted = {"posterior_predictive": predictive, "log_likelihood": pointwise}
    prior = problem.posterior.space.draw(PRIOR_DRAWS, prior_rng)[None]
    inputs: dict[str, Any] = {}
    dims = {c.name: [_clock(c.observation)] for c in columns}
    coords: dict[str, Any] = {_clock(o): o.experiment.t for o in problem.observations}
    coords |= {"draw": used_draws} if predicted else {}
    for observation in problem.observations:
        experiment, label = observation.experiment, observation.label
        for name, value in (*experiment.constant.items(), *experiment.series.items()):
            inputs[labelled_name(name, label)] = np.asarray(value)
        dims |= {labelled_name(name, label): [_clock(observation)] for name in experiment.series}
    names, derived_names = problem.names, [symbol.name for symbol in derived.symbols]
    tree: DataTree = from_dict(
        {
            "posterior": {name: draws[..., d] for d, name in enumerate(names)},
            "sample_stats": {"lp": sampled.log_p},
            "prior": {name: prior[..., d] for d, name in enumerate(names)},
            "derived": {name: derived.values[..., q] for q, name in enumerate(derived_names)},
        }
    )
    tree["sample_stats"].attrs["lp"] = "log density over the sampler's coordinates, unnormalised"
    tree["sample_stats"]["lp"].attrs.update(units="1", long_name="log posterior density")
    tree["sample_stats"].attrs["acceptance_rate"] = sampled.acceptance
    with warnings.catch_warnings():  # ArviZ warns if a group has more chains than draws
        warnings.filterwarnings("ignore", "Found chain dimension")
        groups: DataTree = from_dict(
            {
                **predicted,
                "observed_data": {c.name: c.observation.experiment.y[:, c.index] for c in columns},
                "constant_data": inputs,
            },
            dims=dims,
            coords=coords,
        )
    for name, group in groups.children.items():
        tree[name] = group.copy()
    _describe(tree, problem, columns, derived.symbols)
    tree.attrs.update(attributes)
    tree["posterior"].attrs.update(attributes)
    return tree


def _predict(
    problem: Problem, columns: Sequence[_Column], draws: Array, rng: np.random.Generator
) -> tuple[dict[str, NDArray[np.float32]], dict[str, NDArray[np.float32]]]:
    """Return predictive samples and pointwise log likelihood of each channel, `(E, N, T)` each."""
    space = problem.posterior.space
    shapes = {c.name: (*draws.shape[:2], len(c.observation.experiment.t)) for c in columns}
    predictive = {name: np.empty(shape, np.float32) for name, shape in shapes.items()}
    pointwise = {name: np.empty(shape, np.float32) for name, shape in shapes.items()}
    for chain, theta in enumerate(draws):
        full = space.full(theta)
        for observation in problem.observations:
            signals = observation.signals(full)
            fresh = observation.replicate(signals, theta, rng)
            log_p = observation.pointwise(observation.experiment.y - signals, theta)
            for c in (c for c in columns if c.observation is observation):
                predictive[c.name][chain] = fresh[..., c.index]
                pointwise[c.name][chain] = log_p[..., c.index]
    return predictive, pointwise


@dataclass(frozen=True, slots=True)
class _Column:
    """A column is a channel of one experiment, under its name in the tree."""

    name: str
    observation: Observation
    index: int

    @property
    def unit(self) -> str:
        return self.observation.experiment.channels[self.index].unit


def _clock(observation: Observation) -> str:
    return labelled_name("time", observation.label)


def _columns(problem: Problem) -> list[_Column]:
    return [
        _Column(labelled_name(name, observation.label), observation, index)
        for observation in problem.observations
        for index, name in enumerate(observation.experiment.names)
    ]


def _describe(
    tree: DataTree, problem: Problem, columns: Sequence[_Column], derived: Sequence[Symbol]
) -> None:
    """Add units and meanings to the variables of a tree."""
    inputs = []
    for observation in problem.observations:
        experiment, label = observation.experiment, observation.label
        for name in (*experiment.constant, *experiment.series):
            symbol = experiment.input_symbols[name]
            inputs.append(dataclasses.replace(symbol, name=labelled_name(name, label)))
    symbols = {"posterior": problem.symbols, "prior": problem.symbols}
    for group, variables in {**symbols, "derived": derived, "constant_data": inputs}.items():
        for symbol in variables:
            tree[group][symbol.name].attrs.update(units=symbol.unit, long_name=symbol.meaning)
    groups = ("posterior_predictive", "log_likelihood", "observed_data", "constant_data")
    present = [group for group in groups if group in tree.children]
    for c in columns:
        for group in {"posterior_predictive", "observed_data"} & {*present}:
            tree[group][c.name].attrs["units"] = c.unit
        if "log_likelihood" in present:
            text = f"log density of each sample of {c.name} in {c.unit}"
            tree["log_likelihood"][c.name].attrs.update(units="1", long_name=text)
    for group in present:
        for clock in map(_clock, problem.observations):
            if clock in tree[group].coords:
                tree[group].coords[clock].attrs["units"] = "s"
