"""The numbers in `docs/paper.md` are those of the tables."""

import re
import runpy
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
DOCS, TABLES = ROOT / "docs", ROOT / "results" / "published" / "paper"


# Numbers that the text may have without a table: what the studies are given, names and ranges.
GIVEN = (
    r"ENIEF 2013|arXiv 2107\.13535|Tables? [123]|and 3, which|Figure [1-4]|A\([56],[15]\)|\bi_n\b|"
    r"ode23t|table_\w+|10 s at 100 Hz|10 s at 1 kHz|0\.1 rad(/s)?|7e-3 kg m²|0\.2 ohm|94 %|i_m²|"
    r"\(0\.001, 0\.01\)|64 times|sigma_n = (0\.1 and 1|0\.001|0\.01|1)|less than 0\.01|% at 0\.001\.|"
    r"factor 1/2|1/sigma_n²|within 20 %|up to 60 %|2\.4 m long and 3 mm|noise of 1|\w+_[12]\b"
)


def rendered(tables: Path) -> str:
    render = runpy.run_path(str(DOCS / "render.py"))["render"]
    return render((DOCS / "paper.template.md").read_text(), tables)


def test_every_number_in_the_page_comes_from_the_tables() -> None:
    """The page is its template filled in; what the template itself has are names and givens."""
    assert rendered(TABLES) == (DOCS / "paper.md").read_text()
    text = (DOCS / "paper.template.md").read_text()
    text = re.sub(r"\{[^}]*\}|`[^`]*`|\]\([^)]*\)", " ", text)
    left = re.sub(GIVEN, " ", text)
    assert re.findall(r".*\d.*", left) == []


def test_a_table_that_has_no_such_line_is_told(tmp_path: Path) -> None:
    shutil.copytree(TABLES, tmp_path / "tables")
    path = tmp_path / "tables" / "matrix.csv"
    path.write_text(path.read_text().replace("right,", "wrong,"))
    with pytest.raises(LookupError, match=r"matrix\.csv has 0 lines with right"):
        rendered(tmp_path / "tables")
