"""The comparison of peers as Markdown, CSV and a figure, and text between markers of a document."""

from __future__ import annotations

import csv
import math
import os
import platform
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from bayesdrill.output_files import atomic_write
from bayesdrill.report import scales, style
from benchmarks import verdict
from benchmarks.verdict import Result

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "performance.md"
FIGURES = DOCS / "figures"

HEAD = (
    "sampler", "coordinates", "ESS/s", "ESS", "seconds", "R-hat", "tau", "converged",
    "means off [sd]", "bayesdrill is faster by",
)  # fmt: skip


def insert(page: Path, marker: str, lines: list[str]) -> None:
    """Between `<!-- marker -->` and `<!-- /marker -->`; ValueError where these are missing."""
    text = page.read_text(encoding="utf-8")
    begin, end = f"<!-- {marker} -->", f"<!-- /{marker} -->"
    head, found, rest = text.partition(begin)
    _, closed, tail = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"{page.name} has no place for '{marker}'")
    body = "\n".join(lines)
    with atomic_write(page) as aside:
        aside.write_text(f"{head}{begin}\n{body}\n{end}{tail}", encoding="utf-8")


def where() -> str:
    """The machine, in a sentence."""
    machine, python = platform.machine(), platform.python_version()
    return f"Measured with {os.cpu_count()} processors ({machine}), Python {python}."


def cells(result: Result, ours: Result) -> tuple[str, ...]:
    off = verdict.off(result, ours)
    return (
        result.name,
        result.coordinates,
        digits(result.rate),
        digits(result.ess),
        f"{result.seconds:.1f}",
        "" if math.isnan(result.r_hat) else f"{result.r_hat:.3f}",
        "" if result.tau is None else f"{result.tau:.0f}",
        "yes" if result.converged else "**no**",
        "" if result is ours or math.isnan(off) else f"{off:.2f}",
        "" if result is ours or result.rate == 0.0 else digits(ours.rate / result.rate),
    )


def digits(x: float) -> str:
    """Two digits, or the whole part of a long number."""
    if x == 0.0:
        return ""
    places = max(0, 1 - math.floor(math.log10(x)))
    return f"{x:.{places}f}"


def markdown(results: list[Result]) -> list[str]:
    ours = results[0]
    lines = [where(), "", row(HEAD), row(("---", "---", *["---:"] * 5, ":---:", "---:", "---:"))]
    lines += [row(cells(result, ours)) for result in results]
    notes = [f"- {r.name} ({r.coordinates}): {r.note}" for r in results if r.note]
    return [*lines, "", *notes]


def row(texts: tuple[str, ...]) -> str:
    return f"| {' | '.join(texts)} |"


def save_csv(results: list[Result], path: Path) -> None:
    ours = results[0]
    with atomic_write(path) as aside, aside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*HEAD, "compiling [s]", "evaluations", "note"])
        for result in results:
            texts = [text.strip("*") for text in cells(result, ours)]
            writer.writerow([*texts, f"{result.setup:.1f}", f"{result.work:.0f}", result.note])


def figure(results: list[Result], folder: Path) -> None:
    """Bars of effective draws per second; hatched where the run did not converge."""
    shown = [result for result in reversed(results) if result.rate > 0.0]
    with style.styled():
        made = Figure(figsize=(scales.DOUBLE, 0.42 * len(shown) + 0.9))
        panel = made.add_axes(
            (0.43, 0.62 / made.get_figheight(), 0.55, 1 - 0.92 / made.get_figheight())
        )
        for place, result in enumerate(shown):
            panel.barh(
                place,
                result.rate,
                height=0.62,
                facecolor=style.MIDDLE if result.converged else "white",
                edgecolor=style.BLACK,
                linewidth=0.6,
                hatch="" if result.converged else "//////",
            )
            panel.annotate(
                digits(result.rate), (result.rate, place), (4, 0), textcoords="offset points",
                va="center", fontsize=8,
            )  # fmt: skip
        labels = [f"{result.name}\n{result.coordinates}" for result in shown]
        panel.set_yticks(range(len(shown)), labels)
        panel.tick_params(axis="y", length=0, labelsize=7.5)
        panel.set_xscale("log")
        rates = [result.rate for result in shown]
        panel.set_xlim(0.5 * min(rates), 5.0 * max(rates))
        panel.set_xlabel(r"effective draws of the worst parameter per second [$\mathrm{s^{-1}}$]")
        panel.spines[["top", "right"]].set_visible(False)
        made.legend(
            handles=[
                Patch(facecolor=style.MIDDLE, edgecolor=style.BLACK, label="converged"),
                Patch(facecolor="white", edgecolor=style.BLACK, hatch="//////", label="not converged"),
            ],
            loc="upper right", ncols=2, bbox_to_anchor=(0.99, 1.0),
        )  # fmt: skip
        style.save(made, folder, "peers", {"Title": "Effective draws per second"})
