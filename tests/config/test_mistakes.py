"""Every mistake in a config is told once, with its line, its entry and a way out (`mistakes.yaml`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from support import command_line, config_texts, described_rigs, two_experiments
from support.config_mistakes import MISTAKES, check_mistakes

from bayesdrill.config import loading
from bayesdrill.config.job import prepare


def pair(folder: Path, *changes: tuple[str, str]) -> object:
    return prepare(two_experiments.write(folder, *changes))


def composed(folder: Path, *lines: str, **sections: str) -> object:
    return loading.load(config_texts.write_composed(folder, *lines, **sections))


def shaft(folder: Path, *changes: tuple[str, str]) -> object:
    return prepare(config_texts.write_shaft(folder, *changes))


def small(folder: Path, *changes: tuple[str, str]) -> object:
    return prepare(command_line.small(folder, *changes))


def train(folder: Path, *changes: tuple[str, str]) -> object:
    described_rigs.save_records(folder)
    return prepare(config_texts.write(folder, described_rigs.ROTARY, *changes))


def carts(folder: Path, *changes: tuple[str, str]) -> object:
    described_rigs.save_records(folder)
    return prepare(config_texts.write(folder, described_rigs.LINEAR, *changes))


SOUND_CONFIGS: dict[str, Callable[..., object]] = {
    "sensors": pair,
    "experiments": pair,
    "held_numbers": pair,
    "composed": composed,
    "inputs": shaft,
    "records": config_texts.load_measured,
    "missing_torque": small,
    "noises": small,
    "train": train,
    "carts": carts,
}


@pytest.mark.parametrize("section", MISTAKES)
def test_a_mistake_is_told_once_with_its_line_place_and_way_out(
    section: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    check_mistakes(section, tmp_path_factory, SOUND_CONFIGS[section])
