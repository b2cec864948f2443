"""`bayesdrill calibrate CONFIG`: the same ranks wherever and however they are computed."""

import os
import signal
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases
from support.command_line import assert_refused, replace_text
from support.finished_runs import FinishedRun
from support.reporters import Stopping

from bayesdrill.analysis.calibration import CalibrationStudy, Refit, refit
from bayesdrill.basics.errors import InputError, Interrupted
from bayesdrill.basics.progress import Reporter, Silent
from bayesdrill.output_files import dumps_checksummed, loads_checksummed
from bayesdrill.tasks import calibrate, remote

QUICK = "calibration: {refits: 10, draws: 19, n_tau: 5, ess: 50, max_steps: 100}"
SAMPLED = (0, 2, 9)


class Calibration(FinishedRun):
    @property
    def ranks(self) -> bytes:
        return (self.folder / "ranks.csv").read_bytes()

    def command(self, *options: str) -> command_line.CommandResult:
        arguments = ("calibrate", self.config, "-o", self.folder, "--processes", "1")
        return command_line.cli(*arguments, *options)

    def resume(self) -> command_line.CommandResult:
        return self.command("--resume")

    def calibrate(self, how: str, reporter: Reporter) -> None:
        """In this process, without the command line."""
        job = calibrate.prepare(self.config)
        with command_line.executor(1) as crew:
            calibrate.calibrate(job, self.folder, how, crew, reporter)  # type: ignore[arg-type]


def calibrated(factory: pytest.TempPathFactory) -> Calibration:
    place = factory.mktemp("finished")
    config = command_line.small_config(place, ("output: {", f"{QUICK}\noutput: {{"))
    calibration = Calibration(config, place / "out")
    calibration.calibrate("fresh", Silent())
    return calibration


@pytest.fixture(scope="module")
def sampled(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """A finished calibration, not to be changed."""
    return calibrated(tmp_path_factory)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """The same, where the ranks of most refits are drawn without sampling."""

    def quick(study: CalibrationStudy, index: int) -> Refit:
        if index in SAMPLED:
            return refit(study, index)
        ranks = tuple(np.random.default_rng(index).integers(0, 20, 3).tolist())
        how: dict[str, Any] = {"r_hat": 1.0, "ess": 50.0, "steps": 100, "reasons": ()}
        return Refit(index=index, truth=(1.0 + index,) * 3, ranks=ranks, seconds=0.1, **how)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibrate.calibration, "refit", quick)
        return calibrated(tmp_path_factory)


@pytest.fixture
def copy(finished: Calibration, tmp_path: Path) -> Calibration:
    """The same, to be changed."""
    return finished.copy(tmp_path / "copy")


@pytest.fixture
def study(finished: Calibration) -> CalibrationStudy:
    return calibrate.study(calibrate.prepare(finished.config))


@run_cases(
    "change",
    [
        {"ranks": [0, 0, 20]},  # of 19 draws
        {"ranks": [0, 0, -1]},
        {"ranks": [0, 0]},
        {"ranks": []},  # of a refit that converged
        {"ranks": ["0", "0", "0"]},
        {"truth": [1.0]},
        {"truth": [1.0, float("nan"), 0.0]},
        {"truth": "abc"},
        {"index": 2},
        {"steps": 10**400},
        {"reasons": 0},
        {"seconds": None},
    ],
    ids=str,
)
def test_a_refit_that_cannot_be_is_refused(
    change: dict[str, object], finished: Calibration, study: CalibrationStudy, tmp_path: Path
) -> None:
    """Though its checksum fits."""
    path = tmp_path / "000001.json"
    data = loads_checksummed((finished.folder / ".refits" / path.name).read_bytes())
    path.write_text(dumps_checksummed(data))
    assert [each.index for each in calibrate.saved(tmp_path, study)] == [1]
    path.write_text(dumps_checksummed({**data, **change}))
    with pytest.raises(InputError, match=r"000001.json: is damaged; delete it"):
        calibrate.saved(tmp_path, study)


def test_ctrl_c_keeps_the_refits_that_are_done(
    finished: Calibration, study: CalibrationStudy, tmp_path: Path
) -> None:
    calibration = Calibration(finished.config, tmp_path / "out")
    with pytest.raises(Interrupted, match="saved"):
        calibration.calibrate("fresh", Stopping(lambda fraction, _: fraction >= 0.05))
    assert calibration.json["status"] == "interrupted"
    kept = calibrate.saved(calibration.folder / ".refits", study)
    assert 1 <= len(kept) < 10
    assert kept[0] == calibrate.saved(finished.folder / ".refits", study)[0]
    assert kept[0].index == 0
    assert not (calibration.folder / "ranks.csv").exists()


def test_a_resumed_calibration_equals_one_without_interruption(
    finished: Calibration, copy: Calibration, study: CalibrationStudy
) -> None:
    """A refit depends on the study and its index alone: two of them are computed again."""
    for name in ("ranks.csv", "summary.md", ".refits/000002.json", ".refits/000009.json"):
        (copy.folder / name).unlink()
    copy.calibrate("resume", Silent())
    again, refits = (calibrate.saved(each.folder / ".refits", study) for each in (copy, finished))
    assert again == refits
    assert len({each.truth for each in refits}) == 10
    assert copy.ranks == finished.ranks
    summaries = [each.folder / "summary.md" for each in (copy, finished)]
    assert summaries[0].read_bytes() == summaries[1].read_bytes()


@run_cases(
    "old, new, message",
    [
        ("ess: 50,", "ess: 18,", "18 effective draws are fewer than 19 independent ones"),
        ("max_steps: 100", "max_steps: 99", "calibration.max_steps: 99"),
        ("refits: 10", "refits: 9", "calibration.refits"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    config = command_line.small_config(tmp_path, ("output: {", f"{QUICK}\noutput: {{"))
    replace_text(config, old, new)
    assert_refused(Calibration(config, tmp_path / "out").command(), message)
    assert not (tmp_path / "out").exists()


def test_a_damaged_refit_is_named(copy: Calibration) -> None:
    path = copy.folder / ".refits" / "000007.json"
    digit = path.read_text().replace('"index": 7', '"index": 6')
    for content in ("{", "[1, 2]", '{"index": 7}', digit):
        path.write_text(content)
        before = command_line.listing(copy.folder)
        assert_refused(copy.resume(), "000007.json")
        assert command_line.listing(copy.folder) == before


def test_the_status_is_the_verdict(copy: Calibration) -> None:
    """A posterior that is far too high gives ranks of zero everywhere."""
    assert copy.resume().status == (0 if copy.json["calibrated"] else 3)
    for path in (copy.folder / ".refits").glob("*.json"):
        data = loads_checksummed(path.read_bytes())
        path.write_text(dumps_checksummed({**data, "ranks": [0, 0, 0]}))
    result = copy.resume()
    assert result.status == 3
    assert "not calibrated: ranks of" in result.out
    assert "(posterior too high)" in result.out


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_costs_nothing(sampled: Calibration, tmp_path: Path) -> None:
    """One of three workers gets SIGKILL: every refit is there once, equal to the local one."""
    distributed = pytest.importorskip("distributed")
    folder = tmp_path / "out"
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        killed = threading.Event()

        @dataclass(frozen=True)
        class Killing(Silent):
            def update(self, fraction: float, text: str) -> None:
                if fraction >= 0.25 and not killed.is_set():
                    killed.set()
                    os.kill(pids[1], signal.SIGKILL)

        job = calibrate.prepare(sampled.config)
        with remote.dask_executor(cluster.scheduler_address) as crew:
            result = calibrate.calibrate(job, folder, "fresh", crew, Killing())
    assert killed.is_set()
    assert [each.index for each in result.refits] == list(range(10))
    assert (folder / "ranks.csv").read_bytes() == sampled.ranks
    kept = calibrate.saved(sampled.folder / ".refits", calibrate.study(job))
    assert list(result.refits) == kept
