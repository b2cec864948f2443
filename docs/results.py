"""What `results/published` holds of every config in `configs/`: tables, report and PNG, and no chains.

    python docs/results.py            copies them from the folders that `make results` has just made
    python docs/results.py --check    says what is not of today's configs and records, and exits with 1

Runs write to `results/<name>`, which is no part of the project, so that what is published is in no
run's way. The figure `docs/figures/products` shows what is published, and is made with it.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import VERSION_OF
from bayesdrill.tasks.design import COMING
from docs import products
from studies.paper import reproduction

ROOT = Path(__file__).parent.parent
PAPER = "paper"
DESIGNED, OF = "nominal_step_designed", "nominal_step"  # a designed experiment, and its config
ENDS = (".csv", ".html", ".json", ".md", ".png", ".tex")
OWN = ("map.json",)  # for --resume, which needs a chain
SOME = ("torque.csv",)  # of runs that have a missing torque
DECISIVE = f"{VERSION_OF}bayesdrill"  # of the versions, this one makes results another's


def published(root: Path) -> Path:
    return root / "results" / "published"


def configs(root: Path) -> Mapping[str, bd.Case]:
    """By the names of their runs."""
    cases = map(bd.load, sorted(root.glob("configs/*.yaml")))
    return {case.job.config.name: case for case in cases}


def files(folder: Path, kind: output_files.Kind) -> Iterator[str]:
    """What is published of a finished run."""
    for name in output_files.output_names(folder, kind):
        if name.endswith(ENDS) and name not in OWN:
            yield name


def publish(source: Path, target: Path, kind: output_files.Kind) -> None:
    """Raises `FileNotFoundError` where there is no finished run."""
    if _run(source).get("status") != "finished":
        raise FileNotFoundError(f"{source} is not finished")
    shutil.rmtree(target, ignore_errors=True)
    for name in files(source, kind):
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)


def stale(root: Path) -> Iterator[str]:
    """What differs between what is published and what the configs would give, a sentence each."""
    found = configs(root)
    wanted = {*found, PAPER} | ({DESIGNED} if OF in found else set())
    kept = {path.name for path in published(root).iterdir() if path.is_dir()}
    yield from (f"{name} is not published" for name in sorted(wanted - kept))
    yield from (f"{name} has no config any more" for name in sorted(kept - wanted))
    for name in sorted({*found} & kept):
        folder = published(root) / name
        yield from (f"{name}: {what}" for what in _other_run(found[name], _run(folder)))
        yield from (f"{name}: {what}" for what in _other_files(folder, _run(folder)))
    if DESIGNED in kept and OF in found:
        yield from _other_design(found[OF], published(root) / DESIGNED)
    yield from products.stale(root)


def _run(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / output_files.RUN).read_text(encoding="utf-8")))


def _other_run(case: bd.Case, run: Mapping[str, Any]) -> Iterator[str]:
    today = provenance.fingerprint(case.job.config, case.job.problem)
    for key in sorted({*today, *run["fingerprint"]}):
        old, new = run["fingerprint"].get(key), today.get(key)
        if old != new and (not key.startswith(VERSION_OF) or key == DECISIVE):
            yield f"{key} was {old} and is {new}"


def _other_files(folder: Path, run: Mapping[str, Any]) -> Iterator[str]:
    """Edited, or missing among those that a run of today leaves."""
    here = {*files(folder, output_files.POSTERIOR)}
    for name in sorted(here - {output_files.RUN}):
        if run["files"].get(name) != output_files.digest(folder / name):
            yield f"{name} is not of its run"
    usual = {name for name in output_files.POSTERIOR.files if "/" not in name} - {*SOME}
    for name in sorted({*run["files"], *usual} - here):
        if name.endswith(ENDS) and name not in OWN:
            yield f"{name} is missing"


def _other_design(case: bd.Case, folder: Path) -> Iterator[str]:
    """What the record of today's config tells, and the priors of the coming one."""
    config = case.job.source.data
    coming = YAML(typ="safe").load((folder / COMING).read_text(encoding="utf-8"))
    for key in ("model", "nominal", "parameters"):
        if coming.get(key) != config.get(key):
            yield f"{DESIGNED}: {key} of {COMING} is not that of {OF}"
    wanted = [n for n in output_files.DESIGN.files if n.endswith((*ENDS, ".yaml"))]
    yield from (f"{DESIGNED}: {n} is missing" for n in wanted if not (folder / n).exists())


def main() -> int:
    if sys.argv[1:] == ["--check"]:
        problems = list(stale(ROOT))
        print("\n".join(problems) or "what is published is of today's configs and records")
        return int(bool(problems))
    results = ROOT / "results"
    for name in configs(ROOT):
        publish(results / name, published(ROOT) / name, output_files.POSTERIOR)
    shutil.rmtree(published(ROOT) / DESIGNED, ignore_errors=True)
    shutil.copytree(
        results / DESIGNED, published(ROOT) / DESIGNED, ignore=shutil.ignore_patterns("*.pdf")
    )
    records = [path.parent.name for path in (results / PAPER).glob("*/run.json")]
    publish(results / PAPER, published(ROOT) / PAPER, reproduction.files_of(records))
    products.save(ROOT)
    return 0


if __name__ == "__main__":
    sys.exit(main())
