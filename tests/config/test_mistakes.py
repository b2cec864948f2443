"""Every mistake in a config is told once, with its line, its entry and a way out (`mistakes.yaml`)."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support import command_line, config_texts, described_rigs, two_experiments
from support.case_tables import for_each, read_table

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.job import prepare

MISTAKES: dict[str, dict[str, dict[str, Any]]] = read_table("config/mistakes.yaml")


def pair(folder: Path, *changes: tuple[str, str]) -> None:
    prepare(two_experiments.write(folder, *changes))


def composed(folder: Path, *lines: str, **sections: str) -> None:
    loading.load(config_texts.write_composed(folder, *lines, **sections))


def shaft(folder: Path, *changes: tuple[str, str]) -> None:
    prepare(config_texts.write_shaft(folder, *changes))


def small(folder: Path, *changes: tuple[str, str]) -> None:
    prepare(command_line.small_config(folder, *changes))


def train(folder: Path, *changes: tuple[str, str], text: str = described_rigs.ROTARY) -> None:
    described_rigs.save_records(folder)
    prepare(config_texts.write(folder, text, *changes))


def carts(folder: Path, *changes: tuple[str, str]) -> None:
    train(folder, *changes, text=described_rigs.LINEAR)


LOAD: dict[str, Callable[..., object]] = {
    **dict.fromkeys(("sensors", "experiments", "held_numbers"), pair),
    **dict.fromkeys(("missing_torque", "noises", "held_out"), small),
    "composed": composed,
    "inputs": shaft,
    "records": config_texts.load_measured,
    "train": train,
    "carts": carts,
}


@pytest.mark.parametrize("section", MISTAKES)
def test_a_mistake_is_told_once_with_its_line_place_and_way_out(
    section: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Nothing else is said of a config that is sound otherwise, but of the places in `others`."""

    def check(case: dict[str, Any]) -> None:
        changes = (*map(tuple, case.get("replace", ())), *case.get("lines", ()))
        with pytest.raises(InputError) as caught:
            LOAD[section](tmp_path_factory.mktemp("case"), *changes, **case.get("sections", {}))
        problems = caught.value.problems
        entries = [re.fullmatch(r".+:\d+: (.+)", problem.place) for problem in problems]
        messages = {e[1]: p.message for e, p in zip(entries, problems, strict=True) if e}
        assert {*messages} == {case["place"], *case.get("others", ())}, problems
        assert len(messages) == len(problems), problems
        for text in case["says"]:
            assert text in messages[case["place"]], problems

    for_each({name: (case,) for name, case in MISTAKES[section].items()}, check)
