"""Equal steps through the times of a record, and what its inputs are over each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesdrill.rig.grid import grid

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

AT_NODE = 1e-9  # of a step: a shift nearer to a whole number of them is one


class Ahead:
    """Nodes from the first of `t (T,)` on, `pieces` of them to the usual sample, `span` apart.

    Inputs `series`, each `(T,)`, go from sample to sample (`first_order`) or are held; over a step
    they are what they are at its beginning and their slope, or their mean.
    """

    def __init__(
        self, t: Array, series: Mapping[str, Array], first_order: bool, pieces: int
    ) -> None:
        self._t, self._first_order = t, first_order
        self._series = [np.asarray(u, dtype=float) for u in series.values()]
        g = grid(t)
        self.aligned = g.uniform or len(t) == 1
        whole = float(g.spans[0]) if g.uniform else g.usual
        self.span = whole / pieces
        if self.aligned:
            at = g.at * pieces
            self.counts: Whole = np.append(np.diff(at), 1).astype(np.int64)
            self.nodes = int(at[-1]) + 1
            self.places: Array = at.astype(float)
        else:
            self.counts = np.zeros(len(t), np.int64)
            self.places = (t - t[0]) / self.span
            self.nodes = int(np.ceil(self.places[-1])) + 1
        self.samples = len(t)
        self.spans = np.array([self.span, whole])
        self._pieces = pieces

    @cached_property
    def single(self) -> bool:
        """Whether each step has a sample."""
        return self.aligned and bool((self.counts == 1).all())

    @cached_property
    def usual(self) -> Whole:
        """`(T,)`: 1 where the next sample is as many steps away as usual; inputs go straight on."""
        return np.asarray(self.counts == self._pieces).astype(np.int64)

    def every_node(self) -> Ahead:
        """The same steps, with a sample at each node."""
        made = object.__new__(Ahead)
        cached = ("single", "usual", "_kept", "_over_steps")
        made.__dict__.update({k: v for k, v in self.__dict__.items() if k not in cached})
        made.samples = self.nodes + 1
        made.aligned = True
        made.counts = np.ones(self.nodes + 1, np.int64)
        made.places = np.arange(self.nodes + 1.0)
        made.nodes = self.nodes + 1
        return made

    def between(self, t: Array) -> tuple[Whole, Array]:
        """The node before each time, and how far it is from there in steps."""
        places = (t - self._t[0]) / self.span
        near = np.round(places)
        places = np.where(np.abs(places - near) < 1e-6, near, places)
        last = np.clip(np.floor(places), 0, self.nodes - 1).astype(np.int64)
        return last, places - last

    def after(self, shift: Array) -> int:
        """Steps beyond the last sample that shifts `(W, K)` look at."""
        ahead = -np.nanmin(shift, initial=0.0)
        return int(np.ceil(ahead / self.span)) + 1 if np.isfinite(ahead) else 1

    def margin(self, lag: Array) -> int:
        """Steps before and after the record that inputs late by `lag (W, S)` come from."""
        if not lag.size:
            return 0
        return int(np.ceil(np.nanmax(np.abs(lag), initial=0.0) / self.span)) + 2

    def delays(self, lags: Sequence[Array]) -> tuple[Array, ...]:
        """For lags, and their slopes: whole steps behind the rows of `inputs`, and shares of a step."""
        ratio = lags[0] / self.span
        whole = np.floor(ratio + AT_NODE)
        shares = [np.clip(ratio - whole, 0.0, None), *(lag / self.span for lag in lags[1:])]
        return (np.nan_to_num(whole), *shares)

    def inputs(self, margin: int, after: int) -> Array:
        """Over each step `(N + 1 + after, S)`, with slopes `2 S`; `margin` rows stand before and behind.

        Outside the record they are constant.
        """
        # Few sizes, each kept.
        margin, after = (1 << n.bit_length() if n else 0 for n in (margin, after))
        if (margin, after) not in self._kept:
            tail = np.repeat(self._last[None], after + margin, axis=0)
            head = np.repeat(self._first[None], margin, axis=0)
            known = np.concatenate([head, self._over_steps, tail])
            self._kept[margin, after] = np.ascontiguousarray(known)[margin:]
        return self._kept[margin, after]

    @cached_property
    def _kept(self) -> dict[tuple[int, int], Array]:
        return {}

    def felt(self, which: int, lag: Array) -> tuple[Array, Array]:
        """One of the inputs, late by `lag (W,)`, as steps begin, and its slope: `(W, N)` each."""
        rows = np.concatenate([self._first[None], self._over_steps, self._last[None]])
        whole, share = (part[:, None] for part in self.delays([lag]))
        at = 1 + np.arange(self.nodes) - whole.astype(np.int64)
        here, earlier = (np.clip(at - back, 0, len(rows) - 1) for back in (0, 1))

        def late(column: int) -> Array:
            now = rows[here, column]
            return np.asarray(now + (rows[earlier, column] - now) * share)

        values = late(which)
        return values, late(which + self._slopes) if self._slopes else np.zeros_like(values)

    @cached_property
    def _over_steps(self) -> Array:
        return self._of_steps(np.asarray(np.arange(self.nodes + 2) * self.span))

    def _of_steps(self, nodes: Array) -> Array:
        t = self._t - self._t[0]
        if not self._series:
            return np.zeros((len(nodes) - 1, 0))
        if self._first_order:
            at = np.array([np.interp(nodes, t, u) for u in self._series]).T
            return np.concatenate([at[:-1], np.diff(at, axis=0) / self.span], axis=1)
        if self.aligned:
            near = np.searchsorted(t, nodes[:-1] + 0.5 * self.span, side="right") - 1
            return np.array([u[near] for u in self._series]).T
        return np.array([_means(nodes, t, u) for u in self._series]).T

    @property
    def _first(self) -> Array:
        return np.array([u[0] for u in self._series] + [0.0] * self._slopes)

    @property
    def _last(self) -> Array:
        return np.array([u[-1] for u in self._series] + [0.0] * self._slopes)

    @property
    def _slopes(self) -> int:
        return len(self._series) if self._first_order else 0


def _means(nodes: Array, t: Array, held: Array) -> Array:
    """Over steps, of what is held from sample to sample."""
    whole = np.concatenate([[0.0], np.cumsum(held[:-1] * np.diff(t))])
    beyond = np.clip(nodes - t[-1], 0.0, None) * held[-1]
    return np.asarray(np.diff(np.interp(nodes, t, whole) + beyond) / np.diff(nodes))
