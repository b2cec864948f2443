"""How large what a config asks for may become, foreseen before anything is computed."""

from __future__ import annotations

from pathlib import Path

from bayesdrill.basics import own_files
from bayesdrill.basics.errors import InputError

LARGEST_FILE = 1_000_000_000  # bytes of a record: five million numbers as text are a tenth of that
LARGEST_GUESSED = 100_000_000  # bytes of one that `init` looks at, for up to half a minute
MOST_COLUMNS = 300  # each of which `init` may hold against each other
MOST_SAMPLES = 1_000_000
MOST_MEASURED = 5_000_000  # numbers of a record: samples times channels
MOST_OF_CHAIN = 64_000_000  # numbers of a chain, half a gigabyte
LEAST_STEPS = 200  # that a chain must have room for
MOST_PREDICTED = 20_000_000  # numbers, 80 MB; as many log likelihoods go with them


def check_file(path: Path, largest: int = LARGEST_FILE) -> None:
    """Raises `InputError` beyond `largest` bytes or without an end; a missing one is for its reader."""
    own_files.refuse_endless(path)
    try:
        size = path.stat().st_size
    except (OSError, ValueError):
        return
    if size > largest:
        message = (
            f"has {size / 1e6:.0f} MB; at most {largest / 1e6:.0f} MB are read: resample to a "
            "lower rate, shorten the record, or save fewer variables"
        )
        raise InputError.one(str(path), message)


def check_record(samples: float, channels: int) -> None:
    """Raises `ValueError` with a message for the user."""
    if samples > MOST_SAMPLES or samples * channels > MOST_MEASURED:
        raise ValueError(
            f"{samples:.6g} samples of {channels} channels; at most {MOST_SAMPLES} samples and "
            f"{MOST_MEASURED} numbers are taken: resample to a lower rate, or shorten the record"
        )


def check_guessed(samples: int, columns: int) -> None:
    """Raises `ValueError` with a message for the user."""
    if samples > MOST_SAMPLES or columns > MOST_COLUMNS:
        raise ValueError(
            f"{samples} samples of {columns} columns; `init` looks at {MOST_SAMPLES} samples and "
            f"{MOST_COLUMNS} columns at most: save those of the rig alone, at a lower rate or for a "
            "shorter time, or write a config by hand"
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
