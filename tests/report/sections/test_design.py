"""The figure and the sentences of a designed experiment."""

import dataclasses

import numpy as np
from support.array_cases import two
from support.case_tables import for_each
from support.figure_checks import drawn

from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.sections.design import describe_design, design_figure


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
