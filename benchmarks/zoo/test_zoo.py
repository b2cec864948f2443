"""The zoo covers what it says it does, its records are what their configs say, and a few rows run."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases

from bayesdrill.config import loading
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import simulation
from bayesdrill.config.schema.config import Config
from bayesdrill.inference import residual_checks
from bayesdrill.inference.step_error import choose_steps
from benchmarks.zoo import folder, judge, rows, runs
from benchmarks.zoo.__main__ import arguments
from benchmarks.zoo.makers import ROOT, Driven, Otherwise, Rubbing
from benchmarks.zoo.many import Posed
from benchmarks.zoo.row import Row, Two
from benchmarks.zoo.signals import Chirp, Loop, RandomSteps, Square
from benchmarks.zoo.texts import changed

ROWS = rows.every()
FITTING = [row for row in ROWS if row.fits]
THERE = [row for row in ROWS if row.made.available and not row.seconds]  # of a usual length
SHORT = {  # of a run whose means are looked at with what they are worth
    "map.starts": 2,
    "sampler.walkers": 32,
    "sampler.n_tau": 20,
    "sampler.ess": 2000,
    "output.predictive_draws": 10,
}


def ids(chosen: list[Row] | tuple[Row, ...]) -> list[str]:
    return [row.name for row in chosen]


def priors(row: Row) -> list[dict[str, Any]]:
    """Of parameters, quantities and noise levels."""
    channels = row.config["record"]["channels"].values()
    every = [*row.config["parameters"].values(), *row.config.get("quantities", {}).values()]
    every += [channel["sigma"] for channel in channels]
    return [prior for prior in every if isinstance(prior, dict) and "prior" in prior]


def unknowns(row: Row) -> int:
    """Of the rig."""
    noise = [c["sigma"] for c in row.config["record"]["channels"].values()]
    return len(priors(row)) - sum(isinstance(sigma, dict) for sigma in noise)


def sigmas(row: Row) -> set[float]:
    """True levels."""
    channels = row.config["record"]["channels"].values()
    known = {c["sigma"] for c in channels if not isinstance(c["sigma"], dict)}
    return known | set(row.config.get("simulation", {}).get("sigma", {}).values())


def samples(row: Row) -> int:
    grid = row.made if isinstance(row.made, Driven) else None
    made = row.config.get("simulation", {})
    duration = grid.duration if grid else made.get("duration", 0.0)
    return round(duration * (grid.rate if grid else made.get("rate", 0.0))) + 1


def duration(row: Row) -> float:
    return float(row.config.get("simulation", {}).get("duration", 1.0))


def voltage(row: Row) -> Any:
    return row.config["inputs"].get("v")


def drives(row: Row, kind: type) -> bool:
    return isinstance(row.made, Driven) and isinstance(row.made.series.get("v"), kind)


def channels(row: Row) -> set[str]:
    return {c.get("measures", n) for n, c in row.config["record"]["channels"].items()}


def constant(row: Row, sign: int) -> bool:
    return isinstance(voltage(row), int | float) and np.sign(voltage(row)) == sign


def hold(row: Row, kind: str) -> bool:
    return isinstance(voltage(row), dict) and voltage(row)["hold"] == kind


def width(row: Row) -> set[float]:
    """Upper over lower end of boxes."""
    boxes = [p for p in priors(row) if p["prior"] in ("uniform", "log_uniform") and p["low"] > 0]
    return {round(p["high"] / p["low"], 3) for p in boxes}


def gear(row: Row) -> float:
    return float(row.config.get("model", {}).get("i_m", 1 / 8))


def formulas(row: Row) -> str:
    given = row.config["parameters"].values()
    return " ".join(p for p in given if isinstance(p, str) and p != "nominal")


def posed(row: Row) -> str:
    return row.made.puzzle.kind if isinstance(row.made, Posed) else ""


KINDS = ("gap", "delay", "aliases", "friction", "signs", "mixed")
COVERED: dict[str, Callable[[Row], bool]] = {
    "step up": lambda row: constant(row, 1),
    "step down": lambda row: constant(row, -1),
    "no voltage": lambda row: constant(row, 0) and "initial" in row.config,
    "square wave": lambda row: drives(row, Square),
    "chirp": lambda row: drives(row, Chirp),
    "pseudo-random steps": lambda row: drives(row, RandomSteps),
    "closed loop": lambda row: drives(row, Loop) and hold(row, "zero"),
    "closed loop, first order": lambda row: drives(row, Loop) and hold(row, "first"),
    "load": lambda row: isinstance(row.config["inputs"].get("t_1"), float),
    "measured load": lambda row: isinstance(row.config["inputs"].get("t_1"), dict),
    "twist alone": lambda row: channels(row) == {"theta_1 - theta_2"},
    "one speed alone": lambda row: channels(row) == {"w_1"},
    "current": lambda row: "i" in channels(row),
    "five channels": lambda row: len(channels(row)) == 5,
    "known noise": lambda row: not any(isinstance(s, dict) for s in sigmas(row)),
    "unknown noise": lambda row: unknowns(row) < len(priors(row)),
    "gear of 1/70": lambda row: gear(row) == 1 / 70,
    "no gear": lambda row: gear(row) == 1.0,
    "milliseconds": lambda row: duration(row) < 0.1,
    "minutes": lambda row: duration(row) > 300,
    "box of 5 %": lambda row: 1.105 in width(row),
    "four decades": lambda row: 1e4 in width(row),
    "from zero": lambda row: any(p.get("low") == 0.0 for p in priors(row)),
    "tie": lambda row: any("tie" in p for p in row.config["parameters"].values() if isinstance(p, dict)),
    "sum in a formula": lambda row: "+" in formulas(row),
    "humps": lambda row: row.humps is not None,
    **{f"modes: {kind}": lambda row, kind=kind: posed(row) == kind for kind in KINDS},
    "bundled": lambda row: row.name == "bundled",
    **{f"noise {s}": lambda row, s=s: s in sigmas(row) for s in (1e-5, 1e-3, 0.01, 0.1, 0.3, 1.0)},
    **{f"{n} samples": lambda row, n=n: samples(row) == n for n in (12, 30, 300, 2500, 3000, 100_000)},
    **{f"{n} unknowns": lambda row, n=n: unknowns(row) == n for n in range(1, 10)},
    **{
        f"prior {kind}": lambda row, kind=kind: kind in {p["prior"] for p in priors(row)}
        for kind in (
            *("uniform", "log_uniform", "normal", "truncated_normal", "log_normal"),
            "half_normal",
        )
    },
}  # fmt: skip


def test_names_are_unique_and_there_are_many() -> None:
    assert len(set(ids(ROWS))) == len(ROWS) >= 40
    assert len({row.seed for row in ROWS}) == len(ROWS)
    assert len(ROWS) - len(FITTING) >= 8


@run_cases("what", COVERED)
def test_every_kind_of_record_is_there(what: str) -> None:
    assert [row.name for row in FITTING if COVERED[what](row)]


def test_unsound_rows_are_of_several_kinds() -> None:
    made = {type(row.made) for row in ROWS if not row.sound}
    assert {Otherwise, Rubbing, Driven} < made
    assert {"servo_square", "servo_sweep", "servo_slow", "wrong_gear", "wrong_unit"} < set(
        ids(ROWS)
    )


@pytest.mark.slow
@run_cases("row", ROWS, ids=ids(ROWS))
def test_every_config_is_valid(row: Row, tmp_path: Path) -> None:
    path = tmp_path / f"{row.name}.yaml"
    path.write_text(folder.text(row, row.seed), encoding="utf-8")
    config = loading.load(path).config
    assert config.name == row.name
    usual = Config.model_fields["sampler"].default
    usual = usual.model_copy(update={"walkers": config.sampler.walkers})  # as the rig has it
    assert config.sampler == usual or "sampler" in row.config


@run_cases("name", ["sum_and_tie", "load_measured"])
def test_a_written_row_passes_the_check(name: str, tmp_path: Path) -> None:
    for path in folder.write(rows.chosen([name])[0], tmp_path):
        ran = command_line.cli("check", path)
        assert ran.status == 0, ran.text


def test_the_second_run_differs_in_its_seed_alone(tmp_path: Path) -> None:
    first, second = folder.write(rows.chosen(["aliased_2"])[0], tmp_path)
    one, other = prepare(first), prepare(second)
    assert one.config.seed != other.config.seed
    assert np.array_equal(one.problem.experiment.y, other.problem.experiment.y)
    same = {"seed": 0, "record": one.config.record}
    assert one.config.model_copy(update=same) == other.config.model_copy(update=same)


def test_the_bundled_row_has_the_bundled_record(tmp_path: Path) -> None:
    folder.write(rows.chosen(["bundled"])[0], tmp_path)
    mine = (tmp_path / "records" / "bundled.csv").read_text()
    assert mine == (ROOT / "configs" / "records" / "nominal_step.csv").read_text()


def residuals_at_truth(job: Job) -> tuple[residual_checks.ResidualSummary, ...]:
    """What the record leaves at the values that it was made of."""
    config, space = job.config, job.problem.posterior.space
    (one,) = job.case.experiments
    values = {**space.start, **simulation.truth(one)}
    made: Any = config.simulation
    if made is not None:
        factors = {e.channel.name: e.channel.factor for e in one.channels}
        values |= {f"sigma_{name}": s * factors[name] for name, s in made.sigma.items()}
        values |= made.truth
        for name, value in made.quantities.items():
            values[name] = value * one.rig_numbers.quantities[name].factor
    truth = space.vector(values)
    posterior = choose_steps(job.problem.posterior, truth)  # as a run does at its maximum
    return residual_checks.residual_summaries(posterior.likelihood, truth)


def looks_like_noise(row: Row, place: Path) -> bool:
    left = residuals_at_truth(prepare(folder.write(row, place)[0]))
    return not any(one.large or one.small or one.far or one.correlated for one in left)


@run_cases("name", ["closed_loop", "load_measured"])
def test_a_sound_record_leaves_its_noise_at_the_truth(name: str, tmp_path: Path) -> None:
    assert looks_like_noise(rows.chosen([name])[0], tmp_path)


@pytest.mark.slow
@run_cases("row", THERE, ids=ids(THERE))
def test_records_leave_their_noise_at_the_truth_where_the_rig_fits(
    row: Row, tmp_path: Path
) -> None:
    assert looks_like_noise(row, tmp_path) == row.fits


GRIDS = {1: (20_001,), 2: (201, 1501), 3: (121, 601, 31)}  # k_e, k_s, j_1


@pytest.mark.slow
@run_cases("n", [1, 2, 3])
def test_the_humps_of_an_aliased_record_have_these_shares(n: int, tmp_path: Path) -> None:
    row = rows.chosen([f"aliased_{n}"])[0]
    assert isinstance(row.humps, Two)
    posterior = prepare(folder.write(row, tmp_path)[0]).problem.posterior
    names = posterior.space.free
    ends = [posterior.space.priors[name].quantile(np.array([0.0, 1.0])) for name in names]
    axes = [np.linspace(*end, k + 2)[1:-1] for end, k in zip(ends, GRIDS[n], strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, n)
    log_p = np.concatenate([posterior.density(part) for part in np.array_split(grid, 64)])
    weight = np.exp(log_p - log_p.max())
    low = grid[:, names.index(row.humps.name)] < row.humps.split
    assert weight[low].sum() / weight.sum() == pytest.approx(row.humps.below, abs=0.003)


def test_options_of_the_command_line() -> None:
    given = arguments(["--only", "chirp", "square", "--seconds", "30"])
    assert ids(rows.chosen(given.only)) == ["square", "chirp"]
    assert all(row.quick for row in rows.chosen(quick=True))
    with pytest.raises(ValueError, match="no row is named chirrup"):
        rows.chosen(["chirrup"])


QUICK = [row for row in ROWS if row.name in ("free_swing", "aliased_1", "wrong_noise")]


@pytest.mark.slow
@run_cases("row", QUICK, ids=ids(QUICK))
def test_a_quick_row_does_what_it_should(row: Row, tmp_path: Path) -> None:
    """One run at lower targets, whose means its own weights confirm."""
    short = dataclasses.replace(row, config=changed(row.config, SHORT))
    config, _ = folder.write(short, tmp_path)
    output = tmp_path / "run"
    ran = command_line.cli("posterior", config, "--output", output, "--processes", "1")
    found = runs.read(output, ran.status, 1.0, ran.text)
    share = () if row.humps is None else (row.humps.shares(runs.draws(output, found.mean)),) * 2
    outcome = judge.judged(row, (found, found), 0, 60.0, share)
    assert outcome.passed, (outcome.complaints, ran.text)
    if row.humps is not None:  # a report has no proposal to count with
        said = (output / "summary.md").read_text()
        assert "2 maxima of the posterior" in said
        assert command_line.cli("report", output, "--processes", "1").status == 0
        assert (output / "summary.md").read_text() == said
