"""The search for levels begins at a waveform that keeps the limits, if any constant one does."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bayesdrill.design.search import safe_waveform
from bayesdrill.design.source import SourceLimits


@pytest.mark.parametrize("high", [12.0, 24.0, 48.0, 300.0])
def test_a_wider_range_contains_the_levels_of_a_narrower_one(high: float) -> None:
    """Kills the mutant with a single grid of levels, which misses 1.3 to 1.9 from 24 on."""
    source = SourceLimits(input="v", low=0.0, high=high, hold=0.5, duration=2.0, rate=10.0)
    check = SimpleNamespace(
        coming=SimpleNamespace(source=source),
        kept_share=lambda levels: float(1.3 <= levels[0] <= 1.9),
        excess=lambda levels: float(max(1.3 - levels[0], levels[0] - 1.9, 0.0) ** 2),
    )
    levels = safe_waveform(cast("Any", check), lambda levels: levels)
    assert np.all((levels >= 1.3) & (levels <= 1.9))
