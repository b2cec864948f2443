"""Describe mistakes in the user's input, with messages that say how to correct them."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field

MAX_VALUE_LETTERS = 60  # largest number of letters of a value in a message
MAX_REASON_LETTERS = 120  # largest number of letters quoted from a library's message


@dataclass(frozen=True, slots=True)
class Issue:
    """An issue has a `place` (file, line, entry), and a `message` with the value and the remedy."""

    place: str
    message: str

    def __str__(self) -> str:
        return f"{self.place}: {self.message}" if self.place else self.message


class InputError(Exception):
    """An input error lists all mistakes of the user; the command line exits with status 2.

    Parameters
    ----------
    problems : sequence of Issue
        The mistakes, each with its place and a message that says how to correct it.

    Examples
    --------
    >>> try:
    ...     bd.nominal("table_9")
    ... except bd.InputError as error:
    ...     print(error.problems[0].place)
    nominal
    """

    def __init__(self, problems: Sequence[Issue]) -> None:
        self.problems = tuple(problems)
        super().__init__(self.problems)  # unpickling calls `__init__` with this tuple

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)

    @classmethod
    def at(cls, place: str, message: str) -> InputError:
        """Build an error with a single problem."""
        return cls([Issue(place, message)])


@dataclass(frozen=True, slots=True)
class ErrorCollector:
    """An error collector lists failures in `missing`, so that other results can still be made."""

    missing: list[str] = field(default_factory=list)

    @contextmanager
    def collect(self, product: str) -> Iterator[None]:
        """Add any error in the block to `missing`; errors of disk, memory or workers propagate."""
        try:
            yield
        except (OSError, MemoryError, BrokenExecutor):
            raise
        except Exception as error:
            if was_stopped(error):
                raise
            first = (str(error).splitlines() or [""])[0]
            self.missing.append(f"{product} ({type(error).__name__}: {first})")


@contextmanager
def report_damage(place: str, message: str) -> Iterator[None]:
    """Turn any error of a reader into an `InputError`, with the reason at `{}` in `message`."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        text = message.format(shortened(reason, MAX_REASON_LETTERS))
        raise InputError.at(place, text) from error


def collect_each[T, S](function: Callable[[T], S], items: Iterable[T]) -> list[S]:
    """Apply a function to each item; raises one `InputError` with all distinct mistakes."""
    results: list[S] = []
    problems: list[Issue] = []
    for item in items:
        try:
            results.append(function(item))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(list(dict.fromkeys(problems)))
    return results


def short_repr(value: object) -> str:
    """Return the `repr` of any value for a message, shortened to one line."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # huge integers, and objects with a faulty `repr`
        return f"a value of type {type(value).__name__}"
    return shortened(text)


def shortened(text: str, max_letters: int = MAX_VALUE_LETTERS) -> str:
    """Return a text of at most `max_letters` letters; a longer text is cut off and ends with dots."""
    return text if len(text) <= max_letters else f"{text[: max_letters - 3]}..."


def count_noun(n: int, singular: str, plural: str = "") -> str:
    """Return a count with its noun, which may include a verb: `1 sample`, `2 samples are`."""
    return f"{n} {singular}" if n == 1 else f"{n} {plural or singular + 's'}"


class Stopped(KeyboardInterrupt):
    """A signal asks the program to stop; a plain `KeyboardInterrupt` may come from other packages."""


class Interrupted(Exception):
    """A signal stopped the work; the message says how to continue, and the exit status is 130."""


def was_stopped(error: BaseException | None) -> bool:
    """Return whether a signal caused an error, even if native code raised another exception."""
    return isinstance(error, Stopped) or (error is not None and was_stopped(error.__context__))


def short_of_memory(error: BaseException | None) -> bool:
    """Return whether memory was exhausted, by arrays or while a library was loaded."""
    if error is None:
        return False
    unloaded = isinstance(error, ImportError | OSError) and "failed to map" in str(error)
    full = isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM
    return full or unloaded or short_of_memory(error.__context__)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return `; did you mean X?` or, if no known name is similar, `; known: A, B, ...`."""
    names = list(known)
    folded = {name.casefold(): name for name in names}
    similar = difflib.get_close_matches(word.casefold(), folded, n=1, cutoff=0.6)
    if similar:
        return f"; did you mean {folded[similar[0]]}?"
    return f"; known: {', '.join(names)}" if names else ""


def printable(text: str) -> str:
    """Replace control characters except line ends by blanks, and escape lone surrogates."""
    return "".join(
        letter if letter.isprintable() or letter == "\n" else " " for letter in encodable(text)
    )


def encodable(text: str) -> str:
    """Escape lone surrogates with a backslash; file names that are not UTF-8 have them."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
