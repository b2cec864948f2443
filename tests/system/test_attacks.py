"""Whatever is written, nothing falls over: no traceback, no hang, no file of a stranger touched.

`BAYESDRILL_ATTACK` seconds for each kind of attack; what it finds becomes a case of
`test_bad_inputs.py`.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attacks
import forked
import pytest
import systems
from attacks import EXTRAS
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

SEED = int(os.environ.get("BAYESDRILL_ATTACK_SEED", "0"))
SECONDS = float(os.environ.get("BAYESDRILL_ATTACK", "60"))
STRANGERS = {
    "notes.md": b"mine\n",
    "figures/photo.jpg": b"\xff\xd8\xff",
    "mydata.csv": b"t,x\n0,1\n",
}
SOUND = {0, 2, 3}

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
    systems.small(tmp_path)
    return tmp_path


def stands(home: Path, *arguments: str | Path) -> None:
    ended = forked.ran(arguments, home)
    assert not ended.hung, f"hangs: {ended.text[-500:]}"
    assert not ended.traceback, ended.text[-3000:]
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

    attack("configs", falls, text=attacks.config(), command=COMMANDS)


def test_units_and_formulas(home: Path) -> None:
    def falls(unit: str, formula: str) -> None:
        text = systems.SMALL.replace("unit: rad,", f"unit: {json.dumps(unit)},")
        text = attacks.in_place(text, "k_s", formula)
        (home / "small.yaml").write_text(f"{text}derived: {{x: {json.dumps(formula)}}}\n")
        stands(home, "check", "small.yaml")

    attack("units and formulas", falls, unit=attacks.unit(), formula=attacks.formula())


@pytest.mark.parametrize("kind", ["csv", "mat 5", "mat 7.3", "h5", "npz", "parquet"])
def test_records(home: Path, kind: str) -> None:
    name = f"small.{kind.split()[0]}"
    if name == "small.mat":
        (home / "small.yaml").write_text(attacks.for_mat(systems.SMALL))
    else:
        (home / "small.yaml").write_text(systems.SMALL.replace("small.csv", name))
    content = {
        "csv": attacks.record,
        "mat 5": lambda: attacks.bytes_changed(attacks.mat_file(5)),
        "mat 7.3": lambda: attacks.bytes_changed(attacks.mat_file(7)),
    }.get(kind, lambda: attacks.bytes_changed(attacks.array_file(kind)))()

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
    assert systems.run("posterior", "small.yaml", cwd=home).status in SOUND
    shutil.copytree(results, sound)

    def falls(change: tuple[str, bytes]) -> None:
        shutil.rmtree(results)
        shutil.copytree(sound, results)
        (results / change[0]).write_bytes(change[1])
        stands(home, *command)

    attack(f"damaged results, {command[0]}", falls, change=attacks.damaged(sound))


EXPERIMENTS = (
    "own: [k_e]\nshared: [w_1_0]\nexperiments:\n  one: {}\n  two: {initial: {theta_1: 1}}\n"
)


def test_retyped_configs(home: Path) -> None:
    """Wrong types in every entry, those of further sections among them."""
    every = [systems.SMALL, "\n".join([systems.SMALL, *EXTRAS]), f"{systems.SMALL}{EXPERIMENTS}"]
    every.append((systems.ROOT / "configs" / "example_rig.yaml").read_text())
    shutil.copytree(systems.ROOT / "configs" / "records", home / "records")

    def falls(text: bytes, command: tuple[str, ...]) -> None:
        (home / "small.yaml").write_bytes(text)
        stands(home, *command)

    text = st.sampled_from(every).flatmap(attacks.config_retyped)
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

    names = st.just([]) | st.lists(st.sampled_from(attacks.NAMES), max_size=4)
    attack("odd tables", falls, table=attacks.table(), names=names, split=st.booleans())


FORGED = {
    "posterior": ("report", "verify", "cite", "resume"),
    "map": ("verify", "cite"),
    "compare": ("verify", "cite"),
    "report": ("verify",),
    "calibrate": ("resume", "cite"),
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
        assert systems.run("posterior", "small.yaml", cwd=home).status in SOUND
        shutil.copytree(home / "results" / "small", home / "results" / "other")
        begun[job] = (job, "results/small", "results/other")
    elif job == "calibrate":
        (home / "small.yaml").write_text(f"{systems.SMALL}calibration: {{refits: 10}}\n")
    made = systems.run(*begun[job], "-o", "out", cwd=home, seconds=300)
    assert made.status in SOUND, made.text
    out, sound = home / "out", home / "sound"
    shutil.copytree(out, sound)
    resume = (*begun[job][:2], "-o", "out", "--resume", "--processes", "1")
    commands = {
        "report": ("report", "out", "--processes", "1"),
        "verify": ("verify", "out"),
        "cite": ("cite", "out"),
        "resume": resume,
    }

    def falls(change: tuple[str, bytes], command: str) -> None:
        shutil.rmtree(out)
        shutil.copytree(sound, out)
        (out / change[0]).write_bytes(change[1])
        stands(home, *commands[command])

    which = st.sampled_from(FORGED[job])
    attack(f"forged {job}", falls, change=attacks.forged(sound), command=which)
