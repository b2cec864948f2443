"""`bayesdrill posterior --resume` and `--force`: what goes on, what is refused, what is damaged."""

import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases
from support.command_line import assert_refused, posterior, replace_text
from support.finished_runs import FILES, UNREACHABLE, FinishedRun, copied_run
from support.reporters import Stopping
from support.small_problems import starts_believed

import bayesdrill as bd
from bayesdrill.basics.errors import Interrupted
from bayesdrill.output_files import dumps_checksummed, loads_checksummed
from bayesdrill.results.run_folder import seal


def test_a_finished_run_resumed_changes_nothing(converged: FinishedRun, copy: FinishedRun) -> None:
    assert posterior(copy.config, copy.folder, "--resume").status == 0
    assert set(command_line.listing(copy.folder)) == FILES
    converged.assert_same_chains(copy)


def test_a_finished_run_is_extended(
    converged: FinishedRun, unconverged: FinishedRun, copy: FinishedRun
) -> None:
    replace_text(copy.config, *UNREACHABLE)
    result = posterior(copy.config, copy.folder, "--resume")
    assert result.status == 3, result.text
    assert set(command_line.listing(copy.folder)) == FILES
    short, long = converged.chains(), copy.chains()
    for k in range(4):
        assert long[f"z {k}"].shape == (700, 8, 2)
        assert np.array_equal(long[f"z {k}"][: len(short[f"z {k}"])], short[f"z {k}"])
    unconverged.assert_same_chains(copy)


STOPS = (
    ("searching", "no maximum was found yet; {} only has the config"),
    ("learning", "the maximum is saved in {}, but nothing was sampled yet"),
    ("the walkers", "the maximum is saved in {}, but nothing was sampled yet"),
    (" steps to the next check", "all samples so far are saved in {}"),
    ("the draws", "all samples so far are saved in {}"),
)


def test_a_run_stopped_in_five_stages_says_what_is_saved_and_goes_on(
    converged: FinishedRun, tmp_path: Path
) -> None:
    config = command_line.small_config(tmp_path)
    case, out = bd.load(config), tmp_path / "out"
    for stage, words in STOPS:
        reporter = Stopping(lambda _, text, stage=stage: stage in text)
        with pytest.raises(Interrupted) as stopped:
            case.run(out, resume=out.exists(), report=reporter)
        message = f"stopped; {words.format(out)}; continue with --resume"
        assert str(stopped.value) == message, stage
        if stage != " steps to the next check":
            continue
        report = command_line.cli("report", out)
        assert_refused(report, "--resume")
    assert case.run(out, resume=True).reasons == ()
    assert bd.verify(out).together
    converged.assert_same_chains(FinishedRun(config, out, report))


def test_a_run_cut_before_its_first_check_or_in_one_ensemble_cannot_be_reported_yet(
    unconverged: FinishedRun, tmp_path: Path
) -> None:
    """Though its few steps may look converged."""
    folder = unconverged.copy(tmp_path / "copy").folder
    every = [f"ensemble_{k}" for k in range(4)]
    for names, steps in ((every[2:3], 487), (every, 150)):
        with h5py.File(folder / "chain.h5", "r+") as file:
            for group in map(file.get, names):
                assert len(group["chain"]) > steps
                for name in ("chain", "log_prob"):
                    group[name].resize(steps, axis=0)
                group.attrs["iteration"] = steps
                seal(group)
        before = command_line.listing(folder)
        report = command_line.cli("report", folder)
        assert_refused(report, "before its first check", "--resume")
        assert command_line.listing(folder) == before


@run_cases("old, new, named", command_line.REFUSALS["resume"], copy=copied_run)
@starts_believed()
def test_resuming_another_config_names_what_changed_and_both_values(
    old: str, new: str, named: str, copy: FinishedRun
) -> None:
    before = command_line.listing(copy.folder)
    replace_text(copy.config, old, new)
    result = posterior(copy.config, copy.folder, "--resume")
    assert_refused(result, "cannot resume", named, "--force", "--output")
    assert command_line.listing(copy.folder) == before


@run_cases("package", ["bayesdrill", "numpy", "scipy", "emcee", "llvmlite"], copy=copied_run)
def test_resuming_under_another_version_of_what_decides_the_chain_is_refused(
    package: str, copy: FinishedRun
) -> None:
    """With both versions.  A report, which adds nothing to the chain, is made."""
    run = loads_checksummed((copy.folder / "run.json").read_bytes())
    run["fingerprint"][f"the version of {package}"] = "0.0.1"
    (copy.folder / "run.json").write_text(dumps_checksummed(run))
    before = command_line.listing(copy.folder)
    result = posterior(copy.config, copy.folder, "--resume")
    words = f"the version of {package} was 0.0.1 and is {version(package)}"
    assert_refused(result, words, "--force")
    assert command_line.listing(copy.folder) == before
    if package == "numpy":
        assert command_line.cli("report", copy.folder, "--processes", "1").status == 0
        assert '"the version of numpy": "0.0.1"' in (copy.folder / "run.json").read_text()


def digit_changed(content: bytes) -> bytes:
    """Change the first log posterior of `map.json` by a hundredth."""
    return re.sub(rb"(log_posterior.*\.\d)\d", rb"\g<1>0", content, count=1)


@run_cases(
    "name, damage, way_out",
    [
        ("run.json", lambda content: content[:40], "put back a copy"),
        ("run.json", lambda content: content.replace(b"finished", b"finishes"), "put back a copy"),
        *(("run.json", lambda _, text=text: text, "another folder") for text in
          (b"[]", b"null", b'"x"', b'{"fingerprint": 3}')),
        ("map.json", lambda content: content[:40], "delete it and continue with --resume"),
        ("map.json", lambda content: b"\xff" + content, "delete it and continue with --resume"),
        ("map.json", digit_changed, "delete it and continue with --resume"),
        ("chain.h5", lambda content: content[:40], "delete it and continue with --resume"),
    ],
    copy=copied_run,
)  # fmt: skip
def test_a_damaged_result_is_named_and_nothing_is_written(
    name: str, damage: Callable[[bytes], bytes], way_out: str, copy: FinishedRun
) -> None:
    """Not even that the run is `running` again."""
    content = (copy.folder / name).read_bytes()
    assert damage(content) != content
    (copy.folder / name).write_bytes(damage(content))
    before = command_line.listing(copy.folder)
    commands = [posterior(copy.config, copy.folder, "--resume")]
    if way_out == "another folder":
        commands.append(posterior(copy.config, copy.folder, "--force"))
    else:
        commands.append(command_line.cli("report", copy.folder, "--processes", "1"))
        assert not any("--force" in result.err for result in commands)
    for result in commands:
        assert_refused(result, name, way_out)
    assert command_line.listing(copy.folder) == before


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """A disk of its own, to be mounted and mounted again with other options."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = False

    def mount(options: str) -> Path:
        nonlocal mounted
        again = "remount," if mounted else ""
        command = ["mount", "-t", "tmpfs", "-o", again + options, "tmpfs", str(place)]
        if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
            pytest.skip("nothing may be mounted here")
        mounted = True
        return place

    yield mount
    if mounted:
        subprocess.run(["umount", "-l", str(place)], check=True)


# Too small for the pieces, for the chain beside them, for what follows from it.
@pytest.mark.slow
@pytest.mark.parametrize("kilobytes", [150, 600, 640])
def test_a_run_that_fills_its_disk_can_be_resumed(
    kilobytes: int, converged: FinishedRun, tmp_path: Path, small_disk: Callable[[str], Path]
) -> None:
    folder = small_disk(f"size={kilobytes}k") / "out"
    config = command_line.small_config(tmp_path / "rig")
    # In a process of its own: HDF5 may take the whole process down when it cannot write.
    arguments = ("posterior", config, "-o", folder, "--processes", "1")
    result = command_line.run_process(*arguments, cwd=tmp_path)
    assert_refused(result, f"{folder}", "No space left", "--resume")
    names = [Path(name).name for name in command_line.listing(folder)]
    assert not [name for name in names if name.startswith(".chain")]
    small_disk("size=50m")
    assert posterior(config, folder, "--resume").status == 0
    assert set(command_line.listing(folder)) == FILES
    converged.assert_same_chains(FinishedRun(config, folder, result))
