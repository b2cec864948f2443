"""One word for one unknown, in whatever table it stands."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from bayesdrill.insight.diagnostics import Row, Word
from bayesdrill.insight.verdict import Quantity, Verdict


def reconciled(rows: Sequence[Row], verdict: Verdict) -> tuple[Row, ...]:
    """Draws alone cannot tell what the record narrows from what the priors of others do.

    So the verdict, which can, has the word where both say something of an unknown.
    """
    judged = {
        verdict.names[quantity.exponents.index(1)]: quantity for quantity in verdict.parameters
    }
    return tuple(
        dataclasses.replace(row, word=_word(row, judged[row.name])) if row.name in judged else row
        for row in rows
    )


def _word(row: Row, quantity: Quantity) -> Word:
    match quantity.says:
        case "agrees" | "disagrees" | "in doubt":
            return "determined"
        case "not determined" if row.word == "determined":
            return "through others" if quantity.blind else "weak"
    return row.word
