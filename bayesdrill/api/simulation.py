"""Simulate records of configs and of campaigns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bayesdrill import output_files
from bayesdrill.api import arguments
from bayesdrill.api.campaign import is_campaign
from bayesdrill.basics.errors import InputError

MOST_SAID = 20  # largest number of files that the text lists


@dataclass(frozen=True, slots=True)
class Simulated:
    """A simulated record consists of `files`, each with its number of samples."""

    files: Mapping[Path, int]

    @property
    def path(self) -> Path:
        """Return the path of the first file."""
        return next(iter(self.files))

    @property
    def samples(self) -> int:
        """Return the total number of samples."""
        return sum(self.files.values())

    @property
    def said(self) -> str:
        """Return a line for each of the first `MOST_SAID` files, and the number of other files."""
        lines = [f"{path}: {samples} samples" for path, samples in self.files.items()]
        more = [f"... and {len(lines) - MOST_SAID} more"] if len(lines) > MOST_SAID else []
        return "\n".join([*lines[:MOST_SAID], *more])


@arguments.check_arguments
def simulate(
    config: str | Path,
    output: str | Path | None = None,
    *,
    seed: int | None = None,
    force: bool = False,
) -> Simulated:
    """Simulate the record of a config, the response with noise, and write it as CSV.

    For a campaign, write all records, their table and the true parameters (`truth.csv`).

    Parameters
    ----------
    config : str or path
        The config or campaign file, whose section `simulation:` has the true values.
    output : str or path, optional
        The CSV file, or a folder for several experiments; by default the record that the config
        names.  A campaign names its files itself.
    seed : int, optional
        The seed of the noise; by default that of the config.
    force : bool
        Whether to replace existing files.

    Returns
    -------
    Simulated
        The files, each with its number of samples.

    Raises
    ------
    InputError
        If the config is wrong or a file exists; nothing is written in this case.

    Examples
    --------
    >>> bd.simulate("configs/nominal_step.yaml", "mine.csv", seed=7).path.name
    'mine.csv'
    """
    from bayesdrill.config import loading
    from bayesdrill.config.records import reading, simulation, sources

    path = Path(config).expanduser()
    if is_campaign(path):
        from bayesdrill.campaigns.simulation import simulate_campaign

        if output is not None:
            raise InputError.at("--output", f"{path} is a campaign, which names its files itself")
        number = None if seed is None else arguments.integer("seed", seed, 0)
        return Simulated(simulate_campaign(path, number, force=force))
    case = loading.load(path)
    used_seed = case.config.seed if seed is None else arguments.integer("seed", seed, 0)
    given, several = None if output is None else Path(output).expanduser(), case.config.experiments
    if several and given is not None and given.exists() and not given.is_dir():
        message = "is not a folder; name a folder for the records of several experiments"
        raise InputError.at(str(given), message)
    texts = simulation.simulate_all(case, used_seed, given)
    for target, text in texts.items():
        simulation.check_target(text, target, sources.files(case), force=force)
    files = {}
    for (target, text), experiment in zip(texts.items(), case.experiments, strict=True):
        if several:
            target.parent.mkdir(parents=True, exist_ok=True)
        output_files.write_text(target, text)
        skipped = reading.csv_options(experiment.config.record).skip_rows
        files[target] = len(text.splitlines()) - 1 - skipped
    return Simulated(files)
