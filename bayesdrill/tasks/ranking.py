"""Rank candidate models: refit changes of a config, alone and combined with others that gain.

The changes of a candidate are its parts.  An absorbing part, such as a missing torque, absorbs any
misfit without naming a cause.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from bayesdrill.analysis.causes import (
    SURE_LOG_ODDS,
    Cause,
    Causes,
    Doubt,
    FittedValue,
    recommended,
)
from bayesdrill.analysis.edits import with_gear
from bayesdrill.analysis.refits import RefitMaximum, measured_samples, refit_candidate
from bayesdrill.analysis.suspicions import find_reference
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.job import Job
from bayesdrill.inference import compression
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.residual_checks import like_noise
from bayesdrill.selection.candidates import CandidateModel, CandidateModels
from bayesdrill.selection.change import GEAR, LATER, START, WIDENED

Submit = Callable[..., Future[Any]]  # submits a function and its arguments
PAIRED = 4  # all pairs of this many best candidates are tried
# Grids of constants: first all values of a grid are tried, then values next to the best (`_finer`).
GEARS = (0.1, 0.2, 0.25, 1 / 3, 0.5, 0.7, 1.4, 2.0, 3.0, 4.0, 5.0, 10.0)  # new / given ratio
CLOCKS = (0.95, 0.97, 0.98, 0.99, 0.995, 1.005, 1.01, 1.02, 1.03, 1.05)  # true / recorded time
FINEST_GEAR, FINEST_CLOCK = 1e-3, 1e-5  # smallest distances between tried values
LATER_SHARES = (0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3)  # omitted beginning / whole record
SEEK_ROUNDS, SAME_HEIGHT = 8, 1.0  # limit of rounds; smaller differences of log evidence end them
HANDED_OVER = 4  # number of refits that run at the same time
# After this total of evaluations in all refits, no combination is refitted.  The evaluations take
# about five minutes of a processor for a rig with friction and 10,000 samples.
MOST_EVALUATIONS = 700_000
PROMISE = 3.0  # a search is stopped if it is expected to gain less log density than this [nats]
MIN_SHARE_WORTH_COMBINING = 0.05  # smallest useful gain, divided by the gain of absorbing parts
REDUNDANT = 0.99  # of two parts one is enough, if each alone has this fraction of their joint gain
MAX_HIDDEN = 0.02  # largest fraction of masked samples, unless all other residuals are noise
WINDOWS = 4  # number of windows of a record if no candidate explains it


def rank(
    job: Job, maximum: Mapping[str, float], submit: Submit, report: Reporter
) -> tuple[Causes, Mapping[tuple[str, ...], RefitMaximum]]:
    """Refit all candidate models of `job` from its `maximum`; return causes, and maxima by parts.

    First come single parts and pairs of the best parts.  Then parts are added to the best
    candidate while it improves.  `submit` runs `refits.refit_candidate` in any process.  Of long
    records, only the first samples are used.
    """
    ranking = Ranking(excerpt(job), maximum, submit, report)
    return ranking.causes(), ranking.maxima


def excerpt(job: Job) -> Job:
    """Return the job with only the first samples if a record is long, or else the job itself.

    These samples usually show what a model lacks. A refit to a million samples takes a minute.
    """
    is_long = any(map(compression.is_long, job.problem.observations))
    return job.first_samples(compression.EXCERPT) if is_long else job


def rank_scales(
    job: Job, maximum: Mapping[str, float], submit: Submit, report: Reporter
) -> Causes | None:
    """Try values and units that are off by a factor, if wider priors would improve a good fit much.

    The result is None if wider priors gain too little, or if no such factor is recommended.
    """
    # The search for `maximum` found no higher maximum, so no other start is needed.
    ranking = Ranking(excerpt(job), maximum, submit, report, starts=[maximum])
    widened = tuple(name for name in ranking.models.changes if name.startswith(WIDENED))
    ranking.refit_all(ranking.models.rungs([widened] if widened else []), maximum)
    if not ranking.causes_by_parts or ranking.causes_by_parts[widened].gain < SURE_LOG_ODDS:
        return None
    ranking.refit_scales()
    causes = Causes(
        given=ranking.base.residuals,
        ranked=ranking.ranked(),
        left_out=ranking.left_out,
        samples=ranking.job.samples,
    )
    return causes if causes.best and causes.best.off_by_a_factor else None


@dataclass
class Ranking:
    """A ranking refits candidate models, and keeps the results.

    `base` is the refit of the given config from `starts`, `causes_by_parts` has the refitted
    candidates, and `maxima` their maxima.  `left_out` has reasons why other candidates could not be
    refitted.  `value_counts` has the number of values that were tried for a constant, and
    `evaluations` is the total of all refits.  `skipped` describes combinations skipped because of
    `MOST_EVALUATIONS`.
    """

    job: Job
    maximum: Mapping[str, float]
    submit: Submit
    report: Reporter
    starts: Sequence[Mapping[str, float]] = ()
    causes_by_parts: dict[tuple[str, ...], Cause] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    maxima: dict[tuple[str, ...], RefitMaximum] = field(default_factory=dict)
    value_counts: dict[str, int] = field(default_factory=dict)
    evaluations: int = 0
    skipped: dict[frozenset[str], str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        posterior, least, starts = self.job.problem.posterior, -math.inf, self.starts
        base = self.submit(refit_candidate, posterior, self.maximum, least, starts=starts)
        self.base: RefitMaximum = base.result()
        models = CandidateModels.from_job(self.job, self.maximum)
        self.roles = {unknown.name: unknown.role for unknown in posterior.space.unknowns}
        ends = self.base.at_ends.items()
        widened = {f"{WIDENED}{name}": way for name, way in ends if self.roles[name] != "noise"}
        self.models = models.with_numbers(**widened)
        self.records = measured_samples(posterior.likelihood)

    def causes(self) -> Causes:
        """Refit all candidates, and return the causes, the recommended one first.

        Values and units come first, as added physics would also explain most wrong values.
        """
        self.refit_scales()
        if not self._explained:
            self._refit_others()
        given, reference = (
            self.base.residuals,
            find_reference(self.job.problem, self.base.residuals),
        )
        causes = Causes(
            given=given,
            ranked=self.ranked(),
            left_out=self.left_out,
            reference=reference,
            untried=(*self.skipped.values(),),
            samples=self.job.samples,
        )
        if causes.best is not None and causes.best.explains_all:
            return causes
        return dataclasses.replace(causes, windows=self._windows())

    def refit_scales(self) -> None:
        """Refit with each value and unit multiplied by a factor of wrong units."""
        scales = self.models.scales()
        self.value_counts = {candidate.name: len(scales) for candidate in scales}
        self.refit_all(scales, self.maximum)

    def _refit_others(self) -> None:
        """Refit all candidates except those of `refit_scales`."""
        self.refit_all(self.models.singles(), self.maximum)
        for name, values in self._constants():
            self._seek(name, *values)
        best = self._best()
        # Without a driving input, only motion from a free start shows the sizes of missing physics.
        if best is not None and best.parts == (START,) and best.bayes > SURE_LOG_ODDS:
            (rung,) = self.models.rungs([best.parts])
            there = CandidateModels.from_job(rung.job(), self.maxima[best.parts].values)
            self.models = self.models.at_least(there.sizes, there.speeds)
            self.refit_all(self.models.singles(), self.maximum)
        if not self._explained:
            self.refit_all(self.models.singles(absorbing=True), self.maximum)
            self._combine()

    @property
    def _explained(self) -> bool:
        """Return whether a cause without doubts reduces the residuals to noise."""
        named = [c for c in self.causes_by_parts.values() if not c.absorbing and not c.doubts]
        return any(c.explains_all and c.bayes > SURE_LOG_ODDS for c in named)

    def _combine(self) -> None:
        """Try pairs of parts that gained alone, then add parts to the best while this helps."""
        least = SURE_LOG_ODDS + self._min_gain(0.0)
        first = [c.parts[0] for c in self._all() if not c.absorbing and c.bayes > least]
        first.sort(key=lambda name: not name.startswith(WIDENED))  # ends of priors hide causes
        for k, part in enumerate(first[:PAIRED]):
            self._extended((part,), first[k + 1 : PAIRED])
        absorbing = [change.name for change in self.models.changes.values() if change.absorbs]
        if first:
            self._climb(absorbing)
        if (best := self._best()) is not None and not best.explains_all:
            self._extended(best.parts, absorbing)

    def _climb(self, absorbing: Sequence[str]) -> None:
        """Alternately add parts to the best candidate and remove parts, while this gains evidence.

        A part that was a substitute for another part is thus removed early.  Scales that gain
        little alone are not tried again, nor signs and exchanged columns that lower the evidence alone.
        """
        changes = self.models.changes.values()
        lost = {c.name for c in self._all() if not c.new and c.bayes < -SURE_LOG_ODDS}
        lost |= {
            c.name for c in self._all() if c.name in self.value_counts and c.bayes < SURE_LOG_ODDS
        }
        more = [c.name for c in changes if not c.absorbs and c.name not in lost]
        before = 0.0
        while (best := self._best()) is not None:
            if self._explained or best.bayes < before + self._min_gain(before) + SURE_LOG_ODDS:
                break
            before = best.bayes
            if self._min_gain(before) == 0.0:
                self._extended(best.parts, absorbing)  # shows how much can still be gained
            self._extended(best.parts, more)
            self._reduce()

    def _reduce(self) -> None:
        """Remove parts from the best candidate while this makes it more probable."""
        before = -math.inf
        while (best := self._best()) is not None and best.bayes > before:
            before = best.bayes
            fewer = self.models.without_each(best.parts)
            self.refit_all(fewer, self.maxima[best.parts].values, self._rival)

    def _extended(self, parts: tuple[str, ...], more: Iterable[str]) -> None:
        """Refit a candidate with each part of `more` added, from the maximum of the candidate.

        Parts with the largest earlier gain come first, since later refits stop if they cannot rival
        the best candidate.  They also stop if the added part cannot gain evidence.
        """
        wider = sorted(
            self.models.extensions(parts, more), key=lambda rung: -self._gained(rung.names[-1])
        )
        base = self.causes_by_parts[parts].bayes
        least = base + self._min_gain(base) - SURE_LOG_ODDS + self.base.log_z
        self.refit_all(wider, self.maxima[parts].values, lambda: max(least, self._rival()))

    def _min_gain(self, bayes: float) -> float:
        """Return the smallest useful gain: a fraction of what absorbing parts gain beyond `bayes`.

        If residuals are more than noise, nearly any part gains much more than it would by chance.
        """
        most = max((cause.bayes for cause in self._all() if cause.absorbing), default=0.0)
        return MIN_SHARE_WORTH_COMBINING * max(most - bayes, 0.0)

    def _gained(self, part: str) -> float:
        """Return the gain of a part in the latest candidate to which the part was added."""
        causes = self.causes_by_parts
        heights = {parts: cause.bayes for parts, cause in causes.items()} | {(): 0.0}
        last = (parts for parts in reversed(causes) if parts[-1] == part and parts[:-1] in heights)
        return next((heights[parts] - heights[parts[:-1]] for parts in last), 0.0)

    def _rival(self) -> float:
        """Return the log evidence below which a candidate cannot rival the best one."""
        trusted = (c.bayes for c in self._trusted())
        return max(trusted, default=-math.inf) - SURE_LOG_ODDS + self.base.log_z

    def _trusted(self) -> Iterator[Cause]:
        """Yield those of `_shown` that may be recommended, the most probable first."""
        return (cause for cause in self._shown() if not cause.doubts and cause.finished)

    def _all(self) -> list[Cause]:
        """Return all candidates, the most probable first."""
        return sorted(self.causes_by_parts.values(), key=lambda cause: -round(cause.bayes, 3))

    def _best(self) -> Cause | None:
        """Return the most probable candidate of `_shown`."""
        return next(self._shown(), None)

    def _shown(self) -> Iterator[Cause]:
        """Yield the candidates without absorbing parts, the most probable first.

        A candidate that masks many samples is included only if its other residuals are noise.
        """
        named = (cause for cause in self._all() if not cause.absorbing)
        return (c for c in named if c.explains_all or self.maxima[c.parts].omitted <= MAX_HIDDEN)

    def ranked(self) -> tuple[Cause, ...]:
        """Return the recommended candidate, then all others."""
        every = self._all()
        first = recommended(every)
        return tuple(sorted(every, key=lambda cause: cause is not first))

    # Search for constants of a config.

    def _constants(self) -> Iterator[tuple[str, tuple[Sequence[float], float]]]:
        """Yield each part with a constant, the values to try first, and their smallest distance."""
        model, observations = self.job.problem.model, self.job.problem.observations
        shafts = {shaft.stiffness for shaft in model.roles.shafts}
        if model.geared and shafts & {*model.parameters}:
            yield GEAR, (GEARS, FINEST_GEAR)
        for name in self.models.clocks:
            yield name, (CLOCKS, FINEST_CLOCK)
        shortest = min(float(np.ptp(each.experiment.t)) for each in observations)
        step = min(each.experiment.dt for each in observations)
        yield LATER, ([share * shortest for share in LATER_SHARES], step)

    def _seek(self, name: str, values: Sequence[float], finest: float) -> None:
        """Refit the part `name` with the best value of its constant, in or between `values`."""
        heights, wanted = dict[float, float](), [*values]
        for _ in range(SEEK_ROUNDS):
            futures = [(value, self._refit_with(name, value)) for value in wanted]
            tops = [(value, future.result()) for value, future in futures if future is not None]
            heights |= {value: top.log_z for value, top in tops if top is not None}
            self.evaluations += sum(top.evaluations for _, top in tops if top is not None)
            if max(heights.values(), default=-math.inf) < self.base.log_z + SURE_LOG_ODDS:
                return
            if not (wanted := _finer(heights, finest)):
                break
        self.models = self.models.with_numbers(**{name: max(heights, key=heights.__getitem__)})
        self.value_counts[name] = len(values)
        self.refit_all(self.models.rungs([(name,)]), self.maximum)

    def _refit_with(self, name: str, value: float) -> Future[RefitMaximum | None] | None:
        try:
            if name == GEAR:  # a gear needs no new kernels
                posterior = with_gear(self.job.problem.posterior, value)
            else:
                (rung,) = self.models.with_numbers(**{name: value}).rungs([(name,)])
                posterior = rung.job().problem.posterior
        except (InputError, ValueError):
            return None
        least, alone = self.base.log_posterior + PROMISE, dict[str, float]()
        return self.submit(refit_candidate, posterior, self.maximum, least, alone, self.records)

    # Refits.

    def refit_all(
        self,
        candidates: Sequence[CandidateModel],
        near: Mapping[str, float],
        rival: Callable[[], float] = lambda: -math.inf,
    ) -> None:
        """Refit `candidates` that were not refitted before, a few at a time, from values `near`.

        A refit stops if it cannot reach the log evidence `rival()`.
        """
        under_way: list[tuple[CandidateModel, Job, Future[Any]]] = []
        known = {*map(frozenset, self.causes_by_parts)}
        remaining = [rung for rung in candidates if frozenset(rung.names) not in known]
        total, said = len(remaining), f"refitting {len(remaining)} candidates"
        report = self.report if total > 1 else SILENT
        report.update(0.0, said)
        while remaining or under_way:
            while remaining and len(under_way) < HANDED_OVER:
                rung = remaining.pop(0)
                if len(rung.names) > 1 and self.evaluations > MOST_EVALUATIONS:
                    words = " with ".join(change.description for change in rung.changes)
                    self.skipped[frozenset(rung.names)] = words
                    continue
                try:
                    job = rung.job(shared=True)
                except InputError as error:
                    self.left_out[rung.name] = error.problems[0].message
                    continue
                least = self.base.log_posterior + PROMISE
                single = self.maxima.get(rung.names[-1:]) if len(rung.names) > 1 else None
                alone = {} if single is None else single.values
                sought = (change.starts for change in rung.changes if change.starts)
                starts = next((each for each in sought if not {*each[0]} <= {*near}), ())
                arguments = job.problem.posterior, near, least, alone, self.records, starts, rival()
                under_way.append((rung, job, self.submit(refit_candidate, *arguments)))
            if under_way:
                rung, job, future = under_way.pop(0)
                top: RefitMaximum | None = future.result()
                self._keep(rung, job, top)
                last = "" if top is None else f"; {rung.name} took {top.duration:.1f} s"
                done = 1.0 - (len(remaining) + len(under_way)) / total
                report.update(done, f"{said}{last}")

    def _keep(self, rung: CandidateModel, job: Job, top: RefitMaximum | None) -> None:
        if top is None:
            self.left_out[rung.name] = "has no finite response near the maximum"
            return
        self.evaluations += top.evaluations
        tries = math.prod(self.value_counts.get(name, 1) for name in rung.names)
        new = {*job.problem.names} - {*self.maximum}
        lacks = dict.fromkeys(name for change in rung.changes for name in change.lacks)
        self.causes_by_parts[rung.names] = Cause(
            parts=rung.names,
            words=tuple(change.description for change in rung.changes),
            lines=rung.config_lines,
            lacks=tuple(lacks),
            new=_fitted(job.problem.units, [s for s in job.problem.symbols if s.name in new], top),
            gain=top.log_posterior - self.base.log_posterior,
            bayes=float(top.log_z - self.base.log_z) - math.log(tries),
            fit=top.residuals,
            doubts=(*_doubts(top, {*self.maximum}, rung), *self._redundant(top, rung)),
            finished=top.is_finished,
        )
        self.maxima[rung.names] = top

    def _redundant(self, top: RefitMaximum, rung: CandidateModel) -> Iterator[Doubt]:
        """Yield doubts on pairs in which each part gains nearly as much as both.

        No doubt is raised if residuals are noise, or if the refit was stopped (evidence too low).
        """
        causes, both = self.causes_by_parts, float(top.log_z - self.base.log_z)
        known = top.is_finished and not like_noise(top.residuals)
        for pair in itertools.combinations(rung.changes, 2) if known else ():
            others, *alone = (
                tuple(name for name in rung.names if name not in {*removed})
                for removed in ([c.name for c in pair], *([c.name] for c in pair))
            )
            neither = causes[others].bayes if others in causes else 0.0
            least = neither + max(REDUNDANT * (both - neither), SURE_LOG_ODDS)
            if all(names in causes and causes[names].bayes > least for names in alone):
                yield Doubt("alike", tuple(change.description for change in pair))

    def _windows(self) -> tuple[tuple[FittedValue, ...], ...]:
        """Refit the given config on each window; return nothing if one refit fails.

        Each window has its determined unknowns; windows that determine only noise are omitted.
        """
        try:
            jobs = [rung.job() for rung in self.models.windows(WINDOWS)]
        except InputError:
            return ()
        known, starts = (self.maximum, -math.inf), [self.maximum]  # few starts are enough
        posteriors = [job.problem.posterior for job in jobs]
        futures = [self.submit(refit_candidate, p, *known, starts=starts) for p in posteriors]
        maxima = [future.result() for future in futures]
        if None in maxima:
            return ()
        symbols = [s for s in self.job.problem.symbols if self.roles[s.name] != "start"]
        determined = [[s for s in symbols if s.name not in top.vague] for top in maxima]
        return tuple(
            _fitted(self.job.problem.units, known, top)
            for known, top in zip(determined, maxima, strict=True)
            if any(self.roles[symbol.name] != "noise" for symbol in known)
        )


def _finer(heights: Mapping[float, float], finest: float) -> list[float]:
    """Return values between the best value and its neighbours: midpoints, and a parabola's maximum.

    The result is empty if the neighbours are nearer than `finest`, or about as probable.
    """
    known = sorted(heights)
    k = known.index(max(heights, key=heights.__getitem__))
    group = known[max(k - 1, 0) : k + 2]
    least = heights[known[k]] - SAME_HEIGHT
    wide = [
        (a, b) for a, b in pairwise(group) if b - a > finest and min(heights[a], heights[b]) < least
    ]
    halfway = [0.5 * (a + b) for a, b in wide]
    if len(group) < 3 or not wide:
        return halfway
    bend, slope, _ = np.polyfit(np.subtract(group, known[k]), [heights[x] for x in group], 2)
    top = known[k] - 0.5 * slope / bend if bend < 0 else known[k]
    return [*halfway, float(top)] if group[0] < top < group[2] and top not in heights else halfway


def _doubts(top: RefitMaximum, known: set[str], rung: CandidateModel) -> Iterator[Doubt]:
    """Yield reasons why the evidence of a candidate cannot be trusted."""
    widened = {name.removeprefix(WIDENED) for name in rung.names if name.startswith(WIDENED)}
    optional = {change.optional for change in rung.changes}
    for name, way in top.at_ends.items():
        if (name not in known or name in widened) and not (name in optional and way < 0):
            yield Doubt("end", (name,))
    if top.has_rival:
        yield Doubt("maxima")
    for pair in top.exchangeable:
        if len({rung.owner(name) for name in pair}) > 1:
            yield Doubt("alike", pair)
    if top.omitted > MAX_HIDDEN and not like_noise(top.residuals):
        yield Doubt("hidden", share=top.omitted)


def _fitted(
    units: DisplayUnits, symbols: Iterable[Symbol], top: RefitMaximum
) -> tuple[FittedValue, ...]:
    """Return values and sds of unknowns in display units."""
    shown = [(units.symbol(si), units.factor(si.name)) for si in symbols]
    return tuple(
        FittedValue(
            s.name,
            top.values[s.name] / factor,
            top.sds[s.name] / factor,
            "" if s.unit == "1" else s.plain_unit,
        )
        for s, factor in shown
    )
