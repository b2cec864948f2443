"""The page of the fit: inputs above, then each channel with what is left of it, beside or below."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesdrill.report import style

FIT_SHARE = 0.6  # of the width, for the signals, where the residuals are beside them


@dataclass(frozen=True, slots=True)
class _Sizes:
    """Inches: `row` of signals, `rest` of residuals, `course` of an input, `legend` above signals."""

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
    """`courses`: a panel for each input; `rows`: signals and residuals of each channel.

    `said`: the height in the figure, as a share, of the line that says what is constant.
    """

    figure: Figure
    courses: list[Axes]
    rows: list[tuple[Axes, Axes]]
    said: float
    left: float

    @property
    def panels(self) -> list[Axes]:
        return [*self.courses, *(panel for row in self.rows for panel in row)]


def build(n: int, n_courses: int, width: float, *, constant: bool) -> FitPage:
    """For `n` channels; times are written at the foot of each column only."""
    beside = width >= style.DOUBLE
    size = _WIDE if beside else _NARROW
    channel = size.row if beside else size.row + size.gap_y + size.rest
    inputs = n_courses * (size.course + size.gap_y) + (size.line if n_courses else 0.0)
    said = size.line if constant and (n_courses or not beside) else 0.0  # or above the one legend
    top = 0.06 + said + inputs + size.legend
    height = top + n * channel + (n - 1) * size.gap_y + size.bottom
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
    for foot in rows[-1] if beside else rows[-1][1:]:
        foot.tick_params(labelbottom=True)
    return FitPage(figure, courses, rows, 1 - 0.06 / height, size.left / width)
