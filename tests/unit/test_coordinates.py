"""Round trips and Jacobians of all coordinates."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.integrate
from oracles import NOMINAL, ORDER
from rigs import vector

from bayesdrill.coordinates import COORDINATES, Coordinates, choose
from bayesdrill.formulas import Monomial
from bayesdrill.models.motor_shaft import MotorShaft
from bayesdrill.priors import HalfNormal, LogNormal, Prior, TruncatedNormal, Uniform

CHART = MotorShaft().chart(8.0, ORDER, {})
N_EXTRA = 2  # unknowns beyond the nine, such as noise levels


def make(name: str) -> Coordinates:
    return choose(name, CHART, 9)


def points(n: int = 40, width: float = 0.9) -> np.ndarray:
    """Far apart: friction ratios beyond one half among them."""
    rng = np.random.default_rng(4)
    centre = np.append(vector(NOMINAL), [0.1, 0.3])
    factors = np.exp(rng.uniform(-width, width, (n, 11)))
    factors[: n // 2, 8] *= 40.0
    return centre * factors


@pytest.mark.parametrize("name", COORDINATES)
def test_there_and_back(name: str) -> None:
    coordinates = make(name)
    theta = points()
    assert np.allclose(coordinates.to_physical(coordinates.from_physical(theta)), theta, rtol=1e-12)


@pytest.mark.parametrize("name", COORDINATES)
def test_jacobian_equals_a_numerical_determinant(name: str) -> None:
    """Mutant killed: the Jacobian dropped, or a chart that does not keep volume."""
    coordinates = make(name)
    theta = points(12)
    for row in theta:
        z = coordinates.from_physical(row[None])[0]
        h = 1e-6 * np.maximum(np.abs(z), 1e-3)
        up = coordinates.to_physical(z + np.diag(h))
        down = coordinates.to_physical(z - np.diag(h))
        columns = (up - down) / (2 * h[:, None]) / row  # d log theta / dz: well scaled
        _, log_det = np.linalg.slogdet(columns)
        true = log_det + np.log(row).sum()
        assert coordinates.with_jacobian(z[None])[1][0] == pytest.approx(true, abs=1e-4)


@pytest.mark.parametrize("name", ["physical", "log"])
@pytest.mark.parametrize(
    "prior", [Uniform(0.2, 0.9), TruncatedNormal(0.3, 0.4), LogNormal(0.5, 0.6), HalfNormal(0.8)]
)
def test_prior_times_jacobian_integrates_to_one(name: str, prior: Prior) -> None:
    coordinates = make(name)

    def density(z: float) -> float:
        theta, log_jacobian = coordinates.with_jacobian(np.array([[z]]))
        if theta[0, 0] <= 0:
            return 0.0
        log_p = prior.logpdf(theta[:, 0]) + log_jacobian
        return float(np.exp(log_p[0]))

    edges = [z for end in (0.2, 0.9) for z in (end, np.log(end))]
    total, _ = scipy.integrate.quad(density, -30, 8, points=sorted(edges), limit=500)
    assert total == pytest.approx(1.0, abs=1e-5)


def test_modal_coordinates_are_what_they_are_called() -> None:
    """The steady speed from the two balances, rates from their definitions."""
    p = NOMINAL
    z = dict(zip(CHART.labels, make("modal").from_physical(vector(p)[None])[0], strict=True))
    speed = np.exp(z["log speed"])
    current = (p["t_f"] + p["c_m"] * speed) / p["k_T"]
    assert p["k_e"] * speed + p["r_m"] * current == pytest.approx(8.0, rel=1e-12)
    d = p["c_m"] + p["k_e"] * p["k_T"] / p["r_m"]
    assert np.exp(z["log rotor"]) == pytest.approx(p["k_s"] / p["j_1"])
    assert np.exp(z["log shaft"]) == pytest.approx(p["k_s"] / 64 / d)
    assert np.exp(z["log inertia"]) == pytest.approx(p["j_m"] / d)
    assert np.exp(z["log electrical"]) == pytest.approx(p["l_m"] / p["r_m"])
    for name in ("c_m", "t_f", "j_1", "r_m"):
        assert np.exp(z[f"log {name}"]) == pytest.approx(p[name])


@pytest.mark.parametrize("size", range(1, 10))
def test_charts_of_all_sets_of_free_parameters(size: int) -> None:
    """511 sets: there and back, and the closed-form Jacobian against a numerical determinant.

    Half of the points have friction above half of the stall torque, where the speed is continued.
    Mutant killed: the slope of one equation forgotten.
    """
    rng = np.random.default_rng(size)
    for free in itertools.combinations(ORDER, size):
        fixed = {name: NOMINAL[name] for name in ORDER if name not in free}
        chart = MotorShaft().chart(8.0, free, fixed)
        logs = np.log([NOMINAL[name] for name in free]) + rng.uniform(-1.5, 1.5, (6, size))
        if "t_f" in free:
            logs[:3, free.index("t_f")] += 3.0
        z = chart.straighten(logs)
        back, log_dets = chart.bend(z)
        assert np.allclose(back, logs, atol=1e-8), free
        step = 1e-6 * np.eye(size)
        for row, log_det in zip(logs, log_dets, strict=True):
            columns = (chart.straighten(row + step) - chart.straighten(row - step)) / 2e-6
            assert np.linalg.slogdet(columns)[1] == pytest.approx(-log_det, abs=1e-4), free


def test_charts_take_the_rates_of_the_record_wherever_they_can() -> None:
    chart = MotorShaft().chart(
        8.0, ("c_m", "k_e"), {n: NOMINAL[n] for n in ORDER if n not in ("c_m", "k_e")}
    )
    assert chart.coordinates == ("speed", "c_m")
    assert CHART.coordinates[:5] == ("speed", "rotor", "shaft", "inertia", "electrical")


def test_coordinates_of_no_positive_parameters_are_nan_not_an_error() -> None:
    z = make("modal").from_physical(vector(NOMINAL)[None].repeat(2, axis=0))
    z[1, CHART.coordinates.index("c_m")] += 30.0
    theta = make("modal").to_physical(z)
    assert np.isfinite(theta[0]).all()
    assert np.isnan(theta[1]).any()


def test_automatic_choice_falls_back_on_logs() -> None:
    assert type(choose("auto", CHART, 9)).__name__ == "Modal"
    assert type(choose("auto", None, 9)).__name__ == "Log"


def relations(*names: str) -> dict[str, Monomial]:
    every = {
        "k_T": Monomial(1.0, {"k_e": 1.0}),
        "k_s": Monomial(np.pi / 32, {"G": 1.0, "d": 4.0, "L": -1.0}),
        "l_m": Monomial(3.0, {"r_m": 1.0, "rho": 0.5}),  # a name that the chart uses itself
        "j_1": Monomial(70.0, {"j_m": 1.0}),
    }
    return {name: every[name] for name in names}


QUANTITIES = {"G": 79.3e9, "d": 3e-3, "L": 2.4, "rho": 1.3}


@pytest.mark.parametrize(
    "related",
    [
        ("k_T",),
        ("k_s",),
        ("k_T", "k_s"),
        ("k_T", "l_m"),
        ("j_1", "k_s"),
        ("k_T", "k_s", "j_1", "l_m"),
    ],
)
def test_charts_with_ties(related: tuple[str, ...]) -> None:
    """60 sets each of what else is free: round trips, and the Jacobian against a determinant.

    Mutant killed: the equation of a tie solved without its share in the Jacobian, or left out.
    """
    rng = np.random.default_rng(len(related))
    given = relations(*related)
    inside = [name for name in QUANTITIES if any(name in r.powers for r in given.values())]
    every = [name for name in (*ORDER, *inside) if name not in related]
    values = {**NOMINAL, **QUANTITIES}
    for trial in range(60):
        held = set() if trial == 0 else {name for name in every if rng.random() < 0.4}
        free = tuple(name for name in every if name not in held)
        if not free:
            continue
        m = len(free)
        chart = MotorShaft().chart(8.0, free, {name: values[name] for name in held}, given)
        logs = np.log([values[name] for name in free]) + rng.uniform(-1.0, 1.0, (4, m))
        z = chart.straighten(logs)
        back, log_dets = chart.bend(z)
        assert np.allclose(back, logs, atol=1e-7), free
        step = 1e-6 * np.eye(m)
        for row, log_det in zip(logs, log_dets, strict=True):
            columns = (chart.straighten(row + step) - chart.straighten(row - step)) / 2e-6
            assert np.linalg.slogdet(columns)[1] == pytest.approx(-log_det, abs=1e-4), free


def test_ties_cost_no_rate_of_the_record() -> None:
    """With k_T tied all five are coordinates still, the shaft's stiffness from geometry or not."""
    for related in (("k_T",), ("k_s",), ("k_T", "k_s")):
        given = relations(*related)
        quantities = ("G", "d") if "k_s" in given else ()
        free = (*(name for name in ORDER if name not in given), *quantities)
        chart = MotorShaft().chart(8.0, free, {"L": 2.4}, given)
        assert chart.coordinates[:5] == ("speed", "rotor", "shaft", "inertia", "electrical")
        p = {**NOMINAL, **QUANTITIES}
        p |= {
            name: r.factor * np.prod([p[n] ** power for n, power in r.powers.items()])
            for name, r in given.items()
        }
        z = chart.straighten(np.log([[p[name] for name in free]]))[0]
        assert np.exp(z[1]) == pytest.approx(p["k_s"] / p["j_1"])
        d = p["c_m"] + p["k_e"] * p["k_T"] / p["r_m"]
        assert np.exp(z[3]) == pytest.approx(p["j_m"] / d)
