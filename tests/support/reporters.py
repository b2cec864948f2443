"""A reporter that interrupts work."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Stopping:
    """Keep what is said, and raise Ctrl-C where `when(fraction, text)` is true of the progress."""

    when: Callable[[float, str], bool] = lambda fraction, text: False
    said: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        self.said.append(text)

    def update(self, fraction: float, text: str) -> None:
        if self.when(fraction, text):
            raise KeyboardInterrupt
