"""The page of the fit: inputs, each channel with what is left of it beside or below, frictions."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesdrill.report import style

FIT_SHARE = 0.6  # of the width, for the signals, where the residuals are beside them


@dataclass(frozen=True, slots=True)
class _Sizes:
    """Inches: `row` of signals, `rest` of residuals, `course` of an input or a friction, `legend` above
    signals.
    """

    row: float
    rest: float
    course: float
    left: float
    right: float
    bottom: float
    gap_x: float
    gap_y: float
    line: float
    legend: float


_WIDE = _Sizes(1.45, 1.45, 0.75, 0.84, 0.3, 0.42, 0.9, 0.12, 0.2, 0.6)
_NARROW = _Sizes(0.95, 0.55, 0.55, 0.68, 0.27, 0.38, 0.0, 0.1, 0.17, 0.5)


@dataclass(frozen=True, slots=True)
class FitPage:
    """`courses`: a panel for each input; `rows`: signals and residuals of each channel; `rubs`: a panel
    for each friction.

    `said`: the height in the figure, as a share, of the line that says what is constant.
    """

    figure: Figure
    courses: list[Axes]
    rows: list[tuple[Axes, Axes]]
    rubs: list[Axes]
    said: float
    left: float

    @property
    def panels(self) -> list[Axes]:
        return [*self.courses, *(panel for row in self.rows for panel in row), *self.rubs]


def build(n: int, n_courses: int, n_rubs: int, width: float, *, constant: bool) -> FitPage:
    """For `n` channels; times are written at the foot of each column only."""
    beside = width >= style.DOUBLE
    size = _WIDE if beside else _NARROW
    channel = size.row if beside else size.row + size.gap_y + size.rest
    inputs = n_courses * (size.course + size.gap_y) + (size.line if n_courses else 0.0)
    said = size.line if constant and (n_courses or not beside) else 0.0  # or above the one legend
    top = 0.06 + said + inputs + size.legend
    rubbing = size.gap_y + size.line + n_rubs * (size.course + size.gap_y) if n_rubs else 0.0
    height = top + n * channel + (n - 1) * size.gap_y + rubbing + size.bottom
    figure = Figure(figsize=(width, height))
    free = width - size.left - size.right - (size.gap_x if beside else 0.0)
    share = FIT_SHARE * free if beside else free

    def panel(x: float, y: float, w: float, h: float) -> Axes:
        made = figure.add_axes((x / width, (height - y - h) / height, w / width, h / height))
        made.tick_params(labelbottom=False)
        return made

    y = 0.06 + said + (size.line if n_courses else 0.0)
    courses = [
        panel(size.left, y + k * (size.course + size.gap_y), share, size.course)
        for k in range(n_courses)
    ]
    rows = []
    for k in range(n):
        y = top + k * (channel + size.gap_y)
        signals = panel(size.left, y, share, size.row)
        if beside:
            rest = panel(size.left + share + size.gap_x, y, free - share, size.rest)
        else:
            rest = panel(size.left, y + size.row + size.gap_y, share, size.rest)
        rows.append((signals, rest))
    y = top + n * (channel + size.gap_y) + size.line
    rubs = [
        panel(size.left, y + k * (size.course + size.gap_y), share, size.course)
        for k in range(n_rubs)
    ]
    signals, rest = rows[-1]
    left = rubs[-1] if rubs else signals
    for foot in (left, rest) if beside else (rubs or [rest])[-1:]:
        foot.tick_params(labelbottom=True)
    return FitPage(figure, courses, rows, rubs, 1 - 0.06 / height, size.left / width)
