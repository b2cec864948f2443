"""Calibrations of 200 refits: a right likelihood passes, and wrong ones do not."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import command_line

from bayesdrill.analysis.calibration import CalibrationStudy, Refit, judge_calibration
from bayesdrill.basics.progress import Silent
from bayesdrill.report.sections.calibration import describe_calibration
from bayesdrill.tasks import calibrate, remote
from benchmarks.rates.calibrations import with_misfit


def refits(study: CalibrationStudy, n: int, folder: Path) -> list[Refit]:
    folder.mkdir()
    with remote.local_executor(2) as crew:
        return calibrate.run_refits(study, n, folder / ".refits", crew, Silent())


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> CalibrationStudy:
    """Two unknowns, 101 samples, ranks among 99 draws."""
    change = ("output: {", "calibration: {ess: 100}\noutput: {")
    config = command_line.small_config(tmp_path_factory.mktemp("pair"), change)
    return calibrate.study(calibrate.prepare(config))


@pytest.mark.slow
def test_the_right_likelihood_is_calibrated(pair: CalibrationStudy, tmp_path: Path) -> None:
    """200 refits; kills a walker's move, a prior, a Jacobian or a noise that is not what it says."""
    found = judge_calibration(pair.names, refits(pair, 200, tmp_path / "right"), pair.draws)
    assert found.calibrated, describe_calibration(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "shape"), [(2.0, "posterior too narrow"), (0.5, "posterior too wide")]
)
def test_a_wrong_likelihood_is_not(
    factor: float, shape: str, pair: CalibrationStudy, tmp_path: Path
) -> None:
    """2 is the 1/2 of the misfit forgotten: the posterior is too narrow by sqrt 2."""
    broken = with_misfit(pair, factor)
    found = judge_calibration(pair.names, refits(broken, 200, tmp_path / "wrong"), pair.draws)
    assert not found.calibrated
    assert f"({shape})" in describe_calibration(found)
