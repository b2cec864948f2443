"""What a draft lists as glitches: no peak of a swing, and nearly all that a sensor made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.case_tables import for_each
from support.first_configs import german, made, written
from support.oscillating_records import swing, with_glitches

import bayesdrill as bd
from bayesdrill.config.yaml_source import parse
from bayesdrill.drafting import signals
from bayesdrill.drafting.columns import FileColumn, parse_head

DATA = command_line.ROOT.parent / "shared" / "data"
STEP = 0.01


def listed(columns: dict[str, np.ndarray]) -> dict[str, tuple[tuple[float, float], ...]]:
    """Of each channel the first and last times of what looks like a glitch."""
    heads = {"v": "v [V]"}
    seen = [
        FileColumn(n, {"column": n}, x, parse_head(heads.get(n, n))) for n, x in columns.items()
    ]
    t = STEP * np.arange(len(columns["v"]))
    segment = signals.longest_segment(signals.Timing(t, None, "s", ""), seen)
    assert segment is not None
    sensors, _ = signals.read_sensors(seen, segment)
    return {sensor.name: sensor.raw.glitches for sensor in sensors}


def test_no_peak_of_a_swing_is_a_glitch() -> None:
    """Mutant killed: what a signal does around a departure is no yardstick."""
    for seed in range(200):
        columns = swing(np.random.default_rng(seed))
        assert not any(listed(columns).values()), seed


def test_nearly_all_real_glitches_are_listed() -> None:
    """Of 1 to 3 samples, 5 spreads of the channel: 95 % of 800, whose standard error is 0.8 %."""
    hits = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        columns = swing(rng)
        name = ("theta_2", "w_1", "twist", "i")[seed % 4]
        spoilt, at = with_glitches(columns[name], rng)
        found = np.zeros(len(spoilt), dtype=bool)
        for begin, end in listed({"v": columns["v"], name: spoilt})[name]:
            found[round(begin / STEP) : round(end / STEP) + 1] = True
        hits.append(found[at].mean())
    assert np.mean(hits) >= 0.95


def test_a_glitch_is_listed_with_its_time_and_not_masked(tmp_path: Path) -> None:
    columns = german()
    columns["n_Motor"][[300, 801, 802, 1203]] = -4000.0
    found = made(written(tmp_path / "r.csv", columns))
    channels = found["record"]["channels"]
    assert not any("mask" in channel for channel in channels.values())
    assert channels["motor"]["measures"] == "5 * w_2"
    text = found["text"].replace("\n    #", "")
    assert "looks like glitches: [1.5, 1.5], [4.005, 4.01], [6.015, 6.015] s" in text
    assert "mask: {times: [[1.5, 1.5], [4.005, 4.01], [6.015, 6.015]]}" in text
    assert text.count("looks like") == 1


# Folders of records without a glitch, and how a newcomer names their columns.
CLEAN: dict[str, tuple[list[str], dict[str, object]]] = {
    "simulated_servo": (["slow.csv", "square.csv", "sweep.csv"], {"gear": 14}),
    "two_inertia_bench_tokyo": (
        ["MultisineTypeA.mat", "MultisineTypeB.mat"],
        {
            "rig": "driven_shaft",
            "columns": ["time=t [us]", "theta_mx=theta_2 [rad]", "theta_my=-theta_1 [rad]"],
        },
    ),
    "flexible_drive_waterloo_2022": (
        ["velocity_response_2.mat", "velocity_response_sine_3.mat"],
        {"columns": ["u=v [V]", "v1=w_2 [rad/s]", "v2=w_1 [rad/s]"]},
    ),
    "elastic_joint_padova": (
        ["data3_v1.mat"],
        {"rig": "driven_shaft", "columns": ["data.estimation.thb=theta_1 [deg]"]},
    ),
    "geared_servo_padova": (
        ["awu_resp.mat"],
        {
            "rig": "motor",
            "gear": 14,
            "columns": [
                "step_awu.signals(4).values=v [V]",
                "step_awu.signals(6).values=theta_2 [deg]",
                "step_awu.signals(7).values=i [A]",
            ],
        },
    ),
    "three_disc_epfl": (
        ["FPdata.mat"],
        {"rate": 25.0, "columns": ["u=v [V]", "y=theta_1 [rad]"]},
    ),
}


@pytest.mark.skipif(not DATA.is_dir(), reason="records that do not come with the project")
def test_drafts_of_real_records_pass_check_and_list_no_peak(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    def check(folder: str) -> None:
        files, known = CLEAN[folder]
        config = tmp_path_factory.mktemp("case") / "mine.yaml"
        said = bd.init([DATA / folder / name for name in files], config, **known)  # type: ignore[arg-type]
        assert not said.asks
        assert "looks like" not in said.text
        assert parse(config, said.text).data["parameters"]
        bd.load(config)

    for_each({folder: (folder,) for folder in CLEAN}, check)
