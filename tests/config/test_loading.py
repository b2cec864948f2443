"""Configs are loaded: what the bundled one says, defaults, and what decides a chain."""

from pathlib import Path

from support.case_tables import run_cases
from support.command_line import ROOT
from support.config_texts import write
from support.described_rigs import LINEAR, ROTARY, save_records
from support.small_problems import starts_believed

from bayesdrill.config.job import Job, prepare
from bayesdrill.results import provenance

CONFIGS = ROOT / "configs"
BUNDLED = (CONFIGS / "nominal_step.yaml").read_text().replace("records/", f"{CONFIGS}/records/")
TIES = (CONFIGS / "example_ties.yaml").read_text().replace("records/", f"{CONFIGS}/records/")


def fingerprint(job: Job) -> dict[str, str]:
    return provenance.fingerprint(job.config, job.problem)


@run_cases(
    "text",
    [
        BUNDLED,
        *(f"{BUNDLED}\ninitial: {x}\n" for x in ("steady", "free", "{state: free, w_1: 0.5}")),
        *(TIES, ROTARY, LINEAR),
    ],
    ids=["nominal_step", "steady", "free", "partly free", "ties", "train", "carts"],
)
def test_a_resolved_config_means_the_same(text: str, tmp_path: Path) -> None:
    save_records(tmp_path)
    job = prepare(write(tmp_path, text))
    resolved = tmp_path / "resolved.yaml"
    resolved.write_text(provenance.resolved(job.case, tmp_path))
    again = prepare(resolved)
    assert fingerprint(again) == fingerprint(job)
    assert again.config.sampler == job.config.sampler
    assert again.problem.derived == job.problem.derived
    space = job.problem.posterior.space
    start = space.vector(space.start)[None]
    assert again.problem.posterior.density(start) == job.problem.posterior.density(start)


@run_cases(
    "old, new, name",
    [
        ("seed: 2013", "seed: 2014", "the seed"),
        ("v: 8.0", "v: 8.1", "the input v"),
        ("walkers: 256", "walkers: 66", "sampler.walkers"),
        ("i_m: 0.125", "i_m: 0.25", "the model"),
        ("rad/s, sigma: 0.1}\n    w_2", "rad/s, sigma: 0.2}\n    w_2", "the noise of w_1"),
        ("t_f: {prior: uniform, low: 0.5", "t_f: {prior: uniform, low: 0.4", "the prior of t_f"),
    ],
)
@starts_believed()
def test_the_fingerprint_names_what_decides_a_chain(
    old: str, new: str, name: str, tmp_path: Path
) -> None:
    given = fingerprint(prepare(CONFIGS / "nominal_step.yaml"))
    changed = fingerprint(prepare(write(tmp_path, BUNDLED, (old, new))))
    assert {key for key in {**given, **changed} if given.get(key) != changed.get(key)} == {name}
