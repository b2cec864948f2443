"""The contract of all simulators, over one table of cases and against one oracle (`linear_oracle`).

Signals and slopes are those of the oracle, sums those of the samples that they do without, and a
walker has its own numbers whatever its neighbours do.
"""

import functools
import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.special import log_ndtr
from support.case_tables import slow_except
from support.friction_cases import CASES as RUBBING
from support.linear_oracle import ExactMotion
from support.scipy_oracles import NOMINAL, ORDER
from support.small_problems import experiment, vector
from support.stepped_friction import experiment_of, model_of, parameters

from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.long_record import LongRecord
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

W, N, STEP = 11, 70, 0.01
PERFECT = ObservationModel()
MEASURES = {"alpha": {"theta_1": 1.0, "theta_2": -1.0}, "w_2": {"w_2": 8.0}, "i": {"i": 1.0}}
START = {"theta_1": 0.2, "theta_2": -0.1, "w_1": 3.0, "w_2": 2.0, "i": 0.4}
EVERY = ObservationModel(
    gains={"alpha": "gain_alpha", "w_2": "gain_w_2"},
    offsets={"alpha": "offset_alpha"},
    lags={"alpha": "lag_alpha", "i": "lag_i"},
    input_gains={"v": "gain_v"},
    input_offsets={"v": "offset_v"},
    delay="delay",
    states={"theta_2": "theta_2_0", "w_1": "w_1_0", "i": "i_0"},
)
STEADY = ObservationModel(
    lags={"alpha": "lag_alpha"}, input_gains={"v": "gain_v"}, input_offsets={"v": "offset_v"},
    delay="delay", steady=True,
)  # fmt: skip
FELT = replace(EVERY, delay=None, input_lags={"v": "lag_v"})
TOLD = {
    "gain_alpha": 0.97, "gain_w_2": 1.02, "offset_alpha": 0.01, "lag_alpha": 0.0243, "lag_i": 0.0031,
    "gain_v": 1.04, "offset_v": -0.2, "delay": 0.0052, "lag_v": 0.0052, "theta_1_0": 0.15,
    "theta_2_0": 0.15, "w_1_0": 2.5, "i_0": 0.3,
}  # fmt: skip
VOLTAGE = 6.0 * np.sign(np.sin(np.arange(N) * 0.21)) + 0.5 * np.cos(np.arange(N) * 0.05)


def with_gaps(record: Experiment) -> Experiment:
    """Channels that miss their first or last sample, every other one, or several in a row."""
    y = record.y.copy()
    y[0, 0] = y[-1, 1] = y[20:30, 2] = y[::2, 0] = np.nan
    return replace(record, y=y)


def times(kind: str, n: int = N) -> np.ndarray:
    rng = np.random.default_rng(3)
    even = 2.5 + STEP * np.arange(n)
    jitter = 0.3 * STEP * rng.uniform(-1, 1, n) * (np.arange(n) > 0)
    late = np.where(np.arange(n) >= n // 2, 500.4 * STEP, 0.0)
    left_out = STEP * (np.arange(n) // 5)
    clocks = 2.5 + STEP * np.union1d(1.5 * np.arange(n), 2.0 * np.arange(n))[:n]
    return {"even": even, "gaps": even, "jitter": even + jitter, "gap": even + jitter + late,
            "left out": even + left_out, "two clocks": clocks}[kind]  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A rig, its record, and walkers `full (W, P)`; `tallied`: sums that are compared beside squares."""

    model: Model
    record: Experiment
    full: np.ndarray
    sensing: ObservationModel = PERFECT
    tallied: tuple[str, ...] = ()
    stepping: tuple[int, ...] = ()

    @property
    def close(self) -> float:
        """The largest relative error; long chains have long sums."""
        return 1e-10 if len(self.model.states) > 10 else 1e-11

    @functools.cached_property
    def simulator(self) -> Simulator:
        return self.of(self.record)

    def of(self, record: Experiment) -> Simulator:
        return simulator(self.model, record, self.sensing, *self.stepping)

    @functools.cached_property
    def signals(self) -> np.ndarray:
        return self.simulator.signals(self.full)


def told(rig: np.ndarray, sensing: ObservationModel) -> np.ndarray:
    """Walkers of a rig `(W, P)`, with sensors that differ; lags go both ways, and two by far."""
    rng = np.random.default_rng(7)
    columns = np.array([TOLD[name] for name in sensing.names]) * rng.normal(1, 0.3, (len(rig), 1))
    for k, name in enumerate(sensing.names):
        if name == "lag_alpha":
            columns[1:4, k] = [-0.033, 0.3, 0.0]
    return np.hstack([rig, columns])


def shaft(
    at: str = "even",
    series: tuple[str, ...] = ("v",),
    sensing: ObservationModel = PERFECT,
    *,
    gaps: bool = False,
    lead: float = 0.0,
    moving: bool = True,
    tallied: tuple[str, ...] = (),
    **own: Any,
) -> Case:
    """The paper's rig; one walker has a current that is far faster than all else, one hardly damps."""
    rng = np.random.default_rng(4)
    t = times(at)
    inputs = {"v": VOLTAGE, "t_1": 0.1 * rng.standard_normal(N)}
    constant = {"v": 5.5, "t_1": 0.03}
    start = {"theta_2": -0.1} if sensing.steady else START if moving else {}
    measures = MEASURES | ({"alpha": {"theta_1": 1.0, "theta_2": 0.5}} if sensing.steady else {})
    record = experiment(
        N, STEP, constant={n: u for n, u in constant.items() if n not in series}, measures=measures,
        series={n: inputs[n] for n in series}, start=start,
        t_start=float(t[0]) - lead, **own,
    )  # fmt: skip
    record = replace(record, t=t, y=rng.normal(size=(N, 3)))
    rig = vector(NOMINAL) * np.exp(rng.normal(0, 0.3, (W, 9)))
    if not sensing.steady:
        rig[2, ORDER.index("l_m")] *= 1e-9
        rig[10, [ORDER.index(name) for name in ("c_m", "k_e", "k_T", "j_1")]] *= 0.01
    record = with_gaps(record) if gaps else record
    return Case(MotorShaft(), record, told(rig, sensing), sensing, tallied)


def chain(
    count: int,
    at: str = "even",
    *,
    ground: bool = False,
    series: tuple[str, ...] = ("t_d0",),
    sensing: ObservationModel = PERFECT,
    lead: float = 0.0,
    first_order: bool = False,
    **rig: Any,
) -> Case:
    """A chain of `count` inertias; `ground`: the last is held by a shaft."""
    names = [f"d{k}" for k in range(count)]
    geared = {end for gear in rig.get("gears", {}).values() for end in gear["between"]}
    ends = [
        pair for pair in zip(names, [*names[1:], *["ground"] * ground], strict=False)
        if not {*pair} <= geared
    ]  # fmt: skip
    added = (*(f"c_s{k}" for k in range(len(ends))), "c_d0")
    kinds = {"inertias": names, "drives": {"d0": "torque"}, "added": added} | rig
    model = Train(shafts={f"s{k}": pair for k, pair in enumerate(ends)}, **kinds)
    rng, states = np.random.default_rng(3), model.states
    rows = rng.normal(0, 1, (3, len(states))) * (rng.uniform(size=(3, len(states))) < 0.2)
    rows[0, 0] = rows[1, -1] = rows[2, len(states) // 2] = 1.0
    channels = tuple(
        Channel(name=name, weights=dict(zip(states, row, strict=True)), unit="", latex="",
                latex_unit="") for name, row in zip(MEASURES, rows, strict=True)
    )  # fmt: skip
    t, y = times(at), rng.normal(0, 1, (N, 3))
    if at == "two clocks":
        steps = np.round((t - t[0]) / STEP, 9)
        y[steps % 1.5 > 0, 0] = y[steps % 2.0 > 0, 1:] = np.nan
    record = Experiment(
        t=t, y=y, channels=channels,
        constant={}, series={name: rng.normal(1, 1, N) for name in series},
        first_order=first_order, start={name: rng.normal() for name in states}, t_start=2.5 - lead,
    )  # fmt: skip
    usual = {"j": 0.01, "m": 0.01, "k": 30.0, "c": 0.02, "l": 2e-3, "r": 0.5}
    middle = np.array([usual[name[0]] for name in model.parameters])
    full = told(middle * rng.uniform(0.5, 2.0, (W, len(middle))), sensing)
    if "l_d0" in model.parameters:
        full[2, model.parameters.index("l_d0")] = 1e-13
    record = with_gaps(record) if at == "gaps" else record
    tallied = ("neighbours",) if at == "gaps" and count == 6 else ()
    return Case(model, record, full, sensing, tallied)


def rubs(sensing: ObservationModel, *tallied: str) -> Case:
    case = RUBBING["static"]
    record = experiment_of(case, MEASURES)
    record = replace(record, y=np.random.default_rng(3).normal(size=record.y.shape))
    rig = np.repeat(parameters(case), W, axis=0)
    rig[:, :4] *= np.exp(np.random.default_rng(9).normal(0, 0.1, (W, 4)))
    return Case(model_of(case), with_gaps(record), told(rig, sensing), sensing, tallied, (2,))


BOTH = {"d0": "torque", "d5": "torque"}
MAKE: dict[str, Callable[[], Case]] = {
    "even, held voltage": lambda: shaft(tallied=EVERY_SUM),
    "straight inputs, from before the record": lambda: shaft(
        series=("v", "t_1"), first_order=True, lead=0.137
    ),
    "gaps": lambda: shaft(gaps=True, tallied=EVERY_SUM),
    "jitter, straight inputs": lambda: shaft(
        "jitter", ("v", "t_1"), first_order=True, lead=0.05
    ),
    "gap, all sensors": lambda: shaft(
        "gap", sensing=EVERY, gaps=True, tallied=("neighbours",)
    ),
    "left out, all sensors, straight voltage": lambda: shaft(
        "left out", sensing=EVERY, first_order=True
    ),
    "a step given late": lambda: shaft(
        series=(), sensing=replace(EVERY, states={}), moving=False
    ),
    "steady start, straight voltage": lambda: shaft(sensing=STEADY, first_order=True),
    "steady start, straight voltage, unknown angle": lambda: shaft(
        sensing=replace(STEADY, states={"theta_1": "theta_1_0"}), first_order=True
    ),
    "left out": lambda: shaft("left out"),
    "chain, straight inputs, a line": lambda: chain(
        12, ground=True, first_order=True, series=("f_d0", "f_d5"), motion="linear", drives=BOTH,
        lead=0.0137,
    ),
    "chain, gears and a current": lambda: chain(
        12, series=("u_d0",), first_order=True, drives={"d0": "voltage"},
        gears={"box": {"between": ["d3", "d4"], "ratio": -0.07}}, added=("l_d0", "c_s0", "c_s7"),
    ),
    "rubs, gaps": lambda: rubs(PERFECT, *EVERY_SUM),
    "rubs, all sensors": lambda: rubs(FELT, "intervals"),
}  # fmt: skip
SENSED = {
    "gains": ObservationModel(gains={"alpha": "gain_alpha", "w_2": "gain_w_2"}),
    "offsets": ObservationModel(offsets={"alpha": "offset_alpha"}),
    "lags": ObservationModel(lags={"alpha": "lag_alpha", "i": "lag_i"}),
    "start": ObservationModel(states={"theta_d0": "theta_2_0", "w_d0": "w_1_0"}),
    "steady": ObservationModel(steady=True),
}
# Numbers of states, times, and what walkers have of their own.  Kernels of more than ten states are
# others, and those of forty keep matrices elsewhere.  Kernels do not know gains from offsets or
# starts, and with lags those of many states compile for seconds: these are not repeated.
REPEATED = {5: ("lags",), 20: ("lags", "start", "steady")}
for row, count in enumerate((1, 5, 6, 20)):
    for column, (what, sensing) in enumerate(SENSED.items()):
        if what in REPEATED.get(count, ()):
            continue
        at = ("even", "gaps", "jitter", "two clocks")[(row + column) % 4]
        MAKE[f"{2 * count} states, {at}, {what}"] = functools.partial(
            chain, count, at, sensing=sensing
        )


@functools.cache
def made(name: str) -> Case:
    return MAKE[name]()


# The others enter every branch with few kernels.  A single sample has no step: for rigs of few states,
# which would need a kernel for it, that is slow too.
SLOW = ("chain, straight inputs", "rubs, gaps", "2 states, jitter", "2 states, two", "10 states")
SLOW += ("12 states, jitter, gains", "12 states, even", "40 states")
QUICK = [name for name in MAKE if not name.startswith(SLOW)]
EVERY_CASE = slow_except(QUICK, MAKE)
LINEAR = slow_except(QUICK, (name for name in MAKE if not name.startswith("rubs")))
SHORT = ("even, held voltage", "straight inputs, from before", "2 states", "12 states")
FEW = slow_except(QUICK, (name for name in MAKE if name.startswith(SHORT)))


def far(found: np.ndarray, true: np.ndarray) -> float:
    """The largest error, over the largest number of each channel."""
    return float(np.max(np.abs(found - true) / np.abs(true).max(axis=0)))


@pytest.mark.parametrize("name", LINEAR)
def test_signals_are_those_of_the_oracle(name: str) -> None:
    """Mutants killed: see `mutants.toml`; a lag of the wrong sign, an offset that a gain multiplies."""
    case = made(name)
    for row in (1, 2, 10):
        true = ExactMotion(case.model, case.record, case.full[row], case.sensing).signals()
        assert far(case.signals[row], true) < case.close, row


@pytest.mark.parametrize("name", FEW)
def test_records_of_few_samples_have_the_signals_of_the_oracle(name: str) -> None:
    """Mutant killed: a last step that is taken though it leads nowhere."""
    case = made(name)
    record = case.record
    for n in (1, 2, 3, 8, 65) if name.startswith(("12 states", "2 states, two")) else (2, 3, 8, 65):
        series = {key: u[:n] for key, u in record.series.items()}
        cut = replace(record, t=record.t[:n], y=record.y[:n], series=series)
        true = ExactMotion(case.model, cut, case.full[0], case.sensing).signals()
        assert far(case.of(cut).signals(case.full[:1])[0], true) < case.close, n


@pytest.mark.parametrize("name", LINEAR)
def test_slopes_are_differences_of_the_oracle(name: str) -> None:
    """In 80-bit numbers, differences have nine digits.

    Mutants killed: a lag's slope before the start, a steady start without the angle that is held.
    """
    case, rng, h = made(name), np.random.default_rng(8), 1e-6
    full = case.full[[0, 1]]
    along = full[:, None] * rng.normal(size=(2, 2, full.shape[1]))
    signals, slopes = case.simulator.course(full, along)
    assert signals == pytest.approx(case.signals[[0, 1]], rel=1e-9, abs=1e-9)
    for w, q in ((0, 0), (1, 1)):
        ends = [
            ExactMotion(
                case.model, case.record, full[w] + sign * np.longdouble(h) * along[w, q],
                case.sensing,
            ).signals()
            for sign in (1, -1)
        ]  # fmt: skip
        assert far(slopes[w, q], (ends[0] - ends[1]) / (2 * np.longdouble(h))) < 1e-7


@pytest.mark.parametrize("name", EVERY_CASE)
def test_sums_are_those_of_the_samples(name: str) -> None:
    """Mutants killed: neighbours across a gap that count as none, the first sample taken for the last, a
    channel's weight exchanged, a power of two lost, walkers whose lanes see other samples.
    """
    rig, full, shown = made(name).simulator, made(name).full, made(name).signals
    assert isinstance(rig, Stepped if name.startswith("rubs") else Response)
    y, seen = rig.experiment.y, rig.experiment.is_measured
    left = y - shown
    squares = np.where(seen, left**2, 0.0).sum(axis=1)
    assert rig.squares(full) == pytest.approx(squares, rel=1e-9)
    rng = np.random.default_rng(1)
    for tally in made(name).tallied:
        SUMS[tally](rig, full, left, rng)


def neighbours_are_right(
    rig: Simulator, full: np.ndarray, left: np.ndarray, _: np.random.Generator
) -> None:
    found, seen = rig.neighbours(full), rig.experiment.is_measured
    for k in range(seen.shape[1]):
        own = left[:, seen[:, k], k]
        squares = (own**2).sum(axis=1)
        assert found[:, k, 0] == pytest.approx(squares, rel=1e-9)
        steps = (np.diff(own, axis=1) ** 2).sum(axis=1)
        assert found[:, k, 1] == pytest.approx(steps, abs=1e-9 * squares.max())
        ends = (own[:, [0, -1]] ** 2).sum(axis=1)
        assert found[:, k, 2] == pytest.approx(ends, abs=1e-8 * np.abs(own).max() ** 2)


def logs_are_right(
    rig: Simulator, full: np.ndarray, left: np.ndarray, rng: np.random.Generator
) -> None:
    weights = np.exp(rng.normal(0, 3, (len(full), left.shape[2])))
    left = np.where(rig.experiment.is_measured, left, 0.0)
    logs = np.log1p(weights[:, None] * left**2).sum(axis=1)
    assert rig.logs(full, weights) == pytest.approx(logs, rel=1e-9)


def intervals_are_right(
    rig: Simulator, full: np.ndarray, left: np.ndarray, rng: np.random.Generator
) -> None:
    seen = rig.experiment.is_measured
    over = np.exp(rng.uniform(-1, 4, (len(full), left.shape[2])))
    half = np.exp(rng.uniform(np.log(0.2), 3, over.shape))
    middle, widths = np.where(seen, np.abs(left), 0.0) * over[:, None], half[:, None]
    near, beyond = log_ndtr(widths - middle), log_ndtr(-widths - middle)
    masses = np.where(seen, near + np.log(-np.expm1(beyond - near)), 0.0).sum(axis=1)
    assert rig.intervals(full, over, half) == pytest.approx(masses, rel=1e-8, abs=1e-6)


SUMS = {
    "neighbours": neighbours_are_right,
    "logs": logs_are_right,
    "intervals": intervals_are_right,
}
EVERY_SUM = tuple(SUMS)


def test_logs_of_what_is_far_off_neither_overflow_nor_lose_digits() -> None:
    """10^6 samples would leave the range of numbers, were powers of two not kept apart."""
    case = made("even, held voltage")
    rig = case.simulator.with_record(case.record.y * 1e60)
    weights = np.full((W, 3), 1e-3)
    true = np.log1p(weights[:, None] * (rig.experiment.y - case.signals) ** 2).sum(axis=1)
    assert rig.logs(case.full, weights) == pytest.approx(true, rel=1e-12)
    lost = rig.with_record(np.full_like(case.record.y, 1e120))
    assert np.isnan(lost.logs(case.full, weights)).all()


@pytest.mark.parametrize("name", EVERY_CASE)
def test_normal_equations_are_sums_of_slopes(name: str) -> None:
    """Without what was not seen."""
    case = made(name)
    rig, full, y, seen = case.simulator, case.full[:2], case.record.y, case.record.is_measured
    rng = np.random.default_rng(5)
    along = rng.normal(size=(2, 4, full.shape[1])) * full[:, None, :]
    scales = np.exp(rng.normal(size=(2, y.shape[1])))
    squares, slopes, products = rig.normal(full, along, scales[..., None] ** 2)
    left = np.where(seen, y - case.signals[:2], 0) * scales[:, None]
    shown = np.where(seen, rig.sensitivities(full, along), 0) * scales[:, None, None]
    assert squares == pytest.approx((left**2).sum(axis=1))
    size = np.abs(shown).max() * np.abs(left).max()
    expected = np.einsum("wqtk,wtk->wq", shown, left)
    assert slopes == pytest.approx(expected, rel=1e-6, abs=1e-9 * size)
    assert products == pytest.approx(np.einsum("wqtk,wptk->wqp", shown, shown))


@pytest.mark.parametrize("name", EVERY_CASE)
def test_a_walker_depends_on_no_other_and_pickles_answer_alike(name: str) -> None:
    """Bits, whatever lanes have in common; and numbers that overflow are NaN in their own row alone.

    Mutant killed: the degree of a series that the lanes share.
    """
    case = made(name)
    rig, full, before = case.simulator, case.full, case.full.copy()
    sums = rig.squares(full)
    alone = [rig.squares(full[w : w + 1])[0] for w in range(W)]
    assert np.array_equal(alone, sums)
    assert np.array_equal(rig.signals(full[3:4])[0], case.signals[3])
    sick, wild, weights = full.copy(), full.copy(), np.ones_like(sums)
    sick[4, : len(case.model.parameters)] = np.nan
    wild[4, 0] = 1e-300  # an inertia
    assert not np.isfinite(rig.squares(wild)[4]).all()
    healthy = np.delete(np.arange(W), 4)
    assert np.array_equal(rig.squares(wild)[healthy], sums[healthy])
    sick_sums = {
        "squares": lambda at: rig.squares(at),
        "neighbours": lambda at: rig.neighbours(at)[..., 0],
        "logs": lambda at: rig.logs(at, weights),
        "intervals": lambda at: rig.intervals(at, weights, weights),
    }
    for found, true in (
        (sick_sums[n](sick), sick_sums[n](full)) for n in ("squares", *case.tallied)
    ):
        assert np.array_equal(found[healthy], true[healthy])
        assert np.isnan(found[4]).all()
    assert np.array_equal(pickle.loads(pickle.dumps(rig)).squares(full), sums)
    assert np.array_equal(full, before)


def test_lanes_of_very_different_sizes_do_not_affect_each_other() -> None:
    """Walkers over decades, some not shifted, so that lanes halve cells as often as each needs."""
    case, rng = made("gap, all sensors"), np.random.default_rng(10)
    full = np.repeat(case.full[:1], 64, axis=0)
    full[:, :9] *= np.exp(rng.normal(0, 1.5, (64, 9)))
    full[::3, case.simulator.parameters.index("lag_alpha")] = 0.0
    together = case.simulator.signals(full)
    alone = [case.simulator.signals(full[w : w + 1])[0] for w in range(64)]
    assert np.array_equal(alone, together)


def test_a_long_record_is_that_of_80_bit_numbers() -> None:
    even = made("even, held voltage")
    n = 3001
    series = {"v": np.random.default_rng(7).normal(6, 1, n)}
    record = replace(even.record, t=2.5 + STEP * np.arange(n), y=np.zeros((n, 3)), series=series)
    response = even.of(record)
    long = LongRecord(response.sensors, record.dt, n)
    for full in even.full[[0, 5]]:
        true = np.concatenate([shown for _, shown in long.responses(full)])
        assert far(response.signals(full[None])[0], true) < 1e-11
