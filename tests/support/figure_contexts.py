"""Made contexts of figures, and figures of them as they are rendered."""

from collections.abc import Callable, Collection
from functools import cache
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from support.compared_models import model
from support.figure_checks import (
    SIGMAS,
    SYMBOLS,
    TABLE,
    displayed,
    drawn,
    mode_of,
    posterior,
    prior_of,
)

from bayesdrill.analysis.calibration import Refit
from bayesdrill.analysis.comparison import RunSummary, overlay_rows
from bayesdrill.analysis.diagnostics import rank_histograms
from bayesdrill.analysis.identifiability.profile import Profile
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.display_units import SI, DisplayedUnknowns
from bayesdrill.inference.priors import LogUniform
from bayesdrill.report.scales import DOUBLE, TIME
from bayesdrill.report.sections.comparison import comparison_figure
from bayesdrill.report.sections.convergence import rank_figure, trace_figure
from bayesdrill.report.sections.corner import corner_figure
from bayesdrill.report.sections.fit import Course, Fit, Signal, measured
from bayesdrill.report.sections.parameters import (
    CorrelatedPair,
    prior_posterior_figure,
    ridge_figure,
)

Array = NDArray[np.float64]

SIZES = {**TABLE, **{f"sigma_{name}": size for name, size in SIGMAS.items()}}
CHANNELS = (
    ("w_1", r"\dot\theta_1", "rad/s", 30.0),
    ("i", r"\dot q", "A", 1.9),
    ("s", r"\theta_1 - \theta_2", "rad", 2e-3),
    ("theta_1", r"\theta_1", "rad", 4e3),
    ("far", r"\dot\theta_2", "rad/s", 1e-5),
    ("w_2", r"\dot\theta_2", "rpm", 1e5),
)
V = Symbol("v", "V", "v", "mV", "supply")


def unknowns(
    draws: Array, symbols: tuple[Symbol, ...], logs: Collection[str] = ()
) -> DisplayedUnknowns:
    """Return them with their nominal values; the priors of `logs` are log-uniform over three decades."""
    priors = {symbol.name: prior_of(symbol) for symbol in symbols}
    for name in logs & priors.keys():
        middle = float(priors[name].quantile(np.array([0.5]))[0])
        priors[name] = LogUniform(middle / 30, middle * 30)
    return displayed(symbols, TABLE, mode_of(draws, symbols), priors)


@cache
def corner(
    columns: tuple[int, ...],
    inches: float = DOUBLE,
    width: float | None = None,
    logs: frozenset[str] = frozenset(),
) -> Figure:
    draws, symbols = posterior(1500, width)[:, columns], tuple(SYMBOLS[k] for k in columns)
    return drawn(corner_figure(draws, unknowns(draws, symbols, logs), inches))


def prior_posterior(
    n: int, inches: float = DOUBLE, width: float | None = None, logs: Collection[str] = frozenset()
) -> Figure:
    draws = posterior(1500, width)[:, :n]
    return drawn(prior_posterior_figure(draws, unknowns(draws, SYMBOLS[:n], logs), inches))


def ridge(logs: Collection[str] = frozenset()) -> Figure:
    """Return that of k_s and j_1, of which j_1/k_s^2 is said to be what the record determines."""
    draws = posterior(2000)
    shown = unknowns(draws, SYMBOLS, logs)
    return drawn(ridge_figure(draws, CorrelatedPair((6, 7), (1, 2)), shown))


def trace(
    n: int = 9,
    inches: float = DOUBLE,
    width: float | None = None,
    logs: Collection[str] = frozenset(),
) -> Figure:
    theta = posterior(3 * 500 * 12, width)[:, :n].reshape(3, 500, 12, n)
    shown = unknowns(theta.reshape(-1, n), SYMBOLS[:n], logs)
    return drawn(trace_figure(theta, shown, 70, inches))


def profile(symbol: Symbol) -> Profile:
    """Return one over a decade, skewed, with its nominal value somewhere on it."""
    values = np.geomspace(0.4, 3.0, 15) * SIZES[symbol.name]
    loss = 3.0 * np.log(values / (0.9 * SIZES[symbol.name])) ** 2
    ends: dict[str, float] = {"best": float(values[6]), "low": float(values[2])}
    return Profile(name=symbol.name, values=values, loss=loss, high=None, shape="one-sided", **ends)


def refits(n: int, *, seed: int) -> list[Refit]:
    """Return sixty refits of `n` quantities whose ranks among 99 draws are uniform."""
    how: dict[str, Any] = {"r_hat": 1.0, "ess": 500.0, "steps": 800, "reasons": (), "seconds": 0.0}
    ranks = np.random.default_rng(seed).integers(0, 100, (60, n)).tolist()
    return [
        Refit(index=k, truth=(0.0,) * n, ranks=tuple(row), **how) for k, row in enumerate(ranks)
    ]


def chains(rho: float, n: int = 3, steps: int = 3000) -> Array:
    """First-order autoregressive, `(4, steps, 8, n)`; tau is `(1 + rho) / (1 - rho)`."""
    x = np.random.default_rng(3).standard_normal((4, steps, 8, n))
    for step in range(1, steps):
        x[:, step] = rho * x[:, step - 1] + np.sqrt(1 - rho**2) * x[:, step]
    return x


@cache
def ranks(n: int, moved: float, inches: float = DOUBLE) -> Figure:
    """Return those of five chains; the fourth is moved in its first unknown."""
    x = np.random.default_rng(1).standard_normal((5, 400, n))
    x[3, :, 0] += moved
    histograms = rank_histograms(x, np.random.default_rng(2))
    return drawn(rank_figure(histograms, SYMBOLS[:n], inches))


def course(n: int, *, straight: bool = False) -> Course:
    """Return a voltage that goes both ways."""
    return Course(label=V, values=8e3 * (-1.0) ** (np.arange(n) // 7), straight=straight)


def fit_of(n_channels: int, n_samples: int, courses: int = 0) -> Fit:
    rng = np.random.default_rng(7)
    t = 0.1 + np.arange(n_samples) * 5.0 / n_samples
    wave = 1 - np.exp(-t / 0.8) * np.cos(10 * t)
    signals = []
    for name, latex, unit, size in CHANNELS[:n_channels]:
        response, sigma = size * wave + (250.0 if size == 1e-5 else 0.0), 0.03 * size
        signals.append(
            Signal(
                label=Symbol(name, unit, latex, unit, ""),
                y=response + sigma * rng.standard_normal(n_samples),
                model=response,
                predictive=response + sigma * rng.standard_normal((8, n_samples)),
                sigma=sigma,
                dots=measured(response),
                unexplained=0.0213,
            )
        )
    driven = tuple(course(n_samples) for _ in range(courses))
    return Fit(t=t, time=TIME, signals=tuple(signals), courses=driven, constant=((V, 8.0),))


def models(n: int, n_unknowns: int, wide: float) -> list[RunSummary]:
    """The last is the most probable, and by far."""
    return [
        model(
            f"{'a_long_name_of_a_model_' * (k % 2)}{k}",
            -wide * (n - 1 - k) / n,
            rig=str(k),
            unknowns=n_unknowns - (k == 0 and n_unknowns > 1),
            rms=1.0 + 0.5 * (n - 1 - k) ** 2,
            correlation=0.2 * (n - 1 - k) % 1.0,
            moved=0.5 * k,
        )
        for k in range(n)
    ]


def compared(summaries: list[RunSummary]) -> Figure:
    rows = overlay_rows([summary.layer for summary in summaries])
    return drawn(comparison_figure(summaries, rows, SI))


def overlaid(figure: Callable[..., Figure], summaries: list[RunSummary]) -> Figure:
    layers = [summary.layer for summary in summaries]
    return drawn(figure(layers, overlay_rows(layers), SI))
