"""The zoo's judge rejects what it must, and the parts that make its records are right."""

import dataclasses
import math
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.case_tables import run_cases
from support.unexplained_records import causes_of, try_only

import bayesdrill as bd
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
    *, shift: float = 0.0, weights: float | None = 0.0, effective: float = 1e4, **fields: object
) -> Run:
    """Means 1 and 2, sds 0.1 and 0.2; `shift` and `weights` move a mean, in its standard errors."""
    mean, sd = {"k_s": 1.0, "j_1": 2.0}, {"k_s": 0.1, "j_1": 0.2}
    error = {name: sd[name] / 100.0 for name in NAMES}
    moved = None if weights is None else mean | {"j_1": 2.0 + weights * error["j_1"]}
    usual: dict[str, object] = {
        "status": 0,
        "wall": 10.0,
        "converged": True,
        "seconds": {"map": 1.0, "sampling": 2.0, "report": 3.0},
        "steps": 1000,
        "tau": {"k_s": 2.0, "j_1": 3.0},
        "acceptance": (0.4, 0.5),
        "ess": effective,
        "fit": ({"channel": "w_1", "rms": 1.01},),
        "maxima": ({"values": mean, "log_posterior": 1.0, "weight": 1.0},),
        "importance": None if moved is None else weights_of(moved, error),
        "mean": mean | {"k_s": 1.0 + shift * error["k_s"]},
        "sd": sd,
        "draws": dict.fromkeys(NAMES, effective),
    }
    return Run(**(usual | fields))  # type: ignore[arg-type]


def unsound(**fields: object) -> Run:
    reasons = (f"the MAP leaves {MORE_THAN_NOISE}: w_1",)
    usual = {"status": 3, "converged": False, "reasons": reasons}
    return run(weights=None, **(usual | fields))


def complaints(of: Row, *pair: Run, shares: tuple[tuple[float, ...], ...] = ()) -> str:
    return "; ".join(judge.judged(of, pair, 300, SECONDS, shares).complaints)


@run_cases(
    "bad, complaint",
    [
        ({"shift": 5.0 * math.sqrt(2.0)}, "seeds disagree on k_s"),
        ({"shift": 7.0}, "seeds disagree on k_s"),
        ({"weights": 6.0}, "importance weights disagree on j_1"),
        ({"weights": None}, "no importance weights"),
        ({"draws": {"k_s": 0.0, "j_1": 1e4}}, "disagree"),
        ({"mean": {"k_s": math.nan, "j_1": 2.0}}, "disagree"),
        ({"sd": {"k_s": math.nan, "j_1": 0.2}}, "disagree"),
        ({"importance": weights_of({"k_s": 1.0}, {"k_s": 0.1})}, "disagree"),
        (
            {"importance": weights_of({"k_s": math.nan, "j_1": 2.0}, {"k_s": 1.0, "j_1": 1.0})},
            "disagree",
        ),
        ({"status": None}, "stopped"),
        ({"status": 2, "said": "first\nwrong config\n"}, "status 2: wrong config"),
        ({"status": 3, "reasons": ("tau grows",)}, "status 3: tau grows"),
        ({"converged": False}, "not converged"),
        ({"wall": 61.0}, "61 s"),
    ],
)
def test_a_sound_row_with_a_bad_run_fails(bad: dict[str, Any], complaint: str) -> None:
    """Whichever of the two runs it is."""
    assert complaint in complaints(row(), run(), run(**bad))
    assert complaint in complaints(row(), run(**bad), run())


def test_two_good_runs_pass() -> None:
    assert not complaints(row(), run(), run(shift=2.0, weights=-2.0))
    assert not complaints(row(), run(), run(shift=7.0, effective=100.0))  # few draws allow for more


def test_a_distance_is_in_standard_errors_of_the_difference() -> None:
    """sqrt(2) standard errors of one run are one of the difference."""
    distance = judge.between(run(), run(shift=3.0 * math.sqrt(2.0)))
    assert distance is not None
    assert distance.worst == pytest.approx(3.0)
    assert distance.name == "k_s"
    assert distance.holds


def test_the_limit_allows_for_the_number_of_comparisons() -> None:
    """A distance of 3.5 is too large for one unknown and not for nine."""
    assert judge.limit(1) < 3.5 < judge.limit(9)
    rng = np.random.default_rng(1)
    worst = np.abs(rng.standard_normal((200_000, 9))).max(axis=1)
    assert np.mean(worst > judge.limit(9)) == pytest.approx(judge.LEVEL, abs=3e-4)


def test_an_unsound_row_must_say_why() -> None:
    bad = row("wrong_gear")
    assert not complaints(bad, unsound(), unsound())
    for fields, complaint in (
        ({"status": 0}, "as if all were well"),
        ({"reasons": ("tau grows",)}, "no reason says"),
        ({"wall": 99.0}, "99 s"),
        ({"status": None}, "stopped"),
    ):
        assert complaint in complaints(bad, unsound(**fields), unsound())


def test_modes_must_have_their_shares() -> None:
    two = row("aliased_1")
    assert two.humps is not None
    exact, _ = two.humps.exact

    def message(*shares: float) -> str:
        return complaints(two, run(), run(), shares=tuple((x, 1.0 - x) for x in shares))

    assert not message(exact + 0.02, exact - 0.02)
    for wrong in (exact + 0.04, exact - 0.04, math.nan, 0.0):
        assert "shares of the humps" in message(exact, wrong)
    assert "shares of the humps" in complaints(two, run(), run())
    assert "shares of the humps" in complaints(two, run(), run(), shares=((), ()))


def test_small_modes_must_be_there() -> None:
    """A mode of 3 % may not be missing, though a share may be off by 3 %."""
    small = dataclasses.replace(row(), humps=SimpleNamespace(exact=(0.97, 0.03)))  # type: ignore[arg-type]
    assert not complaints(small, run(), run(), shares=((0.97, 0.03), (0.961, 0.039)))
    assert "shares of the humps" in complaints(small, run(), run(), shares=((0.97, 0.03), (1.0, 0)))


def test_a_row_of_many_modes_is_its_puzzle(tmp_path: Path) -> None:
    """Record and masked samples are the puzzle's, and draws are counted in its modes."""
    case, puzzle = row("switched_on"), collection.chosen(["switched_on"])[0]
    density = prepare(folder.write(case, tmp_path)[0]).problem.posterior.density
    posterior = puzzle.load(tmp_path).job.problem.posterior
    theta = posterior.space.draw(20, np.random.default_rng(1))
    assert np.array_equal(density(theta), posterior.density(theta))
    assert case.humps is not None
    known = puzzle.modes(posterior)
    assert case.humps.exact == tuple(known.masses[known.above(SHOWN)])
    draws = {"t_0": known.tops[[0, 0, 0, 1], 0]}
    assert case.humps.shares(draws)[:2] == (0.75, 0.25)


def test_a_run_that_takes_too_long_is_stopped() -> None:
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    began = time.perf_counter()
    assert runs._ended(process, 0.2) is None
    assert process.poll() is not None
    assert time.perf_counter() - began < 5.0


def test_results_of_an_earlier_run_do_not_count(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text('{"status": "finished", "converged": true}')
    read = runs.read(tmp_path, 2, 1.0, "wrong")
    assert not read.converged
    assert read.rate == 0.0


def test_tables_and_figure_show_every_kind_of_row(tmp_path: Path) -> None:
    nothing = run(status=None, mean={}, tau={}, acceptance=(), ess=0.0, seconds={}, maxima=())
    judged = [
        judge.judged(row(), (run(), run()), 300, SECONDS),
        judge.judged(row("wrong_gear"), (unsound(), unsound()), 300, SECONDS),
        judge.judged(row("chirp"), (run(), nothing), 300, SECONDS),
        judge.judged(row("aliased_1"), (run(), run()), 12, SECONDS, ((0.9, 0.1),) * 2),
    ]
    every = [table.measured(row) for row in judged]
    lines = report.markdown(every, [row("servo_slow")], SECONDS)
    shown = [line for line in lines if line.startswith("|")]
    assert len({line.count("|") for line in shown}) == 1
    assert "2 of 4 rows" in "\n".join(lines)
    assert "servo_slow" in lines[-5]
    assert [plot.kind(row) for row in every][:3] == [*list(plot.KINDS)[:2], "failed"]
    plot.figure(every, SECONDS, tmp_path)
    assert (tmp_path / "zoo.png").stat().st_size > 10_000
    path = tmp_path / "zoo.csv"
    table.save(every, path)
    assert report.markdown(table.read(path), [row("servo_slow")], SECONDS) == lines


def _noiseless(job_path: Path) -> tuple[Experiment, np.ndarray, np.ndarray]:
    """Experiment, true parameters in the model's order, and the exact signals."""
    job = prepare(job_path)
    rig = job.case.model
    truth = simulation.truth(job.case.experiments[0])
    theta = np.array([[truth[name] for name in rig.parameters]])
    return job.problem.experiment, theta[0], Response(rig, job.problem.experiment).signals(theta)[0]


@run_cases("name", ["closed_loop", "closed_loop_straight"])
def test_a_loop_closes_around_the_rig_that_is_simulated(name: str, tmp_path: Path) -> None:
    """The plant of the loop holds its input as the config says."""
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
    t = 0.01 * np.arange(100)
    still = DryFriction(motor=0.5).states(1 / 8, dict(paper().values), t, np.full(100, 1.0))
    assert np.abs(still[:, :4]).max() < 1e-12
    assert still[-1, 4] == pytest.approx(1.0 / paper().values["r_m"], rel=1e-3)


@pytest.mark.slow
def test_friction_with_friction_at_rest_is_named_where_a_bit_sticks_and_slips(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Friction alone ends at a poor maximum, and a rig without it hardly twists its shaft."""
    path, _ = folder.write(row("stick_slip"), tmp_path)
    parts = ("friction_rotor_1", "sticking_rotor_1", "sticking_motor", "prior_k_s", "free_start")
    try_only(parts, monkeypatch)
    causes = causes_of(bd.load(path))
    assert causes is not None
    assert causes.best is not None
    assert causes.best.parts == ("sticking_rotor_1",)
    assert causes.best.explains_all
    assert causes.best.lacks == ("t_c1",)
    sizes = {new.name: new.value for new in causes.best.new}
    assert sizes["t_s1"] / sizes["t_c1"] == pytest.approx(
        4.0, rel=0.05
    )  # which shows, not the scale
