"""Sentences about causes of a misfit: what absorbs it, and how candidates differ from the best."""

from dataclasses import replace

from support.case_tables import run_cases

from bayesdrill.analysis.causes import Cause, Causes, Doubt
from bayesdrill.inference.residual_checks import ResidualLimits, ResidualSummary
from bayesdrill.report.sections.causes import describe_causes

LIMITS = ResidualLimits(least=0.95, most=1.05, correlation=0.06, farthest=4.5)
NOISE = ResidualSummary(
    channel="w_1", rms=1.0, share=0.01, correlation=0.0, farthest=3.0, time=1.0, limits=LIMITS,
    simulated=0.2,
)  # fmt: skip
WORDS = {
    "friction": "friction at rotor 1",
    "ar1": "noise with memory",
    "lag_w_1": "a lag of w_1",
    "offset_v": "an offset of v",
}


def cause(*parts: str, bayes: float, doubts: tuple[Doubt, ...] = ()) -> Cause:
    """Return a candidate of these parts that leaves only noise."""
    return Cause(
        parts=parts, words=tuple(WORDS[part] for part in parts), lines=f"lines of {parts[0]}",
        lacks=(), new=(), gain=bayes, bayes=bayes, fit=(NOISE,), doubts=doubts,
    )  # fmt: skip


FRICTION = cause("friction", bayes=60.0)
DOUBTFUL = replace(FRICTION, doubts=(Doubt("maxima"),))
AR1 = cause("ar1", bayes=100.0)
BOTH = cause("friction", "lag_w_1", bayes=80.0)
ALL = cause("friction", "lag_w_1", "offset_v", bayes=100.0)


@run_cases(
    "ranked, words",
    [
        ([AR1], "noise with memory absorbs the misfit, as it would any misfit, without explaining"),
        ([AR1], "That absorbs the misfit. The rig itself leaves unexplained 20 % of w_1."),
        ([FRICTION, AR1], "noise with memory absorbs more, as it would of any misfit, without"),
        ([DOUBTFUL], "do not trust the Bayes factor of friction at rotor 1: there is another max"),
        ([DOUBTFUL], "none of these can be trusted"),
        ([ALL, BOTH], "A without an offset of v"),
        ([BOTH, cause("offset_v", bayes=9.0)], "an offset of v"),
    ],
)
def test_candidates_are_described_by_what_they_do_to_the_misfit(
    ranked: list[Cause], words: str
) -> None:
    assert words in describe_causes(Causes(given=(NOISE,), ranked=tuple(ranked)))


def test_an_input_that_is_followed_like_a_set_point_is_named() -> None:
    followed = Causes(given=(NOISE,), ranked=(FRICTION,), reference=("v", "w_1"))
    assert "w_1 follows v like a set point, and does not respond like the rig" in describe_causes(
        followed
    )
    assert "set point" not in describe_causes(replace(followed, reference=None))
