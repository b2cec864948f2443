"""Round trips and Jacobians of all coordinates."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate
from oracles import NOMINAL
from rigs import vector

from bayesdrill.coordinates import COORDINATES, Coordinates, choose
from bayesdrill.models.motor_shaft import MotorShaft
from bayesdrill.priors import HalfNormal, LogNormal, Prior, TruncatedNormal, Uniform

CHART = MotorShaft().chart(8.0)
N_EXTRA = 2  # unknowns beyond the nine, such as noise levels


def make(name: str) -> Coordinates:
    return choose(name, CHART, 9, 9)


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
        assert coordinates.log_jacobian(row[None])[0] == pytest.approx(true, abs=1e-4)


@pytest.mark.parametrize("name", ["physical", "log"])
@pytest.mark.parametrize(
    "prior", [Uniform(0.2, 0.9), TruncatedNormal(0.3, 0.4), LogNormal(0.5, 0.6), HalfNormal(0.8)]
)
def test_prior_times_jacobian_integrates_to_one(name: str, prior: Prior) -> None:
    coordinates = make(name)

    def density(z: float) -> float:
        theta = coordinates.to_physical(np.array([[z]]))
        if theta[0, 0] <= 0:
            return 0.0
        log_p = prior.logpdf(theta[:, 0]) + coordinates.log_jacobian(theta)
        return float(np.exp(log_p[0]))

    edges = [z for end in (0.2, 0.9) for z in (end, np.log(end))]
    total, _ = scipy.integrate.quad(density, -30, 8, points=sorted(edges), limit=500)
    assert total == pytest.approx(1.0, abs=1e-5)


def test_modal_coordinates_are_what_they_are_called() -> None:
    p = NOMINAL
    z = dict(zip(CHART.labels, make("modal").from_physical(vector(p)[None])[0], strict=True))
    rho = p["r_m"] / p["k_T"]
    d = p["c_m"] + p["k_e"] / rho
    current = (p["t_f"] + p["c_m"] * np.exp(z["log w3"])) / p["k_T"]
    assert p["k_e"] * np.exp(z["log w3"]) + p["r_m"] * current == pytest.approx(8.0, rel=1e-12)
    assert np.exp(z["log k_s/j_1"]) == pytest.approx(p["k_s"] / p["j_1"])
    assert np.exp(z["log i_m^2 k_s/d"]) == pytest.approx(p["k_s"] / 64 / d)
    assert np.exp(z["log j_m/d"]) == pytest.approx(p["j_m"] / d)
    assert np.exp(z["log l_m/r_m"]) == pytest.approx(p["l_m"] / p["r_m"])
    assert np.exp(z["log u6"]) == pytest.approx(rho * p["t_f"] / 8.0)
    assert np.exp(z["log u7"]) == pytest.approx(rho * p["c_m"] / p["k_e"])
    assert np.exp(z["log j_1"]) == pytest.approx(p["j_1"])
    assert np.exp(z["log r_m"]) == pytest.approx(p["r_m"])


def test_automatic_choice_falls_back_on_logs() -> None:
    assert type(choose("auto", CHART, 9, 9)).__name__ == "Modal"
    assert type(choose("auto", CHART, 9, 7)).__name__ == "Log"
    assert type(choose("auto", None, 9, 9)).__name__ == "Log"
