"""Several runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bayesdrill.api import arguments
from bayesdrill.api import run as single
from bayesdrill.api.pictures import for_notebooks
from bayesdrill.basics.checked import checked
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.values import Value
from bayesdrill.commands import overlaying
from bayesdrill.insight.overlay import Row
from bayesdrill.report.overlay_report import OverlayReport
from bayesdrill.report.sections import as_markdown

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Overlay(Value):
    """What several runs say of their unknowns, side by side.

    `runs`: where each is, None where it is in no folder.
    """

    report: OverlayReport
    runs: tuple[Path | None, ...]

    @property
    def rows(self) -> tuple[Row, ...]:
        """Of each unknown: where each run has it, SI, and how far apart they are, in sds."""
        return self.report.rows

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why some run must not be believed; empty where all may be."""
        return self.report.reasons

    @property
    def text(self) -> str:
        return self.report.text

    def plot(self, name: str = "corner") -> Figure:
        """`corner`, or `intervals`.  Raises `InputError` where there is no such figure."""
        found = arguments.known(self.report.figures, name, "plot", "figure of these runs")
        return for_notebooks(found.drawn())

    def place(self, folder: str | Path | None = None) -> Path:
        """Where `save` leaves its results: `results/<name>-<name>` by default."""
        usual = overlaying.usual_place([layer.name for layer in self.report.layers])
        return usual if folder is None else Path(folder).expanduser()

    def save(self, folder: str | Path | None = None, *, force: bool = False) -> Path:
        """Table, page and figures.

        Raises `InputError` where something else is there, or an overlay and not `force`.
        """
        place = self.place(folder)
        overlaying.publish(self.report, self.runs, place, force=force)
        return place

    def __str__(self) -> str:
        return self.text

    def _repr_markdown_(self) -> str:
        brief = [section for section in self.report.sections if section.brief]
        return as_markdown(self.report.title, brief)

    __repr__ = __str__


@checked
def overlay(runs: Sequence[single.Run | str | Path], names: Sequence[str] | None = None) -> Overlay:
    """Of two runs or more, of any records, priors and rigs: runs in memory, or folders of them.

    `names`: by default those of the folders and cases.  Raises `InputError`.
    """
    overlaying.check_number(len(runs))
    own, opened, places = named_runs(runs, names)
    units = overlaying.units([one.job for one in opened])
    layers = [
        overlaying.layer(name, one.job, one.mode, one.sampled, units)
        for name, one in zip(own, opened, strict=True)
    ]
    return Overlay(OverlayReport(tuple(layers), units), tuple(places))


def named_runs(
    every: Sequence[single.Run | str | Path], names: Sequence[str] | None
) -> tuple[list[str], list[single.Run], list[Path | None]]:
    """Their names, all different; the runs; and where they are."""
    if names is not None and len(names) != len(every):
        raise InputError.one("names", f"{len(names)} names of {len(every)} runs")
    opened = [one if isinstance(one, single.Run) else single.open(one) for one in every]
    places = [None if isinstance(one, single.Run) else Path(one).expanduser() for one in every]
    usual = [
        one.job.config.name if place is None else place.resolve().name
        for one, place in zip(opened, places, strict=True)
    ]
    return overlaying.distinct([str(name) for name in names or usual]), opened, places


@checked
def check_place(
    folders: Sequence[str | Path], output: str | Path | None = None, *, force: bool = False
) -> Path:
    """Where the overlay of these would be saved; raises `InputError` where it cannot be."""
    overlaying.check_number(len(folders))
    places = [Path(folder).expanduser() for folder in folders]
    names = overlaying.distinct([place.resolve().name for place in places])
    usual = overlaying.usual_place(names)
    target = usual if output is None else Path(output).expanduser()
    overlaying.check_place(target, places, force=force)
    return target
