"""How large what a config asks for may become, foreseen before anything is computed."""

from __future__ import annotations

import stat
from pathlib import Path

LARGEST_FILE = 1_000_000_000  # bytes of a record: five million numbers as text are a tenth of that
MOST_SAMPLES = 1_000_000
MOST_MEASURED = 5_000_000  # numbers of a record: samples times channels
MOST_OF_CHAIN = 64_000_000  # numbers of a chain, half a gigabyte
LEAST_STEPS = 200  # that a chain must have room for
MOST_PREDICTED = 20_000_000  # numbers, 80 MB; as many log likelihoods go with them


def check_file(path: Path) -> None:
    """Raises `ValueError` with a message for the user; one that is not there is for its reader."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return
    if not stat.S_ISREG(found.st_mode) and not stat.S_ISDIR(found.st_mode):
        raise ValueError(f"{path} is a device or a pipe; give a file")
    if found.st_size > LARGEST_FILE:
        raise ValueError(
            f"{path} has {found.st_size / 1e6:.0f} MB; at most {LARGEST_FILE / 1e6:.0f} MB are read: "
            "resample to a lower rate, shorten the record, or save fewer variables"
        )


def check_record(samples: float, channels: int) -> None:
    """Raises `ValueError` with a message for the user."""
    if samples > MOST_SAMPLES or samples * channels > MOST_MEASURED:
        raise ValueError(
            f"{samples:.6g} samples of {channels} channels; at most {MOST_SAMPLES} samples and "
            f"{MOST_MEASURED} numbers are taken: resample to a lower rate, or shorten the record"
        )


def check_chain(ensembles: int, walkers: int, unknowns: int) -> None:
    """Raises `ValueError` with a message for the user."""
    if steps_of_chain(ensembles, walkers, unknowns) < LEAST_STEPS:
        raise ValueError(
            f"{ensembles} ensembles of {walkers} walkers with {unknowns} unknowns: {LEAST_STEPS} steps "
            f"would be more than {MOST_OF_CHAIN} numbers, which is all that a chain may hold; take fewer"
        )


def steps_of_chain(ensembles: int, walkers: int, unknowns: int) -> int:
    """As many as a chain may have."""
    return MOST_OF_CHAIN // (ensembles * walkers * unknowns)


def predictive_draws(wanted: int, ensembles: int, numbers: int) -> int:
    """Of each ensemble: `wanted`, or as many as may be predicted, and one at least."""
    return max(1, min(wanted, MOST_PREDICTED // (ensembles * numbers)))
