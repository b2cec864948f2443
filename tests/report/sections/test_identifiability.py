"""Figures of `identify`: profiles over plain and logarithmic axes, and the spectrum of what is known."""

import numpy as np
from support.case_tables import for_each
from support.figure_checks import SYMBOLS, TABLE, drawn, si
from support.figure_contexts import profile
from support.linear_study import PRIOR_SD, linear_study

from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.sections.identifiability import profile_figure, spectrum_figure


def test_values_of_profiles_stand_at_their_places_on_plain_and_logarithmic_axes() -> None:
    profiles, logs = [profile(symbol) for symbol in SYMBOLS], {"c_m", "sigma_w_1"}
    symbols = {symbol.name: symbol for symbol in SYMBOLS}
    figure = profile_figure(profiles, symbols, TABLE, logs)
    for panel, shown in zip(figure.axes, profiles, strict=True):
        u = panel.get_lines()[1].get_xdata()[2]
        value = si(panel.get_xlabel(), 10.0**u if shown.name in logs else u)
        assert np.abs(shown.values / value - 1.0).min() < 1e-6


def test_a_spectrum_names_every_direction_on_the_page_one_below_the_other() -> None:
    def check(inches: float) -> None:
        study = linear_study(np.full(3, PRIOR_SD))
        labels = {name: PARAMETERS[name].latex for name in study.names}
        figure = drawn(spectrum_figure(study, labels, inches))
        assert figure.get_figwidth() == inches
        (panel,) = figure.axes
        texts = [*panel.get_yticklabels(), *panel.texts]
        boxes = [text.get_window_extent() for text in texts if "_" in text.get_text()]
        assert len(boxes) == len(study.information.directions)
        assert all(figure.bbox.contains(*corner) for b in boxes for corner in (b.p0, b.p1))
        assert min(np.abs(np.diff([b.y0 for b in boxes]))) > max(b.height for b in boxes)

    for_each({size: (inches,) for size, inches in WIDTHS.items()}, check)
