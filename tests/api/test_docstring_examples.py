"""The examples in the docstrings of the public API run and print what they say."""

import doctest
import inspect
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.array_cases import two
from support.case_tables import slow_except

import bayesdrill as bd
from bayesdrill.sampling.optimisers import contract


def examples() -> Iterator[tuple[str, str]]:
    """Return names and docstrings of public functions, classes and methods that have an example."""
    owned = ((name, getattr(owner, name)) for owner in (bd, contract) for name in dir(owner))
    for name, thing in owned:
        members = vars(thing) if isinstance(thing, type) else {}
        labelled = {name: thing} | {f"{name}.{m}": member for m, member in members.items()}
        for label, member in labelled.items():
            ours = str(getattr(member, "__module__", "")).startswith("bayesdrill")
            if ours and ">>>" in (text := inspect.getdoc(member) or ""):
                yield label, text


@cache
def run_without_figures() -> bd.Run:
    return two(output={"figures": []}).sample()


EXAMPLES, PARSER = dict(examples()), doctest.DocTestParser()
# Those of results need a run; other tests of the API call the same functions.
LONG = {
    x for x, text in EXAMPLES.items() if any("run" in y.source for y in PARSER.get_examples(text))
}
EVERY = slow_except(EXAMPLES.keys() - LONG, EXAMPLES)


@pytest.mark.parametrize("name", EVERY)
def test_examples_of_docstrings_print_what_they_say(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    bd.example("configs")
    names = {**vars(contract), "bd": bd, "np": np, "case": two()}
    if name in LONG:
        names["run"] = run_without_figures()
    example = PARSER.get_doctest(EXAMPLES[name], names, name, None, None)
    assert doctest.DocTestRunner().run(example).failed == 0
