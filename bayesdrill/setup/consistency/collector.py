"""Where the problems of a config are gathered, each with its place."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

from bayesdrill.basics.errors import Problem, did_you_mean
from bayesdrill.setup.yaml_source import Place, Source


class Collector:
    """Runs steps that raise `ValueError` for the user, and files their messages under a place."""

    def __init__(self, source: Source, spoilt: frozenset[Place]) -> None:
        self.problems: list[Problem] = []
        self.source = source
        self._spoilt = spoilt

    def add(self, place: Place, message: str) -> None:
        if not self.spoilt(place):
            self.problems.append(self.source.problem(place, message))

    def spoilt(self, place: Place) -> bool:
        """Whether something was said already of this entry, of one in it, or of one around it."""
        return any(self._touches(place, other) for other in self._spoilt)

    def run[T](self, place: Place, step: Callable[..., T], *arguments: Any) -> T | None:
        try:
            return step(*arguments)
        except ValueError as error:
            self.add(place, str(error))
            return None

    def expect(self, place: Place, name: str, known: Collection[str], message: str) -> None:
        """That `name`, which stands at `place`, is one of `known`; the nearest is proposed."""
        if name not in known:
            self.add(place, f"{message}{did_you_mean(name, known)}")

    @staticmethod
    def _touches(place: Place, other: Place) -> bool:
        shared = min(len(place), len(other))
        return place[:shared] == other[:shared]
