"""Records as they come: uneven times, missing samples, masks, several files and clocks, raw angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import for_each

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.records import reading
from bayesdrill.record import clocks
from bayesdrill.record.experiment import Experiment

HELD = ("j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "j_1", "t_f")
PARAMETERS = (
    "parameters:\n  k_s: {prior: uniform, low: 0.5, high: 1.5, relative: true}\n"
    + "".join(f"  {name}: nominal\n" for name in HELD)
)

T = 0.3 + np.arange(240) * 0.01
RNG = np.random.default_rng(6)
SPEED = 9.0 + 4.0 * np.sin(7.0 * T) + 0.01 * RNG.standard_normal(len(T))
ANGLE = 20.0 * T - np.cos(5.0 * T) + 0.01 * RNG.standard_normal(len(T))
SUPPLY = 8.0 + np.round(np.sin(3.0 * T), 1)
MOTION = "  time: {column: t, unit: s}\n  channels:\n    w_1: {column: w, unit: rad/s, sigma: 0.1"


def save(folder: Path, name: str = "r.csv", **columns: np.ndarray | list[str]) -> None:
    """Columns of numbers, or of cells as they stand."""
    cells = [
        [x if isinstance(x, str) else f"{x:.12g}" for x in column] for column in columns.values()
    ]
    lines = [",".join(columns), *(",".join(row) for row in zip(*cells, strict=True))]
    (folder / name).write_text("\n".join(lines) + "\n")


def cells(values: np.ndarray, *missing: int) -> list[str]:
    return ["" if k in missing else f"{x:.12g}" for k, x in enumerate(values)]


def one(folder: Path, record: str = "", channel: str = "", inputs: str = "{v: 8}") -> Experiment:
    path = folder / "mine.yaml"
    own = f"  file: r.csv\n{record}{MOTION}{channel}}}"
    path.write_text(f"name: mine\nseed: 1\nrecord:\n{own}\ninputs: {inputs}\n{PARAMETERS}")
    return reading.read(loading.load(path).experiments[0])


def refused(folder: Path, *arguments: str) -> str:
    with pytest.raises(InputError) as caught:
        one(folder, *arguments)
    return str(caught.value)


# --- times -----------------------------------------------------------------------------------------

GAPS = np.r_[0:50, 57:58, 60:200, 201:240]


def test_times_with_gaps_are_put_on_their_grid(tmp_path: Path) -> None:
    """Mutant killed: times with few digits taken as they stand."""
    third = (0.3 + np.arange(240) / 300)[GAPS]
    save(tmp_path, t=np.round(third, 6), w=SPEED[GAPS])
    found = one(tmp_path)
    assert not found.uniform
    assert found.counts == (len(GAPS),)
    np.testing.assert_allclose(found.t, third, rtol=0, atol=3e-7)
    steps = np.diff(found.t) / found.dt
    np.testing.assert_allclose(steps, np.diff(GAPS), rtol=0, atol=1e-6)
    np.testing.assert_array_equal(
        found.y[:, 0], np.array([float(f"{x:.12g}") for x in SPEED[GAPS]])
    )


def test_even_times_are_the_files_own(tmp_path: Path) -> None:
    uneven = np.round(np.arange(240) / 300, 6)
    save(tmp_path, t=uneven, w=SPEED)
    assert one(tmp_path).t.tolist() == uneven.tolist()


def test_jittered_times_arrive_as_they_are(tmp_path: Path) -> None:
    t = T + 0.002 * RNG.uniform(-1, 1, len(T))
    save(tmp_path, t=t, w=SPEED)
    found = one(tmp_path)
    assert not found.uniform
    assert found.t.tolist() == [float(f"{x:.12g}") for x in t]


# --- missing samples -------------------------------------------------------------------------------


def test_missing_samples_are_left_out_where_that_is_asked_for(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=cells(SPEED, 0, 7, 8, 100))
    said = refused(tmp_path)
    assert "4 values without a number, at line 2, line 9, line 10, line 102" in said
    assert "leave them out (record.missing: drop)" in said
    found = one(tmp_path, "  missing: drop\n")
    assert found.uniform
    assert np.flatnonzero(~found.seen[:, 0]).tolist() == [0, 7, 8, 100]
    assert found.counts == (236,)
    assert "w_1: 4 missing samples are left out" in found.told


def test_an_overflow_is_no_missing_sample(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=[*cells(SPEED[:-1]), "Inf"])
    said = refused(tmp_path, "  missing: drop\n")
    assert "1 value without a number, at line 241" in said


def test_missing_samples_of_an_input_are_bridged_by_its_hold(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Mutant killed: the hold of the other kind."""
    cases = [("zero", [5.0, 5.0, 5.0, 11.0]), ("first", [5.0, 7.0, 9.0, 11.0])]

    def check(hold: str, expected: list[float]) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        supply = SUPPLY.copy()
        supply[[30, 33]] = 5.0, 11.0
        save(tmp_path, t=T, w=SPEED, u=cells(supply, 31, 32))
        entry = f"{{v: {{column: u, unit: V, hold: {hold}MORE}}}}"
        said = refused(tmp_path, "", "", entry.replace("MORE", ""))
        assert "column 'u' has 2 values without a number, at line 33, line 34" in said
        assert "bridge them (missing: hold)" in said
        found = one(tmp_path, "", "", entry.replace("MORE", ", missing: hold"))
        assert found.series["v"][30:34] == pytest.approx(expected)
        assert np.isfinite(found.series["v"]).all()
        assert f"v: 2 samples are bridged, hold: {hold}" in found.told

    for_each({case[0]: case for case in cases}, check)


def test_what_no_sample_holds_is_refused(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(hold: str, row: int) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        save(tmp_path, t=T, w=SPEED, u=cells(SUPPLY, row))
        said = refused(
            tmp_path, "", "", f"{{v: {{column: u, unit: V, hold: {hold}, missing: hold}}}}"
        )
        assert f"at line {row + 2}" in said
        assert "record.window" in said

    for_each({str(case): case for case in [("zero", 0), ("first", 0), ("first", 239)]}, check)


# --- windows ---------------------------------------------------------------------------------------


def test_between_several_windows_the_rig_goes_on(tmp_path: Path) -> None:
    """Times and inputs stay, samples do not.  Mutant killed: samples between windows used."""
    save(tmp_path, t=T, w=SPEED, u=SUPPLY)
    inputs = "{v: {column: u, unit: V}}"
    found = one(tmp_path, "  window: [[0.5, 0.7], [1.2, 1.25], [2.0, 2.4]]\n", "", inputs)
    assert found.t == pytest.approx(np.arange(50, 241) * 0.01)
    used = np.concatenate([np.arange(50, 71), np.arange(120, 126), np.arange(200, 241)]) / 100
    assert found.t[found.seen[:, 0]] == pytest.approx(used)
    assert found.series["v"] == pytest.approx(SUPPLY[20:211])
    assert found.t_start == found.t[0]
    assert found.uniform


def test_a_list_of_one_window_is_that_window(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=SPEED)
    several, plain = (one(tmp_path, f"  window: {w}\n") for w in ("[[0.5, 0.7]]", "[0.5, 0.7]"))
    np.testing.assert_array_equal(several.t, plain.t)
    np.testing.assert_array_equal(several.y, plain.y)


def test_windows_that_mean_nothing(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ("[[0.7, 0.5]]", "0.7 s is not before 0.5 s"),
        ("[[1, 2], [0.5, 0.7]]", "put them in order"),
        ("[[0.5, 1.2], [1, 2]]", "a window that begins at 1 s stands after one that ends at 1.2 s"),
        ("[[7, 8]]", "no sample lies in it: the record goes from 0.3 to 2.69 s"),
        ("[[0.5, 0.7], 3]", "3"),
    ]

    def check(window: str, says: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        save(tmp_path, t=T, w=SPEED)
        said = refused(tmp_path, f"  window: {window}\n")
        assert says in said
        assert "record.window" in said

    for_each({case[0]: case for case in cases}, check)


# --- masks and glitches ----------------------------------------------------------------------------

SPIKED = SPEED.copy()
SPIKED[[60, 61, 150]] = -90.0


def test_glitches_are_listed_with_rows_and_times_and_left_alone(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=SPIKED)
    found = one(tmp_path)
    (odd,) = found.odd
    said = odd.in_words(5)
    assert said.startswith("glitches: w_1 leaves its course")
    assert "2 places (3 samples): line 62 to 63 (0.9 to 0.91 s); line 152 (1.8 s)" in said
    assert "record.channels.w_1: mask: glitches" in said
    assert odd.in_words(1).count("line") == 1
    assert found.seen.all()
    assert found.told == ()


def test_masks_leave_out_what_they_name(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Mutants killed: rows counted from another end; one end of a span left in."""
    cases = [
        ("glitches", [60, 61, 150]),
        ("{glitches: true}", [60, 61, 150]),
        ("{rows: [[62, 63]]}", [60, 61]),
        ("{times: [[1.8, 1.8], [2.0, 2.02]]}", [150, 170, 171, 172]),
        ("{glitches: true, rows: [[2, 4]], times: [[1.0, 1.01]]}", [0, 1, 2, 60, 61, 70, 71, 150]),
    ]

    def check(mask: str, gone: list[int]) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        save(tmp_path, t=T, w=SPIKED)
        found = one(tmp_path, "", f", mask: {mask}")
        assert np.flatnonzero(~found.seen[:, 0]).tolist() == gone
        assert found.told

    for_each({case[0]: case for case in cases}, check)


def test_a_glitch_of_an_input_is_held_over_on_request(tmp_path: Path) -> None:
    supply = SUPPLY.copy()
    supply[90] = 250.0
    save(tmp_path, t=T, w=SPEED, u=supply)
    left = one(tmp_path, "", "", "{v: {column: u, unit: V}}")
    assert left.series["v"][90] == 250.0
    assert "glitches: v leaves its course" in left.odd[0].in_words(1)
    held = one(tmp_path, "", "", "{v: {column: u, unit: V, mask: glitches}}")
    assert held.series["v"][90] == held.series["v"][89] == pytest.approx(SUPPLY[89])
    assert held.odd == ()


def test_masked_samples_may_be_missing(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=cells(SPEED, 20, 21))
    assert one(tmp_path, "", ", mask: {rows: [[22, 23]]}").counts == (238,)
    said = refused(tmp_path, "", ", mask: {rows: [[22, 22]]}")
    assert "1 value without a number, at line 23" in said


def test_masks_that_mean_nothing(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ("gliches", "did you mean glitches"),
        (
            "{rows: [[500, 600]]}",
            "no sample lies from 500 to 600: those that are used go from 2 to 241",
        ),
        ("{times: [[2, 1]]}", "no sample lies from 2 to 1 s"),
        ("{rows: [[5]]}", "1 entries stand here, wanted are at least 2"),
        ("{times: [[0, 9]]}", "has no number that is used; check missing samples, masks"),
    ]

    def check(mask: str, says: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        save(tmp_path, t=T, w=SPEED)
        assert says in refused(tmp_path, "", f", mask: {mask}")

    for_each({case[0]: case for case in cases}, check)


def test_ends_of_a_range_and_stuck_counts_are_named(tmp_path: Path) -> None:
    clipped = np.minimum(9.0 + 40.0 * np.sin(9.0 * T) + 0.1 * RNG.standard_normal(240), 40.0)
    save(tmp_path, t=T, w=clipped)
    (odd,) = one(tmp_path).odd
    assert odd.in_words(1).startswith("saturated: w_1 runs into exactly the same value, 40 rad/s")
    stuck = SPEED.copy()
    stuck[100:130] = stuck[100]
    save(tmp_path, t=T, w=stuck)
    (odd,) = one(tmp_path).odd
    assert "stuck: w_1 stays at exactly one value for 30 samples, from 1.3 to 1.59 s" in odd.text
    assert odd.where == ("line 102 to 131 (1.3 to 1.59 s)",)


# --- several files ---------------------------------------------------------------------------------


def test_every_column_may_have_its_own_file_and_clock(tmp_path: Path) -> None:
    """Nothing is resampled: each sample stands at its own time, and there alone."""
    slow, late = np.arange(0.3, 2.69, 0.04), 0.005 + np.arange(60) * 0.03
    save(tmp_path, t=T, w=SPEED)
    save(
        tmp_path, "angle.csv", **{"time [ms]": 1000 * (slow - 0.1)}, phi=np.arange(len(slow)) ** 2.0
    )
    save(tmp_path, "supply.csv", t=late, u=5.0 + np.arange(60) % 7)
    more = (
        "}\n    theta_1: {file: angle.csv, time: {column: 'time [ms]', unit: ms, offset: 100}, "
        "column: phi, unit: deg, sigma: 1"
    )
    window = "  window: [0.35, 1.7]\n"
    found = one(tmp_path, window, more, "{v: {file: supply.csv, column: u, unit: V}}")
    inside = [x[(x > 0.3499) & (x < 1.7001)] for x in (T, slow, late)]
    every = np.unique(np.round(np.concatenate(inside), 9))
    assert found.t == pytest.approx(every, abs=1e-9)
    for k, (times, values) in enumerate(
        ((T, SPEED), (slow, np.radians(np.arange(len(slow)) ** 2.0)))
    ):
        used = (times > 0.3499) & (times < 1.7001)
        assert found.t[found.seen[:, k]] == pytest.approx(times[used])
        assert found.y[found.seen[:, k], k] == pytest.approx(values[used])
    last = np.searchsorted(late, found.t + 1e-9, side="right") - 1
    assert found.series["v"].tolist() == (5.0 + last % 7).tolist()
    assert found.input_steps == {"v": pytest.approx(0.03)}


def test_the_same_clock_in_two_files_is_one(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=SPEED)
    save(tmp_path, "more.csv", t=T, phi=ANGLE)
    found = one(tmp_path, "", "}\n    theta_1: {file: more.csv, column: phi, unit: rad, sigma: 1")
    assert found.seen.all()
    assert found.uniform
    assert found.t.tolist() == [float(f"{x:.12g}") for x in T]


def test_one_clock_written_with_other_digits_is_suspected(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=SPEED)
    save(tmp_path, "more.csv", t=T + 3e-7 * RNG.standard_normal(len(T)), phi=ANGLE)
    found = one(tmp_path, "", "}\n    theta_1: {file: more.csv, column: phi, unit: rad, sigma: 1")
    assert "give both columns the same `time:`" in found.odd[0].in_words(1)
    assert f"{len(found.t)} times of 2 clocks (240, 240 samples)" in found.told[0]


def test_an_input_of_one_sample_is_held(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=SPEED)
    save(tmp_path, "once.csv", t=T[:1], u=np.array([7.5]))
    found = one(tmp_path, "", "", "{v: {file: once.csv, column: u, unit: V}}")
    assert set(found.series["v"]) == {7.5}
    assert found.uniform


def test_a_file_may_be_written_otherwise(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=SPEED)
    rows = (f"{k};{x:.6f}".replace(".", ",") for k, x in enumerate(ANGLE))
    (tmp_path / "more.log").write_text("a title\n" + "\n".join(rows) + "\n")
    more = (
        "}\n    theta_1: {file: {path: more.log, format: csv, skip_rows: 1, header: false, "
        "decimal: ','}, time: {rate: 100, offset: 0.3}, column: 2, unit: rad, sigma: 1"
    )
    found = one(tmp_path, "", more)
    assert found.y[:, 1] == pytest.approx(np.round(ANGLE, 6))


def test_an_input_is_known_where_it_is_needed(tmp_path: Path) -> None:
    save(tmp_path, t=T, w=SPEED)
    save(tmp_path, "late.csv", t=T[5:], u=SUPPLY[5:])
    save(tmp_path, "short.csv", t=T[:-9], u=SUPPLY[:-9])
    late = refused(tmp_path, "", "", "{v: {file: late.csv, column: u, unit: V}}")
    assert "v is known from 0.35 to 2.69 s, and the record goes from 0.3 to 2.69 s" in late
    assert "give a record.window inside both" in late
    short = refused(tmp_path, "", "", "{v: {file: short.csv, column: u, unit: V, hold: first}}")
    assert "or `hold: zero`" in short
    held = one(tmp_path, "", "", "{v: {file: short.csv, column: u, unit: V}}")
    assert set(held.series["v"][-9:]) == {SUPPLY[-10]}
    assert "v: held after its last sample at 2.6 s" in held.told
    cut = one(tmp_path, "  window: [0.355, 2]\n", "", "{v: {file: late.csv, column: u, unit: V}}")
    assert cut.series["v"][0] == pytest.approx(SUPPLY[6])


def test_files_that_mean_nothing(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ("file: gone.csv, column: phi", "there is no such file"),
        ("file: odd.csv, column: phi", "give this entry its own `time:`"),
        ("file: odd.csv, column: fi, time: {rate: 9}", "has no column 'fi'; known: x, phi"),
        ("file: {path: odd.csv, format: cvs}, column: phi, time: {rate: 9}", "did you mean csv"),
        ("file: odd.csv, column: phi, time: {column: x, unit: m}", "not a unit of s"),
        (
            "file: odd.csv, column: phi, time: {column: x, unit: s}",
            "time does not increase, at line 3",
        ),
        ("file: {file: odd.csv}, column: phi", "unknown key"),
    ]

    def check(more: str, says: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        save(tmp_path, t=T, w=SPEED)
        save(tmp_path, "odd.csv", x=-T, phi=ANGLE)
        said = refused(tmp_path, "", f"}}\n    theta_1: {{{more}, unit: rad, sigma: 1")
        assert says in said
        assert "theta_1" in said

    for_each({case[0]: case for case in cases}, check)


# --- angles ----------------------------------------------------------------------------------------


def test_angles_that_begin_again_are_unwrapped(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ("deg", "true", 360.0),
        ("deg", "360", 360.0),
        ("count/4096", "true", 4096.0),
        ("rad", "true", 2 * np.pi),
    ]

    def check(unit: str, wraps: str, turn: float) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        raw = np.mod(ANGLE / (2 * np.pi) * turn, turn)
        save(tmp_path, t=T, w=SPEED, phi=raw)
        more = f"}}\n    theta_1: {{column: phi, unit: {unit}, wraps: {wraps}, sigma: 1"
        found = one(tmp_path, "", more)
        assert found.y[:, 1] - found.y[0, 1] == pytest.approx(ANGLE - ANGLE[0])
        jumps = int(np.sum(np.abs(np.diff(raw)) > turn / 2))
        assert jumps > 5
        assert any(f"theta_1: unwrapped {jumps} jumps" in one for one in found.told)

    for_each({str(case): case for case in cases}, check)


def test_a_jump_that_may_be_either_way_is_refused(tmp_path: Path) -> None:
    raw = np.degrees(ANGLE)
    raw[80:] += 178.0
    save(tmp_path, t=T, w=SPEED, phi=raw)
    more = "}\n    theta_1: {column: phi, unit: deg, wraps: 360, sigma: 1"
    said = refused(tmp_path, "", more)
    assert "at line 82 (1 such jumps), nearly half of 360" in said
    assert "record at a higher rate" in said


def test_sensors_that_mean_nothing(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ("w_2: {column: w, unit: rad/s, wraps: true, sigma: 1}", "is no angle; say after how much"),
        ("w_2: {column: w, unit: count/4096, sigma: 1}", "is an angle, not a unit of rad/s"),
        ("theta_1: {column: w, unit: count, sigma: 1}", "count/4096 of an encoder"),
        ("theta_1: {column: w, unit: count/0, sigma: 1}", "has no counts in a turn"),
        ("theta_1: {column: w, unit: rad, derived_from: w_2, sigma: 1}", "is no other channel"),
        ("theta_1: {column: w, unit: rad, derived_from: theta_1, sigma: 1}", "is no other channel"),
    ]

    def check(channel: str, says: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        save(tmp_path, t=T, w=SPEED)
        assert says in refused(tmp_path, "", "}\n    " + channel[:-1])

    for_each({case[0]: case for case in cases}, check)


def test_a_derived_channel_is_compared_and_not_counted(tmp_path: Path) -> None:
    """Mutant killed: a derived channel as evidence."""
    speed = np.degrees(np.diff(ANGLE, prepend=ANGLE[0]) / 0.01)
    save(tmp_path, t=T, w=SPEED, phi=ANGLE, q=speed)
    more = (
        "}\n    theta_1: {column: phi, unit: rad, sigma: 1}"
        "\n    w_2: {column: COLUMN, unit: deg/s, derived_from: theta_1, sigma: 1"
    )
    found = one(tmp_path, "", more.replace("COLUMN", "q"))
    assert found.names == ("w_1", "theta_1")
    assert found.y.shape == (240, 2)
    (said,) = found.told
    assert said.startswith("w_2 is not counted, as it is derived from theta_1")
    assert "1 times the backward difference quotient of theta_1" in said
    assert found.odd == ()
    other = one(tmp_path, "", more.replace("COLUMN", "w"))
    assert "if it was measured by a sensor of its own, remove derived_from" in other.odd[
        0
    ].in_words(1)


# --- decimation ------------------------------------------------------------------------------------

LONG = np.arange(3000) / 1000
SLOW = 9.0 + np.sin(11.0 * LONG)


def test_decimated_channels_stay_at_their_times(tmp_path: Path) -> None:
    save(tmp_path, t=LONG, w=SLOW + 0.2 * np.sin(2500.0 * LONG))
    found = one(tmp_path, "  decimate: {factor: 10}\n")
    assert found.uniform
    assert found.dt == pytest.approx(0.01)
    assert found.t[0] == pytest.approx(0.1)
    assert found.t_start == 0.0
    assert found.y[:, 0] == pytest.approx(9.0 + np.sin(11.0 * found.t), abs=1e-3)
    (said,) = found.told
    assert (
        f"zero-phase FIR of {clocks.filter_length(10)} samples, half of the amplitude at 40 Hz"
        in said
    )
    assert "took away (sd) 0.14" in said


def test_inputs_stay_at_every_time_when_channels_are_decimated(tmp_path: Path) -> None:
    """Mutant killed: inputs thinned like channels, so that steps between samples are lost."""
    supply = np.where(LONG < 1.234, 3.0, 8.0)
    save(tmp_path, t=LONG, w=SLOW, u=supply)
    found = one(tmp_path, "  decimate: {factor: 10}\n", "", "{v: {column: u, unit: V}}")
    assert found.series["v"].tolist() == supply.tolist()
    assert np.flatnonzero(found.seen[:, 0]).tolist() == list(range(100, 2900, 10))
    assert found.t_start == found.t[0] == 0.0


def test_without_a_filter_samples_are_left_as_they_are_at_their_times(tmp_path: Path) -> None:
    """Of a record with a gap.  Mutants killed: a filter all the same, samples of a grid of their own."""
    rows = np.r_[0:2000, 2005:3000]
    noisy = SLOW + 0.2 * np.sin(2500.0 * LONG)
    save(tmp_path, t=LONG[rows], w=noisy[rows])
    found = one(tmp_path, "  decimate: {factor: 10, filter: false}\n")
    assert found.t == pytest.approx(LONG[rows][::10], abs=1e-12)
    assert found.y[:, 0] == pytest.approx(noisy[rows][::10], abs=1e-9)
    (said,) = found.told
    assert "one sample of 10 is left (300 of 2995 of w_1), as it was measured" in said


def test_without_a_filter_each_channel_has_its_own_and_inputs_every_one(tmp_path: Path) -> None:
    """Where one of them has no sample, it has the next; what is held out stays whole."""
    angle, supply = SLOW + LONG, np.where(LONG < 1.234, 3.0, 8.0)
    angle[:7] = np.nan
    save(tmp_path, t=LONG, w=SLOW, phi=angle, u=supply)
    more = "}\n    theta_1: {column: phi, unit: rad, sigma: 1"
    record = "  missing: drop\n  held_out: [1, 1.2]\n  decimate: {factor: 10, filter: false}\n"
    found = one(tmp_path, record, more, "{v: {column: u, unit: V}}")
    assert found.series["v"].tolist() == supply.tolist()
    speeds, angles = (np.flatnonzero(found.seen[:, k]) for k in (0, 1))
    assert speeds.tolist() == [*range(0, 1000, 10), *range(1201, 3000, 10)]
    assert angles[:3].tolist() == [7, 17, 27]
    assert found.held_out is not None
    assert np.count_nonzero(~np.isnan(found.held_out[:, 0])) == 201


def test_without_a_filter_some_samples_have_to_be_left(tmp_path: Path) -> None:
    save(tmp_path, t=LONG[:90], w=SLOW[:90])
    said = refused(tmp_path, "  decimate: {factor: 10, filter: false}\n")
    assert "90 samples are too few: 91 leave 10; take a smaller factor" in said


def test_what_cannot_be_filtered(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        (np.r_[0:2000, 2005:3000], "", "a filter needs equal time steps"),
        (
            np.r_[0:3000],
            "  window: [[0, 1], [1.5, 2.5]]\n",
            "499 of w_1 are missing, masked or outside",
        ),
        (np.r_[0:250], "", "250 samples are too few: 291 leave 10; take a smaller factor"),
    ]

    def check(rows: np.ndarray, record: str, says: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        save(tmp_path, t=LONG[rows], w=SLOW[rows])
        said = refused(tmp_path, f"{record}  decimate: {{factor: 10}}\n")
        assert says in said
        assert "record.decimate" in said

    for_each({str(case): case for case in cases}, check)
