"""Build changes that absorb any misfit without naming a cause: unknown noise, and a missing torque."""

from __future__ import annotations

from collections.abc import Iterator

from bayesdrill.analysis import edits
from bayesdrill.analysis.causes import TORQUE
from bayesdrill.basics.symbols import noise_name
from bayesdrill.config.building.experiments import EXPERIMENTS
from bayesdrill.selection.change import AR1, UNKNOWN, WIDER, Change
from bayesdrill.selection.config_edits import (
    SHARED,
    Entries,
    columns,
    log_uniform,
    merged,
    nested,
    rounded,
)
from bayesdrill.selection.setting import Setting

MISSING = "missing_torque"
QUARTER = 0.25  # prior scale of a missing torque, divided by the size of all other torques
# Correlation time of a missing torque: at least 3 samples, at most the record's length / 3.
TIME_PARTS = 3.0


def absorbing_changes(setting: Setting) -> Iterator[Change]:
    """Yield two changes of the noise, and a missing torque at each inertia."""
    yield Change(UNKNOWN, "noise of unknown size", _noise(setting, remembers=False))
    yield Change(AR1, "noise that remembers", _noise(setting, remembers=True))
    (step, longest), roles = setting.span, setting.rig.roles
    lacks = {lack.name for lack in edits.lacks(roles)}
    for i in roles.inertias if MISSING not in setting.data else ():
        known = i.name in setting.weights and i.sliding in setting.sizes
        if known and f"friction_{i.name}" in lacks:
            size = {"prior": "half_normal", "scale": rounded(QUARTER * setting.sizes[i.sliding])}
            shortest = TIME_PARTS * step
            time = log_uniform(shortest, max(longest / TIME_PARTS, 2 * shortest))
            torque = {"at": i.name, "smoothness": "1/2", "size": size, "time": time}
            lines = merged({MISSING: torque}, setting.shared("s_d", "tau_d"))  # common to all
            yield Change(f"{TORQUE}{i.name}", f"a missing {roles.motion.torque} {i.at}", lines)


def _noise(setting: Setting, *, remembers: bool) -> Entries:
    """Return lines that make each known sigma an unknown, and the noise AR(1) if `remembers`.

    A sigma that is given once for all experiments becomes one unknown.
    """
    lines: Entries = {}
    shared = {*setting.data.get(SHARED, ())}
    for name in setting.units:
        entries = [*columns(setting.data, name)]
        for place, entry in entries:
            noise, sigma = entry.get("noise", "white"), entry.get("sigma")
            known = sigma if isinstance(sigma, int | float) else None
            white = (noise if isinstance(noise, str) else noise.get("name", "white")) == "white"
            if "sigma" not in entry or not (white if remembers else known):
                continue
            if known:
                prior = log_uniform(known / WIDER, known * WIDER) | {"start": float(known)}
                lines = merged(lines, nested((*place, "sigma"), prior))
                if len(entries) == 1 and place[0] != EXPERIMENTS:
                    shared.add(noise_name(name))
                    lines = merged(lines, setting.shared(noise_name(name)))
            if remembers:
                lines = merged(lines, nested((*place, "noise"), AR1))
                if noise_name(name) in shared:
                    lines = merged(lines, setting.shared(f"rho_{name}"))
    return lines
