"""Files of a results folder whose bytes are not what they were: an error, or the same numbers."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from bayesdrill.basics import seeds
from bayesdrill.basics.errors import InputError
from bayesdrill.output_files import POSTERIOR
from bayesdrill.results.run_folder import Folder, read_chain
from bayesdrill.sampling.samplers.ensemble import ChainSegment, State


@pytest.fixture
def piece() -> ChainSegment:
    rng = np.random.default_rng(5)
    z, log_p = rng.standard_normal((40, 6, 2)), rng.standard_normal((40, 6))
    state = State(z[-1], log_p[-1], seeds.legacy_state(5, "walk", 0))
    return ChainSegment(
        z=z, log_p=log_p, accepted=np.full(6, 20.0), failures=0, state=state, seconds=1.0
    )


def same(one: ChainSegment, other: ChainSegment) -> bool:
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("z", "log_p", "accepted")
    ) and all(map(np.array_equal, one.state.random, other.state.random))


def damages(content: bytes, rng: np.random.Generator) -> list[bytes]:
    """Cut short, emptied, and with single bits changed."""
    cut = [content[: int(n)] for n in (0, 1, *rng.integers(2, len(content), 10))]
    for place in rng.integers(0, len(content), 200):
        changed = bytearray(content)
        changed[place] ^= 1 << int(rng.integers(8))
        cut.append(bytes(changed))
    return cut


def test_a_damaged_chain_is_named_or_harmless(piece: ChainSegment, tmp_path: Path) -> None:
    """Mutant killed: a chain that is believed whatever its checksum."""
    with Folder(tmp_path / "out", "fresh", {}, POSTERIOR) as folder:
        folder.save(0, 0, piece)
        folder.finish_chain([[piece]], {})
    path = tmp_path / "out" / "chain.h5"
    content = path.read_bytes()
    assert same(read_chain(path, 0)[0], piece)
    found = harmless = 0
    for damaged in (spoilt := damages(content, np.random.default_rng(1))):
        path.write_bytes(damaged)
        try:
            back, _ = read_chain(path, 0)
        except InputError as error:
            found += "chain.h5" in str(error) and "delete it" in str(error)
        else:
            assert same(back, piece)
            harmless += 1
    assert found > 20
    assert found + harmless == len(spoilt)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_damaged_piece_is_named_or_harmless(piece: ChainSegment, tmp_path: Path) -> None:
    with Folder(tmp_path / "out", "fresh", {}, POSTERIOR) as folder:
        folder.save(0, 0, piece)
        (path,) = (tmp_path / "out" / ".pieces").iterdir()
        content = path.read_bytes()
        found = harmless = 0
        for damaged in (spoilt := damages(content, np.random.default_rng(2))):
            path.write_bytes(damaged)
            try:
                (back,) = folder.segments(0)
            except InputError as error:
                found += path.name in str(error) and "--resume" in str(error)
            else:
                assert same(back, piece)
                harmless += 1
    assert found > 20
    assert found + harmless == len(spoilt)


def test_pieces_of_another_run_are_refused(piece: ChainSegment, tmp_path: Path) -> None:
    """Mutant killed: a piece that is believed whatever run it is of."""
    with Folder(tmp_path / "other", "fresh", {"the seed": "2"}, POSTERIOR) as other:
        other.save(0, 40, piece)
    with Folder(tmp_path / "mine", "fresh", {"the seed": "1"}, POSTERIOR) as mine:
        mine.save(0, 0, piece)
        name = ".pieces/ensemble_0_000000040.npz"
        shutil.copy(other.path / name, mine.path / name)
        with pytest.raises(InputError, match=f"{name}: is of run .* of run .*--resume"):
            mine.segments(0)


def test_pieces_after_a_gap_wait_until_it_is_filled(piece: ChainSegment, tmp_path: Path) -> None:
    """Mutant killed: a piece taken for the continuation of what is not there."""
    with Folder(tmp_path / "out", "fresh", {}, POSTERIOR) as folder:
        folder.save(0, 0, piece)
        folder.save(0, 80, piece)
        assert len(folder.segments(0)) == 1
        folder.save(0, 40, piece)
        assert len(folder.segments(0)) == 3


def test_a_file_of_others_among_the_pieces_is_none(piece: ChainSegment, tmp_path: Path) -> None:
    with Folder(tmp_path / "out", "fresh", {}, POSTERIOR) as folder:
        folder.save(0, 0, piece)
        (folder.path / ".pieces" / "ensemble_0_copy.npz").write_bytes(b"")
        (folder.path / ".pieces" / "ensemble_0_40.npz").write_bytes(b"")
        assert len(folder.segments(0)) == 1
