"""Several models of one record: which is the more probable, and whether model or noise makes it so."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesdrill.engines.evidence import Evidence
from bayesdrill.inference.residual_checks import Left, like_noise
from bayesdrill.insight.overlay import Layer
from bayesdrill.insight.prediction_scores import HeldOut, LeftOut
from bayesdrill.insight.vagueness import Vague

SURE = 3.0  # of log odds: twenty to one
WIDE = 10.0  # of log odds: what priors that are too wide may take off
BY_CHANCE = 3.0  # standard errors of a difference that is none

Word = Literal["model", "noise", "both", "either", "priors", "neither"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Contender:
    """A run among others. `rig`, `noise`: what it says of either, without priors, by which two are told
    to be the same; `beliefs`: its priors, by unknowns; `loo`: or why there is none.
    """

    layer: Layer
    converged: bool
    evidence: Evidence
    left: tuple[Left, ...]
    vague: tuple[Vague, ...]
    rig: Mapping[str, str]
    noise: Mapping[str, str]
    beliefs: Mapping[str, str]
    held_out: HeldOut | None
    loo: LeftOut | str

    @property
    def name(self) -> str:
        return self.layer.name

    @property
    def log_z(self) -> float:
        return self.evidence.log_z

    @property
    def like_noise(self) -> bool:
        return like_noise(self.left)


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """`first`: what others are held against, `best`: the most probable; `gain`: log odds of it against
    those of the same rig (`model`), of the same noise (`noise`), or the first.

    `vague`: unknowns of models that lose by no more than priors which are too wide can make them.
    """

    word: Word
    first: int
    best: int
    gain: Mapping[str, float]
    vague: tuple[str, ...]

    def sure(self, what: str) -> bool:
        return self.gain[what] > SURE


def decide(models: Sequence[Contender]) -> Decision:
    """The first is what is held against all others."""
    first = models[0]
    best = max(range(len(models)), key=lambda k: models[k].log_z)
    top = models[best]

    def over(those: Callable[[Contender], bool]) -> float:
        """Log odds of the best against the best of those that are not like it."""
        return top.log_z - max((one.log_z for one in models if those(one)), default=-math.inf)

    gain = {
        "first": top.log_z - first.log_z,
        "model": over(lambda one: one.rig == first.rig),
        "noise": over(lambda one: one.noise == first.noise),
    }
    error = BY_CHANCE * math.hypot(top.evidence.error, first.evidence.error)
    word = _word(top, first, gain) if gain["first"] > SURE + error else "neither"
    return Decision(word=word, first=0, best=best, gain=gain, vague=_vague(models, top))


def _word(top: Contender, first: Contender, gain: Mapping[str, float]) -> Word:
    """Of a model that is better than the first."""
    if top.rig == first.rig and top.noise == first.noise:
        return "priors"
    model, noise = gain["model"] > SURE, gain["noise"] > SURE
    if top.rig == first.rig:
        return "noise" if noise else "either"
    if top.noise == first.noise:
        return "model" if model else "either"
    if model and noise:
        return "both"
    return "model" if model else "noise" if noise else "either"


def _vague(models: Sequence[Contender], top: Contender) -> tuple[str, ...]:
    """What the best has in common with the others makes no difference, however wide it is."""
    close = [one for one in models if 0.0 < top.log_z - one.log_z < WIDE]
    names = [
        each.name
        for one in close
        for each in one.vague
        if one.beliefs[each.name] != top.beliefs.get(each.name)
    ]
    return tuple(dict.fromkeys(names))


def probabilities(models: Sequence[Contender]) -> tuple[float, ...]:
    """Of each, where one of them is right and all were as likely before."""
    log_z = np.array([one.log_z for one in models])
    share = np.exp(log_z - log_z.max())
    return tuple(map(float, share / share.sum()))


def difference(one: HeldOut | LeftOut, other: HeldOut | LeftOut) -> tuple[float, float]:
    """Of two scores of the same samples, and its standard error."""
    each = one.each - other.each
    return float(each.sum()), math.sqrt(len(each)) * float(each.std())
