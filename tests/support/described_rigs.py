"""Drive trains that configs describe: their configs, their equations typed anew, and records of them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.integrate
from support.command_line import CONFIGS
from support.config_texts import save

ROTARY = (CONFIGS / "arm.yaml").read_text(encoding="utf-8")
LINEAR = (CONFIGS / "carts.yaml").read_text(encoding="utf-8")

T = np.arange(120) * 0.01
CURRENT = np.where(np.arange(120) // 30 % 2, -0.4, 0.8)  # A
FORCE = np.where(np.arange(120) // 40 % 2, 1.5, -0.7)  # N


def arm_rates(t: float, x: np.ndarray, p: dict[str, float], i: float) -> list[float]:
    """Rates of x = (theta_arm, w_arm, theta_load, w_load); the motor turns 8 times as fast."""
    twist = p["k_coupling"] * (x[0] - x[2])
    inertia = 8**2 * p["j_motor"] + 1e-3
    return [
        x[1],
        (8 * 0.12 * i - twist) / inertia,
        x[3],
        (twist - p["c_load"] * x[3]) / p["j_load"],
    ]


def cart_rates(t: float, x: np.ndarray, p: dict[str, float], f: float) -> list[float]:
    """Rates of x = (x_first, v_first, x_second, v_second)."""
    spring = p["k_spring"] * (x[0] - x[2])
    first = (f - spring - p["c_first"] * x[1]) / p["m_first"]
    return [x[1], first, x[3], (spring - p["k_wall"] * x[2]) / 1.2]


def integrated(
    rates: Callable[..., list[float]], p: dict[str, float], u: np.ndarray, x: list[float]
) -> np.ndarray:
    """Integrate states `(T, 4)` from `x` under inputs that are held from sample to sample."""
    states = [np.array(x)]
    for value in u[:-1]:
        step = scipy.integrate.solve_ivp(
            rates, (0, 0.01), states[-1], args=(p, value), rtol=1e-11, atol=1e-13
        )
        states.append(step.y[:, -1])
    return np.array(states)


def log_density(y: np.ndarray, model: np.ndarray, sigma: float) -> float:
    """Return the log density of white Gaussian noise about a model."""
    return float(np.sum(-0.5 * ((y - model) / sigma) ** 2 - np.log(sigma * np.sqrt(2 * np.pi))))


def save_records(folder: Path) -> dict[str, np.ndarray]:
    """Save records that no rig has made: the density must be right wherever the model is wrong."""
    rng = np.random.default_rng(5)
    noise = {name: rng.normal(size=len(T)) for name in ("w", "twist", "motor", "x", "v")}
    y = {
        "w": 30 + 20 * np.sin(3 * T) + noise["w"],
        "twist": 10 * np.cos(9 * T) + noise["twist"],
        "motor": T**2 + 0.05 * noise["motor"],
        "x": 4 * np.sin(12 * T) + noise["x"],
        "v": 40 * np.cos(12 * T) + noise["v"],
    }
    save(folder, "arm.csv", t=T, w=y["w"], twist=y["twist"], motor=y["motor"], i=1e3 * CURRENT)
    save(folder, "carts.csv", t=1e3 * T, x=y["x"], v=y["v"], f=1e3 * FORCE)
    return y
