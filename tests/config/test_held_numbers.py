"""Numbers that an experiment of several holds by itself, and formulas of what is an experiment's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import command_line, two_experiments
from support.config_mistakes import check_mistakes

from bayesdrill.config import loading
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import simulation
from bayesdrill.inference import derived
from bayesdrill.report import words
from bayesdrill.results import provenance

SMALL = command_line.ROOT.parent / "shared" / "cases" / "small"

# A cart on a spring, with a known weight on it that is another one in each run.
CART = """\
name: cart
seed: 3
record:
  time: {column: t, unit: s}
  channels:
    x_cart: {column: x, unit: m, sigma: 1.0e-4}
inputs: {}
initial: {x_cart: 0.03}
experiments:
  bare: {record: {file: bare.csv}}
  loaded: {record: {file: loaded.csv}, parameters: {m_cart: m_0 + 0.5}}
model: {name: train, motion: linear, inertias: [cart], shafts: {spring: [cart, ground]}}
parameters:
  m_cart: m_0*1
  c_cart: {prior: log_uniform, low: 0.1, high: 100}
  k_spring: {prior: log_uniform, low: 30, high: 3000}
quantities:
  m_0: {prior: log_uniform, low: 0.1, high: 10, unit: kg}
derived:
  by_both: {formula: k_spring/m_cart_loaded, unit: 1/s**2}
map: {starts: 1}
sampler: {walkers: 16, r_hat: 1.2, n_tau: 5, ess: 100, max_steps: 500}
output: {predictive_draws: 10, figures: []}
simulation: {duration: 2, rate: 100, quantities: {m_0: 0.8}, k_spring: 300, c_cart: 2}
"""


def held(folder: Path, *changes: tuple[str, str]) -> Job:
    return prepare(two_experiments.write(folder, *changes))


def alone(folder: Path, label: str, *changes: tuple[str, str]) -> np.ndarray:
    """The response of one experiment of the pair in a config of its own, at the start."""
    text = two_experiments.PAIR
    first, _, rest = text.partition("experiments:")
    text = f"{first}{rest.partition('shared: [lag_theta_1, offset_theta_1]')[2]}"
    text = text.replace("record:\n", f"record:\n  file: {label}.csv\n")
    if label == "slow":
        text = text.replace("v: 8.0", "v: 4.0")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / f"{label}.yaml").write_text(text)
    return signals(prepare(folder / f"{label}.yaml"))[0]


def signals(job: Job) -> list[np.ndarray]:
    space = job.problem.posterior.space
    return [
        x[0] for x in job.problem.posterior.likelihood.all_signals(space.vector(space.start)[None])
    ]


def in_slow(entry: str) -> tuple[str, str]:
    return "slow: {record", f"slow: {{{entry}, record"


def test_each_experiment_moves_as_its_own_numbers_say(tmp_path: Path) -> None:
    """A number, a formula with its own number in it, and what follows from it by a tie above."""
    tied = ("k_T: nominal", "k_T: {tie: k_s}")
    job = held(tmp_path, in_slow("parameters: {k_s: 0.1, j_m: 2*k_s*1.0e-3}"), tied)
    space = job.problem.posterior.space
    assert space.free[:2] == ("k_e", "j_1")
    assert space.fixed["k_s_slow"] == 0.1
    assert space.fixed["k_T_slow"] == 0.1
    assert space.fixed["j_m_slow"] == pytest.approx(2e-4)
    assert space.fixed["k_s"] == space.fixed["k_T"] != 0.1
    slow, fast = signals(job)
    given = [("k_s: nominal", "k_s: 0.1"), ("j_m: nominal", "j_m: 0.0002")]
    assert slow == pytest.approx(alone(tmp_path, "slow", *given, ("k_T: nominal", "k_T: 0.1")))
    assert fast == pytest.approx(alone(tmp_path, "fast", tied))


def test_a_known_load_on_a_cart_tells_its_mass(tmp_path: Path) -> None:
    """Mass and stiffness have one scale: only another known mass in one of the runs shows it."""
    path = tmp_path / "cart.yaml"
    path.write_text(CART)
    for target, text in simulation.simulate_all(loading.load(path), 3).items():
        target.write_text(text)
    job = prepare(path)
    assert job.problem.names == ("k_spring", "c_cart", "m_0")
    assert "tied: m_cart = m_0 * 1, m_cart_loaded = m_0 + 0.5" in words.opening(job.problem)
    ran = command_line.cli("map", path, "--quick", "-o", tmp_path / "map")
    assert ran.status == 0, ran.text
    found = dict(
        line.split(",")[::3] for line in (tmp_path / "map" / "map.csv").read_text().split()
    )
    assert float(found["k_spring"]) == pytest.approx(300, rel=0.01)
    assert float(found["m_0"]) == pytest.approx(0.8, rel=0.01)
    assert command_line.cli("verify", tmp_path / "map").status == 0
    ran = command_line.cli("posterior", path, "-o", tmp_path / "out", "--processes", "1")
    assert ran.status == 0, ran.text
    assert "m_cart_loaded" in (tmp_path / "out" / "derived.csv").read_text()
    assert command_line.cli("verify", tmp_path / "out").status == 0
    (mine,) = (x for x in job.problem.derived if x.symbol.name == "by_both")
    theta = np.array([[300.0, 2.0, 0.8]])
    assert derived.values_at(job.problem, theta)[mine.symbol.name] == pytest.approx(300 / 1.3)


def test_a_run_is_started_again_from_the_config_that_it_has_written(tmp_path: Path) -> None:
    entry = in_slow("parameters: {k_s: 0.1, j_m: 2*k_s*1.0e-3}")
    job = held(tmp_path, entry, ("output:", "derived: {ratio: j_1/k_s_slow}\noutput:"))
    written = tmp_path / "again.yaml"
    written.write_text(provenance.resolved(job.case, tmp_path))
    again = prepare(written)
    marks = [provenance.fingerprint(each.config, each.problem) for each in (job, again)]
    assert marks[0] == marks[1]
    assert marks[0]["k_s_slow, which is held,"] == "0.1"
    assert again.problem.derived[0].expression.text == "j_1 / k_s_slow"


def test_what_is_own_of_an_experiment_stands_in_formulas_by_its_name(tmp_path: Path) -> None:
    own = ("shared: [lag", "own: [j_1]\nshared: [lag")
    both = ("output:", "derived: {ratio: j_1_slow/j_1_fast, of_both: ratio + k_e}\noutput:")
    job = held(tmp_path, own, both)
    theta = job.problem.posterior.space.draw(50, np.random.default_rng(1))
    found = derived.values_at(job.problem, theta)
    names = [*job.problem.names]
    ratio = theta[:, names.index("j_1_slow")] / theta[:, names.index("j_1_fast")]
    assert found["ratio"] == pytest.approx(ratio)
    assert found["of_both"] == pytest.approx(ratio + theta[:, names.index("k_e")])


def test_a_mistake_is_told_where_it_stands(tmp_path_factory: pytest.TempPathFactory) -> None:
    check_mistakes("held_numbers", tmp_path_factory, held)


@pytest.mark.skipif(not SMALL.is_dir(), reason="the records of others are not there")
def test_the_campaigns_of_others_are_read(tmp_path: Path) -> None:
    ran = command_line.cli("check", SMALL / "own_derived" / "config.yaml")
    assert ran.status == 0, ran.text
    text = (SMALL / "own_held_values" / "per.yaml").read_text().replace("../", f"{SMALL}/")
    for column in ("t [s]", "theta [rad]", "u [V]"):
        text = text.replace(f'"{column}"', column[: column.index(" ")])
    (tmp_path / "per.yaml").write_text(text)
    ran = command_line.cli("check", tmp_path / "per.yaml")
    assert ran.status == 0, ran.text
    assert "g_arm_a = 0.8236, g_arm_b = 0.8236" in ran.out
