"""Several experiments in one config: what each reads, holds and shares, and how each begins."""

from pathlib import Path

import numpy as np
import pytest
from support import command_line, two_experiments
from support.command_line import CONFIGS
from support.config_texts import write

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import simulation
from bayesdrill.inference import derived
from bayesdrill.inference.priors import TruncatedNormal
from bayesdrill.report import words

FAST = "  fast: {record: {file: fast.csv}}\n"
SHARED = "shared: [lag_theta_1, offset_theta_1]"
FREE_START = ("experiments:\n  slow", "initial: free\nexperiments:\n  slow")

# A cart on a spring, with a known weight on it that is another one in each run.
CART = (CONFIGS / "cart.yaml").read_text(encoding="utf-8")


def pair(folder: Path, *changes: tuple[str, str]) -> Job:
    return prepare(two_experiments.write(folder, *changes))


def in_slow(entry: str) -> tuple[str, str]:
    return "slow: {record", f"slow: {{{entry}, record"


def places_of_mistakes(folder: Path, *changes: tuple[str, str]) -> set[str]:
    with pytest.raises(InputError) as caught:
        pair(folder, *changes)
    return {problem.place.partition(": ")[2] for problem in caught.value.problems}


def start_signals(job: Job) -> list[np.ndarray]:
    """The response of each experiment at the start."""
    space, likelihood = job.problem.posterior.space, job.problem.posterior.likelihood
    return [y[0] for y in likelihood.all_signals(space.vector(space.start)[None])]


def alone(folder: Path, label: str, *changes: tuple[str, str]) -> np.ndarray:
    """The response of one experiment of the pair in a config of its own, at the start."""
    first, _, rest = two_experiments.PAIR.partition("experiments:")
    text = f"{first}{rest.partition(SHARED)[2]}"
    text = text.replace("record:\n", f"record:\n  file: {label}.csv\n")
    if label == "slow":
        text = text.replace("v: 8.0", "v: 4.0")
    return start_signals(prepare(write(folder, text, *changes)))[0]


def test_mistakes_of_all_experiments_are_told_at_once(tmp_path: Path) -> None:
    """Those of the config; then those of the records."""
    slow = ("slow: {record: {file: slow.csv}, inputs: {v: 4.0}}", "slow: {SLOW}")
    misspelt = (slow[0], "slow: {record: {file: slow.csv, windw: 1}}")
    no_file = (FAST, "  fast: {inputs: {v: [3]}}\n")
    assert places_of_mistakes(tmp_path, misspelt, no_file, ("k_s: nominal", "k_s: nominl")) == {
        "experiments.slow.record.windw",
        "experiments.fast.record.file",
        "experiments.fast.inputs.v",
        "parameters.k_s",
    }
    missing = (slow[0], "slow: {record: {file: slw.csv}}")
    beyond = (FAST, "  fast: {record: {file: fast.csv, window: [9, 10]}}\n")
    assert places_of_mistakes(tmp_path, missing, beyond) == {
        "experiments.slow.record.file",
        "experiments.fast.record.window",
    }


def test_an_experiment_reads_as_if_it_were_alone(tmp_path: Path) -> None:
    """Entries of its own stand over common ones, mapping by mapping; a kind that differs, instead."""
    w_1 = "channels: {w_1: {sigma: 3}}"
    own = f"{{record: {{file: fast.csv, {w_1}}}, inputs: {{v: {{column: w_1, unit: V}}}}}}"
    case = loading.load(two_experiments.write(tmp_path, (FAST, f"  fast: {own}\n")))
    slow, fast = case.experiments
    assert (slow.label, fast.label) == ("slow", "fast")
    assert slow.config.inputs.v == 4.0
    assert slow.config.record.channels["w_1"].sigma == 0.1
    channel = fast.config.record.channels["w_1"]
    assert (channel.sigma, channel.unit, channel.column) == (3.0, "rad/s", "w_1")
    assert fast.config.inputs.v.column == "w_1"  # type: ignore[union-attr]


def test_unknowns_of_one_experiment_have_its_label(tmp_path: Path) -> None:
    problem = pair(tmp_path, (SHARED, "shared: [lag_theta_1]\nown: [j_1]")).problem
    own = ("j_1_slow", "j_1_fast")
    offsets = ("offset_theta_1_slow", "offset_theta_1_fast")
    assert problem.names == ("k_e", *own, offsets[0], "lag_theta_1", offsets[1])
    assert problem.nominal["j_1_slow"] == problem.nominal["j_1_fast"] == problem.nominal["j_1"]
    assert {*own} <= problem.published
    meanings = {symbol.name: symbol.meaning for symbol in problem.symbols}
    assert meanings["j_1_fast"].endswith("of the experiment fast")
    assert "experiment" not in meanings["lag_theta_1"]


def test_each_experiment_moves_with_its_own_numbers(tmp_path: Path) -> None:
    """A number, a formula with its own number in it, and what follows from it by a tie above."""
    tied = ("k_T: nominal", "k_T: {tie: k_s}")
    job = pair(tmp_path, in_slow("parameters: {k_s: 0.1, j_m: 2*k_s*1.0e-3}"), tied)
    fixed = job.problem.posterior.space.fixed
    assert job.problem.posterior.space.free[:2] == ("k_e", "j_1")
    assert (fixed["k_s_slow"], fixed["k_T_slow"]) == (0.1, 0.1)
    assert fixed["j_m_slow"] == pytest.approx(2e-4)
    assert fixed["k_s"] == fixed["k_T"] != 0.1
    slow, fast = start_signals(job)
    given = [("k_s: nominal", "k_s: 0.1"), ("j_m: nominal", "j_m: 0.0002")]
    assert slow == pytest.approx(alone(tmp_path, "slow", *given, ("k_T: nominal", "k_T: 0.1")))
    assert fast == pytest.approx(alone(tmp_path, "fast", tied))


@pytest.mark.slow
def test_a_known_load_on_a_cart_determines_its_mass(tmp_path: Path) -> None:
    """Mass and stiffness have one scale: only another known mass in one of the runs shows it."""
    path = write(tmp_path, CART)
    for target, text in simulation.simulate_all(loading.load(path), 3).items():
        target.write_text(text)
    problem = prepare(path).problem
    assert problem.names == ("k_spring", "c_cart", "m_0")
    assert "tied: m_cart = m_0 * 1, m_cart_loaded = m_0 + 0.5" in words.opening(problem)
    ran = command_line.cli("map", path, "--quick", "-o", tmp_path / "map")
    assert ran.status == 0, ran.text
    rows = (tmp_path / "map" / "map.csv").read_text().split()
    values = dict(row.split(",")[::3] for row in rows)
    assert float(values["k_spring"]) == pytest.approx(300, rel=0.01)
    assert float(values["m_0"]) == pytest.approx(0.8, rel=0.01)
    assert command_line.cli("verify", tmp_path / "map").status == 0
    at_truth = derived.values_at(problem, np.array([[300.0, 2.0, 0.8]]))
    assert at_truth["by_both"] == pytest.approx(300 / 1.3)
    assert at_truth["m_cart_loaded"] == pytest.approx(1.3)


def test_free_states_are_as_wide_as_the_channels(tmp_path: Path) -> None:
    priors = pair(
        tmp_path, FREE_START, ("walkers: 16", "walkers: 32")
    ).problem.posterior.space.priors
    lines = two_experiments.records(two_experiments.PAIR)["fast.csv"].splitlines()[1:]
    y = np.array([line.split(",")[1:] for line in lines], dtype=float) * [np.pi / 180, 1.0]
    angle, speed = priors["theta_1_0_fast"], priors["w_2_0_fast"]
    assert isinstance(angle, TruncatedNormal)
    assert isinstance(speed, TruncatedNormal)
    assert (angle.mean, angle.sd) == pytest.approx((y[0, 0], 2 * np.ptp(y[:, 0])))
    assert speed.sd == pytest.approx(2 * np.abs(y[:, 1]).max(), rel=0.5)
    assert priors["w_1_0_slow"] != priors["w_1_0_fast"]


def test_free_states_allow_for_the_gain_of_their_sensor(tmp_path: Path) -> None:
    turned = ("column: theta_1, unit: deg,", "column: theta_1, unit: deg, gain: -2.0,")
    before, after = (
        pair(
            tmp_path, FREE_START, ("walkers: 16", "walkers: 32"), *changes
        ).problem.posterior.space.priors["theta_1_0_fast"]
        for changes in ((), (turned,))
    )
    assert isinstance(before, TruncatedNormal)
    assert isinstance(after, TruncatedNormal)
    assert (after.mean, after.sd) == pytest.approx((-0.5 * before.mean, 0.5 * before.sd))


def test_a_state_of_which_no_channel_tells_needs_a_prior(tmp_path: Path) -> None:
    """Of a record of the current alone there is no angle, and nothing drives one."""
    channels = two_experiments.PAIR.partition("channels:\n")[2].partition("inputs:")[0]
    changes = [
        (channels, "    i: {column: w_1, unit: A, sigma: 0.1}\n"),
        (f"{SHARED}\n", ""),
        ("experiments:\n  slow", "initial: {theta_1: free}\nexperiments:\n  slow"),
        (", truth: {lag_theta_1: 15, offset_theta_1: -6}", ""),
    ]
    with pytest.raises(InputError, match=r"initial\.theta_1: .*give it a prior"):
        pair(tmp_path, *changes)
