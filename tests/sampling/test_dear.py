"""Where a look along Newton ridges would take minutes it is not made."""

from __future__ import annotations

import numpy as np
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.ensembles import slopes_are_expensive

BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
RIG = {**dict.fromkeys(("j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "t_f"), "nominal"), "k_s": BOX}


def of(n: int, **channel: object) -> Posterior:
    t = 0.01 * np.arange(n)
    seen = {"w_1": bd.Channel(np.sin(t), "rad/s", 0.1, **channel)}
    made = bd.case(t, seen, {"v": 8.0}, {**RIG, "j_1": BOX}, nominal="tables_2_3")
    return made.job.problem.posterior


@run_cases(
    "samples, channel, is_dear",
    [
        (40_000, {}, False),  # sums alone
        (1000, {"lag": {"prior": "uniform", "low": 0, "high": 0.1}}, False),
        (40_000, {"lag": {"prior": "uniform", "low": 0, "high": 0.1}}, True),
    ],
)
def test_long_records_with_samples_of_their_own_are(
    samples: int, channel: dict[str, object], is_dear: bool
) -> None:
    assert slopes_are_expensive(of(samples, **channel)) == is_dear
