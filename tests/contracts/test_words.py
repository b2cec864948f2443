"""Names of package and tests are the field's own, and texts for users are short.

Private words that were retired do not come back, a public class has a name of its own, and no sentence
that users read is longer than `LONGEST_SENTENCE`.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from support import syntax
from support.case_tables import run_cases

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "bayesdrill"
FOLDERS = (PACKAGE, ROOT / "tests")

# As names of functions, classes, fields, arguments and variables.
FILLERS = ("one", "found", "own")
MOST_FILLERS = {"bayesdrill": 30, "tests": 975}
# As names of classes, functions and modules.
RETIRED = frozenset(
    """
    Ahead Alike as_they_come beginning bent carried choosing climb Climbed concluding Contender
    Crew Declared Deeds elsewhere Entry Expansion Filtered followed Follows Frame Fused Given
    Going held Hunt in_the_way Instead Judged laddering Lane Layer Left left_out Loaded Look
    mapping marching Mark Measured met Nowhere Odd Opened opened Parts Past proving pull Pushed
    Regime Remains Resting resting Ridge Rub rubbed scatter Scene Scenery scouts sealed Sensing
    Settled settling Shaken Shaking shaking Sheet Shelf Sparing spreading StandIn standing_in
    Steadily steadily straighten strange Stride striding sundry Surface take_away Tally taught
    Told told told_apart tops Turning Vague View Walkers Widened widened Wired
    """.split()  # noqa: SIM905
)
# As modules of tests, which have the names of those that they test.
RETIRED_TESTS = frozenset(
    """
    dear following instead leaning pressed records_as_they_come resting shaken shaking together
    told_apart vagueness
    """.split()  # noqa: SIM905
)
# Retired words that tests still have; none may be added.
REMAINING = {"held", "opened", "told"}
LONGEST_SENTENCE = 35  # words, of texts for users


@cache
def nodes(folder: Path) -> list[tuple[Path, ast.AST]]:
    return [(path, node) for path in sorted(folder.rglob("*.py")) for node in syntax.nodes(path)]


def names(folder: Path) -> Iterator[str]:
    """Return all names that are defined or used."""
    for _, node in nodes(folder):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                yield name
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield name


@run_cases("folder", FOLDERS, ids=lambda folder: folder.name)
def test_names_are_not_fillers(folder: Path) -> None:
    counts = Counter(name for name in names(folder) if name in FILLERS)
    assert counts.total() <= MOST_FILLERS[folder.name], counts


@run_cases("folder", FOLDERS, ids=lambda folder: folder.name)
def test_retired_words_do_not_come_back(folder: Path) -> None:
    kinds = ast.FunctionDef | ast.ClassDef
    defined = {node.name for _, node in nodes(folder) if isinstance(node, kinds)}
    modules = {path.stem for path, _ in nodes(folder)}
    retired = RETIRED | {f"test_{name}" for name in RETIRED_TESTS}
    allowed = REMAINING if folder.name == "tests" else set[str]()
    assert ((defined | modules) & retired) - allowed == set()


def test_public_classes_have_names_of_their_own() -> None:
    # Results know the noise of a torque by the `repr` of a record's channels.
    exempt = {"Channel", "Entries"}
    counts = Counter(
        node.name
        for path, node in nodes(PACKAGE)
        if isinstance(node, ast.ClassDef)
        and not node.name.startswith("_")
        and "schema" not in path.parts
    )
    assert [name for name, count in counts.items() if count > 1 and name not in exempt] == []


def texts() -> Iterator[tuple[Path, int, str]]:
    """Return files, lines and strings that are no docstrings; a word stands for each value in them."""
    skipped = set[int]()
    for path, node in nodes(PACKAGE):  # outer nodes come first
        match node:
            case ast.Module(body=[ast.Expr(value=docstring), *_]):
                skipped.add(id(docstring))
            case ast.ClassDef(body=[ast.Expr(value=docstring), *_]):
                skipped.add(id(docstring))
            case ast.FunctionDef(body=[ast.Expr(value=docstring), *_]):
                skipped.add(id(docstring))
            case ast.JoinedStr(values=values):
                skipped |= {id(value) for value in values}
                parts = [v.value if isinstance(v, ast.Constant) else "X" for v in values]
                yield path, node.lineno, "".join(map(str, parts))
            case ast.Constant(value=str(text)) if id(node) not in skipped:
                yield path, node.lineno, text


def test_sentences_for_users_are_short() -> None:
    """Whoever has school English reads them; a semicolon does not end one. Heads of tables are none."""
    long = [
        f"{path.relative_to(PACKAGE)}:{line}: {len(sentence.split())} words"
        for path, line, text in texts()
        if " | " not in text
        for sentence in re.split(r"(?<=[.!?])\s+|\n", text)
        if len(sentence.split()) > LONGEST_SENTENCE
    ]
    assert long == []
