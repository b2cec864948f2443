"""What designs promise against sampled fits of simulated records of their waveforms.

The sds of posteriors are compared.  Maxima scatter by more where the priors decide, as they lie at the
ends of these.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.design.responses import ComingExperiment
from bayesdrill.design.targets import parse_targets
from bayesdrill.output_files import numbered
from benchmarks.rates.design_cases import BOTH_WAYS, FORWARD, LIMITED, changed

FITS = 4


def achieved(
    case: bd.Case, numbers: Mapping[str, Any], folder: Path
) -> dict[str, tuple[float, float]]:
    """Return for each determined target the mean error of its log over sds, and sds over the promise.

    Both are those of sampled posteriors: the error is the mean over fits, the sd a geometric mean.
    """
    designed = case.design(draws=1, **numbers)
    designed.save(folder, force=True)
    problem, request = case.job.problem, designed.design.request
    known = [target for target in designed.design.targets if target.designed < 0.2 * target.now]
    coming = ComingExperiment.from_observation(problem.observations[0], request.source)
    batch = designed.design.levels
    posterior = coming.posterior(*batch)
    space, rng = posterior.space, np.random.default_rng(5)
    truth = space.vector(space.start)[None]
    formulas = [x.formula for x in parse_targets(problem, [x.name for x in known], truth)]
    observation, source = posterior.likelihood.observations[0], request.source
    signals = posterior.likelihood.all_signals(truth)
    header = ",".join(["t", source.input, *observation.experiment.names])
    factors = [channel.display_unit.factor for channel in observation.experiment.channels]
    errors, sds = (np.empty((FITS, len(formulas))) for _ in range(2))
    for k in range(FITS):
        files = numbered("record", [*batch])
        for file, levels, exact in zip(files, batch, signals, strict=True):
            record = observation.draw(exact, truth, rng)[0] / factors
            columns = np.column_stack([source.t, source.series(levels), record])
            np.savetxt(folder / f"{file}.csv", columns, "%.9g", ",", header=header, comments="")
        draws = bd.load(folder / "coming.yaml").sample().draws
        for number, formula in enumerate(formulas):
            true = float(np.squeeze(formula.value(space.named(truth))))
            logs = np.log(formula.value({**space.fixed, **draws}) / true)
            errors[k, number], sds[k, number] = logs.mean() / logs.std(), logs.std()
    ratios = np.exp(np.log(sds).mean(axis=0)) / [target.designed for target in known]
    pairs = zip(errors.mean(axis=0).tolist(), ratios.tolist(), strict=True)
    return dict(zip([target.name for target in known], pairs, strict=True))


@pytest.mark.slow
@run_cases(
    "name, numbers",
    [
        ("bundled", FORWARD),
        ("white noise", FORWARD),
        ("unknown noise", FORWARD),
        ("AR(1)", FORWARD),
        ("two channels", FORWARD),
        ("two experiments", {**FORWARD, "duration": 5.0, "experiments": 2}),
        ("friction", {**BOTH_WAYS, "learn": ("t_cm", "c_m")}),
        ("servo", LIMITED),
    ],
)
def test_sampled_refits_have_the_promised_sds(
    name: str, numbers: Mapping[str, Any], tmp_path: Path
) -> None:
    """The sds are within 10 % of the promise, and the errors of fits are their sds."""
    results = achieved(changed(name), numbers, tmp_path)
    print(name, {k: f"error {m:+.2f}, sd {s:.3f}" for k, (m, s) in results.items()})
    errors, sds = np.array([*results.values()]).T
    assert np.abs(errors).max() < 4.0 / np.sqrt(FITS)
    assert np.abs(sds - 1.0).max() < 0.1
