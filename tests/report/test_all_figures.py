"""Figures of contexts that are hard to draw, in the narrow width: nothing is cut, nothing overlaps.

Figures of whole runs, in both widths: `tests/contracts/test_figures.py`; drawings of rigs:
`test_rig_drawing.py`.
"""

import re
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from matplotlib.figure import Figure
from support import figure_contexts as contexts
from support.case_tables import slow_except
from support.compared_models import model
from support.figure_checks import SYMBOLS, TABLE, clashes, drawn, overlap, shown
from support.linear_study import NAMES, PRIOR_SD, gaussian, linear_study, verdict

from bayesdrill.analysis.calibration import LOG_LIKELIHOOD, judge_calibration
from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.report.scales import SINGLE
from bayesdrill.report.sections.calibration import calibration_figure
from bayesdrill.report.sections.convergence import autocorrelation_figure
from bayesdrill.report.sections.fit import fit_figure, record_figure
from bayesdrill.report.sections.identifiability import profile_figure, spectrum_figure
from bayesdrill.report.sections.nominal import invariants_figure
from bayesdrill.report.sections.overlay import intervals_figure, overlay_corner_figure

LOGS = frozenset(("c_m", "l_m", "sigma_w_1", "sigma_i"))
NARROW = 1e-5  # relative width of a posterior whose ticks need an origin
NINE = tuple(range(9))


def profiles() -> Figure:
    symbols = {symbol.name: symbol for symbol in SYMBOLS[:9]}
    lines = [contexts.profile(symbol) for symbol in symbols.values()]
    return profile_figure(lines, symbols, TABLE, LOGS, SINGLE)


def calibration() -> Figure:
    names = [*(symbol.name for symbol in SYMBOLS[:9]), LOG_LIKELIHOOD]
    judged = judge_calibration(names, contexts.refits(10, seed=9), 99)
    return calibration_figure(judged, SYMBOLS[:9], SINGLE)


def spectrum() -> Figure:
    study = linear_study(np.full(3, PRIOR_SD))
    return spectrum_figure(study, {name: PARAMETERS[name].latex for name in study.names}, SINGLE)


def invariants() -> Figure:
    draws = gaussian({**TABLE, "r_m": 1.2 * TABLE["r_m"]}, np.random.default_rng(2))
    symbols = [PARAMETERS[name] for name in NAMES]
    return invariants_figure(verdict(draws), draws, np.median(draws, axis=0), symbols, SINGLE)


LONG_NAMES = [
    model(f"{'all_that_rubs-' * 4}{end}", -9.0 * k) for k, end in enumerate(("one", "two", "three"))
]
TWO_EXPERIMENTS = [
    model(name, -3.0 * k, experiments=("up", "down the hill")) for k, name in enumerate("ab")
]
HARD: dict[str, Callable[[], Figure]] = {
    "corner of 9": lambda: contexts.corner(NINE, SINGLE, logs=LOGS),
    "narrow corner of 2": lambda: contexts.corner((0, 12), SINGLE, NARROW),
    "narrow corner of 9": lambda: contexts.corner(NINE, width=NARROW),
    "narrow trace of 9": lambda: contexts.trace(9, SINGLE, NARROW, LOGS),
    "narrow priors of 9": lambda: contexts.prior_posterior(9, SINGLE, NARROW, LOGS),
    "profiles": profiles,
    "calibration": calibration,
    "ranks": lambda: contexts.ranks(4, 1.0, SINGLE),
    "autocorrelation": lambda: autocorrelation_figure(
        contexts.chains(0.9, 4, 400), SYMBOLS[:4], SINGLE
    ),
    "fit of three channels": lambda: fit_figure(contexts.fit_of(3, 700, 2), SINGLE),
    "invariants": invariants,
    "spectrum": spectrum,
    "record": lambda: record_figure(contexts.fit_of(2, 200, 1)),
    "ridge": contexts.ridge,
    "ridge in logs": lambda: contexts.ridge(frozenset(("k_s", "j_1"))),
    "overlay": lambda: contexts.overlaid(overlay_corner_figure, contexts.models(6, 3, 60.0)),
    "intervals": lambda: contexts.overlaid(intervals_figure, contexts.models(6, 3, 60.0)),
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


# Wide ones; the same functions draw narrow ones, with fewer texts, in the fast tests.
LONG = ("corner of 9", "narrow corner of 9", "narrow trace of 9", "narrow priors of 9")
LONG += ("comparison", "comparison of long names", "calibration")
EVERY = slow_except({*HARD} - {*LONG}, HARD)


@pytest.mark.parametrize("name", EVERY)
def test_figures_are_readable(name: str) -> None:
    """No text is cut or lies on another, and every axis has a unit."""
    assert [*faults(drawn(HARD[name]()))] == []
