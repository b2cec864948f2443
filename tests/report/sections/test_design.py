"""The figure and the sentences of a designed experiment."""

import dataclasses
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
from support.array_cases import two
from support.case_tables import for_each
from support.figure_checks import drawn

from bayesdrill.design.study import DESIGNED, RECORDED, TargetOutlook
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.sections.design import (
    describe_design,
    design_figure,
    design_table,
    odds_sentence,
    target_sentences,
)


def test_marks_of_equal_sds_hide_no_other_and_draws_are_explained() -> None:
    """Mutant: all marks of a target are drawn at one height."""
    case = two()
    found = case.design(("k_s", "t_f"), family="step", hold=1.0, duration=4.0, draws=1).design
    same = {
        name: dict.fromkeys(target.after, target.designed)
        for name, target in zip(("k_s", "t_f"), found.targets, strict=True)
    }
    targets = tuple(dataclasses.replace(t, after=same[t.name]) for t in found.targets)
    alike = dataclasses.replace(found, targets=targets)

    def check(inches: float) -> None:
        panel = drawn(design_figure(alike, case.job.problem, inches)).axes[-1]
        marks = [line for line in panel.lines if line.get_marker() in {"s", "D", "o"}]
        places = np.concatenate(
            [line.get_transform().transform(line.get_xydata()) for line in marks]
        )
        pixels = panel.figure.dpi / 72.0
        apart = np.linalg.norm(places[:, None] - places, axis=-1)[np.triu_indices(len(places), 1)]
        assert len(places) == 3 * len(targets)
        assert apart.min() > 3.5 * pixels

    for_each({size: (inches,) for size, inches in WIDTHS.items()}, check)
    assert "promised relative sds, at the start values:" in describe_design(found)
    heads = describe_design(found).splitlines()[3].split()
    assert {*found.targets[0].usual_sds} <= {*heads}  # a sentence may name any of them
    averaged = "averaged over 8 draws of the prior, each of them a possible rig:"
    assert averaged in describe_design(dataclasses.replace(found, draws=8))


def outlook(name: str, designed: float, **rest: Any) -> TargetOutlook:
    """Return a target that is known to 10 %, or 4 % after the best usual waveform."""
    return TargetOutlook(name=name, now=0.1, after={"step": 0.04, DESIGNED: designed}, **rest)


def test_targets_that_no_waveform_shows_are_named_with_the_symmetry_and_its_remedies() -> None:
    scaled, sensor = (("k_s", "j_1"), ("r_m",)), ("a sensor of w_2", 3.0)
    targets = (
        outlook("k_s", 0.1, hidden_by=scaled, remedies=(sensor,)),
        outlook("c_m", 0.095),
        outlook("k_e", 0.01),
        outlook("r_m", 0.08),
    )
    made: Any = SimpleNamespace(targets=targets)
    assert target_sentences(made).splitlines() == [
        "k_s: no waveform shows it, as scaling k_s, j_1; r_m together changes no channel",
        "  a sensor of w_2: this divides its sd by 3",
        "c_m: hardly any waveform within these limits shows it above the noise",
        "k_e: from 10 % to 1 %, 4 times as sharp as step, the best usual waveform for it",
        "r_m: from 10 % to 8 %, step would be 2 times as sharp for it alone",
    ]


def test_log_odds_of_a_design_are_compared_with_the_best_usual_waveform() -> None:
    odds = {RECORDED: 99.0, "step": 2.0, "prbs": 4.0, DESIGNED: 12.0}
    made: Any = SimpleNamespace(log_odds=odds, criteria={})
    assert "has 3 times the log odds of prbs, the best usual waveform" in odds_sentence(made)
    made.log_odds = odds | {DESIGNED: 4.1}
    assert "has about the log odds of prbs" in odds_sentence(made)
    heads, row = design_table(made).splitlines()
    shown = dict(zip(re.split("  +", heads.strip()), row.split()[2:], strict=True))
    assert shown == {name: f"{x:.3g}" for name, x in made.log_odds.items()}
