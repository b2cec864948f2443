"""A delay stands for a time constant where an input changes slowly, and not where it jumps."""

import numpy as np
import pytest
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.analysis.delay_confounding import delays_and_time_constants
from bayesdrill.report.findings import finding_sentences

J, C, DELAY = 0.1, 2.0, 0.005  # a time constant of 50 ms
T = 0.002 * np.arange(2000)
PRIOR = {"prior": "log_uniform", "low": 1e-3, "high": 10.0}
SLOW, JUMPS = np.sin(2 * np.pi * 0.5 * T), np.sign(np.sin(2 * np.pi * 2.5 * T) + 0.2)


def speed(torque: np.ndarray) -> np.ndarray:
    """Return the speed of the rotor under a torque that acts `DELAY` late and is held between steps."""
    fine = 0.0005 * np.arange(4 * len(T))
    held = torque[np.searchsorted(T, fine - DELAY + 1e-9, "right").clip(1) - 1] * (fine >= DELAY)
    decay, w = np.exp(-C / J * 0.0005), np.zeros(len(fine))
    for k in range(len(w) - 1):
        w[k + 1] = decay * w[k] + (1 - decay) / C * held[k]
    return w[::4] + 0.02 * np.random.default_rng(2).standard_normal(len(T))


def findings(torque: np.ndarray, late: str):
    """Return findings at the truth, with an unknown delay of the input, of the channel, or none."""
    prior = {"prior": "uniform", "low": -0.02, "high": 0.02}
    lag = {"lag": prior} if late == "lag" else {}
    channels = {"w_2": bd.Channel(speed(torque), "rad/s", 0.02, **lag)}
    inputs = {"t_m": bd.Input(torque, "N*m")} | ({"t_0": prior} if late == "t_0" else {})
    case = bd.case(T, channels, inputs, {"j_m": PRIOR, "c_m": PRIOR}, rig="motor")
    posterior = case.job.problem.posterior
    values = {"j_m": J, "c_m": C, "t_0": DELAY, "lag_w_2": DELAY}
    theta = posterior.space.vector({name: values[name] for name in posterior.space.free})
    return [*delays_and_time_constants(posterior, theta)]


@run_cases("late, name", [("t_0", "t_0"), ("lag", "lag_w_2")])
def test_a_slow_input_leaves_a_delay_and_a_time_constant_apart_by_their_sum_alone(
    late: str, name: str
) -> None:
    (finding,) = findings(SLOW, late)
    assert finding.names == {"delay_name": name}
    assert finding.numbers["correlation"] < -0.95
    assert finding.numbers["tau"] == pytest.approx(50.0, rel=1e-6)
    assert finding.numbers["delay"] == pytest.approx(5.0)
    # What one of them gains the other loses: their sum is far better known than either.
    assert finding.numbers["tau_sd"] == pytest.approx(finding.numbers["delay_sd"], rel=0.2)
    (sentence,) = finding_sentences([finding])
    assert f"{name} and a time constant cannot be distinguished (correlation -0.9" in sentence


@run_cases("torque, late", [(JUMPS, "t_0"), (SLOW, "none")])
def test_a_jump_tells_a_delay_from_a_time_constant(torque: np.ndarray, late: str) -> None:
    assert findings(torque, late) == []
