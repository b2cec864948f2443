"""Tests of the warning above the report of a fit that must not be believed."""

from dataclasses import replace

from support.case_tables import for_each

from bayesdrill.inference.residual_checks import ResidualLimits, ResidualSummary
from bayesdrill.report.doubts import misfit

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
