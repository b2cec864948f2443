"""The page of a corner plot: how large panels and letters are, and where the legend has room."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayesdrill.report.widths import DOUBLE, SINGLE

GAP = 0.06  # between panels, in panels
LARGEST = 2.2  # panel
LEAST = 13.0  # points from one panel to the next: a page grows rather than have less
LABEL = 7.8  # letters across a panel that its label and unit need, one upon the other
UPRIGHT = 2.6  # and where they are turned by a right angle
READABLE = 5.7  # points: below, labels are turned
TITLE = 0.106  # inches of a title, for each point of its letters
LEGEND = 2.35, 0.21  # inches of a legend beside, or above, of 8 points, and of a line of it


@dataclass(frozen=True, slots=True)
class CornerPage:
    """Inches, and `letters` in points.

    `pitch`: from one panel to the next; `compact`: symbols at the left, and at the foot upright labels
    with the ends of each axis, instead of ticks with texts; `above`: the legend is, not in the corner.
    """

    n: int
    width: float
    pitch: float
    left: float
    right: float
    bottom: float
    top: float
    letters: float
    legend_letters: float
    compact: bool
    above: bool

    @classmethod
    def of(cls, n: int, width: float, lines: int) -> CornerPage:
        """For `n` unknowns in at most `width`, with a legend of so many `lines`."""
        compact, fits = False, _roomy(n, width)
        if fits[1] < READABLE:
            compact, fits = True, _compact(n, width)
        pitch, letters, left, right, bottom = fits
        legend_letters = 8.0 if width >= DOUBLE else 6.4
        across, line = (size * legend_letters / 8.0 for size in LEGEND)
        page = left + n * pitch + right
        title = 0.02 + 0.028 * letters
        page = max(page, left + across + right + pitch if n == 1 else 0.0)
        above = page > width or not _beside(
            n, (page, pitch, left, letters), across, title + lines * line
        )
        if above:
            page = max(left + n * pitch + right, min(width, SINGLE))
            rows = math.ceil(lines / 2) + 1
        top = title + (rows * 0.75 * line if above else 0.0)
        return cls(
            n=n,
            width=page,
            pitch=pitch,
            left=left,
            right=right,
            bottom=bottom,
            top=top,
            letters=letters,
            legend_letters=legend_letters,
            compact=compact,
            above=above,
        )

    @property
    def inside(self) -> float:
        """All panels, and the gaps between them."""
        return self.n * self.pitch - GAP * self.panel

    @property
    def panel(self) -> float:
        return self.pitch / (1 + GAP)

    @property
    def height(self) -> float:
        return self.bottom + self.inside + self.top

    @property
    def fine(self) -> float:
        """By which lines and marks are thinner than in a large panel."""
        return min(1.0, max(0.45, self.panel / 1.05))

    @property
    def letter(self) -> float:
        """Of a tick, in panels."""
        return 0.43 * self.letters / (72 * self.pitch)


def _roomy(n: int, width: float) -> tuple[float, ...]:
    """Pitch, letters, left, right, bottom, with ticks and labels along the panels."""
    letters = pitch = 10.0
    for _ in range(30):
        left, right = 0.088 * letters, max(0.12, TITLE * letters - pitch)
        pitch = min(LARGEST * (1 + GAP), (width - left - right) / n)
        letters = min(10.0 if width >= DOUBLE else 8.5, 72 * pitch / LABEL)
    return pitch, letters, left, right, 0.088 * letters


def _compact(n: int, width: float) -> tuple[float, ...]:
    letters, pitch = 6.0, 0.3
    for _ in range(30):
        left, right = 0.085 * letters, max(0.06, TITLE * letters - pitch)
        pitch = max(LEAST / 72, (width - left - right) / n)
        letters = min(6.5, 72 * pitch / UPRIGHT)
    return pitch, letters, left, right, 0.17 * letters


def _beside(n: int, page: tuple[float, ...], across: float, deep: float) -> bool:
    """Whether a legend so broad and so deep has room in the corner, or beside a single panel."""
    width, pitch, left, letters = page
    if n == 1:
        return True
    rows = min(n, math.ceil(deep / pitch))
    taken = left + max(rows * pitch, (rows - 1) * pitch + TITLE * letters)
    return rows < n and width - across > taken
