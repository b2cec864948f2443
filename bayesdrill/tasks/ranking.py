"""Rank candidate models: refit each from the maximum, alone and beside others that gain evidence."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from bayesdrill.analysis.causes import (
    NOISE,
    SURE_LOG_ODDS,
    Cause,
    Causes,
    FittedValue,
    RefitMaximum,
    refit_candidate,
)
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.job import Job
from bayesdrill.selection import GEAR, GEARS, START, CandidateModel, CandidateModels

Submit = Callable[..., Future[Any]]  # of a function and its arguments
FEW, PAIRED = 8, 4  # candidates that are tried beside others; in all pairs of these
FINER = (0.8, 0.9, 1.1, 1.25)  # times the best of other gears
HANDED_OVER = 4  # refits at a time
PROMISE = 3.0  # natural logs of the density: what gains less is no candidate
WINDOWS = 4  # of the record, where nothing explains all


def rank(
    job: Job, maximum: Mapping[str, float], submit: Submit, report: Reporter
) -> tuple[Causes, Ranking]:
    """Refit all candidate models of `job` from its maximum.

    First each part by itself and pairs of the best; then, as long as it gets better, what else gained
    beside the best.  `submit` does `causes.refit_candidate` in this process or another.
    """
    given = submit(refit_candidate, job.problem.posterior, maximum, -math.inf).result()
    ranking = Ranking(job, maximum, given, submit, report)
    return ranking.causes(), ranking


@dataclass
class Ranking:
    """A ranking of what `ladder` makes, under way or done.

    `given`: the refit of the config as it is; `causes_by_parts`: candidates that were refitted;
    `maxima`: where the refits of these ended; `left_out`: why others could not be refitted.
    """

    job: Job
    maximum: Mapping[str, float]
    given: RefitMaximum
    submit: Submit
    report: Reporter
    causes_by_parts: dict[tuple[str, ...], Cause] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    maxima: dict[tuple[str, ...], RefitMaximum] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.ladder = CandidateModels.from_job(self.job, self.maximum)

    def causes(self) -> Causes:
        """Refit all, and return what was found, the most probable first."""
        self.refit_all(self.ladder.singles(), self.maximum)
        self.ladder = self._with_best_gear(self.ladder)
        best = next(iter(self._ranked(structural=True)), None)
        # A rig that moves from its start alone shows only there what it may lack.
        if best is not None and best.parts == (START,) and best.bayes > SURE_LOG_ODDS:
            (rung,) = self.ladder.rungs([best.parts])
            there = CandidateModels.from_job(rung.job(), self.maxima[best.parts].values)
            self.ladder = self.ladder.moving(there.sizes, there.speeds)
            self.refit_all(self.ladder.singles(), self.maximum)
        ranked = self._ranked(structural=True)
        first = [cause.parts[0] for cause in ranked if cause.bayes > SURE_LOG_ODDS]
        if self.causes_by_parts and not self._ranked()[0].explains_all:
            for k, part in enumerate(first[:PAIRED]):
                self._beside((part,), first[k + 1 : PAIRED])
            if first:
                self._climb(first)
            best = self._ranked(structural=True)[0]
            if not best.explains_all:
                self._beside(best.parts, (*NOISE, *self.ladder.parts.torques))
        causes = Causes(given=self.given.fit, ranked=self._ranked(), left_out=self.left_out)
        if causes.explains and causes.best.explains_all:
            return causes
        return dataclasses.replace(causes, windows=self._windows())

    def _climb(self, first: Sequence[str]) -> None:
        """Try what gained by itself beside the best, then all else; at last try without each part."""
        known = self.ladder.parts
        absorbing = {*NOISE, *known.torques}
        singles = [
            rung.parts[0] for rung in self.ladder.singles() if rung.parts[0] not in absorbing
        ]
        for more in ((*first[:FEW], *known.physics), singles):
            before = 0.0
            while True:
                best = self._ranked(structural=True)[0]
                if best.explains_all or best.bayes < before + SURE_LOG_ODDS:
                    break
                before = best.bayes
                self._beside(best.parts, more)
        before = -math.inf
        while (best := self._ranked(structural=True)[0]).bayes > before:
            before = best.bayes
            fewer = self.ladder.without_each(best.parts)
            self.refit_all(fewer, self.maxima[best.parts].values)

    def _beside(self, parts: tuple[str, ...], more: Iterable[str]) -> None:
        """Refit a candidate that was refitted, with each of `more`, from where its maximum is."""
        self.refit_all(self.ladder.beyond(parts, more), self.maxima[parts].values)

    def _ranked(self, *, structural: bool = False) -> tuple[Cause, ...]:
        """The most probable first; `structural`: without those that would absorb any misfit."""
        causes = self.causes_by_parts.values()
        ranked = sorted(causes, key=lambda cause: -cause.bayes)
        return tuple(cause for cause in ranked if not (structural and cause.absorbing))

    def _with_best_gear(self, ladder: CandidateModels) -> CandidateModels:
        """With the best of other gears, sought in two rounds."""
        best, times = None, 1.0
        for round_ in (GEARS, FINER):
            for factor in [times * step for step in round_]:
                self.causes_by_parts.pop((GEAR,), None)
                self.refit_all(ladder.with_gear(factor), self.maximum)
                cause = self.causes_by_parts.get((GEAR,))
                if cause is not None and (best is None or cause.bayes > best.bayes):
                    best, ladder = cause, dataclasses.replace(ladder, gear=factor)
            if best is None or best.bayes < SURE_LOG_ODDS:
                break
            times = ladder.gear or 1.0
        self.causes_by_parts.pop((GEAR,), None)
        if best is not None:
            self.causes_by_parts[GEAR,] = best
        return ladder

    def refit_all(self, candidates: Sequence[CandidateModel], near: Mapping[str, float]) -> None:
        """Refit those that were not yet, from `near`, a few handed over at a time."""
        under_way: list[tuple[CandidateModel, Job, Future[Any]]] = []
        known = {*map(frozenset, self.causes_by_parts)}
        remaining = [rung for rung in candidates if frozenset(rung.parts) not in known]
        total, said = len(remaining), f"refitting {len(remaining)} candidates"
        report = self.report if total > 1 else SILENT
        report.update(0.0, said)
        while remaining or under_way:
            while remaining and len(under_way) < HANDED_OVER:
                rung = remaining.pop(0)
                try:
                    job = rung.job()
                except InputError as error:
                    self.left_out[rung.name] = error.problems[0].message
                    continue
                least = self.given.log_posterior + PROMISE
                single = self.maxima.get(rung.parts[-1:]) if len(rung.parts) > 1 else None
                alone = {} if single is None else single.values
                future = self.submit(refit_candidate, job.problem.posterior, near, least, alone)
                under_way.append((rung, job, future))
            if under_way:
                rung, job, future = under_way.pop(0)
                self._keep(rung, job, future.result())
            report.update(1.0 - (len(remaining) + len(under_way)) / total, said)

    def _keep(self, rung: CandidateModel, job: Job, top: RefitMaximum | None) -> None:
        if top is None:
            self.left_out[rung.name] = "has no finite response near the maximum"
            return
        symbols = [symbol for symbol in job.problem.symbols if symbol.name not in self.maximum]
        new = _fitted(symbols, top)
        ends = [value.name for value in new if value.name in top.at_ends]
        doubts = [f"{name} is at an end of its prior" for name in ends]
        if top.several:
            doubts.append("there is another maximum, about as high")
        # A lag leaves out samples of a rig that moves at the start.
        more = top.on(self.given.numbers)
        physics = self.ladder.parts.physics
        self.causes_by_parts[rung.parts] = Cause(
            parts=rung.parts,
            words=rung.words,
            lines=rung.lines,
            lacks=tuple(dict.fromkeys(n for part in rung.parts for n in physics.get(part, ()))),
            new=new,
            gain=top.log_posterior + more - self.given.log_posterior,
            bayes=float(top.log_z + more - self.given.log_z),
            fit=top.fit,
            doubts=tuple(doubts),
        )
        self.maxima[rung.parts] = top

    def _windows(self) -> tuple[tuple[FittedValue, ...], ...]:
        """Refit the config as given on each window; nothing where one of them cannot be."""
        try:
            jobs = [rung.job() for rung in self.ladder.windows(WINDOWS)]
        except InputError:
            return ()
        posteriors = [job.problem.posterior for job in jobs]
        futures = [self.submit(refit_candidate, p, self.maximum, -math.inf) for p in posteriors]
        maxima = [future.result() for future in futures]
        if None in maxima:
            return ()
        space = self.job.problem.posterior.space
        starts = {unknown.name for unknown in space.unknowns if unknown.role == "start"}
        symbols = [symbol for symbol in self.job.problem.symbols if symbol.name not in starts]
        return tuple(_fitted(symbols, top) for top in maxima)


def _fitted(symbols: Iterable[Symbol], top: RefitMaximum) -> tuple[FittedValue, ...]:
    units = {s.name: "" if s.unit == "1" else s.plain_unit for s in symbols}
    return tuple(FittedValue(n, top.values[n], top.sds[n], unit) for n, unit in units.items())
