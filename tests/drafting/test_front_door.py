"""Files that strangers brought: what `init` reads, guesses, asks for and refuses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from support import command_line
from support.case_tables import for_each
from support.first_configs import accepted, made, told, written

import bayesdrill as bd
from bayesdrill.config import loading
from bayesdrill.config.records import reading
from bayesdrill.config.yaml_source import parse

CASES = command_line.ROOT.parent / "shared" / "cases"
SMALL = CASES / "small"
needs_cases = pytest.mark.skipif(not SMALL.is_dir(), reason="records that do not come along")

Columns = Mapping[str, np.ndarray]
T = 0.01 * np.arange(400)
DRIVE = 6.0 * (np.sign(np.sin(1.7 * T)) + 0.2 * np.sin(9 * T)) * (T > 0.2)


def response(late: int = 0, u: np.ndarray = DRIVE, noise: float = 0.2) -> np.ndarray:
    """A speed that follows a voltage, `late` samples after it."""
    w, given = np.zeros(len(u)), np.concatenate([np.zeros(late), u])[: len(u)]
    for k in range(len(u) - 1):
        w[k + 1] = w[k] + 0.01 * (15 * given[k] - w[k]) / 0.08
    return w + np.random.default_rng(1).normal(0, noise, len(u))


W = response()
ANGLE = np.cumsum(W) * 0.01
BASE: Columns = {"t": T, "u": DRIVE, "speed": W}


def draft(folder: Path, columns: Columns, *names: str, **known: Any) -> dict[str, Any]:
    """Entries that are written for a table, and what is said of it on the terminal; they are valid."""
    path = written(folder / "r.csv", dict(columns))
    said = str(bd.init(path, folder / "r.yaml", columns=names, force=True, **known))
    text = (folder / "r.yaml").read_text()
    if "still to do" not in said:
        accepted(folder / "r.yaml")
    return {
        **parse(path, text).data,
        "text": " ".join(text.replace("#", " ").split()),
        "said": said,
    }


def refusal(*arguments: Any, **known: Any) -> str:
    with pytest.raises(bd.InputError) as caught:
        bd.init(*arguments, **known)
    return str(caught.value)


def small(name: str, folder: Path, *names: str, **known: Any) -> dict[str, Any]:
    """Entries that are written for one of the small cases."""
    said = str(bd.init(SMALL / name, folder / "s.yaml", columns=names, force=True, **known))
    text = (folder / "s.yaml").read_text()
    words = " ".join(text.replace("#", " ").split())
    return {**parse(SMALL / name, text).data, "said": said, "text": words}


# --- rows that are counted -------------------------------------------------------------------------


def test_a_column_that_grows_by_one_a_row_is_a_row_number(tmp_path: Path) -> None:
    """Mutants killed: an angle, or a speed with a unit, is called a row number."""
    count = np.arange(400.0)

    def check(head: str, begin: float) -> None:
        found = draft(tmp_path, {head: count + begin, **BASE})
        assert "grows by one a row: a row number" in found["said"]
        assert told(found) == {"w_2": ("speed", "rpm")}

    for_each({"n": ("n", 0), "i": ("i", 1), "nameless": ("", 0), "index": ("index", 7e4)}, check)
    times = draft(tmp_path, {"t": count, "u": DRIVE, "speed": W})
    assert times["record"]["time"] == {"column": "t", "unit": "ms"}
    assert [*told(draft(tmp_path, {"t": T, "u": DRIVE, "theta": count}))] == ["theta_2"]
    speed = draft(tmp_path, {"t": T, "n [rpm]": count, "u": DRIVE})
    assert told(speed) == {"w_2": ("n [rpm]", "rpm")}
    arm = draft(tmp_path, {"": count, "t": T, "a": ANGLE, "i": W}, "t=t [s]", "a=theta_arm [rad]")
    assert told(arm) == {"theta_arm": ("a", "rad")}
    assert "samples a second" in draft(tmp_path, {"n": count, "u": DRIVE, "speed": W})["said"]


@needs_cases
def test_a_counter_beside_a_voltage_and_a_reference(tmp_path: Path) -> None:
    found = small("init_counter/counter.txt", tmp_path)
    assert told(found) == {"theta_2": ("theta", "deg")}
    assert found["inputs"]["v"]["column"] == "v"
    assert "REVIEW: u may be the voltage as well" in found["text"]
    assert told(small("init_counter/only_n.txt", tmp_path)) == {"theta_2": ("theta [deg]", "deg")}


# --- which column drives ---------------------------------------------------------------------------


def test_the_voltage_is_what_is_called_most_like_one(tmp_path: Path) -> None:
    def check(names: Sequence[str], best: str) -> None:
        columns = {name: DRIVE * (1 + k) for k, name in enumerate(names)}
        found = draft(tmp_path, {"t": T, **columns, "speed": W})
        assert found["inputs"]["v"]["column"] == best
        others = ", ".join(name for name in names if name != best and "soll" not in name)
        assert (f"{others} may be the voltage as well" in found["text"]) == bool(others)

    cases = [(["u", "v"], "v"), (["v1", "u"], "u"), (["u", "voltage"], "voltage")]
    cases += [(["v", "U [V]"], "U [V]"), (["u_soll", "u"], "u")]
    for_each({best + names[0]: (names, best) for names, best in cases}, check)


@needs_cases
def test_speeds_that_are_called_like_voltages_are_named(tmp_path: Path) -> None:
    said = refusal(SMALL / "init_not_needed/rec.csv", tmp_path / "s.yaml")
    assert "u is taken as the voltage; if it is a speed say" in said
    assert '--columns "v1=w_1 [rad/s]" or v_cart [mm/s]' in said
    names = ["t=t [s]", "u=u_a [V]", "v1=v_a [mm/s]", "v2=v_b [mm/s]"]
    found = small("init_not_needed/rec.csv", tmp_path, *names)
    assert told(found) == {"v_a": ("v1", "mm/s"), "v_b": ("v2", "mm/s")}


def test_a_steady_voltage_beside_a_motion_both_ways_is_a_supply(tmp_path: Path) -> None:
    """Of a train as well; but not where the rig turns one way, nor where somebody has said it.

    Mutants killed: the motion is that of a twist; a constant voltage is no supply.
    """
    battery = 12 + 0.05 * np.sin(40 * T)
    found = draft(tmp_path, {"t": T, "battery voltage": battery, "speed": W, "current": np.abs(W)})
    assert "v" not in found["inputs"]
    assert (
        "battery voltage: hardly changes while the rig turns both ways: a supply" in found["said"]
    )
    assert "REVIEW: it never changes its sign" in found["text"]
    flat = draft(tmp_path, {"t": T, "v": 0 * T + 12, "angle": ANGLE})
    assert "a supply, not what the motor gets" in flat["said"]
    one_way = {"t": T, "v": battery, "speed": 80 + W / 4, "current": np.abs(W)}
    found = draft(tmp_path, one_way)
    assert found["inputs"]["v"]["column"] == "v"
    assert "never changes its sign" not in found["text"]
    names = ["t=t [s]", "v=u_cart [V]", "x=x_cart [m]"]
    cart = draft(tmp_path, {"t": T, "v": battery, "x": ANGLE}, *names)
    assert cart["inputs"]["u_cart"]["column"] == "v"
    assert "REVIEW: it hardly changes while the rig turns both ways" in cart["text"]


@needs_cases
def test_the_bus_of_a_servo_is_not_its_voltage(tmp_path: Path) -> None:
    found = small("init_supply_as_motor_voltage/servo.csv", tmp_path)
    assert told(found) == {"theta_2": ("position", "rad"), "i": ("current", "mA")}
    assert "input_volts: hardly changes" in found["said"]
    assert "goal_position: is a set point" in found["said"]
    assert "it never changes its sign" in found["text"]
    assert "inputs.v: this entry is missing" in found["said"]


def test_what_was_asked_for_is_no_measurement(tmp_path: Path) -> None:
    def check(head: str) -> None:
        found = draft(tmp_path, {**BASE, head: W})
        assert f"not used: {head}: is a set point" in found["said"]

    heads = ["goal_speed", "speed_ref", "setpoint speed", "cmd_vel", "target position", "n_soll"]
    for_each({head: (head,) for head in heads}, check)


# --- how a record begins, and when inputs act ------------------------------------------------------


def test_a_motion_that_follows_late_gets_a_wide_moment_of_the_input(tmp_path: Path) -> None:
    """Mutants killed: samples late are counted from zero; the past of the input is that of the speed."""

    def check(late: int, name: str) -> None:
        columns = {"t": T, "u": DRIVE, "y": response(late)}
        axis, unit = ("v_cart", "m/s") if name == "cart" else (f"w_{name}", "deg/s")
        found = draft(tmp_path, columns, "t=t [s]", f"u=u_{name} [V]", f"y={axis} [{unit}]")
        high = found["inputs"]["t_0"]["high"]
        assert high == pytest.approx(0.01 if late == 0 else 0.01 * (late + 2))
        assert ("seems to follow late" in found["text"]) == (late > 0)

    for_each(
        {f"{n} {k}": (k, n) for k, n in [(0, "a"), (1, "a"), (3, "rotor"), (2, "cart")]}, check
    )


@needs_cases
def test_a_delay_of_more_than_a_sample_lies_inside_the_prior(tmp_path: Path) -> None:
    """The truth is 25 ms; the speed is a difference of counts, with the noise of its steps."""
    names = ["t=t [s]", "u=u_rotor [V]", "y=w_rotor [deg/s]"]
    found = small("t0_prior_end/rec.csv", tmp_path, *names)
    assert found["inputs"]["t_0"]["low"] < 0.025 < 0.9 * found["inputs"]["t_0"]["high"] < 0.1
    sigma = found["record"]["channels"]["w_rotor"]["sigma"]
    assert sigma["low"] == pytest.approx(6.43 / np.sqrt(6) / 10, rel=0.01)
    assert "a difference of counts? It goes in steps of 6.4286 deg/s" in found["text"]
    accepted(tmp_path / "s.yaml")


def test_no_angle_is_freed_that_no_channel_sees(tmp_path: Path) -> None:
    """Only twists matter to speeds; a position is seen."""

    def check(names: Sequence[str], initial: object) -> None:
        columns = {"t": T, "u": DRIVE, "a": W, "b": response(1)}
        assert draft(tmp_path, columns, "t=t [s]", *names)["initial"] == initial

    free = {"w_a": "free", "w_b": "free", "theta_b": "free"}
    cases: list[tuple[list[str], object]] = [
        (["u=u_motor [V]", "a=w_motor [rad/s]"], {"w_motor": "free"}),
        (["u=i_a [A]", "a=w_a [rad/s]", "b=w_b [rad/s]"], free),
        (["u=f_cart [N]", "a=v_cart [m/s]"], {"v_cart": "free"}),
        (["u=u_motor [V]", "a=theta_motor [rad]"], "free"),
        (["u=f_cart [N]", "a=x_cart [m]"], "free"),
    ]
    for_each({names[-1]: (names, initial) for names, initial in cases}, check)


@needs_cases
def test_no_angle_of_a_small_case_is_freed_that_no_channel_sees(tmp_path: Path) -> None:
    names = ["t=t [s]", "u=u_motor [V]", "w=w_motor [rad/s]"]
    assert small("every_unknown/rec.csv", tmp_path, *names)["initial"] == {"w_motor": "free"}


def test_a_rest_before_the_motion_is_said(tmp_path: Path) -> None:
    rest = {"t": T, "u": DRIVE * (T > 1.5), "speed": response(0, DRIVE * (T > 1.5))}
    for names in ([], ["t=t [s]", "u=u_motor [V]", "speed=w_motor [rad/s]"]):
        text = draft(tmp_path, rest, *names)["text"]
        (begin,) = re.findall(r"Nothing moves before ([\d.]+) s", text)
        assert 1.4 < float(begin) < 1.7
    assert "Nothing moves before" not in draft(tmp_path, {**BASE, "speed": 5 + W})["text"]


# --- what is said of names and units ---------------------------------------------------------------

WRONG_NAMES = """
speed=2*w_1 [rad/s]   speed=w_größe [rad/s]  speed=w_<b> [rad/s]   speed=w_1 [1e400*rad/s]
speed=w_1 [rad/s      speed=w_1 rad/s]       speed=w_1 [[rad/s]]   speed=w_1 [deg]
speed=w_1 [count/0]   speed=x_cart [cm/560]  speed=w_1 []          speed=w_1 [rad/s] twice
speed=w_ground [rad/s]  speed=t_m [%]        speed=theta_2 [counts]  speed=x_cart [count/560]
""".replace("  ", "\n").strip()


def test_a_name_or_unit_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "r.csv", dict(BASE))

    def check(name: str) -> None:
        said = refusal(path, tmp_path / "r.yaml", columns=["t=t [s]", name])
        assert said.startswith("--columns:")
        assert "ground" in said or "count/(560/cm)" in said

    names = [line.strip() for line in WRONG_NAMES.splitlines() if line.strip()]
    assert len(names) == 16
    for_each({name: (name,) for name in names}, check)
    both = ["speed=w_s_a [rad/s]", "u=w_a [rad/s]"]
    assert "two things would be called w_s_a" in refusal(path, tmp_path / "r.yaml", columns=both)
    pair = ["speed=w_shaft [rad/s]", "u=w_load [rad/s]"]
    assert "called shaft" in refusal(path, tmp_path / "r.yaml", columns=pair)
    assert not (tmp_path / "r.yaml").exists()


def test_counts_and_shares_are_units(tmp_path: Path) -> None:
    """Their sizes are those of a turn, of a length and of what a drive is rated for."""

    def check(unit: str, name: str, written_unit: str, si: float) -> None:
        columns = {"t": T, "u": DRIVE, "y": np.round(400 * ANGLE)}
        drive = "t=t [s]", "u=f_cart [N]" if name == "x_cart" else "u=u_motor [V]"
        if name == "t_motor":
            columns, drive = {"t": T, "y": DRIVE, "u": W}, ("t=t [s]", "u=w_motor [rad/s]")
        found = draft(tmp_path, columns, *drive, f"y={name} [{unit}]")
        where = {**found["inputs"], **found["record"]["channels"]}
        assert where[name]["unit"] == written_unit
        job = bd.load(tmp_path / "r.yaml").job
        record = job.problem.experiment
        values = record.series[name] if name in record.series else record.y[:, 0]
        given = dict(columns)["y"][-1]
        assert values[-1] == pytest.approx(si * given, rel=1e-4)

    turn = 2 * np.pi / 2800
    cases = [
        ("count/2800", "theta_motor", "count/2800", turn),
        ("2800 counts per turn", "theta_motor", "count/2800", turn),
        ("count/(560/cm)", "x_cart", "count/(560/cm)", 1e-2 / 560),
        ("560 counts/cm", "x_cart", "count/(560/cm)", 1e-2 / 560),
        ("% of 9.84 mN*m", "t_motor", "% of 9.84 mN*m", 9.84e-5),
    ]
    for_each({case[0]: case for case in cases}, check)


@needs_cases
def test_a_linear_encoder_in_counts_has_a_unit(tmp_path: Path) -> None:
    drive = "t=t [s]", "u=u_cart [V]"
    said = refusal(SMALL / "linear_counts/rec.csv", columns=[*drive, "enc=x_cart [count/560]"])
    assert "count/(560/cm)" in said
    found = small("linear_counts/rec.csv", tmp_path, *drive, "enc=x_cart [count/(560/cm)]")
    assert found["record"]["channels"]["x_cart"]["unit"] == "count/(560/cm)"
    record = bd.load(tmp_path / "s.yaml").job.problem.experiment
    assert np.nanmax(record.y) == pytest.approx(3360 / 56000, rel=1e-6)


def test_it_is_said_who_has_said_a_unit(tmp_path: Path) -> None:
    """The head or the user; and a table without a head has none."""
    named = draft(tmp_path, BASE, "t=t [s]", "u=v [V]", "speed=w_2 [rad/s]")
    assert "unit rad/s, as `--columns` says" in named["text"]
    assert "100 samples a second, as `--columns` says" in named["text"]
    assert "by its head" not in named["text"]
    headed = draft(tmp_path, {"t [s]": T, "u [V]": DRIVE, "speed [rad/s]": W})
    assert "unit rad/s, by its head" in headed["text"]


def test_a_share_of_a_rated_torque_is_asked_for(tmp_path: Path) -> None:
    def check(head: str, kind: str) -> None:
        said = draft(tmp_path, {"t": T, "speed": W, head: DRIVE})["said"]
        assert f"is a share of the rated {kind}; look that up" in said
        assert f'--columns "{head}=t_m [% of 9.84 mN*m]"' in said

    for_each(
        {"torque": ("torque [%]", "torque"), "current": ("motor current (%)", "current")}, check
    )


def test_what_was_largest_is_named_or_left_out(tmp_path: Path) -> None:
    """Mutant killed: speeds along a line are not looked at, which left `by the largest ;`."""

    def check(names: Sequence[str], largest: str) -> None:
        columns = {"t": T, "u": DRIVE, "y": ANGLE}
        text = draft(tmp_path, columns, "t=t [s]", *names)["text"]
        (found,) = re.findall(r"by the largest ([^;]*);", text)
        assert re.fullmatch(largest, found)

    number = r"[\d.e+-]+"
    cases = {
        "x": (["y=x_cart [m]"], f"{number} m/s"),
        "f": (["u=f_cart [N]", "y=x_cart [m]"], f"{number} m/s, {number} N"),
        "w": (["u=i_a [A]", "y=theta_a [rad]"], f"{number} rad/s, {number} A"),
    }
    for_each(cases, check)


@needs_cases
def test_a_decay_of_a_cart_says_what_was_largest(tmp_path: Path) -> None:
    found = small("init_empty_sentence/a.csv", tmp_path, "t=t [s]", "x=x_cart [m]")
    assert "by the largest ;" not in found["text"]
    assert "by the largest 0.382 m/s;" in found["text"]
    accepted(tmp_path / "s.yaml")


# --- several records in one file, and none ---------------------------------------------------------


def repeated(folder: Path, *lengths: int) -> Path:
    long = {name: np.resize(x, 700) for name, x in BASE.items()} | {"t": 0.01 * np.arange(700)}
    parts = [{name: x[:n] for name, x in long.items()} for n in lengths]
    return written(folder / "r.csv", {n: np.concatenate([p[n] for p in parts]) for n in BASE})


def test_records_one_after_the_other_are_split(tmp_path: Path) -> None:
    """Each is an experiment of its rows; what is too short for a record is none.

    Mutants killed: rows are those of the numbers and not of the file; the last row is lost.
    """
    for lengths in ((300, 700), (700, 300), (100, 400)):
        assert "2 records in one file? Say --split" in refusal(repeated(tmp_path, *lengths))
    path = repeated(tmp_path, 300, 5, 400)
    said = refusal(path)
    assert "time goes back at line 307 (2.99 s to 0 s): 2 records in one file" in said
    assert "--split" in said
    found = made(path, split=True)
    assert found["experiments"] == {
        "run_1": {"record": {"file": "r.csv", "rows": [2, 301]}},
        "run_2": {"record": {"file": "r.csv", "rows": [307, 706]}},
    }
    first, second = map(reading.read, loading.load(tmp_path / "r.yaml").experiments)
    assert (len(first.t), len(second.t)) == (300, 400)
    np.testing.assert_allclose(second.y[:, 0] * 30 / np.pi, np.round(W, 5))
    assert second.t[-1] == pytest.approx(T[-1])


def test_other_files_and_rigs_are_split_too(tmp_path: Path) -> None:
    twice = {name: np.concatenate([x, x[:250]]) for name, x in BASE.items()}
    scipy.io.savemat(tmp_path / "r.mat", twice)
    names = ["t=t [s]", "u=u_motor [V]", "speed=w_motor [rad/s]"]
    found = made(tmp_path / "r.mat", split=True, columns=names)
    rows = [one["record"]["rows"] for one in found["experiments"].values()]
    assert rows == [[1, 400], [401, 650]]
    assert found["model"]["name"] == "train"
    second = reading.read(loading.load(tmp_path / "r.yaml").experiments[1])
    np.testing.assert_array_equal(second.y[:, 0], W[:250])
    alone = made(written(tmp_path / "one.csv", dict(BASE)), split=True)
    assert "experiments" not in alone
    lone = made(repeated(tmp_path, 9, 400), split=True)
    assert lone["record"]["rows"] == [11, 410]
    accepted(tmp_path / "r.yaml")


def test_rows_that_are_not_there_are_refused(tmp_path: Path) -> None:
    made(repeated(tmp_path, 300, 400), split=True)
    text = (tmp_path / "r.yaml").read_text()
    (tmp_path / "r.yaml").write_text(text.replace("rows: [302, 701]", "rows: [9000, 9999]"))
    with pytest.raises(bd.InputError, match="has no rows from 9000 to 9999"):
        bd.load(tmp_path / "r.yaml")


@needs_cases
def test_two_validation_runs_in_one_file(tmp_path: Path) -> None:
    for name, last in (("rec.csv", 81), ("rec400.csv", 801)):
        path = SMALL / "validation_two_records" / name
        half = (last - 1) // 2
        said = refusal(path, tmp_path / "s.yaml", force=True)
        assert f"time goes back at line {half + 2} (" in said
        found = small(f"validation_two_records/{name}", tmp_path, split=True, voltage=3.0)
        rows = [one["record"]["rows"] for one in found["experiments"].values()]
        assert rows == [[2, half + 1], [half + 2, last]]
        accepted(tmp_path / "s.yaml")


def test_a_record_in_which_nothing_moves_is_refused_in_one_sentence(tmp_path: Path) -> None:
    """Mutants killed: one column that stands still is enough; references move."""
    still = {"t": T, "u": DRIVE, "speed": 0 * T, "angle": 0 * T + 3, "goal angle": W}
    said = refusal(written(tmp_path / "r.csv", still))
    assert "nothing moved: speed, angle are the same in every row" in said
    assert "\n" not in said
    names = ["t=t [s]", "u=u_cart [V]", "speed=x_cart [m]"]
    assert "nothing moved: speed are" in refusal(tmp_path / "r.csv", columns=names)
    test = np.column_stack([T, *(0 * T + 2.4e-311 for _ in range(8))]).tolist()
    (tmp_path / "r.json").write_text(str({"slow-forward": test}).replace("'", '"'))
    assert "nothing moved: slow-forward.left position" in refusal(tmp_path / "r.json")
    assert [*told(draft(tmp_path, {**still, "angle": ANGLE}))] == ["theta_2"]


# --- what is given, and what is lost ---------------------------------------------------------------


def test_arguments_that_no_rig_has_are_input_errors(tmp_path: Path) -> None:
    path = written(tmp_path / "r.csv", dict(BASE))
    numbers = [1e155, 1e400, -1e400, float("nan"), 10**400, -3, 0, 1e-320]
    for name in ("gear", "voltage", "rate"):
        for value in numbers:
            try:
                bd.init(path, tmp_path / "r.yaml", force=True, **{name: value})
            except bd.InputError:
                continue
            assert name == "voltage"
            assert abs(value) < 10


def test_no_file_that_is_read_is_replaced(tmp_path: Path) -> None:
    """Nor by another name of it."""
    path, sheet = written(tmp_path / "r.csv", dict(BASE)), tmp_path / "sheet.yaml"
    sheet.write_text("k_T: 0.3\n")
    (tmp_path / "link.yaml").symlink_to(sheet)
    (tmp_path / "hard.yaml").hardlink_to(sheet)
    for output in (sheet, tmp_path / "link.yaml", tmp_path / "hard.yaml"):
        done = command_line.cli("init", path, "--sheet", sheet, "-o", output, "--force")
        assert done.status == 2
        assert sheet.read_text() == "k_T: 0.3\n"


def test_a_data_sheet_with_a_key_twice_is_refused(tmp_path: Path) -> None:
    path, sheet = written(tmp_path / "r.csv", dict(BASE)), tmp_path / "sheet.yaml"
    sheet.write_text("k_T: 3\nk_e: 1\nk_T: 4\n")
    assert "sheet.yaml:3: k_T: this key stands already in line 1" in refusal(path, sheet=sheet)


def test_what_is_a_folder_is_no_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = command_line.cli("init", ".")
    assert done.status == 2
    assert "Traceback" not in done.err


def test_a_wide_table_is_summed_up(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    more = {f"c{k}": rng.normal(size=len(T)) for k in range(60)}
    said = draft(tmp_path, {**BASE, **more})["said"]
    assert len(said.splitlines()) < 30
    assert "not used: others, see the config" in said


def test_check_draws_the_record_of_each_experiment(tmp_path: Path) -> None:
    made(repeated(tmp_path, 300, 400), split=True)
    done = command_line.cli("check", tmp_path / "r.yaml", "--figure-record", tmp_path / "seen.png")
    assert done.status == 0
    for k in (1, 2):
        assert (tmp_path / f"seen_{k}.png").read_bytes().startswith(b"\x89PNG")
        assert f"seen_{k}.png" in done.out
    case = bd.load(tmp_path / "r.yaml")
    with pytest.raises(bd.InputError, match=r"--figure-record: 'seen\.gif' is none of \.pdf"):
        case.draw_record(tmp_path / "seen.gif")


# --- files -----------------------------------------------------------------------------------------


def test_an_array_of_structs_is_read_with_names_and_units(tmp_path: Path) -> None:
    y = np.zeros((1, 2), dtype=[(name, "O") for name in ("Name", "Data", "Unit", "XIndex")])
    y[0, 0], y[0, 1] = ("Model/speed", W[None], "rad/s", 1), ("u", DRIVE[None], "mV", 1)
    scipy.io.savemat(tmp_path / "r.mat", {"run": {"X": {"Data": T[None], "Name": ""}, "Y": y}})
    found = made(tmp_path / "r.mat")
    assert told(found) == {"w_2": ("run.Y(1).Data", "rad/s")}
    assert found["inputs"]["v"]["unit"] == "mV"
    assert found["record"]["time"] == {"column": "run.X.Data", "unit": "s"}
    accepted(tmp_path / "r.yaml")
    names = ["run.Y(2).Data=i_motor [mA]", "run.Y(1).Data=w_motor [rad/s]"]
    train = made(tmp_path / "r.mat", columns=names)
    assert train["record"]["time"]["column"] == "run.X.Data"
    assert told(train) == {"w_motor": ("run.Y(1).Data", "rad/s")}
    accepted(tmp_path / "r.yaml")


@needs_cases
def test_a_capture_of_a_control_desk(tmp_path: Path) -> None:
    found = small("struct_array/rec.mat", tmp_path)
    assert found["inputs"]["v"]["column"] == "capture.Y(2).Data"
    assert told(found)["w_2"][0] == "capture.Y(1).Data"
    accepted(tmp_path / "s.yaml")


@needs_cases
def test_the_head_of_a_recorder_is_passed_over(tmp_path: Path) -> None:
    found = small("epos_head/e.csv", tmp_path)
    assert found["record"]["time"] == {"column": 1, "unit": "ms"}
    assert told(found) == {"w_2": ("Velocity actual value averaged", "rpm")}
    assert "is a share of the rated torque" in found["said"]
    names = ["1=t [ms]", "2=w_2 [rpm]", "3=t_m [% of 9.84 mN*m]"]
    motor = small("epos_head/e.csv", tmp_path, *names, rig="motor")
    assert motor["inputs"]["t_m"]["unit"] == "% of 9.84 mN*m"
    record = bd.load(tmp_path / "s.yaml").job.problem.experiment
    assert record.series["t_m"][0] == pytest.approx(0.3 * 9.84e-3)
    assert bd.load(SMALL / "epos_head/e2.yaml")


@needs_cases
def test_rows_that_end_in_a_semicolon_are_read(tmp_path: Path) -> None:
    names = ["1=v [V]", "3=w_2 [rad/s]", "2=i [A]"]
    for name in ("r.txt", "r3.txt", "r4.txt"):
        found = small(f"trailing_semicolon/{name}", tmp_path, *names, rig="motor", rate=200)
        assert told(found) == {"w_2": ("3", "rad/s"), "i": ("2", "A")}
        accepted(tmp_path / "s.yaml")
    assert bd.load(SMALL / "trailing_semicolon/r2.yaml")


@needs_cases
def test_rows_in_json_are_read_or_named(tmp_path: Path) -> None:
    said = refusal(SMALL / "json_recipe/rows.json", tmp_path / "s.yaml")
    assert "slow-forward, column 3; fast-forward, column 1" in said
    assert "has 3 values, and 20 are wanted" in said
    assert "python -c" not in said


# --- records of others -----------------------------------------------------------------------------


@needs_cases
def test_a_drive_whose_encoders_are_dead_is_refused() -> None:
    (path,) = (CASES / "frc_drive_dead_encoder").glob("*.json")
    said = refusal(path)
    assert "nothing moved: slow-forward.left position, " in said
    assert "\n" not in said
    names = ["slow-forward.time [s]=t [s]", "slow-forward.left speed=w_2 [rad/s]"]
    assert "nothing moved" in refusal(path, columns=names)


@needs_cases
def test_a_brushless_motor_of_which_a_capture_names_nothing(tmp_path: Path) -> None:
    path = CASES / "dspace_bldc" / "dataset.mat"
    said = refusal(path)
    assert "column cigan.Y(3).Data (-0.7514 to 0.7514): its name does not say" in said
    names = ["cigan.Y(2).Data=w_rotor [rad/s]", "cigan.Y(3).Data=u_rotor [V]"]
    bd.init(path, tmp_path / "s.yaml", columns=names)
    record = reading.read(loading.load(tmp_path / "s.yaml").experiments[0])
    assert len(record.t) == 8334
    assert record.dt == pytest.approx(0.72e-3)
    assert "Nothing moves before 0.0295" in (tmp_path / "s.yaml").read_text()


@needs_cases
def test_screw_drives_in_exports_of_their_controller(tmp_path: Path) -> None:
    """All are read; one was opened in a spreadsheet, and a cell of it mended by hand."""
    names = ["1=t [ms]", "2=w_2 [rpm]", "3=t_m [% of 9.84 mN*m]"]
    paths = sorted((CASES / "ucl_screw_drives").rglob("*.csv"))
    assert len(paths) == 40
    for path in paths:
        if path.name == "steady_2.csv" and path.parent.name == "drive3":
            said = refusal(path)
            assert "line 15: column 'Torque actual value averaged': '-800,,was -11.1'" in said
            continue
        bd.init(path, tmp_path / "s.yaml", columns=names, rig="motor", force=True)
        record = reading.read(loading.load(tmp_path / "s.yaml").experiments[0])
        assert len(record.t) == 500


@needs_cases
def test_a_servo_that_was_told_a_goal(tmp_path: Path) -> None:
    for path in (CASES / "kscale_sts3215").glob("*.json"):
        said = bd.init(path, tmp_path / "s.yaml", force=True)
        assert {*said.channels} >= {"theta_2", "i"}
        assert "entries.goal_position: is a set point" in str(said)
        assert "entries.input_volts: hardly changes while the rig turns both ways" in str(said)
        assert "it never changes its sign" in " ".join(said.text.replace("#", " ").split())
        assert [issue.place.rpartition(" ")[2] for issue in said.asks] == ["inputs.v"]
