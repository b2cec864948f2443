"""The ranking of candidate models: each refitted from the maximum, alone and beside others, as long as
the evidence grows.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from typing import Any

from bayesdrill.analysis.causes import SURE, Added, Cause, Causes, Maximum, refit
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter
from bayesdrill.config.job import Job
from bayesdrill.selection import CATCH_ALL, GEAR, GEARS, NOISE, PHYSICS, TORQUES, Ladder, Rung

Submit = Callable[..., Future[Any]]  # of a function and its arguments
FEW, PAIRED = 8, 4  # candidates that are tried beside others; in all pairs of these
FINER = (0.8, 0.9, 1.1, 1.25)  # times the best of other gears
HANDED_OVER = 4  # refits at a time
PROMISE = 3.0  # natural logs of the density: what gains less is no candidate


def rank(
    job: Job, found: Mapping[str, float], submit: Submit, report: Reporter
) -> tuple[Causes, Mapping[tuple[str, ...], float]]:
    """All candidate models of `job`, refitted from its maximum `found`: each thing by itself, pairs of
    the best, and as long as it gets better what else gained, beside the best.

    `submit`: does `causes.refit` in this process or another.  Beside the causes: seconds that an
    evaluation of each takes, by its parts.
    """
    ranking = _Ranking(job, found, submit, report)
    return ranking.causes(), ranking.seconds


class _Ranking:
    """`done`: candidates that were refitted, by their parts, and `seconds` that an evaluation of each
    takes; `values` of its unknowns at the maximum; `left_out`: why others could not be.
    """

    def __init__(
        self, job: Job, found: Mapping[str, float], submit: Submit, report: Reporter
    ) -> None:
        self.job, self.found, self.submit, self.report = job, found, submit, report
        self.done: dict[tuple[str, ...], Cause] = {}
        self.left_out: dict[str, str] = {}
        self.seconds: dict[tuple[str, ...], float] = {}
        self.values: dict[tuple[str, ...], Mapping[str, float]] = {}

    def causes(self) -> Causes:
        posterior = self.job.problem.posterior
        given = self.submit(refit, posterior, self.found, -math.inf).result()
        ladder = Ladder.of(self.job)
        self._try(ladder.singles(), given, self.found)
        ladder = self._geared(ladder, given)
        first = [one.parts[0] for one in self._ranked(structural=True) if one.bayes > SURE]
        if self.done and not self._ranked()[0].explains_all:
            for k, part in enumerate(first[:PAIRED]):
                self._beside(ladder, (part,), first[k + 1 : PAIRED], given)
            if first:
                self._climb(ladder, first, given)
            best = self._ranked(structural=True)[0]
            if not best.explains_all:
                self._beside(ladder, best.parts, (*NOISE, *TORQUES), given)
        return Causes(given=given.fit, ranked=self._ranked(), left_out=self.left_out)

    def _climb(self, ladder: Ladder, first: Sequence[str], given: Maximum) -> None:
        """As long as it gets better, what gained by itself beside the best, and then all that is left;
        at last the best without each of its parts.
        """
        every = [rung.parts[0] for rung in ladder.singles() if not {*rung.parts} & CATCH_ALL]
        for more in ((*first[:FEW], *PHYSICS), every):
            before = 0.0
            while True:
                best = self._ranked(structural=True)[0]
                if best.explains_all or best.bayes < before + SURE:
                    break
                before = best.bayes
                self._beside(ladder, best.parts, more, given)
        self._try(ladder.without_each(best.parts), given, self.values[best.parts])

    def _beside(
        self, ladder: Ladder, parts: tuple[str, ...], more: Iterable[str], given: Maximum
    ) -> None:
        """Refit a candidate that was refitted, with each of `more`, from where its maximum is."""
        self._try(ladder.beyond(parts, more), given, self.values[parts])

    def _ranked(self, *, structural: bool = False) -> tuple[Cause, ...]:
        """The most probable first; `structural`: without those that would absorb any misfit."""
        every = [one for one in self.done.values() if not (structural and {*one.parts} & CATCH_ALL)]
        return tuple(sorted(every, key=lambda one: -one.bayes))

    def _geared(self, ladder: Ladder, given: Maximum) -> Ladder:
        """With the best of other gears, sought in two rounds."""
        best, times = None, 1.0
        for round_ in (GEARS, FINER):
            for factor in [times * one for one in round_]:
                self.done.pop((GEAR,), None)
                self._try(ladder.with_gear(factor), given, self.found)
                tried = self.done.get((GEAR,))
                if tried is not None and (best is None or tried.bayes > best.bayes):
                    best, ladder = tried, dataclasses.replace(ladder, gear=factor)
            if best is None or best.bayes < SURE:
                break
            times = ladder.gear or 1.0
        self.done.pop((GEAR,), None)
        if best is not None:
            self.done[GEAR,] = best
        return ladder

    def _try(self, rungs: Sequence[Rung], given: Maximum, near: Mapping[str, float]) -> None:
        """Refit those that were not yet, from `near`, a few handed over at a time."""
        under_way: list[tuple[Rung, Job, Future[Any]]] = []
        rest = [one for one in rungs if frozenset(one.parts) not in map(frozenset, self.done)]
        total, said = len(rest), f"refitting {len(rest)} candidates"
        if total > 1:
            self.report.update(0.0, said)
        while rest or under_way:
            while rest and len(under_way) < HANDED_OVER:
                rung = rest.pop(0)
                try:
                    job = rung.job()
                except InputError as error:
                    self.left_out[rung.name] = error.problems[0].message
                    continue
                least = given.log_posterior + PROMISE
                future = self.submit(refit, job.problem.posterior, near, least)
                under_way.append((rung, job, future))
            if under_way:
                rung, job, future = under_way.pop(0)
                self._keep(rung, job, future.result(), given)
            share = 1.0 - (len(rest) + len(under_way)) / max(total, 1)
            if total > 1:
                self.report.update(share, said)

    def _keep(self, rung: Rung, job: Job, top: Maximum | None, given: Maximum) -> None:
        if top is None:
            self.left_out[rung.name] = "has no finite response near the maximum"
            return
        new = tuple(
            Added(one.name, top.values[one.name], top.sds[one.name], one.plain_unit)
            for one in job.problem.symbols
            if one.name not in self.found
        )
        ends = [one.name for one in new if one.name in top.at_ends]
        doubts = [f"{name} is at an end of its prior" for name in ends]
        if top.several:
            doubts.append("there is another maximum, about as high")
        roles = self.job.problem.model.roles
        physics = [role for part in rung.parts for role in PHYSICS.get(part, ())]
        self.done[rung.parts] = Cause(
            parts=rung.parts,
            about=rung.about,
            lines=rung.lines,
            lacks=tuple(dict.fromkeys(roles[role] for role in physics)),
            new=new,
            gain=top.log_posterior - given.log_posterior,
            bayes=float(top.log_z - given.log_z),
            fit=top.fit,
            doubts=tuple(doubts),
        )
        self.seconds[rung.parts], self.values[rung.parts] = top.seconds, top.values
