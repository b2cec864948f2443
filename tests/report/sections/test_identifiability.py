"""Figures of `identify`: profiles over plain and logarithmic axes, and the spectrum of what is known."""

import numpy as np
from support.figure_checks import SYMBOLS, TABLE, si
from support.figure_contexts import profile

from bayesdrill.report.sections.identifiability import profile_figure


def test_values_of_profiles_stand_at_their_places_on_plain_and_logarithmic_axes() -> None:
    profiles, logs = [profile(symbol) for symbol in SYMBOLS], {"c_m", "sigma_w_1"}
    symbols = {symbol.name: symbol for symbol in SYMBOLS}
    figure = profile_figure(profiles, symbols, TABLE, logs)
    for panel, shown in zip(figure.axes, profiles, strict=True):
        u = panel.get_lines()[1].get_xdata()[2]
        value = si(panel.get_xlabel(), 10.0**u if shown.name in logs else u)
        assert np.abs(shown.values / value - 1.0).min() < 1e-6
