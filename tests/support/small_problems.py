"""Small experiments and problems for tests."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from support.scipy_oracles import NOMINAL, ORDER

from bayesdrill.basics.symbols import PARAMETERS, own_symbol
from bayesdrill.inference import laplace
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


class UnevenShaft(MotorShaft):
    """A rig that its angles hold, but where j_m and j_1 are alike: its shaft pulls unevenly."""

    def linear(self, p: Named) -> Linear:
        right = super().linear(p)
        pull = right.A["w_2", "theta_1"] * p["j_m"] / p["j_1"]
        return Linear(A={**right.A, ("w_2", "theta_1"): pull}, B=right.B, c=right.c)


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
    """Zero data on every state unless told otherwise."""
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
    """Four channels of the nominal rig after an 8 V step, with noise `sigma (4,)`."""
    four = {name: {name: 1.0} for name in STATES[:4]}
    clean = Response(MotorShaft(), experiment(n, dt, measures=four)).signals(vector(NOMINAL)[None])[
        0
    ]
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
    """`sigma` None: unknown, one per channel, uniform from 0.01 to 1; `response`: compiled already.

    `logs`: whether the coordinates of all unknowns are their logs; None: as the priors have it.
    """
    chosen: dict[str, Prior] = {
        name: Uniform(0.5 * NOMINAL[name], 1.5 * NOMINAL[name]) for name in free
    }
    chosen |= priors or {}
    scatter = White.from_channels(
        [
            NoisyChannel(
                channel=channel,
                sigma=chosen.pop(f"sigma_{channel.name}", Uniform(0.01, 1.0))
                if sigma is None
                else float(sigma[k]),
                start=0.1,
            )
            for k, channel in enumerate(record.channels)
        ],
        len(record.t),
    )
    transform: Transform | None = None if logs is None else "log" if logs else "plain"
    unknowns = [unknown(name, prior, transform) for name, prior in chosen.items()]
    space = ParameterSpace(
        model=ORDER,
        unknowns=(*unknowns, *(replace(one, transform=transform) for one in scatter.unknowns)),
        fixed={name: NOMINAL[name] for name in ORDER if name not in free},
    )
    simulator = response or Response(MotorShaft(), record)
    return Posterior(
        space=space,
        likelihood=likelihood_of(space, (simulator, scatter)),
        coordinates=space.coordinates,
    )


def posterior_of(
    simulator: Simulator,
    sigma: Iterable[float],
    priors: Mapping[str, Prior],
    values: Mapping[str, float],
) -> Posterior:
    """Of white noise of known `sigma`; parameters without a prior are held at their `values`."""
    record, names = simulator.experiment, simulator.parameters
    noisy = [
        NoisyChannel(channel=channel, sigma=float(sd), start=float(sd))
        for channel, sd in zip(record.channels, sigma, strict=True)
    ]
    space = ParameterSpace(
        model=names,
        unknowns=tuple(replace(unknown(n, p), start=values[n]) for n, p in priors.items()),
        fixed={name: float(values[name]) for name in names if name not in priors},
    )
    likelihood = likelihood_of(space, (simulator, White.from_channels(noisy, len(record.t))))
    return Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)


def unknown(name: str, prior: Prior, transform: Transform | None = None) -> Unknown:
    """A parameter of the rig, or else a quantity."""
    if name in PARAMETERS:
        symbol, start = PARAMETERS[name], NOMINAL.get(name, 1.0)
        return Unknown(symbol=symbol, role="rig", prior=prior, start=start, transform=transform)
    begin = float(prior.quantile(np.array([0.5]))[0])
    symbol = own_symbol(name, "1", None, name)
    return Unknown(symbol=symbol, role="quantity", prior=prior, start=begin, transform=transform)


def with_start(target: Posterior, start: Mapping[str, float]) -> Posterior:
    """The same, where searches for the MAP begin elsewhere."""
    changed = (replace(u, start=start.get(u.name, u.start)) for u in target.space.unknowns)
    return replace(target, space=replace(target.space, unknowns=tuple(changed)))


def with_priors(space: ParameterSpace, priors: Mapping[str, Prior]) -> ParameterSpace:
    """The same unknowns with other priors of some."""
    changed = (replace(u, prior=priors.get(u.name, u.prior)) for u in space.unknowns)
    return replace(space, unknowns=tuple(changed))


def points_near(
    posterior: Posterior, theta: np.ndarray, n: int, rng: np.random.Generator
) -> np.ndarray:
    """`(n, D)` points of finite posterior around `theta (D,)`, in the sampler's coordinates."""
    centre = posterior.coordinates.from_physical(theta[None])[0]
    steps = laplace.matrix_root(laplace.covariance(posterior, theta))
    kept = np.empty((0, len(theta)))
    while len(kept) < n:
        z = centre + rng.standard_normal((n, len(theta))) @ steps.T
        kept = np.concatenate([kept, z[np.isfinite(posterior(z))]])
    return kept[:n]


def replace_only(likelihood: Likelihood, **changes: Any) -> Likelihood:
    """With another `response` or `noise` of the only observation."""
    changed = replace(likelihood.only_observation, **changes)
    return replace(likelihood, observations=(changed,))


def likelihood_of(space: ParameterSpace, *pairs: tuple[Simulator, Noise]) -> Likelihood:
    """Of simulators with their noises, whose unknowns stand in `space` in this order."""
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
