"""Run campaigns: fit one config to many records, and then the population of their posteriors."""

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
    """A campaign fits many runs separately, and then the distribution of their parameters.

    `bd.campaign` makes one.

    Parameters
    ----------
    plan : CampaignPlan
        The entries of the campaign's file, and its runs.
    pages : tuple of str
        The runs whose misfit `run` explains on a page.
    """

    plan: CampaignPlan
    pages: tuple[str, ...] = ()

    kind: ClassVar[str] = "campaign"

    def place(self, folder: str | Path | None = None) -> Path:
        """Return the folder for the results of `run`, by default `results/<name>`."""
        return arguments.results_folder(folder, Path("results") / self.plan.spec.name)

    def preview(self, report: Reporter | None = None) -> str:
        """Read all records, and describe the runs in a text.

        Parameters
        ----------
        report : Reporter, optional
            Receives the progress.

        Returns
        -------
        str
            The runs, rigs, times and noted columns, and whatever looks wrong in a record.

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
    """Prepare a campaign: list its runs, but do not read records; `Campaign.run` does the work.

    Parameters
    ----------
    path : str or path
        The file of the campaign.
    seed : int, optional
        The seed for all runs; by default the seed in the file.
    pages : sequence of str, optional
        Names of runs that get a page with causes of their misfit; "outliers" names all outliers.

    Returns
    -------
    Campaign
        The campaign, before any fit.

    Raises
    ------
    InputError
        With all mistakes in the file and in its table of runs.

    Examples
    --------
    >>> bd.campaign("configs/campaign/shaft.yaml").place().name
    'shaft'
    """
    plan = read_plan(Path(path).expanduser())
    if seed is not None:
        spec = plan.spec.model_copy(update={"seed": arguments.integer("seed", seed, 0)})
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
    """Watch a campaign: add new files as runs, update all results, and yield alarms.

    Parameters
    ----------
    path : str or path
        The file of the campaign, or a folder with a `campaign.yaml`.
    folder : str or path, optional
        The folder for the results, by default `results/<name>`; earlier results are resumed.
    once : bool
        Whether to look for files only once, and then return.
    interval : float
        The time in s between two looks for new files.
    processes, scheduler, report
        See `Campaign.run`.

    Yields
    ------
    str
        Each alarm that is new, as a line of JSON.

    Raises
    ------
    InputError
        With all mistakes in the file.  A bad record is reported by an alarm instead.

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
    """Return whether a file is that of a campaign, not a config."""
    return path.is_file() and _BASE.search(path.read_bytes()) is not None


_BASE = re.compile(rb"^\{?[\"']?base[\"']?\s*:", re.MULTILINE)  # only a campaign has such a key
