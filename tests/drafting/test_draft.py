"""Whole drafts: what they say where the truth is known, and that a config that is written is valid."""

from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import command_line, first_configs
from support.case_tables import read_table, run_cases
from support.first_configs import (
    RECORD,
    channels_of,
    draft_of,
    german_record,
    refusal,
    shared,
    spoilt_record,
    write_table,
)
from support.small_problems import starts_believed

import bayesdrill as bd
from bayesdrill.config import loading
from bayesdrill.config.records import simulation

CONFIGS = command_line.ROOT / "configs"


TABLE = Path(__file__).with_name("drafts.yaml")
CASES = read_table(TABLE)
SIGNALS = {
    **vars(first_configs),
    "COUNT": np.arange(400.0),
    "BATTERY": 12 + 0.05 * np.sin(40 * first_configs.T),
    "BENCH": first_configs.reversing_rig(),
    "GERMAN": german_record(),
}


def records_of(case: dict[str, Any], folder: Path) -> list[Path | list[Path]]:
    """Each is drafted by itself; `files` are records of one config."""
    if "columns" in case:
        columns = case["columns"]
        if isinstance(columns, str):
            columns = eval(columns, SIGNALS)
        else:
            columns = {head: eval(text, SIGNALS) for head, text in columns.items()}
        return [write_table(folder / "r.csv", columns)]
    patterns = [Path(pattern) for pattern in case.get("files", [case.get("file")])]
    paths = [path for p in patterns for path in sorted(shared(str(p.parent)).glob(p.name))]
    return [paths] if "files" in case else [*paths]


def entry(draft: dict[str, Any], place: str) -> object:
    """What stands at a dotted place, None where there is nothing."""
    return reduce(lambda entries, key: (entries or {}).get(key), place.split("."), draft)


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
@starts_believed()
def test_a_draft_says_what_its_record_shows(case: dict[str, Any], tmp_path: Path) -> None:
    records = records_of(case, tmp_path)
    assert records
    for record in records:
        columns, known = case.get("say", ()), case.get("known", {})
        if "refused" in case:
            message = refusal(record, *columns, **known)
            assert [words for words in case["refused"] if words not in message] == []
            if "nothing moved" in message:
                assert "\n" not in message
            continue
        draft = draft_of(record, *columns, config=tmp_path / "r.yaml", **known)
        text = draft["words"] + draft["said"]
        assert [words for words in case.get("words", ()) if words not in text] == []
        assert [words for words in case.get("nowhere", ()) if words in text] == []
        entries = {place: entry(draft, place) for place in case.get("entries", {})}
        assert entries == case.get("entries", {})
        if "channels" in case:
            assert channels_of(draft) == {k: tuple(v) for k, v in case["channels"].items()}


def noise(draft: dict[str, Any], channel: str) -> float:
    """Ten times the least that its prior allows; the most is the spread of the channel, or more."""
    sigma = draft["record"]["channels"][channel]["sigma"]
    assert sigma["high"] >= 99 * sigma["low"]
    return 10 * float(sigma["low"])


BUNDLED = (
    "nominal_step",
    "example_rig",
    "example_ties",
    "paper/estimates",
    "paper/missing_physics",
)


@run_cases("name", BUNDLED)
def test_bundled_records_come_back_as_their_configs_have_them(name: str, tmp_path: Path) -> None:
    """Names, units, sums of states, time and gear; also the round trip, as they are simulated."""
    case = loading.load(CONFIGS / f"{name}.yaml")
    path = tmp_path / "mine.csv"
    path.write_text(simulation.simulate(case, 11, path))
    draft, config = draft_of(path, voltage=8.0, gear=8), case.config
    channels, time = config.record.channels, config.record.time
    assert channels_of(draft) == {k: (str(spec.column), spec.unit) for k, spec in channels.items()}
    for key, spec in channels.items():
        measures = draft["record"]["channels"][key].get("measures")
        assert (measures or "").replace(" ", "") == str(spec.measures or "").replace(" ", "")
        sigma: Any = config.simulation.sigma.get(key, spec.sigma)  # type: ignore[union-attr]
        assert 1 / 1.5 < noise(draft, key) / sigma < 1.5, key
    assert draft["record"]["time"] == {"column": time.column, "unit": time.unit}  # type: ignore[union-attr]
    assert draft["model"]["i_m"] == 0.125
    assert "initial" not in draft


def test_every_guess_is_marked_and_what_the_record_says_is_not(tmp_path: Path) -> None:
    lines = draft_of(write_table(tmp_path / "r.csv", german_record()))["text"].splitlines()

    def above(entry: str) -> str:
        last = next(k for k, line in enumerate(lines) if line.lstrip().startswith(entry))
        begin = next(k for k in range(last - 1, -1, -1) if "#" not in lines[k][:6])
        return " ".join(lines[begin + 1 : last])

    assert "REVIEW: no unit is stated; the derivative of phi_Rotor_deg is 6 times" in above("w_1:")
    assert "no unit is stated" not in above("theta_1:")
    assert "REVIEW: the noise is not stated" in above("theta_1:")
    assert "REVIEW: the gear ratio is not stated; n_Motor and n_Rotor turn as 5:1" in above(
        "model:"
    )
    assert "REVIEW" in above("v:")
    assert "REVIEW" not in above("time:")


def test_a_time_with_the_head_of_a_twist_does_no_harm(tmp_path: Path) -> None:
    """It grows evenly, so that its law leaves nothing of it at all."""
    head, *rows = (CONFIGS / "records" / "nominal_step.csv").read_text().splitlines()
    path = tmp_path / "odd.csv"
    path.write_text("\n".join([f"twist{head[head.index(',') :]}", *rows]))
    assert "twist" in channels_of(draft_of(path))


@starts_believed()
def test_every_config_that_is_written_is_valid(tmp_path: Path) -> None:
    """Of spoilt records; a voltage that nobody has given is asked for, and nothing else is."""
    invalid, count, path = {}, 0, tmp_path / "r.csv"
    for seed in range(12):
        write_table(path, spoilt_record(np.random.default_rng(seed)))
        config = tmp_path / f"{seed}.yaml"
        try:
            asks = bd.init(path, config, voltage=6.0 if seed % 2 else None).open_issues
        except bd.InputError:
            assert not config.exists()
            continue
        count += 1
        try:
            assert all("inputs" in issue.place for issue in asks)
            if not asks:
                bd.load(config)
        except (bd.InputError, AssertionError) as error:
            invalid[seed] = str(error)
    assert invalid == {}
    assert count > 3


def test_names_that_yaml_would_take_for_something_else(tmp_path: Path) -> None:
    columns = {name: values[:200] for name, values in german_record().items()}
    for name in ("0", "null", "1e5", "true"):
        assert draft_of(write_table(tmp_path / f"{name}.csv", columns))["name"] == name
    paths = [write_table(tmp_path / f"run_{name}.csv", columns) for name in ("null", "true")]
    assert {*draft_of(paths)["experiments"]} == {"null", "true"}


def test_more_files_than_a_config_holds_are_named(tmp_path: Path) -> None:
    columns = {name: values[:60] for name, values in german_record().items()}
    paths = [write_table(tmp_path / f"r{k}.csv", columns) for k in range(52)]
    message = refusal(paths, output=tmp_path / "all.yaml")
    assert "52 entries stand here, wanted are at most 50; take out r50, r51" in message
    assert not (tmp_path / "all.yaml").exists()


@pytest.mark.parametrize("name", ["gear", "voltage", "rate"])
def test_impossible_numbers_are_input_errors(name: str, tmp_path: Path) -> None:
    path = write_table(tmp_path / "r.csv", RECORD)
    numbers = [1e155, 1e400, -1e400, float("nan"), 10**400, 1e-320]
    for number in numbers if name == "voltage" else [*numbers, -3, 0]:
        assert refusal(path, **{name: number})


@starts_believed()
def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    path = write_table(tmp_path / "r.csv", german_record())
    config = tmp_path / "r.yaml"
    config.write_text("mine")
    assert command_line.cli("init", path).status == 2
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


@starts_believed()
def test_check_draws_the_record_of_each_experiment(tmp_path: Path) -> None:
    twice = {name: np.concatenate([x, x]) for name, x in RECORD.items()}
    draft_of(write_table(tmp_path / "r.csv", twice), split=True)
    done = command_line.cli("check", tmp_path / "r.yaml", "--figure-record", tmp_path / "seen.png")
    assert done.status == 0
    for k in (1, 2):
        assert (tmp_path / f"seen_{k}.png").read_bytes().startswith(b"\x89PNG")
        assert f"seen_{k}.png" in done.out
    case = bd.load(tmp_path / "r.yaml")
    with pytest.raises(bd.InputError, match=r"--figure-record: 'seen\.gif' is not one of \.pdf"):
        case.draw_record(tmp_path / "seen.gif")


@starts_believed()
def test_a_data_sheet_becomes_the_nominal_table(tmp_path: Path) -> None:
    record, sheet = write_table(tmp_path / "r.csv", german_record()), tmp_path / "sheet.yaml"
    sheet.write_text(
        "j_m: {value: 0.5, unit: g*m^2, side: load}\nk_T: {value: 45, unit: mN*m/A}\nc_s: 0.001\n"
    )
    draft = draft_of(record, gear=5, sheet=sheet)
    assert draft["nominal"]["j_m"] == {"value": 0.5, "unit": "g*m^2", "side": "load"}
    assert draft["parameters"]["k_T"]["relative"]
    assert draft["parameters"]["k_e"]["prior"] == "log_uniform"
    assert "c_s" in draft["parameters"]
    nominal = bd.load(tmp_path / "r.yaml").job.problem.nominal
    assert nominal["j_m"] == pytest.approx(0.5e-3 / 25)
    assert nominal["k_T"] == pytest.approx(0.045)
    assert {*nominal} == {"j_m", "k_T", "c_s"}
    assert "there is no data sheet" not in (tmp_path / "r.yaml").read_text()
    sheet.write_text("k_T: {value: 45, unit: mN*m/A}\nk_e: 0.045\n")
    assert draft_of(record, gear=5, sheet=sheet)["parameters"]["k_e"] == {"tie": "k_T"}
    sheet.write_text(
        "k_T: {value: 45, unit: mN*m/A}\nk_e: {value: 0.045, unit: ohm}\nj_x: {unit: m}\n"
    )
    message = refusal(record, sheet=sheet, force=True)
    assert "sheet.yaml: k_e" in message
    assert "sheet.yaml: j_x" in message
    sheet.write_text("k_T: {value: 45, unit: mN*m/A, side: load}\nj_x: 3\n")
    message = refusal(record, sheet=sheet, force=True)
    assert "sheet.yaml: k_T" in message
    assert "j_x" in message
    sheet.write_text("k_T: 3\nk_e: 1\nk_T: 4\n")
    message = refusal(record, sheet=sheet, force=True)
    assert "sheet.yaml:3: k_T: this key stands already in line 1" in message
