"""Oracles of a missing torque: covariances and a filter by matrices of all samples, with SciPy alone."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from support.scipy_oracles import matrices

Array = NDArray[np.float64]


Process = tuple[Array, Array, Array]  # F, the intensity of the noise, the covariance at the start


def process(p: dict[str, float], at: str, smoothness: str, size: float, time: float) -> Process:
    """Of theta_1, theta_2, w_1, w_2, i and the torque in N m (with its rate): typed in from its
    meaning.
    """
    own = {"1/2": 1, "3/2": 2}[smoothness]
    n = 5 + own
    f, noise, start = (np.zeros((n, n)) for _ in range(3))
    f[:5, :5] = matrices(p)[0]
    row, push = {"motor": (3, 1 / 8 / p["j_m"]), "rotor_1": (2, 1 / p["j_1"])}[at]
    f[row, 5] = push
    if own == 1:  # d' = -d/tau + white noise
        f[5, 5], noise[5, 5], start[5, 5] = -1 / time, 2 * size**2 / time, size**2
    else:  # d'' = -a^2 d - 2 a d' + white noise, a = sqrt(3)/tau
        a = np.sqrt(3) / time
        f[5, 6], f[6, 5], f[6, 6] = 1.0, -(a**2), -2 * a
        noise[6, 6], start[5, 5], start[6, 6] = 4 * a**3 * size**2, size**2, (a * size) ** 2
    return f, noise, start


def step(matrix: Array, noise: Array, span: float) -> tuple[Array, Array]:
    """Transition and covariance over `span`, by Van Loan's exponential, in pieces that it is good
    for.
    """
    n = len(matrix)
    pieces = max(1, int(np.ceil(np.abs(matrix).sum(axis=1).max() * span)))
    both = np.zeros((2 * n, 2 * n))
    both[:n, :n], both[:n, n:], both[n:, n:] = -matrix, noise, matrix.T
    found = expm(both * span / pieces)
    small = found[n:, n:].T
    phi, q = np.eye(n), np.zeros((n, n))
    one = small @ found[:n, n:]
    for _ in range(pieces):
        phi, q = small @ phi, small @ q @ small.T + 0.5 * (one + one.T)
    return phi, q


def covariance(of: Process, weights: Array, sigmas: Array, t: Array, t_start: float) -> Array:
    """Of all samples of all channels, `(T K, T K)`; `weights (K, n)`."""
    matrix, noise, p = of
    if t[0] > t_start:
        phi, q = step(matrix, noise, t[0] - t_start)
        p = phi @ p @ phi.T + q
    k = len(weights)
    out = np.zeros((len(t) * k, len(t) * k))
    states = [p]
    steps = [step(matrix, noise, span) for span in np.diff(t)]
    for phi, q in steps:
        states.append(phi @ states[-1] @ phi.T + q)
    for a in range(len(t)):
        across = states[a]
        for b in range(a, len(t)):
            if b > a:
                across = steps[b - 1][0] @ across
            block = weights @ across @ weights.T
            out[b * k : (b + 1) * k, a * k : (a + 1) * k] = block
            out[a * k : (a + 1) * k, b * k : (b + 1) * k] = block.T
    return out + np.diag(np.tile(sigmas**2, len(t)))


def log_density(left: Array, covariance_: Array) -> float:
    """Of `left (T, K)`, where it is not NaN."""
    flat = left.ravel()
    seen = ~np.isnan(flat)
    lower = np.linalg.cholesky(covariance_[np.ix_(seen, seen)])
    white = np.linalg.solve(lower, flat[seen])
    own = -0.5 * white @ white - np.log(np.diag(lower)).sum()
    return float(own - 0.5 * seen.sum() * np.log(2 * np.pi))


def filtered(of: Process, weights: Array, sigmas: Array, left: Array, dt: float) -> float:
    """Log density of `left (T, K)` by a Kalman filter in its plainest form, from the first sample on."""
    matrix, noise, p = of
    phi, q = step(matrix, noise, dt)
    x, total = np.zeros(len(p)), 0.0
    for row in left:
        seen = ~np.isnan(row)
        c, r = weights[seen], np.diag(sigmas[seen] ** 2)
        s = c @ p @ c.T + r
        rest = row[seen] - c @ x
        gain = np.linalg.solve(s, c @ p).T
        sign, log_det = np.linalg.slogdet(2 * np.pi * s)
        assert sign > 0
        total -= 0.5 * (rest @ np.linalg.solve(s, rest) + log_det)
        x, p = phi @ (x + gain @ rest), phi @ (p - gain @ c @ p) @ phi.T + q
    return float(total)
