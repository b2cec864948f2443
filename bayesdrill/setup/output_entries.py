"""What a config may say of the results: which figures of what, how large, in which files."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bayesdrill.basics.entries import MOST, Strict

MOST_NAMED = 50  # channels, quantities, formulas; names in a figure
Format = Literal["pdf", "png", "svg"]


def _usual_formats() -> list[Format]:
    return ["pdf", "png"]


class OutputSpec(Strict):
    predictive_draws: Annotated[int, Field(ge=10, le=MOST)] = Field(
        125, description="Per ensemble, with pointwise log likelihood and predictive samples."
    )
    figures: Annotated[list[str], Field(max_length=MOST_NAMED)] | None = Field(
        None, description="Which are drawn, by name; default: all but those on request."
    )
    parameters: Annotated[list[str], Field(min_length=1, max_length=MOST_NAMED)] | None = Field(
        None, description="Unknowns of corner, trace and prior_posterior; default: all."
    )
    corner: Annotated[list[str], Field(min_length=1, max_length=MOST_NAMED)] | None = Field(
        None,
        description="Unknowns and derived quantities of the corner plot; default: `parameters`.",
    )
    size: Literal["single", "double"] = Field(
        "double", description="Width of figures: 3.4 in, one column of a page, or 7 in."
    )
    formats: Annotated[list[Format], Field(min_length=1, max_length=3)] = Field(
        default_factory=_usual_formats, description="Of the files of figures."
    )
    dpi: Annotated[int, Field(ge=50, le=1200)] = Field(
        220, description="Pixels to an inch, of png and of dots in the others."
    )
