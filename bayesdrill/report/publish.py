"""The files of a results folder: tables, figures, and the ArviZ tree."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np

import bayesdrill
from bayesdrill import config as records
from bayesdrill import seeds
from bayesdrill.build import Problem
from bayesdrill.diagnostics import Row
from bayesdrill.mode import Mode
from bayesdrill.report import tables, words
from bayesdrill.sampling import Sampled
from bayesdrill.store import Folder, whole
from bayesdrill.tree import make_tree


def everything(
    problem: Problem,
    mode: Mode,
    sampled: Sampled,
    rows: Sequence[Row],
    config: records.Config,
    folder: Folder,
) -> None:
    """Raises `OSError` when the disk is full; files already there stay whole."""
    folder.write_text("summary.csv", tables.as_csv(rows))
    folder.write_text("summary.md", _summary(config, mode, sampled, rows))
    tree = make_tree(
        problem,
        sampled,
        config.output.predictive_draws,
        seeds.stream(config.seed, "predictive"),
        seeds.stream(config.seed, "prior"),
        _attributes(config, sampled),
    )
    image = io.BytesIO()  # in memory: see store._chain_image
    tree.to_netcdf(image, engine="h5netcdf")
    with whole(folder.path / "posterior.nc") as path:
        path.write_bytes(image.getvalue())
    channels = problem.experiment.names
    group = tree["posterior_predictive"]
    predictive = np.stack([np.asarray(group[name]) for name in channels], axis=-1)
    _figures(problem, mode, sampled, predictive.reshape(-1, *predictive.shape[2:]), folder, config)


def _figures(
    problem: Problem,
    mode: Mode,
    sampled: Sampled,
    predictive: np.ndarray[tuple[int, ...], np.dtype[np.float32]],
    folder: Folder,
    config: records.Config,
) -> None:
    # Late: matplotlib takes a second to load, and only reports need it.
    from bayesdrill.report.corner_plot import corner_figure
    from bayesdrill.report.fit_plot import fit_figure
    from bayesdrill.report.style import save
    from bayesdrill.report.trace_plot import trace_figure

    posterior = problem.posterior
    theta = posterior.space.vector(mode.values)[None]
    draws = sampled.draws.reshape(-1, theta.shape[1])
    figures = folder.path / "figures"
    figures.mkdir(exist_ok=True)
    note = {"Title": config.name, "Creator": f"bayesdrill {bayesdrill.__version__}"}
    drawn = {
        "corner": corner_figure(
            draws, problem.symbols, problem.nominal, mode.values, posterior.space.priors
        ),
        "trace": trace_figure(
            sampled.theta,
            problem.symbols,
            sampled.convergence.burn_in,
            problem.nominal,
            mode.values,
        ),
        "fit": fit_figure(
            problem.experiment,
            posterior.likelihood.signals(theta)[0],
            predictive.astype(np.float64),
            posterior.likelihood.noise.sigmas(posterior.likelihood.sigma_columns(theta))[0],
        ),
    }
    for stem, figure in drawn.items():
        save(figure, figures, stem, note)


def _summary(config: records.Config, mode: Mode, sampled: Sampled, rows: Sequence[Row]) -> str:
    paragraphs = [
        f"# {config.name}",
        tables.as_markdown(rows).rstrip(),
        "`dev. %` is the deviation of the posterior mean from the nominal value "
        f"({config.nominal.table}); `shrinkage` is one minus the ratio of the posterior's to the "  # type: ignore[attr-defined]
        "prior's standard deviation.",
        _listed(tables.in_words(rows)),
        "## Maximum of the posterior (MAP)",
        _listed(words.mode(mode)),
        "## Convergence",
        _listed(words.convergence(sampled)),
    ]
    return "\n\n".join(paragraphs) + "\n"


def _listed(text: str) -> str:
    return "\n".join(f"- {line.strip().removeprefix('- ')}" for line in text.splitlines())


def _attributes(config: records.Config, sampled: Sampled) -> dict[str, object]:
    c = sampled.convergence
    return {
        "name": config.name,
        "creation_library": "bayesdrill",
        "creation_library_version": bayesdrill.__version__,
        "inference_library": "emcee",
        "chain_is": "an independent ensemble",
        "steps": c.steps,
        "burn_in": c.burn_in,
        "thin": c.thin,
        "converged": int(c.converged),
        "seed": config.seed,
        "sample_dims": ["chain", "draw"],
    }
