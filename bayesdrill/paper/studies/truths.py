"""What is known of a record's truth: the record is made anew, and must be the one there is.

So a measured record that takes the place of a simulated one has no truth, whatever configs say.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesdrill.rig import Model, MotorShaft, TwoRotors
from bayesdrill.setup import Config, Source, build, reading, simulating

SAME = 1e-6  # relative, and absolute: records hold nine digits


def truth_of(
    config: Config, source: Source, makers: Sequence[tuple[Config, Source]]
) -> dict[str, float] | None:
    """Parameters of its model with which its record was simulated by one of `makers`.

    Of a rig with more to it, those of the paper's model that it is the same as.
    """
    path, own = reading.path_of(config, source), build.model(config)
    for other, its_source in makers:
        if reading.path_of(other, its_source).resolve() != path.resolve():
            continue
        text = path.read_text(encoding="utf-8", errors="replace")
        if _same(simulating.simulate(other, its_source, other.seed), text):
            rig = build.model(other)
            return _of_model(own, rig, simulating.truth(other, rig))
    return None


def _of_model(own: Model, rig: Model, values: dict[str, float]) -> dict[str, float] | None:
    """The parameters of `own` that make it the `rig` with these `values`; None if it cannot be told."""
    if own == rig:
        return values
    if isinstance(own, MotorShaft) and isinstance(rig, TwoRotors) and own.i_m == rig.i_m:
        return {name: float(x) for name, x in rig.whole(values).items()}
    return None


def _same(text: str, other: str) -> bool:
    """Of two CSV records."""
    heads, *rows = text.strip().splitlines()
    other_heads, *other_rows = other.strip().splitlines()
    if heads != other_heads or len(rows) != len(other_rows):
        return False
    try:
        one, two = (
            np.array([r.split(",") for r in table], dtype=float) for table in (rows, other_rows)
        )
    except ValueError:  # other numbers than a simulation writes
        return False
    return one.shape == two.shape and np.allclose(one, two, rtol=SAME, atol=SAME)
