"""What several experiments say of one rig, each for itself, in sentences and a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bayesdrill.insight.repeats import Repeat
from bayesdrill.report.identify_words import percent, product
from bayesdrill.report.sections import Table

EXPLAINED = (
    "Each experiment alone, around the joint maximum: how far it puts a product from all of them "
    "together, and its own standard deviation. `spread` is what is left between experiments beyond that."
)


def sentence(found: Sequence[Repeat], names: Sequence[str]) -> str:
    """Whether the experiments agree; empty where there are not two that could differ."""
    if not found:
        return ""
    far = [one for one in found if one.differs]
    if not far:
        return (
            "experiments: they tell the same of the rig, as far as each knows it "
            f"({len(found)} products compared)"
        )
    each = ", ".join(
        f"{product(names, one.exponents)} by {percent(one.spread)} (they know it to "
        f"{percent(min(one.sds))} to {percent(max(one.sds))})"
        for one in sorted(far, key=lambda one: one.p)
    )
    return (
        f"experiments: they do not tell the same of the rig: {each}; the joint posterior is too sure. "
        "The rig changed between them, or the model lacks what differs; `own: [...]` lets a parameter "
        "differ"
    )


def table(found: Sequence[Repeat], names: Sequence[str]) -> Table:
    """A line for each product."""
    labels = list(dict.fromkeys(label for one in found for label in one.labels))
    heads = ("", *labels, "spread", "by chance")
    lines = tuple(
        (
            product(names, one.exponents),
            *(_cell(one, label) for label in labels),
            percent(one.spread) if one.spread else "none",
            "**no**" if one.differs else f"{one.p:.2g}",
        )
        for one in found
    )
    return Table(heads, lines, frozenset(("",)))


def as_data(found: Sequence[Repeat], names: Sequence[str]) -> list[dict[str, Any]]:
    """For `run.json`; logs."""
    return [
        {
            "product": product(names, one.exponents),
            "apart": dict(zip(one.labels, one.apart, strict=True)),
            "sd": dict(zip(one.labels, one.sds, strict=True)),
            "spread": one.spread,
            "p": one.p,
        }
        for one in found
    ]


def _cell(one: Repeat, label: str) -> str:
    if label not in one.labels:
        return ""
    k = one.labels.index(label)
    return f"{100 * one.apart[k]:+.2g} % +- {percent(one.sds[k])}"
