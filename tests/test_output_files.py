"""Files are written whole, over nothing of others, and JSON with a checksum is believed or refused."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.command_line import cli, listing, small_config
from support.foreign_files import SPOIL, put

from bayesdrill import output_files
from bayesdrill.basics.errors import InputError
from bayesdrill.output_files import atomic_write, dumps_checksummed, loads_checksummed


@run_cases("spoil", ["linked", "dangling", "folder", "pipe"])
def test_a_file_is_replaced_and_nothing_else(spoil: str, tmp_path: Path) -> None:
    path = tmp_path / "here" / "record.csv"
    put(tmp_path / "here", "record.csv")
    SPOIL[spoil](path)
    before = listing(tmp_path)
    with pytest.raises(InputError, match="never replaced"), atomic_write(path) as aside:
        aside.write_text("new")
    assert listing(tmp_path) == before


def test_json_with_a_changed_bit_is_never_believed() -> None:
    data = {"a": [1, 2.5e-300, float("inf")], "b": {"ü": None, "c": (True, "x" * 40)}}
    content = dumps_checksummed(data).encode()
    loaded = loads_checksummed(content)
    assert loaded["b"] == {"ü": None, "c": [True, "x" * 40]}
    rng = np.random.default_rng(3)
    refused = 0
    for place, bit in zip(rng.integers(0, len(content), 600), rng.integers(0, 8, 600), strict=True):
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(bit)
        try:
            assert loads_checksummed(bytes(damaged)) == loaded
        except ValueError:
            refused += 1
    assert refused > 400


@run_cases(
    "content", [b"", b"\xff", b"{}", b"[]", b"3", b"[" * 100_000, b'{"a": 1' + b"0" * 9999 + b"}"]
)
def test_json_without_a_checksum_is_refused(content: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011
        loads_checksummed(content)


@run_cases(
    "command",
    [
        "posterior",
        "calibrate",
        "ladder",
        "map",
        "identify",
        "simulate",
        "init",
        "report",
        "compare",
    ],
)
def test_a_place_that_cannot_be_written_is_found_before_the_work(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that is read-only, whatever mode bits say: one line, and nothing is said of any work."""

    def read_only(**_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    config, out = small_config(tmp_path), tmp_path / "out"
    given = [config]
    if command == "init":
        given, out = [config.parent / "small.csv"], tmp_path / "mine.yaml"
    elif command == "simulate":
        out = tmp_path / "mine.csv"
    elif command in ("report", "compare"):
        given = [tmp_path / "one", tmp_path / "two"]
    before = listing(tmp_path)
    monkeypatch.setattr(output_files.tempfile, "TemporaryFile", read_only)
    ran = cli(command, *given, "-o", out)
    assert (ran.status, ran.out) == (2, "")
    message = "nothing can be written here (Read-only file system); give another --output"
    assert ran.err == f"{tmp_path}: {message}\n"
    assert listing(tmp_path) == before
