"""The zoo as files: every row a config and its record, to be looked at and run by hand."""

from __future__ import annotations

from pathlib import Path

from bayesdrill.output_files import atomic_write
from benchmarks.zoo.makers import ROOT
from benchmarks.zoo.row import Row
from benchmarks.zoo.texts import as_yaml, parsed

FOLDER = ROOT / "results" / "zoo"
SECOND = 1_000_000  # is added to the seed of a row's second run


def write(row: Row, folder: Path) -> tuple[Path, Path]:
    """Two configs that differ in their seed, and the record that both name."""
    records = folder / "records"
    records.mkdir(parents=True, exist_ok=True)
    first = folder / f"{row.name}.yaml"
    case = parsed(first, text(row, row.seed))
    record = records / f"{row.name}.csv"
    made = row.made.record(case, record)
    second = folder / "again" / first.name
    second.parent.mkdir(exist_ok=True)
    for path, content in (
        (record, made),
        (first, case.source.text),
        (second, text(row, row.seed + SECOND, "../")),
    ):
        with atomic_write(path) as aside:
            aside.write_text(content, encoding="utf-8")
    return first, second


def text(row: Row, seed: int, up: str = "") -> str:
    """The config of a row, which says what it shows; `up` leads to the folder of its record."""
    record = {"file": f"{up}records/{row.name}.csv", **row.config["record"]}
    data = {"name": row.name, "seed": seed, **row.config, "record": record}
    expected = "" if row.sound else f"# A run must not be believed, and says: {row.reason}.\n"
    return f"# {row.shows[0].upper()}{row.shows[1:]}.\n{expected}\n{as_yaml(data)}"
