"""Modes of a posterior: a grid over all of the prior says where they are and what each holds."""

import dataclasses
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp

from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Coordinates
from bayesdrill.sampling.evidence import Evidence
from benchmarks.modes import collection, grid, judge
from benchmarks.modes.grid import Modes
from benchmarks.modes.judge import Outcome
from benchmarks.modes.puzzle import Puzzle

EVERY = collection.every()


@pytest.mark.slow
@pytest.mark.parametrize("puzzle", EVERY, ids=lambda puzzle: puzzle.name)
def test_every_mode_is_sampled_with_its_mass(puzzle: Puzzle, tmp_path: Path) -> None:
    outcome = judge.run(puzzle, tmp_path)
    assert outcome.passed, (outcome.modes.masses, outcome.found, outcome.reasons)


@dataclasses.dataclass(frozen=True)
class Bells:
    """A posterior of two unknowns: normal densities, of masses that are known."""

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

    def modes(self, split: tuple[str, float] | None = None) -> Modes:
        return grid.modes(self, (60, 40), split)  # type: ignore[arg-type]


THREE = Bells(
    np.array([0.6, 0.3, 0.1]),
    np.array([[-0.5, 0.3], [0.4, 0.7], [0.415, 0.4]]),
    np.array([[0.02, 0.004], [0.003, 0.03], [0.001, 0.01]]),
)


def test_a_grid_has_the_masses_of_normal_densities() -> None:
    """Hundreds of them would stand beside each other, and the coarsest cells are wider than each."""
    modes = THREE.modes()
    assert modes.masses == pytest.approx([0.6, 0.3, 0.1], rel=2e-3)
    assert modes.log_z == pytest.approx(np.log(2.0 * np.pi), abs=2e-3)
    assert np.abs(modes.tops - THREE.middles).max() < 2e-3
    rng = np.random.default_rng(1)
    bell = rng.choice(3, 20_000, p=[0.2, 0.5, 0.3])
    z = THREE.middles[bell] + THREE.sds[bell] * rng.standard_normal((20_000, 2))
    assert modes.shares(z) == pytest.approx(np.bincount(bell) / 20_000, abs=1e-3)


def outcome(
    shares: tuple[float, ...], reasons: tuple[str, ...] = (), log_z: float = -7.0
) -> Outcome:
    masses, zeros = np.array([0.6, 0.37, 0.03]), np.zeros((3, 1))
    modes = Modes(
        tops=zeros, masses=masses, index=zeros.astype(np.int64), labels=np.arange(3), low=zeros[0],
        steps=zeros[0] + 1.0, evaluations=3, log_z=-7.0,
    )  # fmt: skip
    return Outcome(
        puzzle=EVERY[0], unknowns=("k_s",), modes=modes, found=np.array(shares), draws=10_000,
        reasons=reasons, seconds=1.0, evidence=Evidence(log_z=log_z, error=0.01, overlap=0.9),
    )  # fmt: skip


def test_a_run_passes_with_every_mode_or_the_reason_for_what_is_missing() -> None:
    whole, lost = (0.58, 0.39, 0.03), (0.62, 0.38, 0.0)
    r_hat, elsewhere = "R-hat 1.2, wanted at most 1.01", "there may be maxima elsewhere"
    assert outcome(whole).passed
    assert outcome((0.6, 0.38, 0.02)).missed == ()  # a third of a small one is chance, too
    assert outcome(lost).missed == (2,)
    assert outcome(whole, log_z=-6.96).passed
    assert not outcome(whole, log_z=-6.95).passed
    assert not outcome(lost).passed
    assert not outcome(lost, (r_hat,)).passed
    assert outcome(lost, (elsewhere,)).passed
    assert outcome(whole, (r_hat,)).status == 3
