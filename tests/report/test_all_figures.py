"""Every figure in both widths, of contexts that are hard to draw: nothing is cut, nothing overlaps.

Figures of whole runs: `tests/contracts/test_figures.py`; drawings of rigs: `test_rig_drawing.py`.
"""

import re
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest
from matplotlib.figure import Figure
from support import figure_contexts as contexts
from support.case_tables import for_each
from support.compared_models import model
from support.figure_checks import SYMBOLS, TABLE, clashes, drawn, overlap, shown
from support.linear_study import NAMES, PRIOR_SD, gaussian, linear_study, verdict

from bayesdrill.analysis.calibration import LOG_LIKELIHOOD, judge_calibration
from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.sections.calibration import calibration_figure
from bayesdrill.report.sections.convergence import autocorrelation_figure
from bayesdrill.report.sections.fit import fit_figure, record_figure
from bayesdrill.report.sections.identifiability import profile_figure, spectrum_figure
from bayesdrill.report.sections.nominal import invariants_figure

LOGS = frozenset(("c_m", "l_m", "sigma_w_1", "sigma_i"))
NARROW = 1e-5  # relative width of a posterior whose ticks need an origin


def corner(columns: tuple[int, ...], width: float | None, inches: float) -> Figure:
    return contexts.corner(columns, inches, width, frozenset() if width else LOGS)


def unknowns(draw: Callable[..., Figure], n: int, width: float | None, inches: float) -> Figure:
    return draw(n, inches, width, LOGS)


def fit(n_channels: int, n_samples: int, courses: int, inches: float) -> Figure:
    return fit_figure(contexts.fit_of(n_channels, n_samples, courses), inches)


def profiles(n: int, inches: float) -> Figure:
    symbols = {symbol.name: symbol for symbol in SYMBOLS[:n]}
    lines = [contexts.profile(symbol) for symbol in symbols.values()]
    return profile_figure(lines, symbols, TABLE, LOGS, inches)


def calibration(n: int, inches: float) -> Figure:
    names = [*(symbol.name for symbol in SYMBOLS[:n]), LOG_LIKELIHOOD]
    judged = judge_calibration(names, contexts.refits(n + 1, seed=n), 99)
    return calibration_figure(judged, SYMBOLS[:n], inches)


def autocorrelation(n: int, inches: float) -> Figure:
    return autocorrelation_figure(contexts.chains(0.9, n, 400), SYMBOLS[:n], inches)


def spectrum(inches: float) -> Figure:
    study = linear_study(np.full(3, PRIOR_SD))
    return spectrum_figure(study, {name: PARAMETERS[name].latex for name in study.names}, inches)


def invariants(inches: float) -> Figure:
    draws = gaussian({**TABLE, "r_m": 1.2 * TABLE["r_m"]}, np.random.default_rng(2))
    symbols = [PARAMETERS[name] for name in NAMES]
    return invariants_figure(verdict(draws), draws, np.median(draws, axis=0), symbols, inches)


LONG_NAMES = [
    model(f"{'all_that_rubs-' * 4}{end}", -9.0 * k) for k, end in enumerate(("one", "two", "three"))
]
TWO_EXPERIMENTS = [
    model(name, -3.0 * k, experiments=("up", "down the hill")) for k, name in enumerate("ab")
]
IN_EITHER_WIDTH: dict[str, Callable[[float], Figure]] = {
    **{f"corner of {n}": partial(corner, tuple(range(n)), None) for n in (1, 2, 9)},
    "narrow corner of 2": partial(corner, (0, 12), NARROW),
    **{
        f"{kind} of 9, width {width}": partial(unknowns, draw, 9, width)
        for kind, draw in (("trace", contexts.trace), ("priors", contexts.prior_posterior))
        for width in (None, NARROW)
    },
    "profiles": partial(profiles, 9),
    "calibration": partial(calibration, 9),
    "ranks": partial(contexts.ranks, 4, 1.0),
    "autocorrelation": partial(autocorrelation, 4),
    "residuals": partial(contexts.residual_correlations, 4),
    "response": partial(contexts.frequency_response, 4),
    "fit of a channel": partial(fit, 1, 20, 0),
    "fit of three channels": partial(fit, 3, 700, 2),
    "predictive": contexts.predictive_checks,
    "invariants": invariants,
    "spectrum": spectrum,
}
IN_ONE_WIDTH: dict[str, Callable[[], Figure]] = {
    "record": lambda: record_figure(contexts.fit_of(2, 200, 1)),
    "narrow corner of 9": lambda: contexts.corner(tuple(range(9)), width=NARROW),
    "ridge": contexts.ridge,
    "ridge in logs": lambda: contexts.ridge(frozenset(("k_s", "j_1"))),
    "overlay": lambda: contexts.overlaid_corner(6, 3),
    "intervals": lambda: contexts.overlaid_intervals(6, 3),
    "comparison": lambda: contexts.compared(contexts.models(24, 5, 2e7)),
    "comparison of long names": lambda: contexts.compared(LONG_NAMES),
    "comparison of two experiments": lambda: contexts.compared(TWO_EXPERIMENTS),
}
WITHOUT_UNIT = re.compile(
    r"(density|step|(auto|their )?correlation|loss of log|log odds|rank|normalised rank|ECDF|PIT)\b"
    r"|.*\(PIT\)|rms of residuals over noise|measured less predicted"  # in sds
)


def faults(figure: Figure) -> Iterator[str]:
    """What a reader would stumble over: see `clashes`; legends on panels; axes without units."""
    yield from clashes(figure)
    panels = [panel for panel in figure.axes if panel.axison]
    for legend in figure.legends:
        if any(overlap(legend.get_window_extent(), p.get_window_extent()) for p in panels):
            yield "a legend on a panel"
    texts = [text for p in panels for text in (p.get_xlabel(), p.get_ylabel()) if text]
    labels = [text.replace("\n", " ") for text in texts]
    if not labels:
        yield "no axis has a label"
    named = {label.partition(" [")[0] for label in labels if re.search(r" \[.+\]", label)}
    for label in labels:
        if label.partition(" [")[0] not in named and not WITHOUT_UNIT.match(label):
            yield f"no unit: {label}"
    sizes = [t.get_fontsize() for p in panels for t in shown([*p.get_xticklabels(), p.xaxis.label])]
    if min(sizes) < 5.0:
        yield f"letters of {min(sizes)} points"


@pytest.mark.parametrize("name", IN_EITHER_WIDTH)
def test_figures_are_readable_in_one_and_in_two_columns(name: str) -> None:
    """No text is cut or lies on another, and every axis has a unit."""

    def check(inches: float) -> None:
        highest = 1.45 * inches if "corner" in name else 9.0 if "priors" in name else 12.0
        figure = drawn(IN_EITHER_WIDTH[name](inches))
        assert [*faults(figure)] == []
        assert figure.get_figwidth() <= inches + 1e-9
        if not name.startswith("fit"):  # which has a row for each channel and input
            assert figure.get_figheight() < highest

    for_each({f"{name} in {size} width": (inches,) for size, inches in WIDTHS.items()}, check)


@pytest.mark.parametrize("name", IN_ONE_WIDTH)
def test_figures_of_one_size_are_readable(name: str) -> None:
    assert [*faults(drawn(IN_ONE_WIDTH[name]()))] == []
