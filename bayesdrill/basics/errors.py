"""What can go wrong at the border, said so that a user can mend it."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field

LONGEST = 60  # letters of a value in a message


@dataclass(frozen=True, slots=True)
class Issue:
    """One mistake: `place` is where it stands (file, line, path), `message` the value and way out."""

    place: str
    message: str

    def __str__(self) -> str:
        return f"{self.place}: {self.message}" if self.place else self.message


class InputError(Exception):
    """The input is wrong: every problem found, at once. The command line exits with status 2."""

    def __init__(self, problems: Sequence[Issue]) -> None:
        self.problems = tuple(problems)
        super().__init__(self.problems)  # by which it is made again in another process

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)

    @classmethod
    def one(cls, place: str, message: str) -> InputError:
        return cls([Issue(place, message)])


@dataclass(frozen=True, slots=True)
class Sparing:
    """`missing`: what could not be made, and why."""

    missing: list[str] = field(default_factory=list)

    @contextmanager
    def making(self, what: str) -> Iterator[None]:
        """Notes what goes wrong inside; a full disk or a killed worker is no matter of `what`."""
        try:
            yield
        except (OSError, MemoryError, BrokenExecutor):
            raise
        except Exception as error:
            first = (str(error).splitlines() or [""])[0]
            self.missing.append(f"{what} ({type(error).__name__}: {first})")


def of_each[T, S](do: Callable[[T], S], those: Iterable[T]) -> list[S]:
    """What `do` makes of each; raises `InputError` with all that is wrong with any, a mistake once."""
    found: list[S] = []
    problems: list[Issue] = []
    for one in those:
        try:
            found.append(do(one))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(list(dict.fromkeys(problems)))
    return found


def shown(value: object) -> str:
    """As a message has it: in one short line, whatever it is."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # whole numbers of thousands of digits, and objects of others
        return f"what is given, of type {type(value).__name__},"
    return shortened(text)


def shortened(text: str, most: int = LONGEST) -> str:
    """Its first letters, where it has more than `most`."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


class Stopped(KeyboardInterrupt):
    """A signal asked to stop, and not the code of another package."""


class Interrupted(Exception):
    """The user or the system asked to stop: what is saved, and how to go on. Exit status 130."""


def short_of_memory(error: BaseException | None) -> bool:
    """Whether there was no room: for numbers, or for a library, of which the loader says it so."""
    if error is None:
        return False
    unloaded = isinstance(error, ImportError | OSError) and "failed to map" in str(error)
    full = isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM
    return full or unloaded or short_of_memory(error.__context__)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """`; did you mean X?` or, when nothing is near, `; known: A, B, ...`."""
    names = list(known)
    folded = {name.casefold(): name for name in names}
    near = difflib.get_close_matches(word.casefold(), folded, n=1, cutoff=0.6)
    if near:
        return f"; did you mean {folded[near[0]]}?"
    return f"; known: {', '.join(names)}" if names else ""


def printable(text: str) -> str:
    """Lines of `text` with a blank for each letter that is not printed, but that a terminal may obey;
    half characters, of names that are not UTF-8, are written out.
    """
    return "".join(one if one.isprintable() or one == "\n" else " " for one in encodable(text))


def encodable(text: str) -> str:
    """As Python writes half a character, as it stands in the name of a file that is not UTF-8."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
