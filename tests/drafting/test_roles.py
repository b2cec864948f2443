"""Which column drives, how a record begins, and which channel is late."""

import math
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from support.case_tables import run_cases
from support.first_configs import RPM, draft_of, german_record, reversing_rig, write_table
from support.small_problems import starts_believed

import bayesdrill as bd


def angle_and_twist(t: np.ndarray, late: float, w: float) -> tuple[np.ndarray, np.ndarray]:
    """An angle at the gearbox, and the twist of a swinging rotor behind it, `late` s before."""

    def drive(s: np.ndarray) -> np.ndarray:
        return np.where(s > 0, 2.0 * np.sin(1.3 * s) ** 2 + 0.5 * np.sin(7.0 * s), 0.0)

    # q'' + w^2 q = -theta_2'', by its exact response on a fine grid
    h = 2e-4
    s = h * np.arange(int(t[-1] / h) + 2)
    push = -np.gradient(np.gradient(drive(s), h), h)
    step = scipy.linalg.expm(h * np.array([[0, 1, 0], [-(w**2), 0, 1], [0, 0, 0]]))
    q = np.zeros((len(s), 2))
    for k in range(len(s) - 1):
        q[k + 1] = step[:2, :2] @ q[k] + step[:2, 2] * push[k]
    return drive(t), np.interp(t - late, s, q[:, 0])


@run_cases("late", [0.0, 0.015])
def test_the_lag_of_a_twist_follows_from_the_motion_of_the_rotor(
    late: float, tmp_path: Path
) -> None:
    t = 0.005 * np.arange(2000)
    rng = np.random.default_rng(4)
    angle, twist = angle_and_twist(t, late, 12.0)
    columns = {
        "t [s]": t,
        "theta_2 [rad]": angle + rng.normal(0, 2e-4, len(t)),
        "twist [rad]": twist + rng.normal(0, 2e-4, len(t)),
    }
    draft = draft_of(write_table(tmp_path / "r.csv", columns), voltage=5.0)
    channels = draft["record"]["channels"]
    assert "lag" not in channels["theta_2"]
    if late:
        high = pytest.approx(1e3 * (2 * late + 3 * 0.005), rel=0.15)
        assert channels["twist"]["lag"] == {
            "prior": "uniform", "low": 0, "high": high, "unit": "ms",
        }  # fmt: skip
        assert "it seems to be 15 ms late" in draft["words"]
    else:
        assert "lag" not in channels["twist"]
        assert "#   lag: {prior: uniform, low: 0, high: 25, unit: ms}" in draft["text"]


@run_cases("head", ["theta_motor [rad]", "theta_motor"])
def test_an_angle_tells_a_delay_and_whole_numbers_may_be_counts(head: str, tmp_path: Path) -> None:
    """Five samples between the voltage and a motor of 60 ms."""
    t, rng = 0.01 * np.arange(600), np.random.default_rng(3)
    u = np.repeat(rng.choice([-3.0, 3.0], 30), 20)
    slow = math.exp(-0.01 / 0.06)
    w = scipy.signal.lfilter([8.0 * (1 - slow)], [1.0, -slow], np.append(np.zeros(6), u[:-6]))
    theta = 0.01 * np.cumsum(w) + rng.normal(0, 2e-3, len(t))
    counted = head == "theta_motor"
    angle = np.round(4096 * theta / (2 * np.pi)) if counted else theta
    draft = draft_of(write_table(tmp_path / "r.csv", {"t [s]": t, "u [V]": u, head: angle}))
    assert "The speed follows about 50 ms late" in draft["words"]
    assert ("if an encoder counts N steps a turn, write count/N" in draft["words"]) == counted


def test_a_record_begins_moving_or_at_rest(tmp_path: Path) -> None:
    """Moving; before zero; later than zero; after a rest that no constant voltage explains."""
    t, v, x = reversing_rig()
    rng = np.random.default_rng(8)

    def columns(rows: slice, shift: float = 0.0) -> dict[str, np.ndarray]:
        y = x[rows, 2:4] + rng.normal(0, 0.02, (len(t[rows]), 2))
        return {"t": t[rows] + shift, "w_1": y[:, 0], "w_2": y[:, 1]}

    path = tmp_path / "r.csv"
    moving = draft_of(write_table(path, columns(slice(150, None))), voltage=6.0)
    assert moving["initial"] == {"time": t[150], "state": "free", "theta_2": 0}
    assert "t_0" not in moving["inputs"]  # the voltage was there before
    measured = draft_of(write_table(path, {**columns(slice(150, None)), "u": v[150:]}))
    assert measured["initial"] == {"state": "free", "theta_2": 0}
    assert "t_0" in measured["inputs"]
    rest = draft_of(write_table(path, columns(slice(0, None), -0.105)), voltage=6.0)
    assert rest["record"]["window"][0] == pytest.approx(0, abs=0.02)
    late = columns(slice(0, None))
    late = {k: np.concatenate([rng.normal(0, 0.02, 100), x]) for k, x in late.items()}
    late["t"] = 0.005 * np.arange(1700)
    draft = draft_of(write_table(path, late), voltage=6.0)
    assert draft["record"]["window"][0] == pytest.approx(0.6, abs=0.03)


def test_a_record_begins_steadily_or_elsewhere_than_at_zero(tmp_path: Path) -> None:
    """Steady until the voltage changes; turning, by an angle alone; at rest at another angle."""
    t = 0.005 * np.arange(1200)
    rng = np.random.default_rng(8)
    v = np.where(t < 2, 4.0, 7.0)
    late = np.maximum(t - 2, 0)
    w = 20 + 15 * (1 - np.exp(-late / 0.3))
    theta = 20 * t + 15 * (late - 0.3 * (1 - np.exp(-late / 0.3))) + rng.normal(0, 0.01, len(t))
    columns = {"t": t, "u": v, "theta_2": 3 + theta, "w_2": w + rng.normal(0, 0.2, len(t))}
    draft = draft_of(write_table(tmp_path / "r.csv", columns))
    assert draft["initial"] == {"state": "steady", "theta_2": "free"}
    del columns["w_2"]
    turning = write_table(tmp_path / "r.csv", {**columns, "u": v + 0.3 * np.sin(9 * t)})
    assert draft_of(turning)["initial"] == "free"
    rest = {"t": t, "u": v - 4, "theta_2": 3 + theta - 20 * t}
    draft = draft_of(write_table(tmp_path / "r.csv", rest))
    assert "initial" not in draft
    offset = draft["record"]["channels"]["theta_2"]["offset"]
    assert (offset["mean"], offset["sd"]) == (0, pytest.approx(6.0, rel=0.05))


@starts_believed()
def test_a_rig_that_coasts_says_how_large_its_current_may_be(tmp_path: Path) -> None:
    """Nothing follows of a voltage of zero; of what turns a current does."""
    columns = {name: german_record()[name][200:900] for name in ("Zeit_ms", "n_Motor")}
    path = write_table(tmp_path / "r.csv", {**columns, "U_Motor": np.zeros(700)})
    draft = draft_of(path)
    assert draft["initial"]["state"] == "free"
    space = bd.load(path.with_suffix(".yaml")).job.problem.posterior.space
    priors = [draft["parameters"][name] for name in ("k_e", "r_m")]
    k_e, r_m = (math.sqrt(prior["low"] * prior["high"]) for prior in priors)
    speed = np.abs(columns["n_Motor"]).max() / RPM
    assert space.priors["i_0"].sd == pytest.approx(2 * speed * k_e / r_m, rel=0.2)
