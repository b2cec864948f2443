"""Small experiments and problems for tests."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
from support.scipy_oracles import NOMINAL, ORDER

from bayesdrill.basics.symbols import PARAMETERS, own_symbol
from bayesdrill.inference import step_error
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.noise.contract import Noise, NoisyChannel
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.priors import Prior, Uniform
from bayesdrill.inference.unknowns import ParameterSpace, Transform, Unknown
from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Linear
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.linear import Response

STATES = ("theta_1", "theta_2", "w_1", "w_2", "i")


@contextmanager
def starts_believed() -> Iterator[None]:
    """Let no job look whether its start has a finite density, or how fine steps there have to be.

    For tests of many rigs that only read configs: kernels would be compiled for each.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(step_error, "choose_steps", lambda posterior, *_: posterior)
        patch.setattr(Likelihood, "__call__", lambda _, theta: np.zeros(len(theta)))
        patch.setattr(Likelihood, "mean_square", lambda _, theta: np.ones(len(theta)))
        yield


class UnevenShaft(MotorShaft):
    """A rig with j_m in the place of j_1 in one element of A: its shaft pulls unevenly."""

    def linear(self, p: Named) -> Linear:
        linear = super().linear(p)
        pull = linear.A["w_2", "theta_1"] * p["j_m"] / p["j_1"]
        return Linear(A={**linear.A, ("w_2", "theta_1"): pull}, B=linear.B, c=linear.c)


def experiment(
    n: int = 301,
    dt: float = 0.01,
    *,
    first: float = 0.0,
    t_start: float = 0.0,
    constant: dict[str, float] | None = None,
    series: dict[str, np.ndarray] | None = None,
    first_order: bool = False,
    start: dict[str, float] | None = None,
    measures: dict[str, dict[str, float]] | None = None,
    y: np.ndarray | None = None,
) -> Experiment:
    """Return an experiment whose data are zero on every state, unless arguments say otherwise."""
    weights = measures or {name: {name: 1.0} for name in STATES}
    channels = tuple(
        Channel(name=name, weights=w, unit="rad", latex=name, latex_unit="rad")
        for name, w in weights.items()
    )
    return Experiment(
        t=first + dt * np.arange(n),
        y=np.zeros((n, len(channels))) if y is None else y,
        channels=channels,
        constant={"v": 8.0, "t_1": 0.0} if constant is None else constant,
        series=series or {},
        first_order=first_order,
        start=start or {},
        t_start=t_start,
    )


def vector(p: dict[str, float]) -> np.ndarray:
    return np.array([p[name] for name in ORDER])


def noisy_step(sigma: np.ndarray, n: int = 301, dt: float = 0.01, seed: int = 5) -> Experiment:
    """Simulate four channels of the nominal rig after an 8 V step, with noise `sigma (4,)`."""
    four = {name: {name: 1.0} for name in STATES[:4]}
    response = Response(MotorShaft(), experiment(n, dt, measures=four))
    (clean,) = response.signals(vector(NOMINAL)[None])
    noise = np.random.default_rng(seed).standard_normal(clean.shape) * sigma
    return experiment(n, dt, measures=four, y=clean + noise)


def posterior(
    record: Experiment,
    sigma: np.ndarray | None,
    *,
    free: tuple[str, ...] = ORDER,
    priors: dict[str, Prior] | None = None,
    logs: bool | None = None,
    response: Response | None = None,
) -> Posterior:
    """Return that of the nominal rig with white noise, where `sigma` None is unknown in each channel.

    `logs` says whether the coordinates of all unknowns are their logs; None leaves that to the priors.
    `response` is one that is compiled already.
    """
    chosen: dict[str, Prior] = {n: Uniform(0.5 * NOMINAL[n], 1.5 * NOMINAL[n]) for n in free}
    chosen |= priors or {}
    levels: list[Prior | float] = [
        chosen.pop(f"sigma_{channel.name}", Uniform(0.01, 1.0))
        if sigma is None
        else float(sigma[k])
        for k, channel in enumerate(record.channels)
    ]
    transform: Transform | None = None if logs is None else "log" if logs else "plain"
    unknowns = [unknown(name, prior, transform) for name, prior in chosen.items()]
    noise = _white(record, levels, [0.1] * len(levels))
    unknowns += [replace(level, transform=transform) for level in noise.unknowns]
    fixed = {name: NOMINAL[name] for name in ORDER if name not in free}
    simulator = response or Response(MotorShaft(), record)
    return _assemble(ORDER, unknowns, fixed, simulator, noise)


def posterior_of(
    simulator: Simulator,
    sigma: Iterable[float],
    priors: Mapping[str, Prior],
    values: Mapping[str, float],
) -> Posterior:
    """Return that of white noise of known `sigma`; parameters without a prior keep their `values`."""
    names, levels = simulator.parameters, [float(sd) for sd in sigma]
    unknowns = [replace(unknown(name, p), start=values[name]) for name, p in priors.items()]
    fixed = {name: float(values[name]) for name in names if name not in priors}
    noise = _white(simulator.experiment, levels, levels)
    return _assemble(names, unknowns, fixed, simulator, noise)


def _white(record: Experiment, sigma: Sequence[Prior | float], starts: Sequence[float]) -> White:
    noisy = [
        NoisyChannel(channel=channel, sigma=level, start=start)
        for channel, level, start in zip(record.channels, sigma, starts, strict=True)
    ]
    return White.from_channels(noisy, len(record.t))


def _assemble(
    model: tuple[str, ...],
    unknowns: list[Unknown],
    fixed: dict[str, float],
    simulator: Simulator,
    noise: Noise,
) -> Posterior:
    space = ParameterSpace(model=model, unknowns=tuple(unknowns), fixed=fixed)
    likelihood = likelihood_of(space, (simulator, noise))
    return Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)


def unknown(name: str, prior: Prior, transform: Transform | None = None) -> Unknown:
    """Return a parameter of the rig if there is one of that name, and else a quantity."""
    if name in PARAMETERS:
        symbol, start = PARAMETERS[name], NOMINAL.get(name, 1.0)
        return Unknown(symbol=symbol, role="rig", prior=prior, start=start, transform=transform)
    start = float(prior.quantile(np.array([0.5]))[0])
    symbol = own_symbol(name, "1", None, name)
    return Unknown(symbol=symbol, role="quantity", prior=prior, start=start, transform=transform)


def near_middle(space: ParameterSpace, n: int = 3) -> np.ndarray:
    """Return unknowns `(n, D)` about the middles of their priors."""
    shares = 0.5 + np.random.default_rng(4).uniform(-0.2, 0.2, (n, len(space.free)))
    priors = space.priors.values()
    return np.stack([p.quantile(u) for p, u in zip(priors, shares.T, strict=True)], axis=-1)


def with_start(target: Posterior, start: Mapping[str, float]) -> Posterior:
    """Return the same posterior, where searches for the MAP begin elsewhere."""
    unknowns = (replace(u, start=start.get(u.name, u.start)) for u in target.space.unknowns)
    return replace(target, space=replace(target.space, unknowns=tuple(unknowns)))


def with_priors(space: ParameterSpace, priors: Mapping[str, Prior]) -> ParameterSpace:
    """Return the same unknowns with other priors of some."""
    unknowns = (replace(u, prior=priors.get(u.name, u.prior)) for u in space.unknowns)
    return replace(space, unknowns=tuple(unknowns))


def replace_only(likelihood: Likelihood, **changes: Any) -> Likelihood:
    """Return it with another `response` or `noise` of the only observation."""
    return replace(likelihood, observations=(replace(likelihood.only_observation, **changes),))


def likelihood_of(space: ParameterSpace, *pairs: tuple[Simulator, Noise]) -> Likelihood:
    """Return that of simulators with noises whose unknowns stand in `space` in this order."""
    levels = iter([space.free[column] for column in space.columns("noise")])
    parts = [
        Observation(
            response=response,
            noise=noise,
            parameters=space.model,
            noise_names=[*islice(levels, len(noise.unknowns))],
        )
        for response, noise in pairs
    ]
    return Likelihood.joint(space, parts)
