"""Configs of rigs that others measured are sound without their data, and the table is consistent."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.config import loading
from benchmarks.real import __main__ as real
from benchmarks.real.bench import Bench, File
from benchmarks.real.benches import BENCHES, EPFL, WATERLOO


@run_cases("bench", BENCHES)
def test_a_config_is_valid_without_its_data(bench: Bench) -> None:
    case = loading.load(bench.config)
    assert case.config.name == bench.name
    files = set(re.findall(r"file: ([\w./]+)", bench.config.read_text(encoding="utf-8")))
    if bench.prepare:
        assert {Path(name).parent for name in files} == {Path("build", bench.name)}
        assert len(files) == len(bench.files)
    else:
        assert files == {f"data/{bench.folder}/{file.name}" for file in bench.files}


@run_cases("bench", BENCHES)
def test_each_file_has_an_address_and_a_digest(bench: Bench) -> None:
    assert re.fullmatch(r"[0-9a-f]{40}", bench.commit)
    assert len({file.name for file in bench.files}) == len(bench.files) > 0
    for file in bench.files:
        assert re.fullmatch(r"[0-9a-f]{64}", file.digest)
        assert " " not in bench.address(file)
        assert bench.address(file).endswith(file.path.replace(" ", "%20"))
    assert all(criterion.low < criterion.high for criterion in bench.criteria)


def test_the_frequencies_of_three_discs_are_those_of_their_matrix() -> None:
    k, j, r = 7.5, 0.03, 1.6
    stiffness = k * np.array([[1, -1, 0], [-1, 2, -1], [0, -1, 1]])
    squares = np.linalg.eigvals(stiffness / (j * np.array([1, 1, r]))[:, None]).real
    expected = np.sqrt(np.sort(squares)[1:])
    values = {"k_shaft_1": k, "j_disc_1": j, "r": r}
    assert [c.figure(values) for c in EPFL.criteria] == pytest.approx(expected)


def test_other_files_and_benches_are_refused() -> None:
    with pytest.raises(ValueError, match="is not the file"):
        real.checked(b"other", File("file.mat", "file.mat", "0" * 64))
    with pytest.raises(ValueError, match="no bench is called nothing"):
        real.chosen(["nothing"])


def test_a_bench_without_data_is_skipped_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    absent = dataclasses.replace(WATERLOO, folder="nowhere")
    assert absent.absent == absent.files
    assert real.run_each([absent], fetch=False, figures=False) == 0
    assert capsys.readouterr().out.count("\n") == 1
