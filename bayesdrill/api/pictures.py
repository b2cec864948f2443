"""Figures as a script or a notebook gets them."""

from __future__ import annotations

import io
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 200  # sharp on a screen


def for_notebooks(figure: Figure) -> Figure:
    """It shows itself as the last line of a cell."""
    # A notebook asks a figure for its picture only once pyplot is loaded, which nothing here does.
    figure._repr_png_ = partial(_as_png, figure)  # type: ignore[attr-defined]
    return figure


def _as_png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI)
    return out.getvalue()
