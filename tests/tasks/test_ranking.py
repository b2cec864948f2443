"""Rankings say which parts of a candidate stand for each other."""

from types import SimpleNamespace
from typing import Any

import pytest

from bayesdrill.tasks.ranking import Ranking

NEITHER, FIRST, SECOND = ("a",), ("a", "b"), ("a", "c")


def parts_alike(both: float, second: float, *, finished: bool = True) -> list[tuple[str, ...]]:
    """Return parts that stand for each other in a, b, c: a, and a with b, gain 100 and 140."""
    ranking: Any = object.__new__(Ranking)
    gains = {NEITHER: 100.0, FIRST: 140.0, SECOND: second}
    ranking.causes_by_parts = {names: SimpleNamespace(bayes=x) for names, x in gains.items()}
    ranking.given = SimpleNamespace(log_z=0.0)
    left: Any = (SimpleNamespace(like_noise=False),)
    top: Any = SimpleNamespace(log_z=both, fit=left, finished=finished)
    changes = tuple(SimpleNamespace(name=name, words=name) for name in "abc")
    rung: Any = SimpleNamespace(names=("a", "b", "c"), changes=changes)
    return [doubt.said_of for doubt in ranking._redundant(top, rung)]


@pytest.mark.parametrize(
    ("both", "second", "finished", "alike"),
    [
        (140.2, 140.0, True, [("b", "c")]),
        (145.0, 140.0, True, []),
        (137.0, 98.0, True, []),
        (95.0, 98.0, False, []),
        (101.0, 100.9, True, []),
    ],
    ids=["either does it", "both do more", "one does nothing", "stopped", "neither does much"],
)
def test_parts_are_alike_if_each_gains_nearly_all_that_both_gain(
    both: float, second: float, finished: bool, alike: list[tuple[str, ...]]
) -> None:
    assert parts_alike(both, second, finished=finished) == alike
