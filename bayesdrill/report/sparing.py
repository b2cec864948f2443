"""A table or figure that cannot be made takes no other with it."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field


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
