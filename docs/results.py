"""What `results/published` holds of every config in `configs/`: tables, report and PNG, and no chains.

    python docs/results.py            copies them from the folders that `make results` has just made
    python docs/results.py --check    says what is not of today's configs and records, and exits with 1

Runs write to `results/<name>`, which is no part of the project, so that a run is never in the way.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import bayesdrill as bd
from bayesdrill.basics import own_files
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import VERSION_OF

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "results"
PUBLISHED = RESULTS / "published"
ENDS = (".csv", ".html", ".json", ".md", ".png", ".tex")
OWN = ("map.json",)  # for --resume, which needs a chain


def configs() -> Mapping[str, Path]:
    """By the names of their runs."""
    return {bd.load(path).job.config.name: path for path in sorted(ROOT.glob("configs/*.yaml"))}


def files(folder: Path, kind: own_files.Kind) -> Iterator[str]:
    """What is published of a finished run."""
    for name in own_files.present(folder, kind):
        if name.endswith(ENDS) and name not in OWN:
            yield name


def publish(source: Path, target: Path, kind: own_files.Kind) -> None:
    """Raises `FileNotFoundError` where there is no finished run."""
    shutil.rmtree(target, ignore_errors=True)
    if json.loads((source / own_files.RUN).read_text()).get("status") != "finished":
        raise FileNotFoundError(f"{source} is not finished")
    for name in files(source, kind):
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)


def stale() -> Iterator[str]:
    """What differs between what is published and what the configs would give, a sentence each."""
    found = configs()
    kept = {path.name for path in PUBLISHED.iterdir() if path.is_dir()}
    for name in sorted({*found, "paper"} - kept):
        yield f"{name} is not published"
    for name in sorted(kept - {*found, "paper"}):
        yield f"{name} has no config any more"
    for name in sorted({*found} & kept):
        yield from _differences(name, found[name])


def _differences(name: str, config: Path) -> Iterator[str]:
    run = json.loads((PUBLISHED / name / own_files.RUN).read_text())
    case = bd.load(config)
    today = provenance.fingerprint(case.job.config, case.job.problem)
    for key in sorted({*today, *run["fingerprint"]}):
        old, new = run["fingerprint"].get(key), today.get(key)
        if old != new and (not key.startswith(VERSION_OF) or key == f"{VERSION_OF}bayesdrill"):
            yield f"{name}: {key} was {old} and is {new}"
    for file in files(PUBLISHED / name, own_files.POSTERIOR):
        digest = own_files.digest(PUBLISHED / name / file)
        if file != own_files.RUN and run["files"].get(file) != digest:
            yield f"{name}: {file} is not of its run"
    usual = [file for file in own_files.POSTERIOR.files if "/" not in file]
    for file in sorted({*run["files"], *usual}):
        if file.endswith(ENDS) and file not in OWN and not (PUBLISHED / name / file).exists():
            yield f"{name}: {file} is missing"


def main() -> int:
    if sys.argv[1:] == ["--check"]:
        problems = list(stale())
        print("\n".join(problems) or "what is published is of today's configs and records")
        return int(bool(problems))
    for name in configs():
        publish(RESULTS / name, PUBLISHED / name, own_files.POSTERIOR)
    records = [path.parent.name for path in (RESULTS / "paper").glob("*/run.json")]
    publish(RESULTS / "paper", PUBLISHED / "paper", own_files.paper(records))
    return 0


if __name__ == "__main__":
    sys.exit(main())
