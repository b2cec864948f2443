"""Figures of `identify`, and the line that starts a design for what a record leaves open."""

import dataclasses

import numpy as np
from support.figure_checks import SYMBOLS, TABLE, si
from support.figure_contexts import profile
from support.linear_study import LINEAR, R_M, RATIO, draws_of, linear_study, verdict

from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.report.sections.identifiability import (
    next_experiment,
    open_products,
    profile_figure,
)
from bayesdrill.report.sections.nominal import verdict_sentences


def test_values_of_profiles_stand_at_their_places_on_plain_and_logarithmic_axes() -> None:
    profiles, logs = [profile(symbol) for symbol in SYMBOLS], {"c_m", "sigma_w_1"}
    symbols = {symbol.name: symbol for symbol in SYMBOLS}
    figure = profile_figure(profiles, symbols, TABLE, logs)
    for panel, shown in zip(figure.axes, profiles, strict=True):
        u = panel.get_lines()[1].get_xdata()[2]
        value = si(panel.get_xlabel(), 10.0**u if shown.name in logs else u)
        assert np.abs(shown.values / value - 1.0).min() < 1e-6


def test_a_design_is_offered_for_the_products_that_the_verdict_calls_not_determined() -> None:
    found = verdict(draws_of(2))
    ratio, *others = sorted(found.products, key=lambda quantity: quantity.exponents != RATIO)
    left = dataclasses.replace(ratio, says="not determined")
    found = dataclasses.replace(found, products=(left, *others))
    assert "\nNot determined: k_s/j_1. " in verdict_sentences(found, "table")
    exponents = [quantity.exponents for quantity in found.undetermined]
    line = next_experiment(found.names, exponents, "run")
    assert line.endswith(": bayesdrill design run --learn 'k_s/j_1'")
    assert next_experiment(found.names, [], "run") == ""


def test_products_that_a_record_would_not_narrow_are_open_before_it_is_sampled() -> None:
    assert open_products(LINEAR, IdentifySpec()) == []
    assert {*open_products(linear_study(np.full(3, 1e-3)), IdentifySpec())} == {RATIO, R_M}
