"""bayesdrill beside its peers: same record, same posterior, one after another in one run.

`make bench` writes the tables into `docs/performance.md` and the figures into `docs/figures/`.
A peer whose package is not installed is left out, and said to be.
"""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks import growth, likelihood, problem, tables, verdict
from benchmarks.peers import PEERS
from benchmarks.peers.naive import in_the_long_run
from benchmarks.verdict import Result

NEEDS = {"pints": "pints", "nuts": "numpyro"}
LONGER = {"nuts_physical": 2.0}  # times the budget: a thousand gradients for every draw
GRACE = 240.0  # seconds beside the budget: the search for the MAP, compiling, diagnostics


def measure(name: str, budget: float) -> Result | None:
    """In a process of its own; None, with a word, where that fails."""
    package = NEEDS.get(name.split("_")[0])
    if package is not None and importlib.util.find_spec(package) is None:
        print(f"  {name}: left out, {package} is not installed", flush=True)
        return None
    seconds = budget * LONGER.get(name, 1.0)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "result.json"
        command = [sys.executable, "-m", "benchmarks.peers", name, str(seconds), str(file)]
        try:
            subprocess.run(command, check=True, timeout=seconds + GRACE)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
            print(f"  {name}: failed, {type(error).__name__}", flush=True)
            return None
        found = verdict.read(file)
    shown = "converged" if found.converged else "NOT converged"
    rate = tables.digits(found.rate) or "-"
    print(
        f"  {name:15s} {rate:>7s} effective draws/s, {found.seconds:5.1f} s, "
        f"R-hat {found.r_hat:.3f}, {shown}; {found.note}",
        flush=True,
    )
    return found


def peers(names: list[str], budget: float) -> list[Result]:
    """Ours first, then the fastest."""
    print(f"peers, {budget:.0f} s each at most (nuts_physical twice that)", flush=True)
    found = {name: measure(name, budget) for name in names}
    results = {name: result for name, result in found.items() if result is not None}
    if "first_try" in results and "stretch" in results:
        results["long_run"] = in_the_long_run(results["first_try"], results["stretch"])
    ours = [results.pop("ours")] if "ours" in results else []
    return ours + sorted(results.values(), key=lambda result: -result.rate)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=float, default=60.0, help="seconds for each peer")
    parser.add_argument("--only", nargs="+", choices=[*PEERS, "growth"], default=[*PEERS, "growth"])
    parser.add_argument("--dry", action="store_true", help="print, but leave docs/ as it is")
    options = parser.parse_args()
    job = problem.load()
    cost = likelihood.table(job)
    print(*cost, sep="\n", flush=True)
    names = [name for name in PEERS if name in options.only]
    results = peers(names, options.budget) if names else []
    if results and names[0] == "ours":
        print(*tables.markdown(results), sep="\n", flush=True)
    if not options.dry:
        tables.insert(tables.PAGE, "likelihood", [tables.where(), "", *cost])
    if not options.dry and names == list(PEERS):
        tables.insert(tables.PAGE, "peers", tables.markdown(results))
        tables.save_csv(results, tables.FIGURES / "peers.csv")
        tables.figure(results, tables.FIGURES)
    if "growth" in options.only:
        growth.main(job, dry=options.dry)


if __name__ == "__main__":
    main()
