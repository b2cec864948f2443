"""What a rung of a ladder changes in a config: the noise of channels, and what experiments share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from bayesdrill.basics.symbols import noise_name
from bayesdrill.setup import experiments

RED = "ar1"
WIDER = 10.0  # either way, of the noise that was given


def channels(data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any], bool]]:
    """Each with its name, and whether all experiments have it so."""
    top, *own = [section.get("record", {}).get("channels", {}) for section in sections(data)]
    for name, channel in top.items():
        yield name, channel, not any(name in one for one in own)
    for one in own:
        for name, channel in one.items():
            yield name, channel, False


def changed(
    data: dict[str, Any],
    change: Callable[[dict[str, Any]], bool],
    name: str,
    channel: dict[str, Any],
    common: bool,
) -> bool:
    """What was one number for all experiments becomes one unknown; a memory goes with its size."""
    known = isinstance(channel.get("sigma"), int | float)
    if not change(channel):
        return False
    sigma = noise_name(name)
    if common and known:
        share(data, sigma)
    if channel.get("noise") == RED and sigma in data.get("shared", ()):
        share(data, f"rho_{name}")
    return True


def share(data: dict[str, Any], *names: str) -> None:
    """One unknown in all experiments, where there are several."""
    if data.get(experiments.EXPERIMENTS):
        data["shared"] = [*dict.fromkeys((*data.get("shared", ()), *names))]


def sections(data: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """The top, and each experiment."""
    yield data
    yield from (data.get(experiments.EXPERIMENTS) or {}).values()


def freed(channel: dict[str, Any]) -> bool:
    """Of a size that is known; whether it was."""
    sigma = channel.get("sigma")
    if isinstance(sigma, int | float):
        low, high = rounded(sigma / WIDER), rounded(sigma * WIDER)
        prior = {"prior": "log_uniform", "low": low, "high": high, "start": float(sigma)}
        channel["sigma"] = prior
        return True
    return False


def reddened(channel: dict[str, Any]) -> bool:
    """That remembers, where it was white; whether it was."""
    own = channel.get("noise", "white")
    if (own if isinstance(own, str) else own.get("name", "white")) != "white":
        return False
    freed(channel)
    channel["noise"] = RED
    return True


def rounded(value: float) -> float:
    """To three digits: a config is read."""
    return float(f"{value:.3g}")
