"""Figures of a run: one file and one line in `output_files`, or an entry point `bayesdrill.figure`.

A recipe says of a finished run what is to be drawn, or None where there is nothing.  Recipes load what
draws when they are asked: matplotlib takes a second, and drawing longer than all tables together.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection

from bayesdrill.basics.registry import Registry, callable_one
from bayesdrill.inference.posterior import Problem
from bayesdrill.output_files import ON_REQUEST, OWN_FIGURES, numbered
from bayesdrill.report.view import Drawing, View, captioned

FIT_ALONE = "Record and model at the MAP; beside them what is left, and the noise."

Recipe = Callable[[View], Drawing | tuple[Drawing, ...] | None]


def drawings(name: str, run: View) -> dict[str, Drawing]:
    """What is to be drawn of this run, by the stems of the files: one, or one for each experiment.

    Raises `TypeError` for a recipe that is none.
    """
    found = FIGURES[name](run)
    every = found if isinstance(found, tuple) else () if found is None else (found,)
    for one in every:
        if not isinstance(one, Drawing):
            raise TypeError(f"a recipe gives a Drawing or None, not {type(one).__name__}")
    return numbered(name, every)


def alone_captions(problem: Problem) -> dict[str, str]:
    """What `fits_alone` shows, without drawing it."""
    return numbered("fit", [captioned(one.label, FIT_ALONE) for one in problem.observations])


def _recipe(name: str, module: str) -> Recipe:
    """`draw_<name>` of a module of this folder, which is loaded when something is to be drawn."""

    def draw(run: View) -> Drawing | tuple[Drawing, ...] | None:
        found: Recipe = getattr(importlib.import_module(f"{__package__}.{module}"), f"draw_{name}")
        return found(run)

    return draw


FIGURES: Registry[Recipe] = Registry(
    "figure",
    {name: _recipe(name, module) for name, module in OWN_FIGURES.items()},
    judge=callable_one,
)


def drawn(wanted: Collection[str] | None) -> list[str]:
    """Names of the figures that a config asks for; None: all but those on request."""
    if wanted is None:
        return [name for name in FIGURES if name not in ON_REQUEST]
    return [name for name in FIGURES if name in wanted]
