"""A first config of a record: what it says where the truth is known, and where it says nothing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from support import command_line
from support.case_tables import for_each
from support.first_configs import (
    DEG,
    RPM,
    accepted,
    both_ways,
    german,
    hostile,
    made,
    told,
    written,
)

import bayesdrill as bd
from bayesdrill.config import loading
from bayesdrill.config.records import simulation
from bayesdrill.config.yaml_source import parse
from bayesdrill.drafting import signals
from bayesdrill.drafting.columns import GEARBOX, MOTOR, ROTOR, TWIST, parse_head

CONFIGS = command_line.ROOT / "configs"
DATA = command_line.ROOT.parent / "shared" / "data"


def noise(entries: dict[str, Any], channel: str) -> float:
    """Ten times the least that its prior allows; the most is the spread of the channel, or more."""
    sigma = entries["record"]["channels"][channel]["sigma"]
    assert sigma["high"] >= 99 * sigma["low"]
    return 10 * float(sigma["low"])


# As a table: head, and what it says.
HEADS = {
    "theta_1": ("angle", ROTOR, ""),
    "w2": ("speed", GEARBOX, ""),
    "n [rpm]": ("speed", "", "rpm"),
    "w (rad/s)": ("speed", "", "rad/s"),
    "phi_deg": ("angle", "", "deg"),
    "speed_rpm": ("speed", "", "rpm"),
    "n_Motor": ("speed", MOTOR, ""),
    "Drehzahl Rotor [1/min]": ("speed", ROTOR, "rpm"),
    "omega_load_rad_s": ("speed", ROTOR, "rad/s"),
    "Winkelgeschwindigkeit Getriebe in deg/s": ("speed", GEARBOX, "deg/s"),
    "thetadot_1": ("speed", ROTOR, ""),
    "dTheta2": ("speed", GEARBOX, ""),
    "twist": ("angle", TWIST, ""),
    "alpha [deg]": ("angle", TWIST, "deg"),
    "U_Motor": ("voltage", MOTOR, ""),
    "U [mV]": ("voltage", "", "mV"),
    "Spannung_V": ("voltage", "", "V"),
    "tensão (V)": ("voltage", "", "V"),
    "Strom / mA": ("current", "", "mA"),
    "i_mot": ("current", MOTOR, ""),
    "Bit_Torque": ("torque", ROTOR, ""),
    "velocidad_motor": ("speed", MOTOR, ""),
    "vitesse arbre (tr/min)": ("speed", GEARBOX, "rpm"),
    "ω_1 [rad/s]": ("speed", ROTOR, "rad/s"),
    "Zeit_ms": ("time", "", "ms"),
    "temps [s]": ("time", "", "s"),
    "humidity": ("", "", ""),
}


def test_heads_in_several_languages() -> None:
    def check(head: str) -> None:
        meaning = parse_head(head)
        assert (meaning.kind, meaning.location, meaning.unit) == HEADS[head]

    for_each({str(head): (head,) for head in HEADS}, check)


def test_a_unit_of_no_turn_is_strange() -> None:
    assert parse_head("theta_1 [counts]").unknown_unit == "counts"
    assert parse_head("position [mm]").kind == "position"  # of what moves along a line
    assert parse_head("w [rpm]", "ignored").unit == "rpm"
    assert parse_head("w", "[rpm]").unit == "rpm"


ROUND = ("nominal_step", "example_rig", "example_ties", "paper/estimates", "paper/missing_physics")


def test_bundled_records_come_back_as_their_configs_have_them(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Names, units, sums of states, time and gear; also the round trip, as they are simulated."""

    def check(name: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        case = loading.load(CONFIGS / f"{name}.yaml")
        record = tmp_path / "mine.csv"
        record.write_text(simulation.simulate(case, 11, record))
        found, config = made(record, voltage=8.0, gear=8), case.config
        channels = config.record.channels
        assert told(found) == {k: (str(one.column), one.unit) for k, one in channels.items()}
        for key, one in channels.items():
            assert found["record"]["channels"][key].get("measures") == one.measures or (
                str(found["record"]["channels"][key]["measures"]).replace(" ", "")
                == str(one.measures).replace(" ", "")
            )
            sigma: Any = config.simulation.sigma.get(key, one.sigma)  # type: ignore[union-attr]
            assert 1 / 1.5 < noise(found, key) / sigma < 1.5, key
        assert found["record"]["time"] == {
            "column": config.record.time.column,
            "unit": config.record.time.unit,
        }  # type: ignore[union-attr]
        assert found["model"]["i_m"] == 0.125
        assert "initial" not in found
        accepted(record.with_suffix(".yaml"))

    for_each({str(name): (name,) for name in ROUND}, check)


@pytest.mark.slow
def test_check_is_content_with_what_is_written(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(name: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        case = loading.load(CONFIGS / f"{name}.yaml")
        record = tmp_path / "mine.csv"
        record.write_text(simulation.simulate(case, 11, record))
        bd.init(record, voltage=8.0)
        assert command_line.cli("check", tmp_path / "mine.yaml").status == 0

    for_each({str(name): (name,) for name in ROUND}, check)


def test_a_newcomers_record_is_understood(tmp_path: Path) -> None:
    found = made(written(tmp_path / "messung 07.csv", german()))
    assert told(found) == {
        "theta_1": ("phi_Rotor_deg", "deg"),
        "w_1": ("n_Rotor", "rpm"),
        "motor": ("n_Motor", "rpm"),
    }
    assert found["record"]["time"] == {"column": "Zeit_ms", "unit": "ms"}
    assert found["record"]["channels"]["motor"]["measures"] == "5 * w_2"
    assert found["model"]["i_m"] == 0.2
    v = found["inputs"]["v"]
    assert (v["column"], v["unit"], v["hold"]) == ("U_Motor", "V", "zero")
    assert v["offset"] == {"prior": "normal", "mean": 0, "sd": pytest.approx(0.13, abs=0.005)}
    assert found["inputs"]["t_0"] == {"prior": "uniform", "low": -0.005, "high": 0.005}
    assert found["parameters"]["t_f"] == 0.0  # it turns both ways
    for name, sigma in (("theta_1", 0.5), ("w_1", 1.0), ("motor", 6.0)):
        assert 1 / 1.5 < noise(found, name) / sigma < 1.5
    accepted(tmp_path / "messung 07.yaml")


def test_every_guess_has_its_mark_and_what_is_said_has_none(tmp_path: Path) -> None:
    text = made(written(tmp_path / "r.csv", german()))["text"]
    lines = text.splitlines()

    def above(entry: str) -> str:
        at = next(k for k, line in enumerate(lines) if line.lstrip().startswith(entry))
        begin = next(k for k in range(at - 1, -1, -1) if "#" not in lines[k][:6])
        return " ".join(lines[begin + 1 : at])

    assert "REVIEW: no unit is said; the derivative of phi_Rotor_deg is 6 times" in above("w_1:")
    assert "no unit is said" not in above("theta_1:")
    assert "REVIEW: the noise is not said" in above("theta_1:")
    assert "REVIEW: the gear is not said; n_Motor and n_Rotor turn as 5:1" in above("model:")
    assert "REVIEW" in above("v:")
    assert "REVIEW" not in above("time:")


def test_a_derivative_tells_both_units(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [("deg", "rpm"), ("deg", "rad/s"), ("rad", "rpm"), ("rad", "deg/s")]

    def check(angle: str, speed: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        size = {"deg": DEG, "rad": 1.0, "rpm": RPM, "rad/s": 1.0, "deg/s": DEG}
        t, v, x = both_ways()
        rng = np.random.default_rng(3)
        columns = {
            "t": t,
            "voltage": v,
            "position": (x[:, 1] + rng.normal(0, 0.01, len(t))) * size[angle],
            "velocity": (x[:, 3] + rng.normal(0, 0.1, len(t))) * size[speed],
        }
        found = made(written(tmp_path / "r.csv", columns))
        assert told(found) == {"theta_2": ("position", angle), "w_2": ("velocity", speed)}
        assert "which end of the shaft is not said" in found["text"]

    for_each({str(case): case for case in cases}, check)


def test_decimal_commas_a_row_of_units_and_blanks(tmp_path: Path) -> None:
    t, v, x = both_ways()
    columns = {"Zeit": t, "Spannung": v, "Winkel Getriebe": x[:, 1] * DEG, "Drehzahl Last": x[:, 2]}
    path = written(tmp_path / "r.csv", columns, ";", ",")
    head, _, rest = path.read_text().partition("\n")
    path.write_text(f"{head}\ns;V;Grad;rad/s\n{rest}")
    found = made(path)
    assert told(found) == {"theta_2": ("Winkel Getriebe", "deg"), "w_1": ("Drehzahl Last", "rad/s")}
    assert found["record"]["time"] == {"column": "Zeit", "unit": "s"}
    accepted(path.with_suffix(".yaml"))


def test_the_unit_of_time_by_its_steps(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(unit: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        columns = german()
        t = columns.pop("Zeit_ms") / {"s": 1e3, "ms": 1.0, "us": 1e-3}[unit]
        found = made(written(tmp_path / "r.csv", {"t": t, **columns}))
        assert found["record"]["time"]["unit"] == unit
        assert told(found)["w_1"] == ("n_Rotor", "rpm")

    for_each({unit: (unit,) for unit in ["s", "ms", "us"]}, check)


def test_without_times_an_angle_and_its_speed_tell_the_rate(tmp_path: Path) -> None:
    columns = german()
    del columns["Zeit_ms"]
    columns["n_Rotor [rpm]"] = columns.pop("n_Rotor")
    found = made(written(tmp_path / "r.csv", columns))
    assert found["record"]["time"]["rate"] == pytest.approx(200, rel=0.02)
    del columns["n_Rotor [rpm]"]
    found = made(written(tmp_path / "r.csv", columns))
    assert found["record"]["time"] == {"rate": 100}
    assert "REVIEW: no column is a time" in found["text"]


def test_a_matlab_file_of_structs_and_a_nameless_matrix(tmp_path: Path) -> None:
    t, v, x = both_ways()
    rng = np.random.default_rng(4)
    y = x + rng.normal(0, 0.02, x.shape)
    named = tmp_path / "named.mat"
    scipy.io.savemat(named, {"rig": {"t": t, "u": v, "theta_1": y[:, 0], "i": y[:, 4]}, "J": 0.01})
    found = made(named)
    assert told(found) == {"theta_1": ("rig.theta_1", "rad"), "i": ("rig.i", "A")}
    assert "# - J: has one value" in found["text"]
    accepted(named.with_suffix(".yaml"))
    nameless = tmp_path / "nameless.mat"
    scipy.io.savemat(nameless, {"data": np.column_stack([t, y[:, 1], v, y[:, 3]])})
    found = made(nameless, voltage=1.0)
    theta, w = (found["record"]["channels"][name] for name in ("theta_2", "w_2"))
    assert (theta["column"], theta["unit"]) == (2, "rad")
    assert (w["column"], w["unit"]) == (4, "rad/s")
    assert found["record"]["time"] == {"variable": "data", "column": 1, "unit": "s"}
    assert "# - data, column 3: (" in found["text"]
    accepted(nameless.with_suffix(".yaml"))


def test_files_of_arrays(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(ending: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        t, v, x = both_ways()
        noisy = x + np.random.default_rng(4).normal(0, 0.02, x.shape)
        columns = {"t": t, "u": v, "theta_2": noisy[:, 1] * DEG, "n_motor": noisy[:, 3] * 5 * RPM}
        path = tmp_path / f"r.{ending}"
        if ending == "npz":
            np.savez(path, **columns)
        else:
            with h5py.File(path, "w") as file:
                file.update(columns)
        found = made(path)
        assert told(found) == {"theta_2": ("theta_2", "deg"), "motor": ("n_motor", "rpm")}
        assert found["record"]["channels"]["motor"]["measures"] == "5 * w_2"
        accepted(path.with_suffix(".yaml"))

    for_each({ending: (ending,) for ending in ["npz", "h5"]}, check)


def test_speeds_alone_have_one_unit(tmp_path_factory: pytest.TempPathFactory) -> None:
    """By the size of the slower one, as the motor's is made by the gear."""

    def check(unit: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        t, _, x = both_ways()
        size = RPM if unit == "rpm" else 1.0
        rng = np.random.default_rng(4)
        y = (x[:, 2:4] * [1, 5] + rng.normal(0, 0.05, (len(t), 2))) * size
        found = made(
            written(tmp_path / "r.csv", {"t": t, "speed motor": y[:, 1], "speed bit": y[:, 0]})
        )
        assert told(found) == {"w_1": ("speed bit", unit), "motor": ("speed motor", unit)}
        assert found["record"]["channels"]["motor"]["measures"] == "5 * w_2"

    for_each({unit: (unit,) for unit in ["rpm", "rad/s"]}, check)


def test_without_a_voltage_check_asks_for_it(tmp_path: Path) -> None:
    columns = german()
    del columns["U_Motor"]
    path = written(tmp_path / "r.csv", columns)
    said = bd.init(path)
    assert "inputs.v" in str(said)
    refused = command_line.cli("check", path.with_suffix(".yaml"))
    assert refused.status == 2
    assert "inputs.v: this entry is missing" in refused.err
    assert "REVIEW: no column is a voltage" in path.with_suffix(".yaml").read_text()


def test_what_cannot_be_told_is_left_out_with_its_reason(tmp_path: Path) -> None:
    columns = german()
    n = len(columns["Zeit_ms"])
    rng = np.random.default_rng(6)
    angle, dt = columns["phi_Rotor_deg"], 0.005
    more = {
        "humidity": rng.normal(50, 1, n),
        "WOB [N]": rng.normal(300, 5, n),
        "theta_2 [counts]": rng.normal(0, 9, n),
        "n_soll": rng.normal(0, 9, n),
        "speed_set": np.full(n, 3.0),
        "n_Last": np.gradient(angle, dt) / 6,
    }
    del columns["n_Rotor"]
    found = made(written(tmp_path / "r.csv", {**columns, **more}))
    assert set(told(found)) == {"theta_1", "w_1", "motor"}
    assert found["record"]["channels"]["w_1"]["derived_from"] == "theta_1"
    assert "derived_from" not in found["record"]["channels"]["motor"]
    rows = (
        found["text"]
        .split("# Not used:")[1]
        .split("inputs:")[0]
        .replace("\n  # ", " ")
        .split(" - ")
    )
    for name, why in {
        "humidity": "its name does not say",
        "WOB [N]": "is a force",
        "theta_2 [counts]": "does not say how far one of it turns",
        "n_soll": "is a set point",
    }.items():
        (reason,) = (row for row in rows if name in row.partition(": ")[0])
        assert why in reason, name


def test_how_a_record_begins(tmp_path: Path) -> None:
    """Moving; before zero; later than zero; after a rest that no constant voltage explains."""
    t, v, x = both_ways()
    rng = np.random.default_rng(8)

    def columns(rows: slice, shift: float = 0.0) -> dict[str, np.ndarray]:
        y = x[rows, 2:4] + rng.normal(0, 0.02, (len(t[rows]), 2))
        return {"t": t[rows] + shift, "w_1": y[:, 0], "w_2": y[:, 1]}

    moving = made(written(tmp_path / "a.csv", columns(slice(150, None))), voltage=6.0)
    assert moving["initial"] == {"time": t[150], "state": "free", "theta_2": 0}
    assert "t_0" not in moving["inputs"]  # the voltage was there before
    measured = made(written(tmp_path / "b.csv", {**columns(slice(150, None)), "u": v[150:]}))
    assert measured["initial"] == {"state": "free", "theta_2": 0}
    assert "t_0" in measured["inputs"]
    rest = made(written(tmp_path / "c.csv", columns(slice(0, None), -0.105)), voltage=6.0)
    assert rest["record"]["window"][0] == pytest.approx(0, abs=0.02)
    late = columns(slice(0, None))
    late = {k: np.concatenate([rng.normal(0, 0.02, 100), one]) for k, one in late.items()}
    late["t"] = 0.005 * np.arange(1700)
    found = made(written(tmp_path / "d.csv", late), voltage=6.0)
    assert found["record"]["window"][0] == pytest.approx(0.6, abs=0.03)
    for name in "abcd":
        accepted(tmp_path / f"{name}.yaml")


def test_gaps_and_missing_cells_are_left_as_they_are(tmp_path: Path) -> None:
    columns = german()
    columns["n_Rotor"][300] = np.nan
    columns["Zeit_ms"][1500:] += 4000
    path = written(tmp_path / "r.csv", columns)
    found = made(path)
    assert "window" not in found["record"]
    assert found["record"]["missing"] == "drop"
    assert "missing" not in found["inputs"]["v"]
    assert "800 missing in 1 gap" in found["text"].replace("\n  # ", " ")
    assert told(found)["w_1"] == ("n_Rotor", "rpm")
    accepted(path.with_suffix(".yaml"))


def test_times_that_go_back_and_infinite_cells_are_cut_off(tmp_path: Path) -> None:
    columns = german()
    columns["U_Motor"][:4] = np.nan
    columns["phi_Rotor_deg"][1500] = np.inf
    path = written(tmp_path / "r.csv", columns)
    found = made(path)
    assert found["record"]["window"] == pytest.approx([0.02, 7.495])
    accepted(path.with_suffix(".yaml"))


BATCHES = [
    pytest.param((0, 1), id="quick"),
    pytest.param((2, 3), id="long", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("batches", BATCHES)
def test_whatever_the_table_a_config_that_is_written_passes_check(
    batches: tuple[int, ...], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Or nothing is written, with the reason; a voltage that nobody has told is asked for.  Mutants
    killed: a window that holds rows of another part, or a draft that nobody has checked.
    """

    def check(batch: int) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        wrong, count, path = {}, 0, tmp_path / "r.csv"
        for seed in range(100 * batch, 100 * batch + 12):
            written(path, hostile(np.random.default_rng(seed)))
            config = tmp_path / f"{seed}.yaml"
            voltage = 6.0 if seed % 2 else None
            try:
                asks = bd.init(path, config, voltage=voltage).asks
            except bd.InputError:
                assert not config.exists()
                continue
            count += 1
            try:
                assert all("inputs" in one.place for one in asks)
                if not asks:
                    bd.load(config)
            except (bd.InputError, AssertionError) as error:
                wrong[seed] = str(error)
        assert wrong == {}
        assert count > 3

    for_each({str(batch): (batch,) for batch in batches}, check)


def test_rows_that_share_a_time_with_others_are_cut_off(tmp_path: Path) -> None:
    """Three times one after the other, of which no window of times can take one."""
    columns = german()
    columns["Zeit_ms"][900:] -= 15.0
    path = written(tmp_path / "r.csv", columns)
    assert made(path)["record"]["window"] == pytest.approx([0.0, 4.48])
    assert bd.load(path.with_suffix(".yaml"))
    columns["Zeit_ms"][900:] += 15.0
    columns["Zeit_ms"][899] = 1e7  # which grows, too
    path = written(tmp_path / "r.csv", columns)
    assert made(path)["record"]["window"] == pytest.approx([0.0, 4.49])
    assert bd.load(path.with_suffix(".yaml"))


def test_a_rig_that_coasts_says_how_large_its_current_may_be(tmp_path: Path) -> None:
    """Of a voltage of zero nothing follows; of what turns a current does."""
    columns = {name: german()[name][200:900] for name in ("Zeit_ms", "n_Motor")}
    path = written(tmp_path / "r.csv", {**columns, "U_Motor": np.zeros(700)})
    assert made(path)["initial"]["state"] == "free"
    space = bd.load(path.with_suffix(".yaml")).job.problem.posterior.space
    given = made(path)["parameters"]
    p = {name: math.sqrt(given[name]["low"] * given[name]["high"]) for name in ("k_e", "r_m")}
    speed = np.abs(columns["n_Motor"]).max() / RPM
    assert space.priors["i_0"].sd == pytest.approx(2 * speed * p["k_e"] / p["r_m"], rel=0.2)


def test_names_that_yaml_would_take_for_something_else(tmp_path: Path) -> None:
    columns = {name: values[:200] for name, values in german().items()}
    for name in ("0", "null", "1e5", "true"):
        path = written(tmp_path / f"{name}.csv", columns)
        assert made(path)["name"] == name
    paths = [written(tmp_path / f"run_{name}.csv", columns) for name in ("null", "true")]
    bd.init(paths, tmp_path / "both.yaml")
    assert {*bd.load(tmp_path / "both.yaml").job.config.experiments} == {"null", "true"}


def test_more_files_than_a_config_holds_are_named(tmp_path: Path) -> None:
    columns = {name: values[:60] for name, values in german().items()}
    paths = [written(tmp_path / f"r{k}.csv", columns) for k in range(52)]
    refused = command_line.cli("init", *paths, "-o", tmp_path / "all.yaml")
    assert refused.status == 2
    assert "52 entries stand here, wanted are at most 50; take out r50, r51" in refused.err
    assert not (tmp_path / "all.yaml").exists()


def test_noise_of_what_swings_is_counted_or_is_constant() -> None:
    rng = np.random.default_rng(9)
    t = 0.01 * np.arange(2000)
    swing = 30 * np.sin(20 * t)
    assert signals.noise(swing + rng.normal(0, 0.3, 2000)) == pytest.approx(0.3, rel=0.15)
    coarse = np.round(3 * np.sin(0.3 * t) / 0.5) * 0.5
    assert signals.noise(coarse) == pytest.approx(0.5 / math.sqrt(12), rel=0.01)
    assert signals.counted_unit(np.round(swing / 0.36) * 0.36) == "deg"
    assert signals.counted_unit(np.round(swing / (math.pi / 2048)) * (math.pi / 2048)) == "rad"
    assert signals.counted_unit(np.round(swing, 1)) == ""
    assert signals.counted_unit(swing) == ""


HOPELESS = {
    "no such file": None,
    "no column is an angle": "t,humidity\n" + "".join(f"{k},{k % 7}\n" for k in range(50)),
    "20 numbers or more": "t,w_1\n0,1\n1,2\n",
}


def test_nothing_can_be_made_of_it(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(why: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        path = tmp_path / "r.csv"
        if (text := HOPELESS[why]) is not None:
            path.write_text(text)
        before = command_line.listing(tmp_path)
        refused = command_line.cli("init", path)
        assert refused.status == 2
        assert why in refused.err
        assert "Traceback" not in refused.err
        assert command_line.listing(tmp_path) == before

    for_each({str(why): (why,) for why in HOPELESS}, check)


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    path = written(tmp_path / "r.csv", german())
    config = tmp_path / "r.yaml"
    config.write_text("mine")
    refused = command_line.cli("init", path)
    assert refused.status == 2
    assert config.read_text() == "mine"
    done = command_line.cli("init", path, "--force")
    assert done.status == 0
    assert "REVIEW" in done.out
    record = path.read_bytes()
    for output in (path, tmp_path / "notes.txt"):
        assert command_line.cli("init", path, "--output", output, "--force").status == 2
    assert path.read_bytes() == record
    folder = tmp_path / "configs"
    folder.mkdir()
    assert command_line.cli("init", path, "--output", folder / "mine.yaml", "--gear", 5).status == 0
    assert "file: ../r.csv" in (folder / "mine.yaml").read_text()
    assert command_line.cli("init", path, "--gear", 0.2, "--force").status == 2


SERVO = DATA / "simulated_servo"


@pytest.mark.skipif(not SERVO.is_dir(), reason="a record that does not come with the project")
def test_a_servo_is_understood(tmp_path: Path) -> None:
    """The twist is 3.3 ms late, which `square` alone tells, and the voltage 0.06 V less."""
    config = tmp_path / "mine.yaml"
    bd.init([SERVO / f"{name}.csv" for name in ("slow", "square", "sweep")], config, gear=14)
    found = parse(config, config.read_text()).data
    assert list(found["experiments"]) == ["slow", "square", "sweep"]
    lag = found["record"]["channels"]["twist"]["lag"]
    assert lag["unit"] == "ms"
    assert lag["low"] < 1 < 3.3 < 10 < lag["high"] < 30
    assert "lag" not in found["record"]["channels"]["theta_2"]
    assert found["inputs"]["v"]["offset"]["sd"] > 0.06
    assert {"offset_v", "lag_twist", "t_0", "sigma_twist"} < {*found["shared"]}
    assert "initial" not in found
    assert told(found) == {"theta_2": ("theta [deg]", "deg"), "twist": ("alpha [deg]", "deg")}
    assert found["record"]["time"] == {"column": "time [ms]", "unit": "ms"}
    assert found["inputs"]["v"]["unit"] == "V"
    accepted(config)


def test_a_time_that_is_called_a_twist_does_no_harm(tmp_path: Path) -> None:
    """It grows evenly, so that its law leaves nothing of it at all."""
    head, *rows = (CONFIGS / "records" / "nominal_step.csv").read_text().splitlines()
    record = tmp_path / "odd.csv"
    record.write_text("\n".join([f"twist{head[head.index(',') :]}", *rows]))
    assert "twist" in bd.init(record, tmp_path / "odd.yaml").channels


@pytest.mark.skipif(not DATA.is_dir(), reason="records that do not come with the project")
def test_records_of_others_without_a_voltage(tmp_path: Path) -> None:
    config = tmp_path / "mine.yaml"
    said = bd.init(DATA / "ufrj_drillstring_rig" / "175_completo_1.mat", config)
    found = parse(config, config.read_text()).data
    assert "mask" not in found["record"]["channels"]["w_2"]
    assert "looks like glitches" in config.read_text().partition("w_1:")[2]
    assert found["initial"] == {"state": "free", "theta_2": 0}
    assert {k: unit for k, (_, unit) in told(found).items()} == {"w_1": "rpm", "w_2": "rpm"}
    assert found["inputs"]["t_1"]["unit"] == "N*m"
    assert [one.place.rpartition(" ")[2] for one in said.asks]
    repeats = [DATA / "hsm150_servo" / f"idf_pos_0.065_{k}.mat" for k in (1, 2, 3)]
    bd.init(repeats, config, voltage=1.0, force=True)
    found = parse(config, config.read_text()).data
    assert list(found["experiments"]) == ["run_1", "run_2", "run_3"]
    assert found["record"]["channels"]["w_2"]["derived_from"] == "theta_2"
    assert found["shared"] == ["sigma_theta_2", "sigma_i"]
    assert found["record"]["channels"]["theta_2"]["unit"] == "rad"
    assert found["record"]["channels"]["theta_2"]["column"] == 3
    accepted(config)
