"""What is known of a record's truth: the record is made anew, and must be the one there is.

So a measured record that takes the place of a simulated one has no truth, whatever configs say.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesdrill import build, recording, simulation
from bayesdrill import config as records
from bayesdrill.models.two_rotors import TwoRotors
from bayesdrill.yaml_source import Source

SAME = 1e-6  # relative, and absolute: records hold nine digits


def truth_of(
    config: records.Config, source: Source, makers: Sequence[tuple[records.Config, Source]]
) -> dict[str, float] | None:
    """Parameters of the paper's model with which its record was simulated by one of `makers`.

    Of a rig with more to it, those of the paper's model that it is the same as.
    """
    path = recording.path_of(config, source)
    for other, its_source in makers:
        if recording.path_of(other, its_source).resolve() != path.resolve():
            continue
        if not _same(simulation.simulate(other, its_source, other.seed), path.read_text()):
            continue
        rig = build.model(other)
        values = simulation.truth(other, rig)
        if isinstance(rig, TwoRotors):
            return {name: float(x) for name, x in rig.whole(values).items()}
        return values
    return None


def _same(text: str, other: str) -> bool:
    """Of two CSV records."""
    heads, *rows = text.strip().splitlines()
    other_heads, *other_rows = other.strip().splitlines()
    if heads != other_heads or len(rows) != len(other_rows):
        return False
    one, two = (
        np.array([r.split(",") for r in table], dtype=float) for table in (rows, other_rows)
    )
    return one.shape == two.shape and np.allclose(one, two, rtol=SAME, atol=SAME)
