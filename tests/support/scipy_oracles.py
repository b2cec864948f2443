"""Responses of the paper's rig by SciPy and plain loops, without any of the package's own."""

import numpy as np
import scipy.integrate
import scipy.linalg

NOMINAL = {
    "j_m": 4.0e-4,
    "c_m": 19.0e-5,
    "k_e": 601.6e-4,
    "k_T": 1.2e-1,
    "r_m": 3.3e-1,
    "l_m": 1.1e-3,
    "k_s": 2.6e-1,
    "j_1": 28.3e-3,
    "t_f": 1.0e-1,
}
ORDER = ("j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "k_s", "j_1", "t_f")

# Unequal factors, so that no two parameters can be exchanged unnoticed.
SKEWED = dict(zip(ORDER, (1.31, 0.62, 1.07, 0.83, 1.42, 0.71, 1.19, 0.94, 0.57), strict=True))


def skewed() -> dict[str, float]:
    return {name: NOMINAL[name] * SKEWED[name] for name in ORDER}


def matrices(p: dict[str, float], i_m: float = 1 / 8) -> tuple[np.ndarray, ...]:
    """Return A (5, 5), columns of B for v and t_1, and the constant, from the equations of motion.

    States theta_1, theta_2, w_1, w_2, i.  j_1 w_1' + k_s (theta_1 - theta_2) = -t_1;
    j_m w_2' - i_m^2 k_s (theta_1 - theta_2) - i_m k_T i + c_m w_2 = -i_m t_f;
    l_m i' + r_m i + k_e w_2 / i_m = v.
    """
    k, j1, jm = p["k_s"], p["j_1"], p["j_m"]
    a = np.array(
        [
            [0, 0, 1, 0, 0],
            [0, 0, 0, 1, 0],
            [-k / j1, k / j1, 0, 0, 0],
            [i_m**2 * k / jm, -(i_m**2) * k / jm, 0, -p["c_m"] / jm, i_m * p["k_T"] / jm],
            [0, 0, 0, -p["k_e"] / i_m / p["l_m"], -p["r_m"] / p["l_m"]],
        ]
    )
    v = np.array([0, 0, 0, 0, 1 / p["l_m"]])
    t_1 = np.array([0, 0, -1 / j1, 0, 0])
    friction = np.array([0, 0, 0, -i_m * p["t_f"] / jm, 0])
    return a, v, t_1, friction


def by_expm(p: dict[str, float], t: np.ndarray, x0: np.ndarray, v: float, t_1: float) -> np.ndarray:
    """Return states (T, 5) by a matrix exponential for each sample."""
    a, b_v, b_t, c = matrices(p)
    augmented = np.zeros((6, 6))
    augmented[:5, :5] = a
    augmented[:5, 5] = b_v * v + b_t * t_1 + c
    start = np.append(x0, 1.0)
    return np.array([(scipy.linalg.expm(augmented * s) @ start)[:5] for s in t])
