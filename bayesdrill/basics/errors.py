"""Errors at the border, with messages from which a user can mend the input."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field

MAX_VALUE_LETTERS = 60  # letters of a value in a message
MAX_REASON_LETTERS = 120  # of a reader's own words: some quote half of the file


@dataclass(frozen=True, slots=True)
class Issue:
    """One mistake: `place` is where it stands (file, line, path), `message` the value and way out."""

    place: str
    message: str

    def __str__(self) -> str:
        return f"{self.place}: {self.message}" if self.place else self.message


class InputError(Exception):
    """The input is wrong: every problem, at once. The command line exits with status 2."""

    def __init__(self, problems: Sequence[Issue]) -> None:
        self.problems = tuple(problems)
        super().__init__(self.problems)  # by which it is made again in another process

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)

    @classmethod
    def at(cls, place: str, message: str) -> InputError:
        """Build the error of a single problem."""
        return cls([Issue(place, message)])


@dataclass(frozen=True, slots=True)
class ErrorCollector:
    """Collects what could not be made, and why, in `missing`, and goes on."""

    missing: list[str] = field(default_factory=list)

    @contextmanager
    def making(self, what: str) -> Iterator[None]:
        """Note what goes wrong inside, but raise a full disk or a killed worker: no matter of `what`."""
        try:
            yield
        except (OSError, MemoryError, BrokenExecutor):
            raise
        except Exception as error:
            if was_stopped(error):
                raise
            first = (str(error).splitlines() or [""])[0]
            self.missing.append(f"{what} ({type(error).__name__}: {first})")


@contextmanager
def report_damage(place: str, message: str) -> Iterator[None]:
    """Turn what readers raise at damaged bytes into an `InputError`, with the reason for a `{}`."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        text = message.format(shortened(reason, MAX_REASON_LETTERS))
        raise InputError.at(place, text) from error


def collect_each[T, S](do: Callable[[T], S], those: Iterable[T]) -> list[S]:
    """Return what `do` makes of each; raises `InputError` with all that is wrong, each mistake once."""
    results: list[S] = []
    problems: list[Issue] = []
    for item in those:
        try:
            results.append(do(item))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(list(dict.fromkeys(problems)))
    return results


def short_repr(value: object) -> str:
    """Return a value as a message shows it: in one short line, whatever it is."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # whole numbers of thousands of digits, and objects of others
        return f"what is given, of type {type(value).__name__},"
    return shortened(text)


def shortened(text: str, most: int = MAX_VALUE_LETTERS) -> str:
    """Return a text, or its first letters where it has more than `most`."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


class Stopped(KeyboardInterrupt):
    """A signal asked to stop, and not the code of another package."""


class Interrupted(Exception):
    """The user or the system asked to stop: what is saved, and how to go on. Exit status 130."""


def was_stopped(error: BaseException | None) -> bool:
    """Tell whether a signal asked to stop: native code that is loaded makes another error of it."""
    return isinstance(error, Stopped) or (error is not None and was_stopped(error.__context__))


def short_of_memory(error: BaseException | None) -> bool:
    """Tell whether there was no room: for numbers, or for a library, as its loader says."""
    if error is None:
        return False
    unloaded = isinstance(error, ImportError | OSError) and "failed to map" in str(error)
    full = isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM
    return full or unloaded or short_of_memory(error.__context__)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return `; did you mean X?` or, when nothing is near, `; known: A, B, ...`."""
    names = list(known)
    folded = {name.casefold(): name for name in names}
    near = difflib.get_close_matches(word.casefold(), folded, n=1, cutoff=0.6)
    if near:
        return f"; did you mean {folded[near[0]]}?"
    return f"; known: {', '.join(names)}" if names else ""


def printable(text: str) -> str:
    """Return lines with blanks for what a terminal may obey, and half characters written out."""
    return "".join(
        letter if letter.isprintable() or letter == "\n" else " " for letter in encodable(text)
    )


def encodable(text: str) -> str:
    """Write half characters, as in names of files that are not UTF-8, as Python does."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
