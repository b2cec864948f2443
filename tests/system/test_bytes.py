"""A move of walls changes no byte: results of the bundled config, against digests kept here.

Whoever changes one of them on purpose says so in CHANGELOG.md.  The tables of the paper are kept whole,
in `docs/paper` (`test_paper.py`).  Another processor may round the last bits otherwise.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import h5py
import pytest
from support import command_line

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"

DIGESTS = {
    "summary.csv": "dd00e72173b9c8b8",
    "derived.csv": "9e96c7a22626370c",
    "verdict.csv": "a3e969bffa81f483",
    "draws": "355a2459ab0dc915",
}


@pytest.mark.slow
def test_the_bundled_config_gives_the_same_bytes(tmp_path: Path) -> None:
    ran = command_line.cli("posterior", CONFIG, "--output", tmp_path / "out")
    assert ran.status == 0, ran.text
    folder = tmp_path / "out"
    found = {name: (folder / name).read_bytes() for name in DIGESTS if name != "draws"}
    with h5py.File(folder / "chain.h5") as file:
        found["draws"] = b"".join(file[name]["chain"][:].tobytes() for name in sorted(file))
    assert {name: hashlib.sha256(some).hexdigest()[:16] for name, some in found.items()} == DIGESTS
