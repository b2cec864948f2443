"""Run campaigns: many runs of one config, as a population."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bayesdrill.api import arguments
from bayesdrill.api.arguments import ManyFits
from bayesdrill.basics.equality import Value
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.campaigns.runs import CampaignPlan, describe_plan, read_plan

if TYPE_CHECKING:
    from bayesdrill.campaigns.study import CampaignOutcome
    from bayesdrill.results.run_folder import WriteMode
    from bayesdrill.tasks.remote import RefitExecutor


@arguments.check_arguments
@dataclass(frozen=True, slots=True, eq=False)
class Campaign(ManyFits["CampaignOutcome"], Value):
    """A campaign fits many runs, each by itself, and then their population.

    Make it with `bd.campaign`.

    Parameters
    ----------
    plan : CampaignPlan
        The entries of the campaign's file, and the runs.
    pages : tuple of str
        The runs for which `run` makes pages.
    """

    plan: CampaignPlan
    pages: tuple[str, ...] = ()

    kind: ClassVar[str] = "campaign"

    def place(self, folder: str | Path | None = None) -> Path:
        """Return the folder of the results of `run`, by default `results/<name>`."""
        return arguments.results_folder(folder, Path("results") / self.plan.spec.name)

    def preview(self, report: Reporter | None = None) -> str:
        """Read all records, and describe the runs in words.

        Parameters
        ----------
        report : Reporter, optional
            Receives the progress.

        Returns
        -------
        str
            Runs, rigs, times and noted columns, and findings that look wrong.

        Raises
        ------
        InputError
            With the mistakes of all records at once.

        Examples
        --------
        >>> print(bd.campaign("configs/campaign/shaft.yaml").preview())  # doctest: +ELLIPSIS
        campaign shaft: 12 runs...
        """
        from bayesdrill.campaigns import records

        notes = records.check_runs(self.plan, report or SILENT)[1]
        return f"{describe_plan(self.plan, notes)}\nThe campaign has no mistakes and can run."

    def _run(
        self, path: Path, how: WriteMode, crew: RefitExecutor, report: Reporter
    ) -> CampaignOutcome:
        from bayesdrill.campaigns import study

        return study.run_campaign(self.plan, path, how, crew, report, asked=self.pages)


@arguments.check_arguments
def campaign(path: str | Path, *, seed: int | None = None, pages: Sequence[str] = ()) -> Campaign:
    """Prepare a campaign: list its runs, without reading their records; its `run` does the work.

    Parameters
    ----------
    path : str or path
        The file of the campaign.
    seed : int, optional
        The seed of all runs, by default that of the file.
    pages : sequence of str, optional
        Runs that get pages with the causes of a misfit; "outliers" stands for all outliers.

    Returns
    -------
    Campaign
        The job.

    Raises
    ------
    InputError
        With all mistakes of the file and its table of runs.

    Examples
    --------
    >>> bd.campaign("configs/campaign/shaft.yaml").place().name
    'shaft'
    """
    plan = read_plan(Path(path).expanduser())
    if seed is not None:
        spec = plan.spec.model_copy(update={"seed": arguments.whole("seed", seed, 0)})
        plan = dataclasses.replace(plan, spec=spec)
    return Campaign(plan, tuple(pages))


@arguments.check_arguments
def watch(
    path: str | Path,
    folder: str | Path | None = None,
    *,
    once: bool = False,
    interval: float = 10.0,
    processes: int | None = 1,
    scheduler: str | None = None,
    report: Reporter | None = None,
) -> Iterator[str]:
    """Watch a campaign: new files join as runs, and all results are updated.

    Parameters
    ----------
    path : str or path
        The file of the campaign, or a folder with a `campaign.yaml`.
    folder : str or path, optional
        The folder of the results, by default `results/<name>`; earlier results there are continued.
    once : bool
        Whether to look only once.
    interval : float
        Seconds from one look to the next.
    processes, scheduler, report
        See `Campaign.run`.

    Yields
    ------
    str
        Each alarm that was not raised before, as a line of JSON.

    Raises
    ------
    InputError
        With all mistakes of the file.  A bad record is an alarm.

    Examples
    --------
    >>> alarms = bd.watch("configs/campaign/shaft.yaml", once=True)
    """
    from bayesdrill.campaigns import watch

    file = Path(path).expanduser()
    file = file / "campaign.yaml" if file.is_dir() else file
    place = campaign(file).place(folder)
    with arguments.crew(processes, scheduler) as crew:
        yield from watch.watch(file, place, crew, report or SILENT, interval, once=once)


def is_campaign(path: Path) -> bool:
    """Return whether a file describes a campaign, not a config."""
    return path.is_file() and _BASE.search(path.read_bytes()) is not None


_BASE = re.compile(rb"^\{?[\"']?base[\"']?\s*:", re.MULTILINE)  # only a campaign has such a key
