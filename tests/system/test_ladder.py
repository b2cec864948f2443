"""`bayesdrill ladder CONFIG`: a run of each candidate model, a comparison, and a recommended config."""

import dataclasses
import json
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases
from support.command_line import CONFIGS, assert_refused
from support.finished_runs import FinishedRun
from support.reporters import Stopping
from support.unexplained_records import try_only

import bayesdrill as bd
from bayesdrill.analysis.causes import SURE_LOG_ODDS, Causes
from bayesdrill.analysis.refits import RefitMaximum, refit_candidate
from bayesdrill.basics.errors import Interrupted
from bayesdrill.basics.progress import Reporter, Silent
from bayesdrill.config import loading
from bayesdrill.config.job import prepare
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.proposal.learning import NoSupportError
from bayesdrill.selection.candidates import CandidateModel
from bayesdrill.tasks import ladder, ranking, remote

CONFIG = (CONFIGS / "turned.yaml").read_text(encoding="utf-8")
FRICTIONS = ("friction_motor", "sticking_motor")
J_M, C_M, FRICTION, SIGMA = 4e-4, 1e-3, 0.02, 0.1
DT, N, FINER = 0.02, 150, 400


def turned() -> str:
    """A record of a motor with dry friction under an alternating torque, by short steps of Euler."""
    t = DT * np.arange(N)
    torque = 0.06 * np.sign(np.sin(4.0 * t + 0.3)) + 0.02
    w, speed = 0.0, []
    for push in torque:
        speed.append(w)
        for _ in range(FINER):
            free = w + DT / FINER * (push - C_M * w) / J_M
            most = DT / FINER * FRICTION / J_M
            w = free - min(max(free, -most), most)
    measured = np.array(speed) + SIGMA * np.random.default_rng(5).standard_normal(N)
    rows = zip(t, torque, measured, strict=True)
    return "t,t_m,w_2\n" + "".join(f"{a:.6g},{b:.6g},{c:.6g}\n" for a, b, c in rows)


def given(place: Path) -> Path:
    """Write the record of a motor with friction, and a config without it."""
    config = place / "given.yaml"
    config.write_text(CONFIG)
    (place / "turned.csv").write_text(turned())
    return config


def run_ladder(config: Path, folder: Path, how: str, reporter: Reporter) -> None:
    """Make a ladder in this process, without the command line."""
    with command_line.executor(1) as crew:
        ladder.ladder(prepare(config), folder, how, crew, reporter)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """A ladder of two candidates for a motor with friction, from a config without it."""
    place = tmp_path_factory.mktemp("ladder")
    config, out = given(place), place / "out"
    with pytest.MonkeyPatch.context() as patch:
        try_only(FRICTIONS, patch)
        run_ladder(config, out, "fresh", Silent())
    return FinishedRun(config, out)


def guessed(
    folder: Path,
    log_odds: Callable[[set[str]], float],
    enough: float = math.inf,
    refit: Callable[[Posterior], float] = lambda _: 0.0,
    **found: object,
) -> tuple[ranking.Ranking, list[float]]:
    """Return a ranking that refits nothing, and log odds that its candidates had to reach.

    Parts have the `log_odds` that are given, and from `enough` on they leave noise; `refit` gives the
    log odds of a posterior, NaN without a finite response.  Each refit has `found` these numbers.
    """
    job = prepare(command_line.small_config(folder, ("walkers: 8", "walkers: 24")))
    template = refit_candidate(job.problem.posterior, job.problem.posterior.space.start, -math.inf)
    assert template is not None
    template = dataclasses.replace(template, **found)
    misfit = tuple(dataclasses.replace(row, correlation=1.0) for row in template.residuals)
    rivals = list[float]()

    class Guessing(ranking.Ranking):
        def refit_all(
            self,
            candidates: Sequence[CandidateModel],
            near: Mapping[str, float],
            rival: Callable[[], float] = lambda: -math.inf,
        ) -> None:
            for rung in candidates:
                rivals.append(rival() - self.base.log_z)
                odds = log_odds({*rung.names})
                fit = template.residuals if odds >= enough else misfit
                self._keep(rung, job, dataclasses.replace(gained(odds), residuals=fit))

    def gained(odds: float) -> RefitMaximum:
        higher = {name: getattr(template, name) + odds for name in ("log_z", "log_posterior")}
        return dataclasses.replace(template, **higher)

    def submit(_: object, posterior: Posterior, *_more: object, **_named: object) -> Future[Any]:
        is_given = posterior is job.problem.posterior
        future, odds = Future[Any](), 0.0 if is_given else refit(posterior)
        future.set_result(None if math.isnan(odds) else gained(odds))
        return future

    start = job.problem.posterior.space.start
    return Guessing(job, start, submit, Silent()), rivals


def test_a_cause_that_explains_nothing_alone_is_tried_with_the_best(tmp_path: Path) -> None:
    """Each part has a given log evidence, damping only together with friction.

    A missing torque, which absorbs any misfit, neither keeps friction out nor is recommended.
    """
    worth = {"missing_torque_motor": 120.0, "friction_motor": 50.0, "friction_both": 100.0}

    def log_odds(parts: set[str]) -> float:
        together = 30.0 * ({"friction_both", "damping_shaft"} <= parts)
        together += 20.0 * ({"friction_both", "lag_w_1"} <= parts)
        return together + sum(worth.get(part, -1.0) for part in parts)

    every, rivals = guessed(tmp_path, log_odds)
    best = every.causes().ranked[0]
    assert {*best.parts} == {"friction_both", "damping_shaft", "lag_w_1"}
    assert rivals[0] == -math.inf
    assert max(rivals) == pytest.approx(best.bayes - SURE_LOG_ODDS)
    done = {frozenset(parts) for parts in every.causes_by_parts}
    assert frozenset({*best.parts, "ar1"}) in done
    few, _ = guessed(tmp_path, log_odds, 110.0)
    assert few.causes().ranked[0].parts == ("friction_both", "damping_shaft")
    assert max(map(len, few.causes_by_parts)) == 2


def test_what_stands_for_a_part_is_removed_before_more_is_built_upon_it(tmp_path: Path) -> None:
    """Drag does more than the lag at first, and each other physics a little of what is left."""
    right = ("friction_both", "lag_w_1", "offset_w_1")

    def log_odds(parts: set[str]) -> float:
        friction, lag, offset = (part in parts for part in right)
        others = {part for part in parts if part.startswith(("drag", "damping", "voltage", "load"))}
        if "ar1" in parts:
            return 1000.0
        if friction and lag and offset:
            return 1000.0 - 5.0 * (len(parts) - 3)
        drags = (150.0 if lag else 250.0) * ("drag_motor" in parts)
        return 300.0 * friction + 200.0 * (friction and lag) + drags + 20.0 * len(others)

    ranked, _ = guessed(tmp_path, log_odds, 1000.0)
    best = ranked.causes().best
    assert best is not None
    assert {*best.parts} == {*right}


@run_cases("share", [1.55, 12.0])
def test_a_gear_is_sought_next_to_the_best_of_its_grid(share: float, tmp_path: Path) -> None:
    """The log evidence falls with the square of the distance, for a gear beyond the grid too."""

    def refit(posterior: Posterior) -> float:
        factor = posterior.space.relations["geared_k_T"].text.split("*")[1]
        return 1000.0 - 100.0 * (1.0 / float(factor) - share) ** 2

    every, _ = guessed(tmp_path, lambda _: 0.0, refit=refit)
    every._seek(ranking.GEAR, ranking.GEARS, ranking.FINEST_GEAR)
    expected = min(share, ranking.GEARS[-1])
    assert every.models.numbers[ranking.GEAR] == pytest.approx(expected, abs=0.1)
    assert every.value_counts == {ranking.GEAR: len(ranking.GEARS)}


@run_cases(
    "enough, kinds", [(math.inf, ["maxima", "alike", "hidden"]), (50.0, ["maxima", "alike"])]
)
def test_a_refit_with_several_maxima_or_many_hidden_samples_is_doubted(
    enough: float, kinds: list[str], tmp_path: Path
) -> None:
    """Unknowns that are alike are no doubt if both were in the config as given."""
    alike = (("t_cm", "k_e"), ("k_e", "j_1"))
    every, _ = guessed(
        tmp_path,
        lambda _: 50.0,
        enough,
        has_rival=True,
        omitted=0.1,
        exchangeable=alike,
        at_ends={},
    )
    every.refit_all(every.models.rungs([("friction_motor",)]), {})
    (cause,) = every.causes_by_parts.values()
    assert [doubt.kind for doubt in cause.doubts] == kinds
    assert cause.doubts[1].said_of == alike[0]


def test_candidates_and_windows_without_a_finite_response_are_left_out(tmp_path: Path) -> None:
    every, _ = guessed(tmp_path, lambda _: 0.0, refit=lambda _: math.nan)
    rungs = every.models.rungs([("friction_motor",)])
    ranking.Ranking.refit_all(every, rungs, every.maximum)
    assert every.left_out == {"friction_motor": "has no finite response near the maximum"}
    assert every.causes_by_parts == {}
    assert every._windows() == ()


@run_cases("gain, share, named", [(90.0, 200.0, True), (90.0, 0.0, False), (1.0, 200.0, False)])
def test_a_good_fit_at_an_end_of_a_prior_is_asked_for_factors_if_a_wider_prior_gains(
    gain: float, share: float, named: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def log_odds(parts: set[str]) -> float:
        scaled = any(part.startswith("scale_k_e") for part in parts)
        return gain if parts == {"prior_k_e"} else share * scaled

    every, _ = guessed(tmp_path, log_odds, at_ends={"k_e": 1})
    monkeypatch.setattr(ranking, "Ranking", type(every))
    causes = ranking.rank_scales(every.job, every.maximum, every.submit, Silent())
    assert (causes is not None) == named


@pytest.mark.slow
def test_the_missing_friction_is_named_and_recommended_after_ctrl_c(tmp_path: Path) -> None:
    """Among all candidates; what was done before is taken up."""
    config, out = given(tmp_path), tmp_path / "out"
    with pytest.raises(Interrupted, match="continue with --resume"):
        run_ladder(config, out, "fresh", Stopping(lambda _, text: text.startswith("1 ")))
    finished = FinishedRun(config, out)
    assert finished.json["status"] == "interrupted"
    before = {p: p.stat().st_mtime_ns for p in out.glob("*/chain.h5")}
    assert len(before) == 1
    reporter = Stopping()
    run_ladder(config, out, "resume", reporter)
    assert "(1 of them done before)" in reporter.said[-1]
    assert all(path.stat().st_mtime_ns == time for path, time in before.items())
    run = finished.json
    assert run["status"] == "finished"
    assert run["recommended"] == "friction_motor"  # its odds against friction at rest are 20 to 1
    assert run["candidates"]["ranked"][0]["parts"] == ["friction_motor"]
    assert len(run["log_evidence"]) == 2
    page = (finished.folder / "comparison.md").read_text(encoding="utf-8")
    assert "# Ladder of turned" in page
    assert "- verdict: " in page
    assert "the residuals of friction_motor look like the noise" in page
    recommended = finished.folder / "recommended.yaml"
    checked = command_line.cli("check", recommended)
    assert checked.status == 0, checked.text
    config = loading.load(recommended).config
    assert config.name == "turned_friction_motor"
    assert config.parameters.get("t_cm") is not None


def test_a_ladder_without_a_model_that_can_be_sampled_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        raise NoSupportError("no point has a finite density")

    monkeypatch.setattr(ladder, "fit", fails)
    monkeypatch.setattr(ladder._Sampling, "_ranked", lambda _: Causes(given=(), ranked=()))
    config = given(tmp_path)
    with pytest.raises(bd.InputError, match=r"given\.yaml: no point has a finite density"):
        run_ladder(config, tmp_path / "out", "fresh", Silent())
    assert json.loads((tmp_path / "out" / "run.json").read_text())["status"] != "finished"


def test_a_rung_is_the_run_of_its_config(finished: FinishedRun, tmp_path: Path) -> None:
    """Byte for byte; and it can be reported and compared again."""
    alone, mine = tmp_path / "alone", finished.folder / "model_1"
    command_line.cli("posterior", mine / "config.resolved.yaml", "-o", alone, "--processes", "1")
    for name in ("summary.csv", "map.json"):
        assert (mine / name).read_bytes() == (alone / name).read_bytes(), name
    runs = [json.loads((folder / "run.json").read_text()) for folder in (mine, alone)]
    evidence = [run["evidence"]["log_z"] for run in runs]
    assert evidence[0] == evidence[1]
    assert finished.json["log_evidence"]["friction_motor"] == evidence[0]
    compared = bd.compare([finished.folder / "model_2", mine])
    assert "verdict: " in compared.text  # the odds are near the limit of 20 to 1


def test_verify_names_a_changed_table_of_a_rung_or_of_the_comparison(
    finished: FinishedRun, tmp_path: Path
) -> None:
    assert command_line.cli("verify", finished.folder).status == 0
    for k, place in enumerate(("model_1/summary.csv", "comparison.csv")):
        copy = tmp_path / str(k)
        shutil.copytree(finished.config.parent, copy)
        table = copy / "out" / place
        lines = table.read_text().splitlines()
        table.write_text("\n".join([lines[0], lines[2], lines[1], *lines[3:]]) + "\n")
        result = command_line.cli("verify", copy / "out")
        assert_refused(result, f"{table}: was changed after this run had written it")
        assert result.err.count("\n") == 1, result.err


@pytest.mark.slow
def test_processes_and_a_cluster_give_the_same_comparison(
    finished: FinishedRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    try_only(FRICTIONS, monkeypatch)
    distributed = pytest.importorskip("distributed")
    table = (finished.folder / "comparison.csv").read_bytes()
    result = command_line.cli("ladder", finished.config, "-o", tmp_path / "two", "--processes", "2")
    assert result.status == 0, result.text
    assert "recommended: dry friction at the motor" in result.out
    assert (tmp_path / "two" / "comparison.csv").read_bytes() == table
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        remote.dask_executor(cluster.scheduler_address) as crew,
    ):
        ladder.ladder(prepare(finished.config), tmp_path / "three", "fresh", crew, Silent())
    assert (tmp_path / "three" / "comparison.csv").read_bytes() == table
