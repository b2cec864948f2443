"""Run benches of others: `python -m benchmarks.real [NAME ...] [--fetch] [--list]`.

A bench whose files are not there is skipped.  `--fetch` gets them from where they were published,
into `benchmarks/real/data`.  Exit status 1 where a bench does not find what it should.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import sys
import time
import urllib.request
from collections.abc import Sequence

import numpy as np

import bayesdrill as bd
from bayesdrill.inference import residual_checks
from bayesdrill.report.sections.nominal import quantity_name, verdict_sentence
from benchmarks.real.bench import HERE, Bench, File
from benchmarks.real.benches import BENCHES

SECONDS = 60.0  # that a server may take


def arguments(given: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.real", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="benches; default: all")
    parser.add_argument("--fetch", action="store_true", help="get files that are not there")
    parser.add_argument("--list", action="store_true", help="name the benches and stop")
    parser.add_argument("--figures", action="store_true", help="write the fits to docs/figures")
    return parser.parse_args(given)


def chosen(names: Sequence[str]) -> tuple[Bench, ...]:
    """By their names, all without one; ValueError where there is none."""
    if unknown := {*names} - {bench.name for bench in BENCHES}:
        raise ValueError(f"no bench is called {', '.join(sorted(unknown))}")
    return tuple(bench for bench in BENCHES if not names or bench.name in names)


def checked(content: bytes, file: File) -> bytes:
    """Return what was got; ValueError where it is another file than the one that was measured."""
    if hashlib.sha256(content).hexdigest() != file.digest:
        raise ValueError(f"{file.path} is not the file that was measured: another SHA-256")
    return content


def get(bench: Bench) -> None:
    """Get the files that are absent."""
    for file in bench.absent:
        with urllib.request.urlopen(bench.address(file), timeout=SECONDS) as answer:
            content = checked(answer.read(), file)
        place = bench.place(file)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)


def run(bench: Bench, *, figure: bool = False) -> tuple[str, bool]:
    """Return a line of figures, and whether all are in their ranges."""
    began = time.perf_counter()
    if bench.prepare:
        bench.prepare(bench)
    case = bd.load(bench.config)
    best = case.find_map(quick=True)
    posterior = case.job.problem.posterior
    theta, likelihood = posterior.space.vector(best.values), posterior.likelihood
    left = residual_checks.residual_summaries(likelihood, theta)
    unseen = residual_checks.residual_summaries(
        dataclasses.replace(likelihood, observations=likelihood.held_out, held_out=()), theta
    )
    worst = max(left, key=lambda one: one.share)
    passed = bool(worst.share <= bench.left)
    said = [f"leaves at most {worst.share:.1%} ({worst.name})"]
    if unseen:
        said.append("and of others " + ", ".join(f"{one.share:.0%} ({one.name})" for one in unseen))
    for criterion in bench.criteria:
        value = criterion.figure(best.values)
        holds = criterion.low <= value <= criterion.high
        limits = "" if holds else f" (not in {criterion.low:g} to {criterion.high:g})"
        unit = "" if criterion.unit == "1" else f" {criterion.unit}"
        said.append(
            f"{criterion.name} {np.format_float_positional(value, 4, fractional=False)}"
            f"{unit}{limits}"
        )
        passed &= holds
    if bench.disagrees:
        wrong, words = judged(case, best)
        passed &= wrong >= {*bench.disagrees}
        said.append(words)
    if figure:
        place = HERE.parents[1] / "docs" / "figures" / f"gallery_{bench.name}.png"
        best.plot().savefig(place, dpi=110)
    told = "; ".join(said)
    verdict = "ok" if passed else "FAILED"
    return f"{bench.name}: {verdict}, {time.perf_counter() - began:.0f} s; {told}", passed


def judged(case: bd.Case, best: bd.Best) -> tuple[set[str], str]:
    """Sample, and return the parameters whose nominal values disagree, and what the verdict says."""
    outcome = case.sample(best, processes=None).judge()
    verdict = outcome.verdict
    if verdict is None or outcome.reasons:
        return set(), f"no verdict: {' '.join(outcome.reasons)}"
    wrong = {quantity_name(verdict, each) for each in verdict.saying("disagrees")}
    records = len(case.job.problem.observations)
    return wrong, verdict_sentence(verdict, "what was published", records)


def run_each(benches: Sequence[Bench], *, fetch: bool, figures: bool) -> int:
    """Run benches, print a line of each, and return how many fail."""
    failed = 0
    for bench in benches:
        if fetch:
            get(bench)
        if bench.absent:
            print(f"{bench.name}: skipped, {bench.absent[0].name} is not there; --fetch gets it")
            continue
        line, passed = run(bench, figure=figures)
        failed += not passed
        print(line, flush=True)
    return failed


def main(given: Sequence[str] | None = None) -> int:
    options = arguments(given)
    try:
        benches = chosen(options.names)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if options.list:
        for bench in benches:
            print(f"{bench.name:10} licence: {bench.licence}; published: {bench.published}")
        return 0
    return 1 if run_each(benches, fetch=options.fetch, figures=options.figures) else 0


if __name__ == "__main__":
    sys.exit(main())
