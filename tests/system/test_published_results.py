"""Results that are published are those of today's configs and records, and others are detected."""

import shutil
from pathlib import Path

import pytest

from docs import results

ROOT = results.ROOT


def test_what_is_published_is_of_todays_configs_and_records() -> None:
    assert list(results.stale(ROOT)) == []


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """One config, and what is published of it and of the paper."""
    (tmp_path / "configs" / "records").mkdir(parents=True)
    for name in ("nominal_step.yaml", "records/nominal_step.csv"):
        shutil.copyfile(ROOT / "configs" / name, tmp_path / "configs" / name)
    for name in ("nominal_step", results.DESIGNED, results.PAPER):
        shutil.copytree(results.published(ROOT) / name, results.published(tmp_path) / name)
    assert list(results.stale(tmp_path)) == []
    return tmp_path


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_another_config_record_table_or_figure_is_found(tree: Path) -> None:
    config = tree / "configs" / "nominal_step.yaml"
    mine = results.published(tree) / "nominal_step"
    change(config, "seed: 2013", "seed: 2014")
    change(mine / "summary.csv", "determined", "weak")
    shutil.copyfile(mine / "figures" / "trace.png", mine / "figures" / "fit.png")
    (mine / "table.tex").unlink()
    assert list(results.stale(tree)) == [
        "nominal_step: the seed was 2013 and is 2014",
        "nominal_step: figures/fit.png is not of its run",
        "nominal_step: summary.csv is not of its run",
        "nominal_step: table.tex is missing",
    ]
    record = tree / "configs" / "records" / "nominal_step.csv"
    lines = record.read_text().splitlines()
    other = "1" if lines[-1][-1] != "1" else "2"
    record.write_text("\n".join([*lines[:-1], lines[-1][:-1] + other]) + "\n")
    assert any("the record was" in line for line in results.stale(tree))
