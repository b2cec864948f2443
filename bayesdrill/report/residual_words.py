"""What the best fit leaves, in sentences and as data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from bayesdrill.basics.units import Unit
from bayesdrill.inference.residual_checks import Left


def sentences(found: Sequence[Left], clock: Unit) -> str:
    """How much is left; that it looks like the noise, or a line for each way in which it does not.

    `clock`: in which times are said.
    """
    lines = [f"fit: of what each channel does the MAP leaves unexplained {_shares(found)}"]
    if large := _worst(found, "large", "rms"):
        lines.append(
            f"fit: the MAP leaves more than the noise, in sigmas: {_each(large, 'rms')} (noise leaves "
            f"at most {large[0].limits.most:.3g}); a unit, an input, a sigma, the end of a prior or the "
            "model does not fit what was recorded, and every sd and verdict here is surer than it may be"
        )
    if far := _worst(found, "far", "farthest"):
        each = ", ".join(
            f"{one.name} {one.farthest:.3g} at {one.time / clock.factor:.4g} {clock.name}"
            for one in far
        )
        lines.append(
            f"fit: single samples are farther off than noise puts them, in sigmas: {each} (noise at "
            f"most {far[0].limits.farthest:.2g}); outliers, or something short that the model misses"
        )
    if correlated := _worst(found, "correlated", "correlation"):
        lines.append(
            "fit: what the MAP leaves is not white: correlation of one sample with the next "
            f"{_each(correlated, 'correlation')} (white noise has at most "
            f"{correlated[0].limits.correlation:.2g} either way); the model misses something there, or "
            "the column was filtered or differenced, and the sds are not to be trusted"
        )
    if small := _worst(found, "small", "rms"):
        lines.append(
            f"fit: the MAP leaves less than the noise, in sigmas: {_each(small, 'rms')} (noise leaves "
            f"at least {small[0].limits.least:.3g}); these sigmas are too large, or the column was "
            "filtered"
        )
    if len(lines) == 1:
        lines.append(f"fit: what the MAP leaves looks like the noise ({_range(found)})")
    return "\n".join(lines)


def reasons(found: Sequence[Left]) -> tuple[str, ...]:
    """Why nothing here must be believed, though the ensembles converge; empty where it may be."""
    doubtful = [one for one in found if one.unbelievable]
    said = []
    if large := _worst(doubtful, "large", "rms"):
        said.append(f"the fit leaves more than the noise, in sigmas: {_each(large, 'rms')}")
    if correlated := _worst(doubtful, "correlated", "correlation"):
        said.append(
            "what the fit leaves is not white noise: correlation of one sample with the next "
            f"{_each(correlated, 'correlation')}"
        )
    return tuple(said)


def as_data(found: Sequence[Left]) -> list[dict[str, Any]]:
    """For `run.json`."""
    return [
        {
            "channel": one.channel,
            **({"experiment": one.experiment} if one.experiment else {}),
            "rms_over_sigma": round(one.rms, 5),
            "rms_over_spread": None if math.isnan(one.share) else round(one.share, 7),
            "correlation": round(one.correlation, 5),
            "farthest_over_sigma": round(one.farthest, 5),
            "says": [
                word
                for word, true in (
                    ("more than noise", one.large),
                    ("less than noise", one.small),
                    ("far samples", one.far),
                    ("correlated", one.correlated),
                )
                if true
            ],
        }
        for one in found
    ]


def _worst(found: Sequence[Left], which: str, by: str) -> list[Left]:
    """Those of which it is true, the worst first."""
    chosen = [one for one in found if getattr(one, which)]
    return sorted(chosen, key=lambda one: abs(getattr(one, by)), reverse=which != "small")


def _each(found: Sequence[Left], what: str) -> str:
    return ", ".join(f"{one.name} {getattr(one, what):.3g}" for one in found)


def _shares(found: Sequence[Left]) -> str:
    """In per cent, of channels that have a spread."""
    seen = [one for one in found if not math.isnan(one.share)]
    each = [f"{percent(one.share)} ({one.name})" for one in seen]
    return ", ".join(each) or "nothing to speak of"


def percent(share: float) -> str:
    """Of a channel's spread about its mean."""
    return f"{100 * share:.2g} %"


def _range(found: Sequence[Left]) -> str:
    sizes = [one.rms for one in found]
    return f"rms {min(sizes):.3f} to {max(sizes):.3f} sigma"
