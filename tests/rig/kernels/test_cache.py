"""The cache of machine code: what is wrong with it is never an error, and never a wrong number."""

import os
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases
from support.compiled_responses import response
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment, vector

from bayesdrill.rig.kernels import cache
from bayesdrill.rig.kernels.cache import CACHE_VARIABLE, CodeCache, user_cache
from bayesdrill.rig.kernels.compiling import compile_kernel
from bayesdrill.rig.kernels.lanes import Module
from bayesdrill.rig.kernels.linear import write_linear
from bayesdrill.rig.kernels.step_arguments import SteppedShape
from bayesdrill.rig.kernels.sums import LOGS, SQUARES
from bayesdrill.rig.kernels.time_stepping import write_stepping
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

KEY, CODE = "a kernel", bytes(range(256)) * 4
THETA = vector(NOMINAL)[None]


@pytest.fixture
def kept(tmp_path: Path) -> CodeCache:
    """A cache with the code of one key."""
    made = CodeCache(tmp_path / "kernels")
    made.store(KEY, CODE)
    assert made.load(KEY) == CODE
    return made


def file_of(kept: CodeCache) -> Path:
    (path,) = kept.folder.iterdir()
    return path


def test_files_and_their_folder_belong_to_the_user_alone(kept: CodeCache) -> None:
    assert kept.folder.stat().st_mode & 0o777 == 0o700
    assert file_of(kept).stat().st_mode & 0o777 == 0o600


@run_cases("word", ["off", "OFF", "Off", "0"])
def test_nothing_is_kept_where_it_is_switched_off(word: str) -> None:
    off = user_cache({CACHE_VARIABLE: word})
    off.store(KEY, CODE)
    off.clear()
    assert (off.folder, off.load(KEY), off.sizes) == (None, None, ())


def test_the_folder_is_that_of_the_variable_or_of_the_user() -> None:
    for word, folder in (
        ("~/mine", Path.home() / "mine"), ("~no-such/x", Path("~no-such/x")), ("00", Path("00")),
        ("/srv/x", Path("/srv/x")),
    ):  # fmt: skip
        assert user_cache({CACHE_VARIABLE: word}).folder == folder / "kernels"
    assert user_cache({}).folder == user_cache({CACHE_VARIABLE: ""}).folder
    assert "bayesdrill" in str(user_cache({}).folder)


def test_a_file_that_differs_in_any_byte_or_length_is_refused(kept: CodeCache) -> None:
    """And a file that is cut short anywhere, or has more at its end."""
    path = file_of(kept)
    whole = path.read_bytes()
    spoilt = [whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :] for k in range(len(whole))]
    for content in (*spoilt, *(whole[:length] for length in range(len(whole))), whole + b"\0"):
        path.write_bytes(content)
        assert kept.load(KEY) is None
    kept.store(KEY, CODE)  # which mends it
    assert kept.load(KEY) == CODE


def test_code_under_the_name_of_another_key_is_not_taken(kept: CodeCache) -> None:
    """As of another processor, another LLVM or another source: these are part of the key."""
    first = file_of(kept)
    kept.store("another", b"other code")
    (second,) = set(kept.folder.iterdir()) - {first}
    second.write_bytes(first.read_bytes())
    assert kept.load("another") is None
    assert kept.load(KEY) == CODE


def test_a_folder_that_others_may_use_is_refused(kept: CodeCache) -> None:
    for mode in (0o755, 0o750, 0o770, 0o777, 0o701):
        kept.folder.chmod(mode)
        assert kept.load(KEY) is None
        kept.store("another", CODE)
        with pytest.raises(PermissionError, match="others have access to it"):
            assert kept.sizes
    kept.folder.chmod(0o700)
    assert kept.load(KEY) == CODE
    assert len(kept.sizes) == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_what_belongs_to_another_is_refused(kept: CodeCache, tmp_path: Path) -> None:
    os.chown(file_of(kept), 12345, -1)
    assert kept.load(KEY) is None
    os.chown(file_of(kept), 0, -1)
    os.chown(kept.folder, 12345, -1)
    link = tmp_path / "link"
    link.symlink_to(kept.folder)
    for one in (kept, CodeCache(link)):
        assert one.load(KEY) is None
        one.store("another", CODE)
    assert len(list(kept.folder.iterdir())) == 1


def test_only_a_plain_file_of_the_user_alone_is_read(kept: CodeCache, tmp_path: Path) -> None:
    """One that others may read or write, a link, a folder, a pipe, at which a process would wait."""
    path, elsewhere = file_of(kept), tmp_path / "elsewhere"
    for mode in (0o644, 0o620, 0o602):
        path.chmod(mode)
        assert kept.load(KEY) is None
    path.chmod(0o600)
    path.rename(elsewhere)
    for make in (lambda: path.symlink_to(elsewhere), lambda: os.mkfifo(path, 0o600)):
        make()
        assert kept.load(KEY) is None
        path.unlink()
    path.mkdir(0o700)
    assert kept.load(KEY) is None
    kept.store(KEY, CODE)
    assert elsewhere.exists()


def test_a_place_that_cannot_be_a_folder_is_no_error(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "nowhere" / "else")
    for folder in (file, file / "kernels", Path("/proc/kernels"), link, tmp_path / ("x" * 300)):
        bad = CodeCache(folder)
        bad.store(KEY, CODE)
        assert bad.load(KEY) is None
    assert file.read_text() == "mine"


def test_the_oldest_go_where_there_are_too_many(tmp_path: Path) -> None:
    """Use makes a file young."""
    few = CodeCache(tmp_path / "kernels", max_files=3)
    for second, key in enumerate("abcd", start=1000):
        few.store(key, CODE)
        for path in set(few.folder.iterdir()):
            if path.stat().st_mtime > 1e6:
                os.utime(path, (second, second))
    assert [few.load(key) is not None for key in "abcd"] == [False, True, True, True]
    for path in few.folder.iterdir():
        os.utime(path, (1000, 1000))
    assert few.load("b") == CODE
    few.store("e", CODE)
    few.store("f", CODE)
    assert [few.load(key) is not None for key in "bef"] == [True, True, True]
    small = CodeCache(tmp_path / "kernels", max_bytes=2 * (len(CODE) + 32))
    small.store("g", CODE)
    assert len(small.sizes) == 2
    assert small.load("g") == CODE


def test_files_of_others_stay_where_the_cache_is_cleared(kept: CodeCache) -> None:
    kernel = file_of(kept).name
    notes = kept.folder / "notes.txt"
    notes.write_text("mine")
    half = kept.folder / f"{kernel}.0123456789abcdef.tmp"
    half.write_bytes(b"of a process that was killed")
    assert len(kept.sizes) == 2
    kept.clear()
    assert [path.name for path in kept.folder.iterdir()] == ["notes.txt"]


def test_many_that_write_and_read_at_once_never_see_a_part(tmp_path: Path) -> None:
    """More keys than there is room for, so that files also go meanwhile."""
    few, wrong = CodeCache(tmp_path / "kernels", max_files=3), []

    def work(seed: int) -> None:
        rng = np.random.default_rng(seed)
        for key in map(str, rng.integers(0, 6, 150)):
            few.store(key, key.encode() * 5000)
            found = few.load(str(rng.integers(0, 6)))
            if found is not None and len(set(found)) != 1:
                wrong.append(found)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
    assert len(few.sizes) <= 3


# Of kernels.


def test_the_cache_is_shown_and_cleared_by_a_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compile_kernel.cache_clear()
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    Response(MotorShaft(), response("step").experiment).squares(THETA)
    assert f"{tmp_path / 'kernels'}: 1 compiled kernel, 0.0 MB" in command_line.cli("cache").out
    assert "0 compiled kernels" in command_line.cli("cache", "--clear").out
    (tmp_path / "kernels").chmod(0o755)
    refused = command_line.cli("cache")
    assert refused.status == 2
    assert "chmod 700" in refused.err
    assert CACHE_VARIABLE in refused.err
    monkeypatch.setenv(CACHE_VARIABLE, "off")
    assert "BAYESDRILL_CACHE=off" in command_line.cli("cache").out


def test_what_the_code_depends_on_is_in_the_key() -> None:
    """Sources outside the folder that write kernels, but for models, whose formulas are in it."""
    folder = Path(cache.__file__).parent
    lines = {
        line.split()[1]
        for path in folder.glob("*.py")
        for line in path.read_text().splitlines()
        if line.startswith("from bayesdrill.")
    }
    others = {one for one in lines if not one.startswith("bayesdrill.rig.kernels")}
    models = {one for one in others if one.startswith("bayesdrill.rig.models.")}
    assert others - models == {"bayesdrill.basics", "bayesdrill.basics.duals"}


def code(write: Callable[..., None], *structures: Any) -> str:
    """A kernel in LLVM's language."""
    module = Module("kernel")
    write(module, *structures)
    return str(module)


def rubbing(model: Model, **own: Any) -> SteppedShape:
    pattern = ((True,) * (len(model.states) + 1),)
    usual = {"tally": SQUARES, "dual": False, "read": False, "efforts": False}
    named = {"series": ("v",), "delayed_series": (), "constant": (), "first_order": True}
    return SteppedShape(**{"model": model, "pattern": pattern, **usual, **named, **own})


def test_kernels_have_one_text_where_they_have_one_code() -> None:
    """Neither less nor more is in the key than the code depends on, and it is the same each time."""
    motor = ("t_cm", "t_sm", "w_sm")
    steps = [
        *(rubbing(MotorShaft(added=added)) for added in ((), ("t_cm",), ("t_c1",), motor)),
        *(
            rubbing(MotorShaft(added=motor, stribeck=2), **own)
            for own in ({}, {"dual": True, "tally": None})
        ),
        *(rubbing(MotorShaft(added=motor, i_m=i_m)) for i_m in (0.5, 0.25)),
        *(rubbing(MotorShaft(), **own) for own in ({"read": True}, {"delayed_series": ("v",)})),
        *(rubbing(MotorShaft(), tally=tally) for tally in (LOGS, None)),
    ]
    texts = [shape.text for shape in steps]
    codes = [code(write_stepping, shape) for shape in steps]
    assert len(set(texts)) == len(set(codes)) == len(steps)
    assert [rubbing(shape.model).text for shape in steps[:4]] == texts[:4]


def test_equal_formulas_are_one_kernel_wherever_they_come_from() -> None:
    shape = response("step")._structure
    one = shape.layout
    other = replace(one, entries=lambda p: [(i, j, 1.0 * x) for i, j, x in one.entries(p)])
    alike = replace(one, entries=lambda p: list(one.entries(p)))
    assert alike.text == one.text != other.text
    assert code(write_linear, replace(shape, layout=alike)) == code(write_linear, shape)


def test_offsets_of_channels_need_no_kernel_of_their_own() -> None:
    """Nor do perfect sensors.  Mutant killed: one for each set of channels that has one."""
    record = experiment(20, constant={}, series={"v": np.full(20, 8.0)})
    offsets = {"w_1": 0.7, "w_2": -1.5}
    for kind, model in ((Stepped, MotorShaft(added=("t_c1",))), (Response, MotorShaft())):
        own = np.append(THETA, np.full(len(model.parameters) - THETA.size, 0.05))
        plain = kind(model, record, ObservationModel()).signals(own[None])[0]
        compiled = [compile_kernel.cache_info().misses]
        for names in (("w_1",), ("w_2",), ("w_1", "w_2")):
            sensing = ObservationModel(offsets={name: f"offset_{name}" for name in names})
            full = np.append(own, [offsets[name] for name in names])
            shown = kind(model, record, sensing).signals(full[None])[0]
            added = [offsets[name] if name in names else 0.0 for name in record.names]
            assert shown == pytest.approx(plain + added, rel=1e-12, abs=1e-12)
            compiled.append(compile_kernel.cache_info().misses)
        assert len(set(compiled)) == 1, kind
