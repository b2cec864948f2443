"""The zoo's judgement, and the parts that make its records: what must fail does."""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.config.job import prepare
from bayesdrill.config.records import simulation
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.simulators.linear import Response
from benchmarks.modes import collection
from benchmarks.modes.judge import SHOWN
from benchmarks.zoo import folder, judge, plot, report, rows, runs, table
from benchmarks.zoo.entries import paper
from benchmarks.zoo.friction import DryFriction
from benchmarks.zoo.plant import Plant
from benchmarks.zoo.row import MORE_THAN_NOISE, Row
from benchmarks.zoo.runs import Importance, Run
from benchmarks.zoo.texts import parsed

SECONDS = 60.0
NAMES = ("k_s", "j_1")


def row(name: str = "samples_300") -> Row:
    return rows.chosen([name])[0]


def weights_of(mean: dict[str, float], error: dict[str, float]) -> Importance:
    return Importance(draws=10_000, share=0.8, mean=mean, error=error)


def run(
    *, shift: float = 0.0, weights: float | None = 0.0, draws: float = 10_000.0, **own: object
) -> Run:
    """Means 1 and 2, sds 0.1 and 0.2; `shift` and `weights` move a mean, in its standard errors."""
    mean, sd = {"k_s": 1.0, "j_1": 2.0}, {"k_s": 0.1, "j_1": 0.2}
    error = {name: sd[name] / 100.0 for name in NAMES}
    off = None if weights is None else mean | {"j_1": 2.0 + weights * error["j_1"]}
    usual: dict[str, object] = {
        "status": 0,
        "wall": 10.0,
        "converged": True,
        "seconds": {"map": 1.0, "sampling": 2.0, "report": 3.0},
        "steps": 1000,
        "tau": {"k_s": 2.0, "j_1": 3.0},
        "acceptance": (0.4, 0.5),
        "ess": draws,
        "fit": ({"channel": "w_1", "rms": 1.01},),
        "maxima": ({"values": mean, "log_posterior": 1.0, "weight": 1.0},),
        "importance": None if off is None else weights_of(off, error),
        "mean": mean | {"k_s": 1.0 + shift * error["k_s"]},
        "sd": sd,
        "draws": dict.fromkeys(NAMES, draws),
    }
    return Run(**(usual | own))  # type: ignore[arg-type]


def unsound(**own: object) -> Run:
    usual = {
        "status": 3,
        "converged": False,
        "reasons": (f"the MAP leaves {MORE_THAN_NOISE}: w_1",),
    }
    return run(weights=None, **(usual | own))


def complaints(made: Row, *pair: Run, shares: tuple[tuple[float, ...], ...] = ()) -> str:
    return "; ".join(judge.judged(made, pair, 300, SECONDS, shares).complaints)


def test_two_good_runs_pass() -> None:
    assert not complaints(row(), run(), run(shift=2.0, weights=-2.0))


def test_seeds_that_disagree_fail() -> None:
    """sqrt(2) standard errors of one run are one of the difference."""
    distance = judge.between(run(), run(shift=3.0 * math.sqrt(2.0)))
    assert distance is not None
    assert distance.worst == pytest.approx(3.0)
    assert distance.name == "k_s"
    assert distance.holds
    assert "seeds disagree on k_s" in complaints(row(), run(), run(shift=5.0 * math.sqrt(2.0)))
    assert "seeds disagree" in complaints(row(), run(shift=-5.0 * math.sqrt(2.0)), run())


def test_fewer_effective_draws_allow_for_more() -> None:
    many, few = run(shift=7.0), run(shift=7.0, draws=100.0)
    assert "seeds disagree" in complaints(row(), run(), many)
    assert "seeds disagree" not in complaints(row(), run(), few)


@run_cases("second", [False, True])
def test_weights_that_disagree_fail_in_either_run(second: bool) -> None:
    pair = (run(), run(weights=6.0))
    said = complaints(row(), *(pair if second else pair[::-1]))
    assert "importance weights disagree on j_1" in said


@run_cases("second", [False, True])
def test_a_sound_run_without_weights_fails(second: bool) -> None:
    pair = (run(), run(weights=None))
    assert "no importance weights" in complaints(row(), *(pair if second else pair[::-1]))


def test_the_limit_allows_for_the_number_of_comparisons() -> None:
    """A distance of 3.5 is too large for one unknown and not for nine."""
    assert judge.limit(1) < 3.5 < judge.limit(9)
    rng = np.random.default_rng(1)
    worst = np.abs(rng.standard_normal((200_000, 9))).max(axis=1)
    assert np.mean(worst > judge.limit(9)) == pytest.approx(judge.LEVEL, abs=3e-4)


@run_cases(
    "spoilt",
    [
        {"draws": {"k_s": 0.0, "j_1": 1e4}},
        {"mean": {"k_s": math.nan, "j_1": 2.0}},
        {"sd": {"k_s": math.nan, "j_1": 0.2}},
        {"importance": weights_of({"k_s": 1.0}, {"k_s": 0.1})},
        {"importance": weights_of({"k_s": math.nan, "j_1": 2.0}, {"k_s": 1.0, "j_1": 1.0})},
    ],
)
def test_what_is_no_number_does_not_agree(spoilt: dict[str, object]) -> None:
    found = dataclasses.replace(run(), **spoilt)  # type: ignore[arg-type]
    assert "disagree" in complaints(row(), run(), found)


@run_cases(
    "own, says",
    [
        ({"status": None}, "stopped"),
        ({"status": 2, "said": "first\nwrong config\n"}, "status 2: wrong config"),
        ({"status": 3, "reasons": ("tau grows",)}, "status 3: tau grows"),
        ({"converged": False}, "not converged"),
        ({"wall": 61.0}, "61 s"),
    ],
)
def test_a_sound_row_needs_two_runs_that_end_well(own: dict[str, object], says: str) -> None:
    assert says in complaints(row(), run(), run(**own))
    assert says in complaints(row(), run(**own), run())


def test_an_unsound_row_must_say_why() -> None:
    bad = row("wrong_gear")
    assert not complaints(bad, unsound(), unsound())
    assert "as if all were well" in complaints(bad, unsound(), unsound(status=0))
    assert "no reason says" in complaints(bad, unsound(), unsound(reasons=("tau grows",)))
    assert "99 s" in complaints(bad, unsound(wall=99.0), unsound())
    assert "stopped" in complaints(bad, unsound(), unsound(status=None))


def test_humps_must_have_their_shares() -> None:
    two = row("aliased_1")
    assert two.humps is not None
    right, _ = two.humps.exact

    def said(*below: float) -> str:
        return complaints(two, run(), run(), shares=tuple((one, 1.0 - one) for one in below))

    assert not said(right + 0.02, right - 0.02)
    for wrong in (right + 0.04, right - 0.04, math.nan, 0.0):
        assert "shares of the humps" in said(right, wrong)
    assert "shares of the humps" in complaints(two, run(), run())
    assert "shares of the humps" in complaints(two, run(), run(), shares=((), ()))


def test_small_humps_must_be_there() -> None:
    """Mutant killed: a hump of 3 % may be missing, as 3 % is what a share may be off."""

    class Small:
        exact = (0.97, 0.03)

        def shares(self, draws: Mapping[str, np.ndarray]) -> tuple[float, ...]:
            return self.exact

    made = dataclasses.replace(row(), humps=Small())
    assert not complaints(made, run(), run(), shares=((0.97, 0.03), (0.961, 0.039)))
    assert "shares of the humps" in complaints(made, run(), run(), shares=((0.97, 0.03), (1.0, 0)))


def test_a_row_of_many_modes_is_its_puzzle(tmp_path: Path) -> None:
    """Record and reading, for example what is masked; and draws are counted in the puzzle's modes."""
    made, puzzle = row("switched_on"), collection.chosen(["switched_on"])[0]
    mine = prepare(folder.write(made, tmp_path)[0]).problem
    posterior = puzzle.load(tmp_path).job.problem.posterior
    theta = posterior.space.draw(20, np.random.default_rng(1))
    assert np.array_equal(mine.posterior.density(theta), posterior.density(theta))
    assert made.humps is not None
    known = puzzle.modes(posterior)
    exact = known.masses[known.above(SHOWN)]
    assert made.humps.exact == tuple(exact)
    draws = {"t_0": known.tops[[0, 0, 0, 1], 0]}
    assert made.humps.shares(draws)[:2] == (0.75, 0.25)


def test_a_run_that_takes_too_long_is_stopped() -> None:
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    began = time.perf_counter()
    assert runs._ended(process, 0.2) is None
    assert process.poll() is not None
    assert time.perf_counter() - began < 5.0


def test_results_of_an_earlier_run_do_not_count(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text('{"status": "finished", "converged": true}')
    found = runs.read(tmp_path, 2, 1.0, "wrong")
    assert not found.converged
    assert found.rate == 0.0


def test_tables_and_figure_show_every_kind_of_row(tmp_path: Path) -> None:
    nothing = run(status=None, mean={}, tau={}, acceptance=(), ess=0.0, seconds={}, maxima=())
    made = [
        judge.judged(row(), (run(), run()), 300, SECONDS),
        judge.judged(row("wrong_gear"), (unsound(), unsound()), 300, SECONDS),
        judge.judged(row("chirp"), (run(), nothing), 300, SECONDS),
        judge.judged(row("aliased_1"), (run(), run()), 12, SECONDS, ((0.9, 0.1),) * 2),
    ]
    every = [table.measured(one) for one in made]
    lines = report.markdown(every, [row("servo_slow")], SECONDS)
    shown = [line for line in lines if line.startswith("|")]
    assert len({line.count("|") for line in shown}) == 1
    assert "2 of 4 rows" in "\n".join(lines)
    assert "servo_slow" in lines[-5]
    assert [plot.kind(one) for one in every][:3] == [*list(plot.KINDS)[:2], "failed"]
    plot.figure(every, SECONDS, tmp_path)
    assert (tmp_path / "zoo.png").stat().st_size > 10_000
    path = tmp_path / "zoo.csv"
    table.save(every, path)
    assert report.markdown(table.read(path), [row("servo_slow")], SECONDS) == lines


def test_what_is_run_again_takes_the_place_of_what_was(tmp_path: Path) -> None:
    """The rest stays, in the order of the zoo; what is no row any more goes."""
    path, names = tmp_path / "zoo.csv", ["bundled", "chirp", "samples_300"]
    assert table.read(path) == []

    def one(name: str, wall: float) -> table.Measured:
        pair = (run(wall=wall), run(wall=wall + 1))
        return table.measured(judge.judged(row(name), pair, 300, SECONDS))

    table.save([one("samples_300", 5.0), one("gear_one", 6.0), one("chirp", 7.0)], path)
    both = table.merged(table.read(path), [one("bundled", 8.0), one("chirp", 9.0)], names)
    assert [(of.name, of.numbers("wall_s")) for of in both] == [
        ("bundled", [8.0, 9.0]),
        ("chirp", [9.0, 10.0]),
        ("samples_300", [5.0, 6.0]),
    ]


def _noiseless(job_path: Path) -> tuple[Experiment, np.ndarray, np.ndarray]:
    """Experiment, true parameters in the model's order, and the exact signals."""
    job = prepare(job_path)
    rig = job.case.model
    truth = simulation.truth(job.case.experiments[0])
    theta = np.array([[truth[name] for name in rig.parameters]])
    return job.problem.experiment, theta[0], Response(rig, job.problem.experiment).signals(theta)[0]


@run_cases("name", ["closed_loop", "closed_loop_straight"])
def test_a_loop_closes_around_the_rig_that_is_simulated(name: str, tmp_path: Path) -> None:
    """Kills: a plant that holds its input otherwise than the config says."""
    path, _ = folder.write(row(name), tmp_path)
    experiment, _, signals = _noiseless(path)
    case = parsed(path, path.read_text(encoding="utf-8"))
    plant, v = Plant.of(case, experiment.dt), experiment.series["v"]
    x = plant.rest()
    for k in range(len(v) - 1):
        end = v[k + 1] if plant.first_order else v[k]
        x = plant.step(x, float(v[k]), float(end))
    last = {s: x[plant.states.index(s)] for s in plant.states}
    assert signals[-1] == pytest.approx([last["theta_2"], last["theta_1"] - last["theta_2"]])
    assert v.min() < -1.0 < 1.0 < v.max()


def test_without_friction_the_integrator_gives_the_packages_response(tmp_path: Path) -> None:
    path, _ = folder.write(row("dry_friction"), tmp_path)
    experiment, theta, signals = _noiseless(path)
    rig = parsed(path, path.read_text(encoding="utf-8")).model
    truth = dict(zip(rig.parameters, theta, strict=True)) | {"t_f": 0.0}
    quiet = Response(rig, experiment).signals(np.array([list(truth.values())]))[0]
    n = 150
    mine = DryFriction(parts=200).states(1 / 8, truth, experiment.t[:n], experiment.series["v"])
    assert mine[:, :4] == pytest.approx(quiet[:n], abs=2e-3 * np.abs(quiet[:n]).max())
    rubbing = row("dry_friction").made.friction  # type: ignore[attr-defined]
    slow = rubbing.states(1 / 8, truth, experiment.t[:n], experiment.series["v"])
    assert np.abs(slow[:, :4] - signals[:n]).max() > 1.0


def test_friction_holds_what_does_not_reach_it() -> None:
    """Kills: friction that drives the rig back instead of holding it."""
    t = 0.01 * np.arange(100)
    still = DryFriction(motor=0.5).states(1 / 8, dict(paper().values), t, np.full(100, 1.0))
    assert np.abs(still[:, :4]).max() < 1e-12
    assert still[-1, 4] == pytest.approx(1.0 / paper().values["r_m"], rel=1e-3)
