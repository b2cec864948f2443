"""Whatever is written, nothing falls over: no traceback, no hang, no file of a stranger touched.

`BAYESDRILL_ATTACK` seconds for each kind of attack; what it finds becomes a case of
`tests/system/bad_inputs.yaml`.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from support import command_line, forked_command

from benchmarks.attack import strategies
from benchmarks.attack.strategies import EXTRAS

SEED = int(os.environ.get("BAYESDRILL_ATTACK_SEED", "0"))
SECONDS = float(os.environ.get("BAYESDRILL_ATTACK", "60"))
STRANGERS = {
    "notes.md": b"mine\n",
    "figures/photo.jpg": b"\xff\xd8\xff",
    "mydata.csv": b"t,x\n0,1\n",
}
SOUND = {0, 2, 3}
SILENCE = 10.0  # s

pytestmark = pytest.mark.slow

BATCH = settings(
    max_examples=50,
    deadline=None,
    database=None,
    phases=[Phase.generate],  # what falls is small as it is, and the time is stated
    suppress_health_check=list(HealthCheck),
)


def attack(what: str, falls: Callable[..., None], **given_: st.SearchStrategy[Any]) -> None:
    """Batch after batch, each from a seed of its own, until the time is over."""
    end, cases, batches = time.monotonic() + SECONDS, 0, 0

    def counted(**case: Any) -> None:
        nonlocal cases
        if time.monotonic() < end:
            cases += 1
            falls(**case)

    while time.monotonic() < end:
        seed(SEED + batches)(BATCH(given(**given_)(counted)))()
        batches += 1
    print(f"{what}: {cases} cases")


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder of a user's, in which some of the files are not for us."""
    for name, content in STRANGERS.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    command_line.small_config(tmp_path)
    return tmp_path


def stands(home: Path, *arguments: str | Path) -> None:
    ended_well(home, forked_command.ran(arguments, home))


def ended_well(home: Path, ended: forked_command.Ended) -> None:
    assert not ended.hung, f"hangs: {ended.text[-500:]}"
    assert ended.silence < SILENCE, f"is silent for {ended.silence:.1f} s: {ended.text[-500:]}"
    assert not ended.traceback, ended.text[-3000:]
    assert "Warning: " not in ended.text, ended.text[-1000:]
    assert ended.status in SOUND, (ended.status, ended.text[-1000:])
    for name, content in STRANGERS.items():
        assert (home / name).read_bytes() == content, f"{name} was touched"


COMMANDS = st.sampled_from(
    [
        *[("check", "small.yaml")] * 6,
        ("simulate", "small.yaml", "--output", "made.csv", "--force"),
        ("identify", "small.yaml"),
        ("map", "small.yaml", "--processes", "1"),
    ]
)


def test_configs(home: Path) -> None:
    def falls(text: str, command: tuple[str, ...]) -> None:
        (home / "small.yaml").write_bytes(text.encode("utf-8", "surrogatepass"))
        stands(home, *command)

    attack("configs", falls, text=strategies.config(), command=COMMANDS)


def test_units_and_formulas(home: Path) -> None:
    def falls(unit: str, formula: str) -> None:
        text = command_line.SMALL.replace("unit: rad,", f"unit: {json.dumps(unit)},")
        text = strategies.in_place(text, "k_s", formula)
        (home / "small.yaml").write_text(f"{text}derived: {{x: {json.dumps(formula)}}}\n")
        stands(home, "check", "small.yaml")

    attack("units and formulas", falls, unit=strategies.unit(), formula=strategies.formula())


@pytest.mark.parametrize("kind", ["csv", "mat 5", "mat 7.3", "h5", "npz", "parquet"])
def test_records(home: Path, kind: str) -> None:
    name = f"small.{kind.split()[0]}"
    if name == "small.mat":
        (home / "small.yaml").write_text(strategies.for_mat(command_line.SMALL))
    else:
        (home / "small.yaml").write_text(command_line.SMALL.replace("small.csv", name))
    content = {
        "csv": strategies.record,
        "mat 5": lambda: strategies.bytes_changed(strategies.mat_file(5)),
        "mat 7.3": lambda: strategies.bytes_changed(strategies.mat_file(7)),
    }.get(kind, lambda: strategies.bytes_changed(strategies.array_file(kind)))()

    def falls(content: bytes) -> None:
        (home / name).write_bytes(content)
        stands(home, "check", "small.yaml")

    attack(kind, falls, content=content)


@pytest.mark.parametrize(
    "command",
    [("report", "results/small"), ("posterior", "small.yaml", "--resume", "--processes", "1")],
    ids=lambda command: command[0],
)
def test_damaged_results(home: Path, command: tuple[str, ...]) -> None:
    """Whatever has become of one file of a run."""
    results, sound = home / "results" / "small", home / "sound"
    assert command_line.run_process("posterior", "small.yaml", cwd=home).status in SOUND
    shutil.copytree(results, sound)

    def falls(change: tuple[str, bytes]) -> None:
        shutil.rmtree(results)
        shutil.copytree(sound, results)
        (results / change[0]).write_bytes(change[1])
        stands(home, *command)

    attack(f"damaged results, {command[0]}", falls, change=strategies.damaged(sound))


EXPERIMENTS = (
    "own: [k_e]\nshared: [w_1_0]\nexperiments:\n  one: {}\n  two: {initial: {theta_1: 1}}\n"
)


def test_retyped_configs(home: Path) -> None:
    """Wrong types in every entry, those of further sections among them."""
    every = [
        command_line.SMALL,
        "\n".join([command_line.SMALL, *EXTRAS]),
        f"{command_line.SMALL}{EXPERIMENTS}",
    ]
    every.append((command_line.ROOT / "configs" / "example_rig.yaml").read_text())
    shutil.copytree(command_line.ROOT / "configs" / "records", home / "records")

    def falls(text: bytes, command: tuple[str, ...]) -> None:
        (home / "small.yaml").write_bytes(text)
        stands(home, *command)

    text = st.sampled_from(every).flatmap(strategies.config_retyped)
    attack("retyped configs", falls, text=text, command=st.just(("check", "small.yaml")))


def test_odd_tables(home: Path) -> None:
    """What `init` makes of records that nobody would call one, and `check` of what it wrote."""

    def falls(table: tuple[str, bytes], names: list[str], split: bool) -> None:
        name = f"odd.{table[0]}"
        (home / name).write_bytes(table[1])
        (home / "odd.yaml").unlink(missing_ok=True)
        named = [word for text in names for word in ("--columns", text)]
        stands(home, "init", name, *named, *(["--split"] if split else []))
        if (home / "odd.yaml").exists():
            stands(home, "check", "odd.yaml")

    names = st.just([]) | st.lists(st.sampled_from(strategies.NAMES), max_size=4)
    attack("odd tables", falls, table=strategies.table(), names=names, split=st.booleans())


FORGED = {
    "posterior": ("report", "verify", "resume"),
    "map": ("verify",),
    "compare": ("verify",),
    "report": ("verify",),
    "calibrate": ("resume",),
    "ladder": ("verify", "resume"),
}


@pytest.mark.parametrize("job", FORGED)
def test_forged_results(home: Path, job: str) -> None:
    """One file of a folder made anew, with a checksum that fits."""
    begun = {
        "posterior": ("posterior", "small.yaml"),
        "map": ("map", "small.yaml"),
        "calibrate": ("calibrate", "small.yaml"),
        "ladder": ("ladder", "small.yaml"),
    }
    if job in ("compare", "report"):
        assert command_line.run_process("posterior", "small.yaml", cwd=home).status in SOUND
        shutil.copytree(home / "results" / "small", home / "results" / "other")
        begun[job] = (job, "results/small", "results/other")
    elif job == "calibrate":
        (home / "small.yaml").write_text(f"{command_line.SMALL}calibration: {{refits: 10}}\n")
    made = command_line.run_process(*begun[job], "-o", "out", cwd=home, seconds=300)
    assert made.status in SOUND, made.text
    out, sound = home / "out", home / "sound"
    shutil.copytree(out, sound)
    resume = (*begun[job][:2], "-o", "out", "--resume", "--processes", "1")
    commands = {
        "report": ("report", "out", "--processes", "1"),
        "verify": ("verify", "out"),
        "resume": resume,
    }

    def falls(change: tuple[str, bytes], command: str) -> None:
        shutil.rmtree(out)
        shutil.copytree(sound, out)
        (out / change[0]).write_bytes(change[1])
        stands(home, *commands[command])

    which = st.sampled_from(FORGED[job])
    attack(f"forged {job}", falls, change=strategies.forged(sound), command=which)


@pytest.fixture
def runs(home: Path) -> Path:
    """A home with runs in it, a data sheet, and files of other names for the same."""
    shutil.copytree(home, home / "kept", ignore=shutil.ignore_patterns("kept"))
    shutil.rmtree(home / "kept" / "figures")
    assert command_line.run_process("posterior", "small.yaml", cwd=home).status in SOUND
    shutil.copytree(home / "results" / "small", home / "results" / "other")
    (home / "sheet.yaml").write_text("k_s: 0.3\n")
    (home / "campaign.yaml").write_text(f"{command_line.SMALL}{EXPERIMENTS}")
    return home


def afresh(kept: Path, place: Path) -> None:
    """What an attack works on, with links to two of its files."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(kept, place)
    (place / "link.yaml").symlink_to("small.yaml")
    os.link(place / "small.csv", place / "hard.csv")


def read_by(words: list[str], place: Path) -> dict[Path, bytes]:
    """What a command reads and must leave as it is: files, and folders that it does not write to."""
    given = [place / word for word in words[1:] if not word.startswith("-")]
    sheets = [place / b for a, b in itertools.pairwise(words) if a == "--sheet"]
    outputs = [place / b for a, b in itertools.pairwise(words) if a in ("--output", "--figure")]
    files = [path for path in (*given, *sheets) if path not in outputs or words[0] != "init"]
    files += [place / "small.csv", place / "small.yaml"] if words[0] != "init" else []
    if words[0] in ("export", "verify", "cite", "compare", "schema", "cache", "check", "simulate"):
        files += [path for path in (place / "results").rglob("*") if path.name != ".lock"]
    positional = [place / word for word in words[1:2] if words[0] == "init"]
    return {p: p.read_bytes() for p in {*files, *positional, *sheets} if readable(p)}


def readable(path: Path) -> bool:
    try:
        return path.is_file() and str(path).isprintable()
    except (OSError, ValueError):
        return False


def test_command_lines(runs: Path) -> None:
    """Commands with options and things of all kinds, whose inputs stay as they are."""
    place = runs / "place"
    kept = runs / "whole"
    shutil.copytree(runs, kept, ignore=shutil.ignore_patterns("whole", "kept"))

    def falls(words: list[str]) -> None:
        afresh(kept, place)
        before = read_by(words, place)
        ended_well(place, forked_command.ran(words, place))
        for path, content in before.items():
            assert path.read_bytes() == content, f"{path} was replaced by {words}"

    attack("command lines", falls, words=strategies.arguments_of_a_command())


def test_environments(runs: Path) -> None:
    """In processes of their own, with what the environment and an output may be."""
    lines = (
        *("--help", "--version", "posterior --help", "schema", "cite", "cache", "", "nonsense"),
        *("check small.yaml", "export results/small --to mjcf", "verify results/small"),
        "report results/small --processes 1",
    )
    commands = st.sampled_from([tuple(line.split()) for line in lines])

    def falls(command: tuple[str, ...], out: str, names: dict[str, str]) -> None:
        read, write = os.pipe()
        if out == "closed pipe":
            os.close(read)
        if out == "/dev/full":
            os.close(write)
            write = os.open(out, os.O_WRONLY)
        shell = {**os.environ, "PYTHONPATH": str(command_line.ROOT), "HOME": str(runs), **names}
        closed = {"preexec_fn": lambda: os.close(1)} if out == "closed" else {"stdout": write}
        ended = subprocess.run(  # type: ignore[call-overload]
            [sys.executable, "-m", "bayesdrill", *command],
            cwd=runs, env=shell, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, timeout=60, **closed,
        )  # fmt: skip
        os.close(write)
        if out != "closed pipe":
            os.close(read)
        err = ended.stderr.decode(errors="replace")
        ended_well(runs, forked_command.Ended(ended.returncode, err, hung=False))

    outs = st.sampled_from(strategies.OUTPUTS)
    attack("environments", falls, command=commands, out=outs, names=strategies.environment())


def test_api_calls(runs: Path) -> None:
    """An `InputError` for every wrong argument, and nothing else."""
    import bayesdrill as bd

    for name in strategies.CALLS:
        getattr(bd, name)  # loaded once, and not in each child

    def falls(call: tuple[str, dict[str, Any]]) -> None:
        name, arguments = call
        shutil.rmtree(runs / "new", ignore_errors=True)
        ended = forked_command.called(lambda: getattr(bd, name)(**arguments), runs)
        ended_well(runs, ended)
        assert ended.status in (0, 2), (call, ended.text)

    attack("api calls", falls, call=strategies.api_call())


def test_campaigns(home: Path) -> None:
    """Trains that rub, drill or rest, in experiments with numbers of their own."""

    def falls(made: tuple[str, list[Any]], command: tuple[str, ...]) -> None:
        text, records = made
        (home / "campaign.yaml").write_text(text)
        for label, record in zip("abc", records, strict=False):
            np.savetxt(home / f"{label}.csv", record, "%.9g", ",", header="t,w,u,n", comments="")
        stands(home, *command)

    commands = st.sampled_from([("check", "campaign.yaml"), ("identify", "campaign.yaml")])
    attack("campaigns", falls, made=strategies.campaign(), command=commands)
