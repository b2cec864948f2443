"""`bayesdrill paper`: whole, twice, and its numbers in `docs/paper.md`."""

from __future__ import annotations

import csv
import re
import runpy
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import systems
from together import together

from bayesdrill.output_files import dumps_checksummed
from bayesdrill.paper.printed import NINE_PARAMETERS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
TABLES = DOCS / "paper"
FIGURES = (
    *("rig", "heuristic", "matrix", "table_2", "simultaneous", "convergence"),
    *("fit_estimates", "fit_measured", "table_3_estimates", "table_3_measured"),
)

# Numbers that the text may have without a table: what the studies are given, names and ranges.
GIVEN = (
    r"ENIEF 2013|arXiv 2107\.13535|Tables? [123]|and 3, which|Figure [1-4]|A\([56],[15]\)|\bi_n\b|"
    r"ode23t|table_\w+|10 s at 100 Hz|10 s at 1 kHz|0\.1 rad(/s)?|7e-3 kg m²|0\.2 ohm|94 %|i_m²|"
    r"\(0\.001, 0\.01\)|64 times|sigma_n = (0\.1 and 1|0\.001|0\.01|1)|less than 0\.01|% at 0\.001\.|"
    r"factor 1/2|1/sigma_n²|within 20 %|up to 60 %|2\.4 m long and 3 mm|noise of 1|\w+_[12]\b"
)


def rows(folder: Path, stem: str) -> list[dict[str, str]]:
    with (folder / f"{stem}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


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


def test_results_are_not_overwritten_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    (tmp_path / "run.json").write_text(dumps_checksummed({"job": "paper", "fingerprint": {}}))
    ran = systems.cli("paper", "--output", str(tmp_path))
    assert ran.status == 2
    assert "exist already" in ran.err
    assert "--force" in ran.err
    assert [p.name for p in tmp_path.iterdir()] == ["run.json"]


def changed(name: str, old: str, new: str) -> Callable[[Path], None]:
    """Spoils one place in a config."""

    def spoil(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return spoil


def deleted(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def held(*names: str) -> Callable[[Path], None]:
    """These are no longer unknown in the config of the measured record."""

    def spoil(folder: Path) -> None:
        path = folder / "measured.yaml"
        kept = "|".join(names)
        path.write_text(re.sub(rf"(  (?:{kept}): )\{{.*\}}", r"\1nominal", path.read_text()))

    return spoil


UNKNOWN = "sigma: {prior: log_uniform, low: 0.01, high: 1}}"


@together(
    "spoil, says",
    [
        (deleted("measured.yaml"), "measured.yaml"),
        (deleted("missing_physics.yaml"), "missing_physics.yaml"),
        (deleted("records/missing_physics.csv"), "missing_physics.csv"),
        (changed("estimates.yaml", "  t_f: {", "  t_g: {"), "estimates.yaml:"),
        (changed("missing_physics.yaml", "j_2:", "j_3:"), "missing_physics.yaml:"),
        (changed("measured.yaml", "sigma: 0.1}", UNKNOWN), "give each sigma as a number"),
        (held("j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "k_s", "j_1"), "two unknown parameters"),
        (
            changed(
                "two_parameters.yaml", "j_m: nominal", "j_m: {prior: uniform, low: 0, high: 1}"
            ),
            "Table 2 has the unknowns c_m and k_e",
        ),
        (changed("measured.yaml", "name: measured", "name: Estimates"), "measured.yaml:6"),
        (changed("measured.yaml", "name: measured", "name: figures"), "give another"),
        (
            changed("two_parameters.yaml", "inputs: {v: 8.0}", "inputs: {v: {column: t, unit: V}}"),
            "under a constant voltage",
        ),
    ],
)
def test_a_mistake_in_the_configs_is_told_before_anything_runs(
    spoil: Callable[[Path], None], says: str, tmp_path: Path
) -> None:
    shutil.copytree(ROOT / "configs" / "paper", tmp_path / "paper")
    spoil(tmp_path / "paper")
    ran = systems.cli("paper", str(tmp_path / "paper"), "--output", str(tmp_path / "out"))
    assert ran.status == 2
    assert says in ran.err
    assert "Traceback" not in ran.err
    assert not (tmp_path / "out").exists()


@together("given", ["configs/paper/measured.yaml", "configs/nothing"])
def test_what_is_no_folder_of_studies_is_told(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    ran = systems.cli("paper", given)
    assert ran.status == 2
    assert ran.err.startswith(f"{given}: ")
    assert "give the one that holds two_parameters.yaml" in ran.err


def test_a_report_of_these_results_says_what_makes_it(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(
        dumps_checksummed({"status": "running", "job": "paper", "fingerprint": {}})
    )
    ran = systems.cli("report", str(tmp_path))
    assert ran.status == 2
    assert "results of `bayesdrill paper`" in ran.err
    assert "--resume" not in ran.err


def test_a_file_in_the_place_of_the_results_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    (tmp_path / "out").write_text("mine")
    ran = systems.cli("paper", "--output", str(tmp_path / "out"))
    assert ran.status == 2
    assert "a file is in the way; give another --output" in ran.err
    assert (tmp_path / "out").read_text() == "mine"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("paper") / "results"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        ran = systems.cli("paper", "--output", str(folder))
    assert ran.status == 0, ran.err
    return folder


@pytest.mark.slow
def test_all_tables_and_figures_are_written(results: Path) -> None:
    for stem in FIGURES:
        for end in ("png", "pdf"):
            assert (results / "figures" / f"{stem}.{end}").stat().st_size > 5000
    for path in TABLES.iterdir():
        assert (results / path.name).exists()
    for name in ("estimates", "measured"):
        assert (results / name / "posterior.nc").exists()
    report = (results / "report.md").read_text()
    for link in re.findall(r"\]\(([^)]+)\)", report):
        assert (results / link).exists()


@pytest.mark.slow
def test_the_page_has_the_numbers_of_this_run(results: Path) -> None:
    """To the last digit on the machine that wrote it; elsewhere chains differ in theirs."""
    committed, fresh = ((DOCS / "paper.md").read_text(), rendered(results))
    number = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
    assert number.sub("#", committed).split() == number.sub("#", fresh).split()
    pairs = list(zip(number.findall(committed), number.findall(fresh), strict=True))
    off = [(a, b) for a, b in pairs if float(b) != pytest.approx(float(a), rel=0.1, abs=1e-3)]
    assert len(off) <= 0.05 * len(pairs), off


@pytest.mark.slow
def test_estimates_of_two_parameters_are_efficient(results: Path) -> None:
    """Within 10 % of the Cramer-Rao bound; 400 records leave 3.5 % to chance."""
    for row in rows(results, "table_2"):
        ratio = float(row["spread_scaled_percent"]) / float(row["bound_percent"])
        assert 0.9 < ratio < 1.1, row


@pytest.mark.slow
def test_the_heuristic_reaches_the_floor_at_wrong_values_and_the_posterior_holds_the_truth(
    results: Path,
) -> None:
    for row in rows(results, "misfits"):
        assert float(row["low"]) < float(row["heuristic"]) < float(row["high"])
    for name in ("estimates", "measured"):
        lines = rows(results, f"table_3_{name}")
        assert [line["parameter"] for line in lines] == list(NINE_PARAMETERS)
        assert max(abs(float(line["off_percent"])) for line in lines) > 30
        assert all(line["holds"] == "True" for line in lines)


@pytest.mark.slow
def test_again_the_tables_are_the_same_to_the_byte(results: Path, tmp_path: Path) -> None:
    """In one process instead of two."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        ran = systems.cli("paper", "--output", str(tmp_path / "again"), "--processes", "1")
    assert ran.status == 0, ran.err
    tables = [p for p in results.rglob("*") if p.suffix in (".csv", ".md")]
    assert len(tables) > 20
    for path in tables:
        other = tmp_path / "again" / path.relative_to(results)
        assert path.read_bytes() == other.read_bytes(), path.name
