"""What a ladder tries, and what it recommends, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from bayesdrill.report import comparison_words
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.setup.rungs import Rung


def opening(every: Sequence[Rung], missing: int) -> str:
    """What is to be run."""
    if not every:
        return "nothing more to try"
    done = f" ({len(every) - missing} of them done before)" if missing < len(every) else ""
    return "\n".join(
        [f"to try{done}:", *(f"  {one.name}: {one.about}" for one in every)],
    )


def conclusion(chosen: Rung, left_out: Mapping[str, str], config: Path) -> str:
    """What was not tried, and what to go on with."""
    return "\n".join([*_left_out(left_out), f"recommended: {chosen.about}: {config}"])


def _left_out(left_out: Mapping[str, str]) -> Iterator[str]:
    for name, reason in left_out.items():
        yield f"left out: {name}: {reason}"


def about_config(chosen: Rung, name: str, report: ComparisonReport) -> str:
    """For the head of the config."""
    verdict = next(iter(comparison_words.verdict(report.models)))
    simplest = "the simplest of the models that are about as probable as the best"
    return f"{name}: {chosen.about}, {simplest}.\n{verdict}"
