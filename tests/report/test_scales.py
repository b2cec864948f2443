"""Axes: few, distinct and true ticks, labels with powers, origins and units; logarithmic axes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.figure_checks import si

from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.report import scales


@given(
    st.floats(-1e6, 1e6).filter(lambda x: abs(x) > 1e-7), st.floats(-9, 1).map(lambda e: 10.0**e)
)
def test_ticks_are_few_distinct_and_true(middle: float, width: float) -> None:
    low, high = middle - 0.5 * width * abs(middle), middle + 0.5 * width * abs(middle)
    scale = scales.scale(low, high)
    places, texts = scale.ticks()
    assert 2 <= len(places) <= 3
    assert len(set(texts)) == len(texts)
    assert max(map(len, texts)) <= 8
    label = scale.label(PARAMETERS["j_m"]).replace(" - -", " - ")
    for place, text in zip(places, texts, strict=True):
        assert float(text.replace("\N{MINUS SIGN}", "-")) == place
        if middle > 0:
            x = si(label, place)
            assert low - 1e-12 * abs(low) <= x <= high + 1e-12 * abs(high)
            np.testing.assert_allclose(float(scale(x)), place, atol=1e-4 * (scale.high - scale.low))


@given(st.floats(-8, 4), st.floats(0.001, 6))
def test_logarithmic_ticks_are_few_round_and_inside(start: float, decades: float) -> None:
    low = 10.0**start
    scale = scales.scale(low, low * 10.0**decades, log=True)
    places, texts = scale.ticks(4)
    assert 2 <= len(places) <= 4
    assert len(set(texts)) == len(texts)
    assert (scale.low <= places).all()
    assert (places <= scale.high).all()
    for place, text in zip(places, texts, strict=True):
        if not text.startswith("$"):
            expected = si(scale.label(PARAMETERS["r_m"]), float(text))
            np.testing.assert_allclose(float(scale.value(place)), expected, rtol=1e-6)
