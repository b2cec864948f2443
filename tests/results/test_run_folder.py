"""Files of a results folder whose bytes are not what they were: an error, or the same numbers."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from bayesdrill.basics import seeds
from bayesdrill.basics.errors import InputError
from bayesdrill.output_files import POSTERIOR, dumps_checksummed
from bayesdrill.results.run_folder import Folder, dump_record, load_record, read_chain
from bayesdrill.sampling.mode_search import Search
from bayesdrill.sampling.samplers.ensemble import ChainSegment, State


@pytest.fixture
def piece() -> ChainSegment:
    rng = np.random.default_rng(5)
    z, log_p = rng.standard_normal((40, 6, 2)), rng.standard_normal((40, 6))
    state = State(z[-1], log_p[-1], seeds.legacy_state(5, "walk", 0))
    return ChainSegment(
        z=z, log_p=log_p, accepted=np.full(6, 20.0), failures=0, state=state, seconds=1.0
    )


@pytest.fixture
def folder(piece: ChainSegment, tmp_path: Path) -> Iterator[Folder]:
    """A run that has saved one piece."""
    with Folder(tmp_path / "out", "fresh", {}, POSTERIOR) as run:
        run.save(0, 0, piece)
        yield run


def same(piece: ChainSegment, other: ChainSegment) -> bool:
    names = ("z", "log_p", "accepted")
    arrays = [np.array_equal(getattr(piece, name), getattr(other, name)) for name in names]
    return all([*arrays, *map(np.array_equal, piece.state.random, other.state.random)])


def damages(content: bytes, rng: np.random.Generator) -> Iterator[bytes]:
    """Cut short, emptied, and with single bits changed."""
    for length in (0, 1, *rng.integers(2, len(content), 10)):
        yield content[: int(length)]
    for place in rng.integers(0, len(content), 200):
        changed = bytearray(content)
        changed[place] ^= 1 << int(rng.integers(8))
        yield bytes(changed)


def assert_damage_is_named_or_harmless(
    path: Path, piece: ChainSegment, read: Callable[[], ChainSegment], way_out: str, seed: int
) -> None:
    messages = []
    for damaged in damages(path.read_bytes(), np.random.default_rng(seed)):
        path.write_bytes(damaged)
        try:
            back = read()
        except InputError as error:
            messages.append(str(error))
        else:
            assert same(back, piece)
    assert len(messages) > 20
    assert [text for text in messages if path.name not in text or way_out not in text] == []


def test_a_damaged_chain_is_named_or_harmless(folder: Folder, piece: ChainSegment) -> None:
    folder.finish_chain([[piece]], {})
    path = folder.path / "chain.h5"
    assert same(read_chain(path, 0)[0], piece)
    read = lambda: read_chain(path, 0)[0]  # noqa: E731
    assert_damage_is_named_or_harmless(path, piece, read, "delete it", seed=1)


def test_a_damaged_piece_is_named_or_harmless(folder: Folder, piece: ChainSegment) -> None:
    (path,) = (folder.path / ".pieces").iterdir()
    read = lambda: folder.segments(0)[0]  # noqa: E731
    assert_damage_is_named_or_harmless(path, piece, read, "--resume", seed=2)


def test_pieces_of_another_run_are_refused(piece: ChainSegment, tmp_path: Path) -> None:
    with Folder(tmp_path / "other", "fresh", {"the seed": "2"}, POSTERIOR) as other:
        other.save(0, 40, piece)
    with Folder(tmp_path / "mine", "fresh", {"the seed": "1"}, POSTERIOR) as mine:
        mine.save(0, 0, piece)
        name = ".pieces/ensemble_0_000000040.h5"
        shutil.copy(other.path / name, mine.path / name)
        with pytest.raises(InputError, match=f"{name}: is of run .* of run .*--resume"):
            mine.segments(0)


def test_a_run_whose_noise_an_older_version_identified_otherwise_is_refused(tmp_path: Path) -> None:
    with Folder(tmp_path, "fresh", {"the kind of noise": "9286bd589cdf"}, POSTERIOR) as older:
        older.begin(status="interrupted")
    reason = (
        "the kind of noise was written by an older version, as the digest 9286bd589cdf, and is AR1"
    )
    with pytest.raises(InputError, match=reason):
        Folder(tmp_path, "report", {"the kind of noise": "AR1"}, POSTERIOR).check()


def test_pieces_after_a_gap_wait_until_it_is_filled(folder: Folder, piece: ChainSegment) -> None:
    folder.save(0, 80, piece)
    assert len(folder.segments(0)) == 1
    folder.save(0, 40, piece)
    assert len(folder.segments(0)) == 3


def test_a_record_is_read_as_it_was_written_and_that_of_another_form_refused(
    tmp_path: Path,
) -> None:
    path = tmp_path / "search.json"
    search = Search(
        start={"k_s": 0.1}, end={"k_s": 0.2}, log_posterior=-1 / 3, evaluations=9, settled=True
    )
    path.write_text(dump_record(search, 2, run="a run"))
    read, entries = load_record(path, Search, 2)
    assert (read, entries["run"], entries["form"]) == (search, "a run", 2)
    fields = {name: value for name, value in entries.items() if name != "form"}
    for text, reason in (
        (
            path.read_text().replace("0.2", "0.3"),
            "is damaged; delete it and continue with --resume",
        ),
        (
            dumps_checksummed({**fields, "end": []}),
            "was written by another version of bayesdrill; ",
        ),
        (dumps_checksummed({**entries, "end": []}), "is damaged; delete it"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=f"search.json: {reason}"):
            load_record(path, Search, 2)
