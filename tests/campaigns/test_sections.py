"""The page of a run says why the run does not belong to the others."""

import math
from types import SimpleNamespace
from typing import Any

from support.case_tables import run_cases

from bayesdrill.campaigns.sections import level_cells, likely_reason

EXPLAINED = SimpleNamespace(best=SimpleNamespace(about="a gear of 7:1"))


@run_cases(
    "outlier, causes, words",
    [
        (False, None, ""),
        (True, None, "the model fits its record, so the rig or its state differed from other runs"),
        (True, EXPLAINED, "its record is explained by a gear of 7:1"),
        (False, SimpleNamespace(best=None), "nothing that was tried explains its record"),
    ],
)
def test_the_likely_reason_is_a_cause_of_its_misfit_or_another_rig(
    outlier: bool, causes: Any, words: str
) -> None:
    outcome: Any = SimpleNamespace(outlier=outlier)
    assert likely_reason(outcome, causes) == words


@run_cases("sd, shown", [(0.07, "0.1235"), (1.3e-4, "0.123457"), (0.0, "0.12345678912346")])
def test_a_level_has_two_digits_of_its_sd(sd: float, shown: str) -> None:
    assert level_cells("level", "+-", math.log(0.1234567891234567), sd)["level"] == shown
