"""Rigs that rub, in steps: against the oracle of `rubbing`, and laws that no step may break."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from oracles import NOMINAL
from rigs import experiment, vector
from rubbing import RUBS
from rubbing_cases import CASES, Case, moved, moved_of
from stepping import experiment_of, model_of, parameters, states, stepped
from together import for_each

from bayesdrill.rig.models.friction import Friction
from bayesdrill.rig.models.linear import Linear, WrappedModel
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

W_1, W_2 = 2, 3
QUICK = ("stick slip", "falling", "sine", "other")
LONG = tuple(name for name in CASES if name not in QUICK)
GROUPS = [
    pytest.param(QUICK, id="quick"),
    pytest.param(LONG, id="long", marks=pytest.mark.slow),
]


def off(name: str, pieces: int) -> np.ndarray:
    """The largest distance from the oracle `(5,)`."""
    return np.asarray(np.abs(states(CASES[name], pieces) - moved(name).states).max(axis=0))


def test_a_step_to_a_sample_is_enough_for_friction_of_a_constant_size() -> None:
    """Of a noise of 0.1 rad/s; mutant killed: friction of one sign in a step in which it changes."""
    assert off("sine", 1)[W_1] < 5e-4
    assert off("reversing", 1)[W_1] < 2e-4


@dataclass(frozen=True)
class Fading:
    """A law with all that a law needs, and no more."""

    parameters = ("t_c1", "w_s1")
    seen = ()
    steady = False

    def size(self, p: Any, speed: Any, seen: Any) -> Any:
        return p["t_c1"] / (1.0 + speed / p["w_s1"])


@dataclass(frozen=True)
class Braked(WrappedModel):
    parameters = (*MotorShaft.parameters, "t_c1", "w_s1")
    frictions = (Friction(name="brake", against="w_1", law=Fading(), holds="theta_1"),)

    def linear(self, p: Any) -> Linear:
        plain = self.rig.linear(p)
        return replace(plain, B={**plain.B, ("w_1", "brake"): -1.0 / p["j_1"]})


def test_a_law_need_not_say_what_its_size_comes_down_to() -> None:
    """There were several steps to a sample only where it did."""
    one = experiment(80, 0.01, constant={"t_1": 0.0}, series={"v": 6.0 * np.sin(np.arange(80) / 9)})
    full = np.array([[*vector(NOMINAL), 0.2, 3.0]])
    rigs = [Stepped(Braked(MotorShaft()), one, ObservationModel(), pieces) for pieces in (2, 4, 32)]
    half, quarter, fine = (rig.signals(full)[0] for rig in rigs)
    assert np.abs(quarter - fine).max() < 0.5 * np.abs(half - fine).max() < 1e-2


def test_a_step_that_turns_is_made_in_parts() -> None:
    """Each driven by what is there then; mutants killed: no parts, or one drive for all."""
    truth, rig = moved("straight").states, stepped(CASES["straight"])
    full = parameters(CASES["straight"])
    whole, parts = (
        np.abs(rig.with_substeps(1, turns).signals(full)[0] - truth).max(axis=0)[W_1]
        for turns in (1, REVERSAL_SUBSTEPS)
    )
    assert parts < 1e-4
    assert parts < 0.3 * whole


def test_friction_that_falls_with_the_speed_is_of_second_order() -> None:
    """Mutants killed: its size at the start of a step, or at the end."""
    for pieces, limit in ((1, 2e-2), (2, 4e-3), (4, 1e-3), (8, 3e-4)):
        assert off("falling", pieces)[W_1] < limit


@pytest.mark.parametrize("names", GROUPS)
def test_shorter_steps_come_to_the_oracle(names: tuple[str, ...]) -> None:
    """128 times shorter: by more than first order, whatever happens in a step."""

    def check(name: str) -> None:
        largest = np.abs(moved(name).states).max(axis=0)
        coarse, fine = off(name, 1) / largest, off(name, 128) / largest
        assert coarse.max() < 5e-2
        assert fine.max() < 2e-5
        assert fine.max() < coarse.max() / 128**1.5

    for_each({name: (name,) for name in names}, check)


@pytest.mark.parametrize("names", GROUPS)
def test_efforts_are_what_the_oracle_has_in_a_step(names: tuple[str, ...]) -> None:
    """Its mean over a step: the same where nothing happens in it."""

    def check(name: str) -> None:
        true, case = moved(name), CASES[name]
        motion = stepped(case, 16, record=experiment_of(case)).motion(parameters(case))
        found = motion.efforts[0]
        which = [RUBS.index(friction.name) for friction in model_of(case).frictions]
        assert which == [k for k in range(3) if case.rig.rubs[k]]
        step = case.t[1] - case.t[0]
        mean = np.diff(true.impulses[:, which], axis=0) / step
        size = np.abs(true.efforts[:, which]).max(axis=0)
        near = np.abs(found[:-1] - mean) / size
        assert np.quantile(near, 0.9, axis=0).max() < 0.03
        assert np.abs(found).max(axis=0) == pytest.approx(size, rel=0.05)
        # Strides from sample to sample are exact, where steps are nearly so.
        assert motion.states[0] == pytest.approx(states(case, 16), abs=3e-7)

    for_each({name: (name,) for name in names}, check)


@pytest.mark.parametrize("names", GROUPS)
def test_what_sticks_does_not_move_at_all(names: tuple[str, ...]) -> None:
    """Mutants killed: a speed that is stopped to rounding only, an angle that creeps."""

    def check(name: str, pieces: int) -> None:
        true, found = moved(name), states(CASES[name], pieces)
        for k, (angle, speed) in ((0, (1, W_2)), (1, (0, W_1))):
            held = true.stuck[:, k]
            # So long that steps cannot be in doubt of it.
            inside = np.flatnonzero(held[:-2] & held[1:-1] & held[2:]) + 1
            still = inside[found[inside, speed] == 0.0]
            assert len(still) >= 0.9 * len(inside)
            both = still[np.isin(still + 1, still)]
            assert (found[both + 1, angle] == found[both, angle]).all()
        drop = true.stuck[:-1, 2] & true.stuck[1:, 2]
        assert (found[1:, 4][drop] == 0.0).mean() > 0.9 if drop.any() else True

    for_each({f"{name}, {n} pieces": (name, n) for name in names for n in (1, 4)}, check)


def taken(case: Case, every: int) -> tuple[float, float, float]:
    """Energies of motion in steps of a sample, which is a `every`-th of the case's: supplied less turned
    into heat and less stored, over all supplied; and work of the frictions, here and in the oracle.
    """
    t = np.linspace(case.t[0], case.t[-1], every * (len(case.t) - 1) + 1)
    held = np.minimum(np.arange(len(t)) // every, len(case.t) - 1)
    v = np.interp(t, case.t, case.v) if case.first_order else case.v[held]
    record = experiment_of(case)
    series = {"v": v}
    if "t_1" in record.series:
        series["t_1"] = np.interp(t, case.t, case.t_1)
    fine = replace(record, t=t, y=np.zeros((len(t), 5)), series=series)
    motion = stepped(case, 1, record=fine).motion(parameters(case))
    true = moved_of(case)
    here = replace(true, states=motion.states[0])
    x, efforts, step = here.states, motion.efforts[0], t[1] - t[0]
    w_3 = x[:, W_2] / case.rig.i_m
    p, get = case.rig.p, case.rig.get
    rates = {
        "heat": (p["r_m"] + get("r_s")) * x[:, 4] ** 2 + p["c_m"] * w_3**2,
        "viscous": get("c_1") * x[:, 2] ** 2 + get("c_s") * (x[:, 2] - x[:, 3]) ** 2,
        "else": get("t_f") * w_3 + (p["k_e"] - p["k_T"]) * x[:, 4] * w_3,
    }
    spent = sum(0.5 * step * (one[1:] + one[:-1]).sum() for one in rates.values())
    load = series.get("t_1", np.full(len(t), float(np.ravel(case.t_1)[0])))
    i, w_1 = x[:, 4], x[:, 2]
    if case.first_order:
        supplied = 0.5 * step * ((v * i)[1:] + (v * i)[:-1]).sum()
        spent += 0.5 * step * ((load * w_1)[1:] + (load * w_1)[:-1]).sum()
    else:
        supplied = 0.5 * step * (v[:-1] * (i[1:] + i[:-1])).sum()
        spent += 0.5 * step * (load[:-1] * (w_1[1:] + w_1[:-1])).sum()
    names = [friction.name for friction in model_of(case).frictions]
    over = {"friction_m": x[:, 1] / case.rig.i_m, "friction_1": x[:, 0]}
    work = 0.0
    for k, name in enumerate(names):
        way = np.diff(over[name]) if name in over else 0.5 * step * (i[1:] + i[:-1])
        work += float((efforts[:-1, k] * way).sum())
    kept = sum(float(part[-1] - part[0]) for part in here.stored.values())
    scale = float(np.abs(true.taken["supply"]).max())
    return (supplied - spent - work - kept) / scale, work, float(true.taken["friction"][-1])


@pytest.mark.parametrize(
    ("name", "every"),
    [
        ("reversing", 16),
        pytest.param("static", 16, marks=pytest.mark.slow),
        pytest.param("other", 32, marks=pytest.mark.slow),
    ],
)
def test_energies_close(name: str, every: int) -> None:
    """What is supplied is stored, or turned into heat, or taken by friction: as much as the oracle's."""
    left, work, true = taken(CASES[name], every)
    coarse, _, _ = taken(CASES[name], every // 4)
    assert abs(left) < 2e-4
    assert abs(left) < max(0.2 * abs(coarse), 2e-6)
    assert work == pytest.approx(true, rel=1e-3)
    assert work > 0


def test_frictions_of_no_size_leave_the_linear_rig() -> None:
    """To rounding, at any pieces, and for walkers that differ."""
    case = CASES["other"]
    nothing = {"eta": 1.0, "v_d": 0.0, "t_cm": 0.0, "t_sm": 0.0, "t_c1": 0.0, "t_s1": 0.0}
    nothing |= {"c_s": 0.0, "j_2": 0.0, "r_s": 0.0, "c_1": 0.0}
    model, record = model_of(case), experiment_of(case)
    rig = replace(case.rig, p={**case.rig.p, **nothing})
    full = np.array([[rig.p[name] for name in model.parameters]]).repeat(3, axis=0)
    full[:, :8] *= np.random.default_rng(2).uniform(0.8, 1.2, (3, 8))
    true = Response(MotorShaft(i_m=case.rig.i_m), record).signals(full[:, :9])
    for pieces in (1, 3):
        found = Stepped(model, record, ObservationModel(), pieces).signals(full)
        assert found == pytest.approx(true, rel=1e-9, abs=1e-9)


def test_a_stride_is_as_long_as_the_way_to_the_next_sample() -> None:
    """A record with gaps, in which inputs stay what they are."""

    def check(name: str) -> None:
        case, rng = CASES[name], np.random.default_rng(8)
        record = experiment_of(case)
        same = np.append(np.diff(case.v) == 0.0, False)
        kept = ~(np.roll(same, 1) & (rng.uniform(size=len(case.t)) < 0.2))
        kept[0] = True
        fewer = replace(
            record, t=record.t[kept], y=record.y[kept], series={"v": record.series["v"][kept]}
        )
        found = stepped(case, 8, record=fewer).signals(parameters(case))[0]
        assert 20 < np.count_nonzero(~kept) < 0.3 * len(kept)
        assert found == pytest.approx(states(case, 8)[kept], abs=3e-7)

    for_each({name: (name,) for name in ["falling", "stick slip"]}, check)


def test_a_linear_rig_keeps_its_kernels() -> None:
    record = experiment(50)
    assert isinstance(simulator(MotorShaft(), record, ObservationModel()), Response)
    rubbing = simulator(MotorShaft(added=("t_c1",)), record, ObservationModel())
    assert isinstance(rubbing, Stepped)


def walkers(name: str, n: int) -> np.ndarray:
    """Parameters about those of a case, `(n, P)`."""
    rng = np.random.default_rng(6)
    full = parameters(CASES[name]).repeat(n, axis=0)
    eta = [k for k, one in enumerate(model_of(CASES[name]).parameters) if one == "eta"]
    spread = np.exp(rng.normal(0, 0.3, full.shape))
    spread[:, eta] = 1.0
    return np.asarray(full * spread)


def test_a_walker_does_not_depend_on_its_neighbours() -> None:
    """Bits, though lanes in which nothing turns go the short way; and one that overflows harms none."""

    def check(name: str) -> None:
        case = CASES[name]
        record = experiment_of(case)
        y = np.random.default_rng(3).normal(size=record.y.shape)
        rig = stepped(case, 2, record=replace(record, y=y))
        full = walkers(name, 19)
        together, sums = rig.signals(full), rig.squares(full)
        alone = np.concatenate([rig.signals(one[None]) for one in full])
        assert np.array_equal(together, alone)
        assert sums == pytest.approx(((y - together) ** 2).sum(axis=1), rel=1e-10)
        sick = full.copy()
        sick[4, 7], sick[11, 5] = 1e-300, np.nan  # j_1 and l_m
        healthy = np.delete(np.arange(19), [4, 11])
        assert np.array_equal(rig.squares(sick)[healthy], sums[healthy])
        assert not np.isfinite(rig.squares(sick)[[4, 11]]).any()

    for_each({name: (name,) for name in ["static", "other"]}, check)


def test_the_way_of_the_signs_is_nobodys_preference() -> None:
    """Mutant killed: friction that holds one way only. All that turns the other way turns so."""
    case = CASES["static"]
    record = experiment_of(case)
    mirror = replace(record, series={"v": -record.series["v"]})
    found = stepped(case, 1, record=record).motion(parameters(case))
    other = stepped(case, 1, record=mirror).motion(parameters(case))
    assert np.array_equal(found.states, -other.states)
    assert np.array_equal(found.efforts, -other.efforts)


def test_friction_of_a_constant_sign_is_that_of_a_rig_that_turns_one_way() -> None:
    """t_cm of a motor that never stops is t_f."""
    record = experiment(400, 0.01, constant={"v": 8.0, "t_1": 0.1}, start={"w_2": 1.0, "w_1": 1.0})
    theta = vector({**CASES["sine"].rig.p, "t_f": 0.1})
    true = Response(MotorShaft(), record).signals(theta[None])[0]
    rig = Stepped(MotorShaft(added=("t_cm",)), record, ObservationModel(), 1)
    without = np.append(theta[:8], [0.0, 0.1])
    found = rig.signals(without[None])[0]
    assert true[:, W_2].min() > 0
    assert found == pytest.approx(true, rel=1e-9, abs=1e-9)
