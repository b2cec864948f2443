"""Modes of a posterior: a grid over all of the prior says where they are and what each holds."""

from __future__ import annotations

import dataclasses
import re
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp
from support.case_tables import for_each, run_cases
from support.small_problems import with_priors

from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Coordinates
from bayesdrill.sampling import multiple_modes
from bayesdrill.sampling.evidence import Evidence
from benchmarks.modes import collection, grid, judge
from benchmarks.modes.grid import Modes
from benchmarks.modes.judge import Outcome
from benchmarks.modes.puzzle import Puzzle

EVERY = collection.every()
SLOW = pytest.mark.slow
KINDS = {"gap", "delay", "aliases", "friction", "signs", "mixed"}


# Those that take long are for `make test-slow`.
GROUPS = [
    pytest.param({one.name: one for one in EVERY if one.quick}, id="quick"),
    pytest.param({one.name: one for one in EVERY if not one.quick}, id="long", marks=SLOW),
]


def folder(parent: Path, puzzle: Puzzle) -> Path:
    """One of its own."""
    made = parent / re.sub(r"\W", "_", puzzle.name)
    made.mkdir()
    return made


@pytest.mark.parametrize("puzzles", GROUPS)
def test_every_mode_is_found_with_its_mass(puzzles: dict[str, Puzzle], tmp_path: Path) -> None:
    """Mutant killed: at most six maxima are kept."""

    def check(puzzle: Puzzle) -> None:
        outcome = judge.run(puzzle, folder(tmp_path, puzzle))
        assert outcome.passed, (outcome.modes.masses, outcome.found, outcome.reasons)

    for_each({name: (one,) for name, one in puzzles.items()}, check)


@SLOW
@run_cases("puzzle", EVERY)
def test_a_grid_twice_as_fine_finds_the_same_masses(puzzle: Puzzle, tmp_path: Path) -> None:
    posterior = puzzle.load(tmp_path).job.problem.posterior
    here, finer = (puzzle.modes(posterior, n) for n in (1, 2))
    shown = here.above(judge.SHOWN)
    assert len(shown) > 1
    assert finer.masses[shown] == pytest.approx(here.masses[shown], rel=0.01)
    assert finer.masses[len(shown) :].max(initial=0.0) < 1.05 * judge.SHOWN


def test_aliases_that_the_prior_rules_out_are_not_missed(tmp_path: Path) -> None:
    """Of 230 the 96 that are kept hold all, but for a prior to which all are alike.

    Mutant killed: of aliases that are alike, all hold the same.
    """
    puzzle = collection.chosen(["twenty"])[0]
    posterior = puzzle.load(tmp_path).job.problem.posterior
    flat = with_priors(posterior.space, {"k_s": Uniform(1e-3, 1e5)})
    left_out = []
    for one in (posterior, dataclasses.replace(posterior, space=flat)):
        u = one.coordinates.from_physical(np.array([[68.217]]))[0]
        (found,) = multiple_modes.alias_starts(LogDensity(one, physical=True), u)
        assert len(found.u) == multiple_modes.MAX_ALIASES
        left_out.append(found.missed_share)
    assert left_out[0] < 1e-3
    assert left_out[1] > 0.2


def test_puzzles_are_of_every_kind() -> None:
    kinds = [one.kind for one in EVERY]
    assert set(kinds) == KINDS
    assert min(map(kinds.count, KINDS)) >= 4
    assert len({one.name for one in EVERY}) == len(EVERY)
    assert all(len(one.t) <= 1000 and len(one.cells) <= 3 for one in EVERY)


@dataclasses.dataclass(frozen=True)
class Bells:
    """Bells of two unknowns, of masses that are known."""

    masses: np.ndarray
    middles: np.ndarray
    sds: np.ndarray

    coordinates = Coordinates((False, False))

    @cached_property
    def space(self) -> SimpleNamespace:
        priors = {"a": Uniform(-1.0, 1.0), "b": Uniform(0.0, 1.0)}
        return SimpleNamespace(priors=priors, free=tuple(priors))

    def __call__(self, z: np.ndarray) -> np.ndarray:
        off = (z[:, None] - self.middles) / self.sds
        heights = np.log(self.masses) - np.log(self.sds).sum(axis=1)
        return logsumexp(heights - 0.5 * (off**2).sum(axis=2), axis=1)


def bells() -> Bells:
    return Bells(
        np.array([0.6, 0.3, 0.1]),
        np.array([[-0.5, 0.3], [0.4, 0.7], [0.415, 0.4]]),
        np.array([[0.02, 0.004], [0.003, 0.03], [0.001, 0.01]]),
    )


def test_bells_have_their_masses() -> None:
    """Hundreds of them would stand beside each other, and the coarsest cells are wider than each."""
    known = grid.modes(bells(), (60, 40))  # type: ignore[arg-type]
    assert known.masses == pytest.approx([0.6, 0.3, 0.1], rel=2e-3)
    assert known.log_z == pytest.approx(np.log(2.0 * np.pi), abs=2e-3)
    assert np.abs(known.tops - bells().middles).max() < 2e-3
    rng = np.random.default_rng(1)
    which = rng.choice(3, 20_000, p=[0.2, 0.5, 0.3])
    z = bells().middles[which] + bells().sds[which] * rng.standard_normal((20_000, 2))
    assert known.shares(z) == pytest.approx(np.bincount(which) / 20_000, abs=1e-3)


def test_a_number_may_part_a_mode() -> None:
    known = grid.modes(bells(), (60, 40), ("b", 0.3))  # type: ignore[arg-type]
    assert known.masses == pytest.approx([0.3, 0.3, 0.3, 0.1], rel=3e-2)


def test_what_is_hardly_a_valley_parts_nothing() -> None:
    """Two bells of one sd: four sds apart a valley of e^-1.3, eight apart one of e^-7."""
    for apart, count in ((4.0, 1), (8.0, 2)):
        middles = np.array([[0.0, 0.5], [0.05 * apart, 0.5]])
        two = Bells(np.full(2, 0.5), middles, np.full((2, 2), 0.05))
        assert len(grid.modes(two, (60, 40)).masses) == count  # type: ignore[arg-type]


def outcome(
    found: tuple[float, ...], reasons: tuple[str, ...] = (), log_z: float = -7.0
) -> Outcome:
    masses = np.array([0.6, 0.37, 0.03])
    one = np.zeros((3, 1))
    known = Modes(
        tops=one, masses=masses, index=one.astype(np.int64), labels=np.arange(3), low=one[0],
        steps=one[0] + 1.0, evaluations=3, log_z=-7.0,
    )  # fmt: skip
    return Outcome(
        puzzle=EVERY[0], unknowns=("k_s",), modes=known, found=np.array(found), draws=10_000,
        reasons=reasons, seconds=1.0, evidence=Evidence(log_z=log_z, error=0.01, overlap=0.9),
    )  # fmt: skip


def test_a_run_passes_with_every_mode_or_the_reason_for_what_is_missing() -> None:
    assert outcome((0.58, 0.39, 0.03)).passed
    assert outcome((0.6, 0.38, 0.02)).missed == ()  # a third of a small one is chance, too
    lost = (0.62, 0.38, 0.0)
    assert outcome(lost).missed == (2,)
    assert outcome((0.58, 0.39, 0.03), log_z=-6.96).passed
    assert not outcome((0.58, 0.39, 0.03), log_z=-6.95).passed
    assert not outcome(lost).passed
    assert not outcome(lost, ("R-hat 1.2, wanted at most 1.01",)).passed
    assert outcome(lost, ("there may be maxima elsewhere",)).passed
    assert outcome((0.6, 0.37, 0.03), ("R-hat 1.2, wanted at most 1.01",)).status == 3
