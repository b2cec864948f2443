"""Handle events of dry friction within a time step: zero crossings of speeds, stick and slip.

Between events each friction slips one way or sticks, the rig is linear, and a step is exact
(`friction`).  One kind of event is the zero crossing of a sliding speed, after which the friction
sticks or slips the other way.  The other kind is the moment when the effort (torque, or voltage)
that sticking requires exceeds the friction at rest, so that slip begins.

Events are not located in time: no root is sought, and no step ends at an event.  A step with an
event is divided into parts, and in each part a constant mean effort replaces the friction's effort:

- a zero crossing: the mean of the efforts before and after it, weighted by their durations (the
  speed is assumed to fall along a straight line);
- slip to stick: the effort that brings the speed to zero at the end of the part;
- stick to slip: the mean of the required effort until it reaches the friction at rest, and of the
  sliding friction after that. The required effort is approximated by two straight lines in time.

Over a part of length h the impulse of the mean effort has an error of O(h^2), and so has the motion
within the part.  So an event leaves an error of O(h^2) in the state.  A record with finitely many
events has an error of second order in the step (`docs/rigs.md`, dry friction).

Steps are short because the size of friction falls with the speed.  If every speed stays so high
that the sizes are constant, one long step to the next sample is exact.  While a friction sticks,
steps are always short: a long step would make its speed zero at the ends of the step only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from llvmlite import ir

from bayesdrill.basics.duals import below, signed, size, where
from bayesdrill.rig.kernels.friction import (
    FrictionHistory,
    FrictionMode,
    Sizes,
    Step,
    StepStart,
    any_of,
)
from bayesdrill.rig.kernels.lanes import EVERYWHERE, F64, Loop, Mask, Values, Vector
from bayesdrill.rig.kernels.numbers import (
    Column,
    Number,
    above,
    is_moving,
    is_sticking,
    keeps_direction,
    multiply_add,
    sum_products,
)
from bayesdrill.rig.models.friction import SettlingLaw


def advance_step(
    mode: FrictionMode,
    turning: Callable[[], ReversalStep],
    now: StepStart,
    turn: Callable[[list[Number]], None],
) -> list[Number]:
    """Return new state, efforts if the mode shows them, varying sizes, and their trends.

    After an event, a zero crossing or the end of sticking, `turn(state)` sets the new mode.
    """
    kind, x, directions = mode.step.kind, len(now.state), mode.directions()
    smooth = mode.advance(now, directions)
    new = smooth[:x]

    def looked() -> list[Number]:
        changes = mode.changes(new, now, directions)

        def turned() -> list[Number]:
            others = turning().advance(now, shows=mode.shows)
            merged = [where(changes, *both) for both in zip(others, smooth, strict=True)]
            turn(merged[:x])
            return merged

        return kind.replace_if_any(changes, smooth, turned)

    return kind.replace_if_any(mode.may_change(new, directions), smooth, looked)


@dataclass(frozen=True, slots=True)
class RestState:
    """To stick at the beginning of a step, a friction needs `effort`; at rest it has `sizes`."""

    effort: Number
    sizes: Sizes


@dataclass(frozen=True, slots=True)
class ReversalStep:
    """A step with events is one in which speeds may cross zero, and frictions may stick or slip.

    It is divided into `n_parts` parts, each a `step` over a `fraction` of the whole. A fast state,
    such as a current, is nearer to the assumed straight line over a part than over the whole step.
    """

    step: Step
    n_parts: ir.Value
    fraction: Vector

    @property
    def _order(self) -> list[int]:
        """Return the order in which efforts are computed, each from the latest values of the others.

        The initial values assume no reversal. Voltage drops oppose a current, have no angle, and come
        first. With a voltage drop the order is repeated, as current and motor are strongly coupled.
        """
        angles = [friction.angle for friction in self.step.frictions]
        order = sorted(range(len(angles)), key=lambda e: angles[e] is not None)
        return order * (1 + (None in angles))

    def advance(self, now: StepStart, *, shows: bool) -> list[Number]:
        """Return new state, mean efforts if they are shown, varying sizes, and zeros as their trends."""
        step, kind = self.step, self.step.kind
        x, v = len(now.state), len(step.varying)
        e = x + (len(step.frictions) if shows else 0)
        nothing = [kind.zero() for _ in range(e - x)]
        start = kind.flat([*now.state, *nothing, *now.history.sizes, *now.history.trends])
        loop = Loop(kind.b, self.n_parts, start, "parts")
        values = kind.shaped(loop.carried)
        before = FrictionHistory(values[e : e + v], values[e + v :])
        since = Vector(kind.b, kind.b.splat(kind.b.sitofp(loop.index, F64))) * step.span
        drive = step.drive_after(now.drive, since)
        result = self._whole(StepStart(values[:x], before, drive, now.inputs), shows=shows)
        pairs = zip(values[x:e], result[x:e], strict=True)
        efforts = [total + effort * self.fraction for total, effort in pairs]
        result = [*result[:x], *efforts, *result[e:]]
        loop.close(kind.flat(result))
        return result

    def _whole(self, now: StepStart, *, shows: bool) -> list[Number]:
        """Return the result of one part, as `advance` does for the whole step."""
        step, state, drive, inputs = self.step, now.state, now.drive, now.inputs
        rest_sizes = step.rest_sizes(state, inputs)
        sizes = [*rest_sizes]  # a past size has one direction; it is not used if directions differ
        for e, magnitude in zip(step.varying, now.history.sizes, strict=True):
            if not sizes[e].differ:
                sizes[e] = Sizes(magnitude, magnitude)
        free, later = step.frictionless(state, drive), step.drive_after(drive, step.span)
        holding = [friction.holding_effort(state, drive) for friction in self.step.frictions]
        at_rest = [RestState(*both) for both in zip(holding, rest_sizes, strict=True)]
        efforts, slips = self._efforts(free, state, later, sizes, at_rest)
        if step.varying:
            ahead = self._stopped(self._moved(free, efforts), slips)
            sizes = step.mean_sizes(state, ahead, inputs)
            efforts, slips = self._efforts(free, state, later, sizes, at_rest)
        new = self._held(self._stopped(self._moved(free, efforts), slips), state, slips)
        shown = efforts if shows else []
        varying = [sizes[e].along(new[step.frictions[e].row]) for e in step.varying]
        return [*new, *shown, *varying, *(self.step.kind.zero() for _ in varying)]

    def _efforts(
        self,
        free: list[Number],
        state: list[Number],
        drive: Column,
        sizes: list[Sizes],
        at_rest: list[RestState],
    ) -> tuple[list[Number], list[Mask]]:
        """Return efforts, and lanes in which each friction slips; `drive` is that after the step."""
        speeds = [state[friction.row] for friction in self.step.frictions]
        known = [
            where(is_moving(speed), signed(most.along(speed), speed), at.effort)
            for speed, most, at in zip(speeds, sizes, at_rest, strict=True)
        ]
        slips: dict[int, Mask] = {}
        for e in self._order:
            friction = self.step.frictions[e]
            others = [
                (self.step.frictions[k].column[friction.row], effort)
                for k, effort in enumerate(known)
                if k != e and friction.row in self.step.frictions[k].column
            ]
            stop = sum_products(free[friction.row], others) * friction.stop_gain
            speed = state[friction.row]
            slipping = self._effort_from_slip(stop, speed, friction.stop_gain, sizes[e], at_rest[e])
            stopped = [stop if k == e else effort for k, effort in enumerate(known)]
            there = self._moved(free, stopped, [k for k in friction.holding_row if k < len(free)])
            later = friction.holding_effort(there, drive)
            still = self._effort_from_stick(stop, later, sizes[e], at_rest[e])
            moves = is_moving(speed)
            known[e] = where(moves, slipping[0], still[0])
            slips[e] = slipping[1].both(moves).either(still[1].without(moves))
        return known, [slips[e] for e in range(len(self.step.frictions))]

    def _effort_from_slip(
        self, stop: Number, speed: Number, over: Number, sizes: Sizes, at_rest: RestState
    ) -> tuple[Number, Mask]:
        """Return the mean effort over a step that begins in slip, and lanes that slip at its end.

        `stop` is the effort that would make the speed zero at the end of the step. Let v > 0 be the
        speed, times `over` (effort per speed). If `stop` exceeds the size of the friction, v stays
        positive. Otherwise v crosses zero within the step, where the effort v - stop drives it
        backwards. The friction sticks if this effort is at most its size at rest. Else it slips.
        """
        back, most = below(speed, 0.0), sizes.along(speed)
        ahead, rate = where(back, -stop, stop), size(speed) * over
        against = rate - ahead + most  # v - stop, which drives backwards, plus sliding friction
        beyond = at_rest.sizes.along(speed, back=True)
        keeps, passes = above(ahead, most), above(against, most + beyond)
        turned = where(keeps, most, ahead)

        def reversed_effort() -> list[Number]:
            before = rate / against  # fraction of the step before the crossing
            if not sizes.differ:
                return [most * (before * 2.0 - 1.0)]
            other = sizes.along(speed, back=True)
            return [(most + other) * before - other]

        (turned,) = self.step.kind.select_if_any(passes.without(keeps), [turned], reversed_effort)
        return where(back, -turned, turned), keeps.either(passes)

    def _effort_from_stick(
        self, stop: Number, later: Number, sizes: Sizes, at_rest: RestState
    ) -> tuple[Number, Mask]:
        """Return the mean effort over a step that begins in stick, and lanes that slip at its end.

        The required effort goes from `at_rest.effort` to `later`, with the mean `stop`. Once it
        exceeds the size at rest, the friction slips with the size in `sizes`.
        """
        back, most, held = below(stop, 0.0), sizes.along(stop), at_rest.sizes.along(stop)
        efforts = (stop, at_rest.effort, later)
        mean, first, last = (where(back, -effort, effort) for effort in efforts)
        slips = above(last, held).either(above(mean, held))

        def slipping() -> list[Number]:
            # The required effort is two straight lines in time: first to middle, then to last.
            middle = (mean * 6.0 - first - last) * 0.25
            halves = [_excess(*ends, held) for ends in ((first, middle), (middle, last))]
            fraction = (halves[0][0] + halves[1][0]) * 0.5
            driving = (halves[0][1] + halves[1][1]) * 0.5
            bent = mean - (first + middle * 2.0 + last) * 0.25
            return [mean - driving - fraction * (held - most + bent)]

        (turned,) = self.step.kind.select_if_any(slips, [mean], slipping)
        return where(back, -turned, turned), slips

    def _moved(
        self, free: list[Number], efforts: list[Number], only: Sequence[int] | None = None
    ) -> list[Number]:
        """Return the states with efforts applied; if given, `only` lists the states that are needed."""
        new = list(free)
        for friction, effort in zip(self.step.frictions, efforts, strict=True):
            for i in (i for i in friction.column if only is None or i in only):
                new[i] = multiply_add(friction.column[i], effort, new[i])
        return new

    def _stopped(self, new: list[Number], slips: list[Mask]) -> list[Number]:
        new = list(new)
        for friction, moves in zip(self.step.frictions, slips, strict=True):
            new[friction.row] = where(moves, new[friction.row], 0.0)
        return new

    def _held(self, new: list[Number], old: list[Number], slips: list[Mask]) -> list[Number]:
        """Restore the old angle in lanes in which the speed was zero and is zero."""
        for friction, moves in zip(self.step.frictions, slips, strict=True):
            if friction.angle is not None:
                moved = moves.either(is_moving(old[friction.row]))
                new[friction.angle] = where(moved, new[friction.angle], old[friction.angle])
        return new


def _excess(first: Number, last: Number, limit: Number) -> tuple[Number, Number]:
    """Return the fraction of a straight line above a limit, and the mean of max(line - limit, 0)."""
    begins, ends, rises = above(first, limit), above(last, limit), above(last, first)
    high, low = where(rises, last, first), where(rises, first, last)
    crosses = begins.either(ends).without(begins.both(ends))
    fraction = where(crosses, (high - limit) / (high - low), where(begins, 1.0, 0.0))
    excess = where(begins.both(ends), (first + last) * 0.5 - limit, fraction * (high - limit) * 0.5)
    return fraction, excess


SETTLED_EXPONENT = 18.0  # a size is constant once exp(-18) = 2e-8 of its excess at rest remains


def advance_stride(
    mode: FrictionMode, wanted: ir.Value, now: StepStart, steps: Callable[[], list[Number]]
) -> list[Number]:
    """Return the numbers that are carried to the next sample.

    `mode` is that of a long step from sample to sample. A lane (one walker) takes the long step if
    `wanted` is true and all its frictions slip far from any event. All other lanes take `steps`,
    whose code runs only if there are such lanes.
    """
    step, state, past, directions = mode.step, now.state, now.history, mode.directions()

    def long_step() -> list[Number]:
        steady = [sliding for sliding, _ in _decay_terms(step, state)]
        trends = [step.kind.zero() for _ in steady]
        begin = replace(now, history=FrictionHistory(steady, trends))
        new = mode.advance(begin, directions, sizes=steady)
        return [*new[: len(state)], *steady, *trends]

    b, kind, stays = step.kind.b, step.kind, [*state, *past.sizes, *past.trends]

    def stride() -> Values:
        """Return the numbers after a long step, and the lanes that may not take it."""
        stuck = [is_sticking(direction) for direction in directions]
        bound = any_of([*stuck, *_falling(step, state)])
        moved = kind.replace_if_any(bound.negate(), stays, long_step)
        new = moved[: len(state)]
        walks = [bound, *_falling(step, new), *_near_zero(step, state, new, directions)]
        return [*kind.flat(moved), any_of(walks).value]

    *moved, walks = b.replace_if(wanted, [*kind.flat(stays), EVERYWHERE], stride)
    return kind.select_if_any(Mask(b, walks), kind.shaped(moved), steps)


def _falling(step: Step, state: Sequence[Number]) -> Iterator[Mask]:
    """Yield a mask for each varying size: the lanes in which it still changes with the speed."""
    for _, fallen in _decay_terms(step, state):
        yield below(fallen, SETTLED_EXPONENT)


def _decay_terms(step: Step, state: Sequence[Number]) -> Iterator[tuple[Number, Number]]:
    """Evaluate `SettlingLaw.decay_terms` for the sizes that vary."""
    for e in step.varying:
        friction = step.frictions[e]
        assert isinstance(friction.law, SettlingLaw)  # `SteppedShape.long_steps`
        yield friction.law.decay_terms(step.parameters, size(state[friction.row]))


def _near_zero(
    step: Step, state: Sequence[Number], new: Sequence[Number], directions: Sequence[Vector]
) -> Iterator[Mask]:
    """Yield lanes in which a speed may cross zero: it changes by more than its size at either end."""
    for friction, direction in zip(step.frictions, directions, strict=True):
        change = size(new[friction.row] - state[friction.row])
        for end in (state, new):
            yield above(change, size(end[friction.row]))
        yield keeps_direction(direction, new[friction.row]).negate()
