"""What stands over a fit that must not be believed, and of several maxima."""

from dataclasses import replace

import numpy as np
from support.case_tables import for_each

from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.residual_checks import ResidualLimits, ResidualSummary
from bayesdrill.report.doubts import misfit
from bayesdrill.report.sections.convergence import maxima
from bayesdrill.sampling.mode_search import LocalMaximum, Mode

LIMITS = ResidualLimits(least=0.95, most=1.05, correlation=0.06, farthest=4.5)
WHITE = ResidualSummary(
    channel="w_1", rms=1.0, share=0.01, correlation=0.0, farthest=3.0, time=1.0, limits=LIMITS
)


def test_the_warning_says_what_is_wrong_with_the_residuals() -> None:
    cases = [
        (WHITE, ""),
        (replace(WHITE, rms=0.2), ""),
        (replace(WHITE, rms=1.2), "THE RESIDUALS ARE MORE THAN NOISE"),
        (
            replace(WHITE, rms=9.0, correlation=0.9),
            "DOES NOT FIT: the residuals are far larger than the noise",
        ),
        (
            replace(WHITE, rms=0.4, correlation=0.9),
            "DOES NOT FIT: the residuals are far from white",
        ),
    ]

    def check(found: ResidualSummary, said: str) -> None:
        assert misfit([WHITE, found]) == said

    for_each({str(case): case for case in cases}, check)


def test_maxima_are_named_by_their_places_or_said_to_be_close() -> None:
    cases = [(2.5, "the one at k_s 2.5"), (2.001, "within 1% of each other in every unknown")]

    def check(elsewhere: float, said: str) -> None:
        other = LocalMaximum(values={"k_s": elsewhere, "j_1": 3.0}, log_posterior=-1.0)
        found = Mode(
            values={"k_s": 2.0, "j_1": 3.0}, log_posterior=0.0, slope={}, gain=0.0, at_bound=(),
            searches=(), others=(other,),
        )  # fmt: skip
        text = maxima(found, np.array([0.75, 0.25]), DisplayUnits({}))
        assert said in text
        assert "75.0%" in text
        assert "25.0%" in text
        assert "  \n" not in text

    for_each({str(case): case for case in cases}, check)
