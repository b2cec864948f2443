"""What the best fit leaves, in sentences and as data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bayesdrill.residuals import Left


def sentences(found: Sequence[Left]) -> str:
    """One line if it looks like the noise; else one for each way in which it does not."""
    lines = []
    if large := [one for one in found if one.large]:
        lines.append(
            f"fit: the MAP leaves more than the noise, in sigmas: {_sizes(large)} (noise leaves at most "
            f"{large[0].most:.3g}); a unit, an input, a sigma, the end of a prior or the model does not "
            "fit this record, and every sd and verdict here is surer than it may be"
        )
    if correlated := [one for one in found if one.correlated]:
        each = ", ".join(f"{one.channel} {one.correlation:.2f}" for one in correlated)
        lines.append(
            f"fit: what the MAP leaves is alike from one sample to the next: correlation {each} (white "
            f"noise has at most {correlated[0].limit:.2g}); the model misses something there, or the "
            "noise is not white, and the sds are too small"
        )
    if small := [one for one in found if one.small]:
        lines.append(
            f"fit: the MAP leaves less than the noise, in sigmas: {_sizes(small)} (noise leaves at "
            f"least {small[0].least:.3g}); these sigmas are too large, and so are the sds"
        )
    return "\n".join(lines) or f"fit: what the MAP leaves looks like the noise{_range(found)}"


def as_data(found: Sequence[Left]) -> list[dict[str, Any]]:
    """For `run.json`."""
    return [
        {
            "channel": one.channel,
            "rms_over_sigma": round(one.rms, 5),
            "correlation": round(one.correlation, 5),
            "says": [
                word
                for word, true in (
                    ("more than noise", one.large),
                    ("less than noise", one.small),
                    ("correlated", one.correlated),
                )
                if true
            ],
        }
        for one in found
    ]


def _sizes(found: Sequence[Left]) -> str:
    return ", ".join(f"{one.channel} {one.rms:.3g}" for one in found)


def _range(found: Sequence[Left]) -> str:
    known = [one.rms for one in found if one.most is not None]
    return f" (rms {min(known):.3f} to {max(known):.3f} sigma)" if known else ""
