"""Define the entries of a campaign's file: a base config, runs, and notes on each run."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from bayesdrill.basics.entries import Count, NonNegative, Number, Positive, Strict

TimeUnit = Literal["s", "min", "h", "d"]
SECONDS: dict[TimeUnit, float] = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
Text = Annotated[str, Field(min_length=1)]
Change = Annotated[Number, Field(gt=-1)]  # relative change: 0.05 is 5 %
NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"


class RunSpec(Strict):
    """A run has a record and notes."""

    file: Text = Field(description="Relative to the folder of the campaign's file.")
    name: str | None = Field(None, description="Default: the name of the file without its ending.")
    rig: str = Field("", description="The rig with which the run was made.")
    time: Number | str | None = Field(
        None, description="A number in `time_unit`, or a date such as 2026-03-01T12:00."
    )
    noted: dict[str, Number | None] = Field(default_factory=dict)
    """Numbers that were noted in addition to the record, such as a temperature."""


class JumpSpec(Strict):
    """A jump changes the parameters of all simulated runs after a given run."""

    after: Count
    change: dict[str, Change]
    """Relative changes by parameter: 0.05 is 5 %."""


class ForeignSpec(Strict):
    """Foreign runs of a simulated campaign are made with other parameters."""

    count: Count
    change: dict[str, Change]
    """Relative changes by parameter."""


class CampaignSimulation(Strict):
    """The simulation section sets how `simulate` draws the true parameters of each run."""

    runs: Annotated[int, Field(ge=1, le=100_000)]
    rigs: Annotated[int, Field(ge=1, le=1000)] = 1
    interval: Positive = 1.0
    """Time from one run to the next, in `time_unit`."""
    spread: dict[str, NonNegative] = Field(default_factory=dict)
    """Relative standard deviations between runs of one rig, by parameter."""
    rig_spread: dict[str, NonNegative] = Field(default_factory=dict)
    """Relative standard deviations between rigs, by parameter."""
    drift: dict[str, Change] = Field(default_factory=dict)
    """Relative changes from the first run to the last, by parameter."""
    jump: JumpSpec | None = None
    noted: dict[str, dict[str, Number]] = Field(default_factory=dict)
    """Notes with standard normal values; each has the relative changes of parameters per unit."""
    foreign: ForeignSpec | None = None


def _place_or_list(value: Any) -> str:
    return "<list>" if isinstance(value, list) else "<place>"


class CampaignSpec(Strict):
    """A campaign has a base config and many runs, each with a record of its own."""

    name: Annotated[str, Field(pattern=NAME, max_length=100)]
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    base: Text = Field(description="The config of all runs, relative to the folder of this file.")
    runs: Annotated[
        Annotated[Text, Tag("<place>")]
        | Annotated[list[RunSpec], Field(min_length=1), Tag("<list>")],
        Discriminator(_place_or_list),
    ]
    """A glob such as `records/*.csv`, a list, or a table of runs (CSV or Parquet).

    File names are relative to the folder of the campaign's file, or else of the table.
    """
    time_unit: TimeUnit = "s"
    """Unit of times that are numbers."""
    by_name: bool = False
    """Space runs without times equally, in the order of their names."""
    noted: list[str] = Field(default_factory=list)
    """Columns of the table of runs that may explain differences between runs."""
    leave_out: list[str] = Field(default_factory=list)
    """Names of runs that are left out."""
    overrides: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """Entries of the config that differ in a run, by the name of the run."""
    effort: Annotated[int, Field(ge=100, le=100_000)] = 500
    """Number of effective draws from the posterior of each run."""
    simulation: CampaignSimulation | None = None
