"""`python -m studies.paper`: refused, and whole."""

import csv
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from support import command_line
from support.case_tables import run_cases

from bayesdrill.output_files import POSTERIOR
from studies.paper.__main__ import app
from studies.paper.printed import NINE_PARAMETERS
from studies.paper.reproduction import files_of
from studies.paper.tests.test_page import DOCS, TABLES, rendered

ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def _in_the_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def paper(*arguments: str | Path) -> command_line.CommandResult:
    return command_line.cli(*arguments, program=app)


def refused(*arguments: str | Path, below: Path, says: str) -> None:
    """Status 2, no traceback, and nothing below `below` changes."""
    before = command_line.listing(below)
    ran = paper(*arguments)
    assert ran.status == 2
    assert says in ran.err
    assert "Traceback" not in ran.err
    assert command_line.listing(below) == before


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


@run_cases(
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
    refused(tmp_path / "paper", "-o", tmp_path / "out", below=tmp_path, says=says)


@run_cases("given", ["configs/paper/measured.yaml", "configs/nothing"])
def test_what_is_no_folder_of_studies_is_told(given: str, tmp_path: Path) -> None:
    says = f"{given}: no such folder; give the one that holds two_parameters.yaml"
    refused(given, "-o", tmp_path / "out", below=tmp_path, says=says)


def test_results_and_files_of_others_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    says = "a file is in the way; give another --output"
    refused("-o", tmp_path / "file", below=tmp_path, says=says)
    other = command_line.write_results(tmp_path / "other", POSTERIOR)
    refused("--force", "-o", other, below=tmp_path, says="results of `bayesdrill posterior`")
    own = command_line.write_results(tmp_path / "own", files_of(("estimates", "measured")))
    refused("-o", own, below=tmp_path, says="make them anew with --force")
    (own / "measured").mkdir()
    (own / "measured" / "thesis.tex").write_text("mine")
    refused("--force", "-o", own, below=tmp_path, says="other files (thesis.tex)")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("paper") / "results"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        ran = paper("--output", folder)
    assert ran.status == 0, ran.err
    return folder


def rows(folder: Path, stem: str) -> list[dict[str, str]]:
    with (folder / f"{stem}.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_all_tables_and_figures_are_written(results: Path) -> None:
    for name in files_of(("estimates", "measured")).files:
        assert (results / name).stat().st_size > (5000 if name.startswith("figures") else 0)
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
    ran = paper("--output", tmp_path / "again", "--processes", "1")
    assert ran.status == 0, ran.err
    tables = [p for p in results.rglob("*") if p.suffix in (".csv", ".md")]
    assert len(tables) > 20
    for path in tables:
        other = tmp_path / "again" / path.relative_to(results)
        assert path.read_bytes() == other.read_bytes(), path.name
