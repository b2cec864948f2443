"""Records of rigs with physics that is then left out, made by the oracle in `friction_oracle`."""

from collections.abc import Mapping

import numpy as np
from scipy.signal import lfilter
from support.friction_oracle import Rig, simulate
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, likelihood_of, unknown

from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.sampling.gauss_newton import gauss_newton

FREE = ("j_m", "c_m", "k_e", "k_s", "j_1")
MEASURES = {"alpha": {"theta_1": 1.0, "theta_2": -1.0}, "w_2": {"w_2": 1.0}}
SIGMA = np.array([0.02, 0.1])
DT, N = 0.01, 300
T = DT * np.arange(N)
HELD = {"t_f": 1e-3}


def voltage() -> np.ndarray:
    return 5.0 * np.sign(np.sin(5.0 * T + 0.4)) + 0.7


def record(
    added: Mapping[str, float],
    v: np.ndarray | None = None,
    *,
    late: int = 0,
    supply: float = 0.0,
    gain: float = 1.0,
    offset: float = 0.0,
) -> Experiment:
    """Of the nominal rig with what is `added`; its twist `late` by so many samples, with a `gain` and an
    `offset`; its voltage off by `supply`.
    """
    given = voltage() if v is None else v
    rig = Rig(p={**NOMINAL, **HELD, **added})
    states = simulate(rig, T, given + supply).states
    y = np.stack([states[:, 0] - states[:, 1], states[:, 3]], axis=-1)
    y[late:, 0] = y[: N - late, 0].copy()
    y[:late, 0] = 0.0
    y[:, 0] = gain * y[:, 0] + offset
    y = y + SIGMA * np.random.default_rng(8).standard_normal(y.shape)
    return experiment(N, DT, series={"v": given}, constant={"t_1": 0.0}, measures=MEASURES, y=y)


def believed(
    seen: Experiment, model: Model | None = None, *, known: bool = True, **held: float
) -> Posterior:
    """As if the rig were `model`, or linear; `known`: the noise."""
    rig = model or MotorShaft()
    values = {**NOMINAL, **HELD, **held}
    noisy = [
        NoisyChannel(channel=c, sigma=float(s) if known else Uniform(1e-3, 10.0), start=float(s))
        for c, s in zip(seen.channels, SIGMA, strict=True)
    ]
    scatter = White.from_channels(noisy, N)
    rigs = [unknown(n, Uniform(0.3 * NOMINAL[n], 3 * NOMINAL[n])) for n in FREE]
    space = ParameterSpace(
        model=rig.parameters,
        unknowns=(*rigs, *scatter.unknowns),
        fixed={name: values[name] for name in rig.parameters if name not in FREE},
    )
    likelihood = likelihood_of(space, (simulator(rig, seen, ObservationModel()), scatter))
    return Posterior(space=space, likelihood=likelihood, coordinates=space.coordinates)


def best(posterior: Posterior) -> np.ndarray:
    surface = LogDensity(posterior, physical=True)
    start = posterior.space.vector(posterior.space.start)
    top = gauss_newton(surface, posterior.coordinates.from_physical(start[None]), 60)
    return np.asarray(posterior.coordinates.to_physical(top.u)[0])


def ar1(rho: float, shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Return autoregressive columns of the standard deviation 1."""
    noise = np.random.default_rng(seed).standard_normal((shape[0] + 300, *shape[1:]))
    return np.asarray(lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], noise, axis=0)[300:])


def against_the_table(posterior: Posterior, tolerance: float = 0.0, **table: float) -> Problem:
    """With the nominal rig for a table, but for what is named."""
    nominal = {name: NOMINAL[name] for name in FREE} | table
    return Problem(
        posterior=posterior,
        symbols=tuple(one.symbol for one in posterior.space.unknowns),
        nominal=nominal,
        tolerance=dict.fromkeys(nominal, tolerance),
    )
