"""Figures of `identify`, and the line that starts a design for what a record leaves open."""

import dataclasses

import numpy as np
from support.figure_checks import SYMBOLS, TABLE, si
from support.figure_contexts import profile
from support.linear_study import LINEAR, R_M, RATIO, draws_of, linear_study, verdict

from bayesdrill.analysis.identifiability.structure import ScalingStructure
from bayesdrill.analysis.identifiability.study import Nuisance, Remedy
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.report.sections.identifiability import (
    next_experiment,
    nuisances,
    open_products,
    profile_figure,
    remedies,
    structure,
    summarise_study,
)
from bayesdrill.report.sections.nominal import verdict_sentences

NO_SYMMETRY = dataclasses.replace(LINEAR.structure, symmetries=())


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


def test_a_nuisance_that_resembles_an_unknown_is_named_with_what_it_costs() -> None:
    lag = Nuisance(name="lag_w_1", sd=2e-3, prior_sd=0.01, word="determined", like=(("r_m", 3.0),))
    offset = Nuisance(name="offset_w_1", sd=0.1, prior_sd=0.1, word="left to the prior", like=())
    plain = dataclasses.replace(LINEAR, structure=NO_SYMMETRY, nuisances=(offset,))
    tied = dataclasses.replace(plain, nuisances=(lag, offset))
    text = nuisances(tied)
    assert text.splitlines()[2].split() == ["lag_w_1", "0.002", "0.01", "determined"]
    likeness = "lag_w_1 can hardly be distinguished from r_m"
    assert f"{likeness}. If it were known, sds would be smaller: r_m (3 times)." in text
    assert "distinguished" not in nuisances(plain)
    assert likeness in summarise_study(tied)
    assert likeness not in summarise_study(plain)


def test_products_are_left_out_if_a_symmetry_scales_everything_and_measurements_that_do_not_help() -> (
    None
):
    alone = ScalingStructure(names=("k_s",), symmetries=((1,),), invariants=(), unexplained=0)
    text = structure(dataclasses.replace(LINEAR, structure=alone))
    assert text.endswith(
        "  - k_s can be multiplied by any factor without changing any measured signal"
    )
    vain = Remedy(what="a sensor of w_2", breaks=(), left=1, shrink=1.01)
    text = remedies(dataclasses.replace(LINEAR, remedies=(vain,)))
    assert text == "no single further measurement that was tried would help much"
