"""The files of a results folder: tables, figures, and the ArviZ tree."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import bayesdrill
from bayesdrill.basics import seeds
from bayesdrill.basics.own_files import FIGURES, whole
from bayesdrill.engines.mode import Mode
from bayesdrill.engines.sampling import Sampled
from bayesdrill.engines.workers import Crew
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.residual_checks import Left
from bayesdrill.insight.derived import Derived, derive, summarise, with_products
from bayesdrill.insight.diagnostics import Row
from bayesdrill.insight.verdict import Judgement
from bayesdrill.report import (
    derived_words,
    identify_words,
    residual_words,
    tables,
    verdict_words,
    words,
)
from bayesdrill.report.sparing import Sparing
from bayesdrill.results.run_folder import Folder
from bayesdrill.setup.build import compared_with
from bayesdrill.setup.config import Config

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import DataTree

Array = NDArray[np.float64]


def everything(
    problem: Problem,
    mode: Mode,
    left: Sequence[Left],
    sampled: Sampled,
    rows: Sequence[Row],
    judged: Judgement | None,
    config: Config,
    folder: Folder,
    crew: Crew,
) -> tuple[str, ...]:
    """What could not be made, and why; all else is written.

    Raises `OSError` when the disk is full; files already there stay whole.
    """
    place = (*_place(folder, config), words.warning(sampled, left))
    sparing = Sparing()
    derived = _derived(problem, sampled, judged, sparing)
    tasks: list[tuple[str, Future[None]]] = []
    for wanted in _figures(problem, mode, sampled, derived, judged, config, sparing):
        with sparing.making(f"figures/{wanted[0]}"):
            tasks.append((wanted[0], crew.submit(draw, *wanted, *place)))
    # While others draw, the rest.
    folder.write_text("summary.csv", tables.as_csv(rows))
    second = "none"
    with sparing.making("derived.csv"):
        following = summarise(derived)
        folder.write_text("derived.csv", derived_words.as_csv(following))
        second = derived_words.as_markdown(following, derived)
    with sparing.making("summary.md"):
        folder.write_text("summary.md", _summary(config, mode, left, sampled, rows, judged, second))
    if judged is not None:
        with sparing.making("verdict.csv"):
            folder.write_text("verdict.csv", verdict_words.as_csv(judged.verdict))
    whole_tree = None
    with sparing.making("posterior.nc, figures/fit"):
        whole_tree = _tree(problem, sampled, derived, config)
    if whole_tree is not None:
        with sparing.making("figures/fit"):
            tasks.append(("fit", crew.submit(draw, *_fit(problem, mode, whole_tree), *place)))
        with sparing.making("posterior.nc"):
            _write_tree(whole_tree, folder.place("posterior.nc"))
    for stem, task in tasks:
        with sparing.making(f"figures/{stem}"):
            task.result()
    return tuple(sparing.missing)


def tree(problem: Problem, sampled: Sampled, judged: Judgement | None, config: Config) -> DataTree:
    """For ArviZ, as `posterior.nc` has it."""
    return _tree(problem, sampled, _derived(problem, sampled, judged, Sparing()), config)


def _tree(problem: Problem, sampled: Sampled, derived: Derived, config: Config) -> DataTree:
    # Late: xarray takes half a second to load.
    from bayesdrill.results.arviz_tree import make_tree

    return make_tree(
        problem,
        sampled,
        words.predictive_draws(problem, config),
        seeds.stream(config.seed, "predictive"),
        seeds.stream(config.seed, "prior"),
        _attributes(config, sampled),
        derived,
    )


def figure(
    problem: Problem,
    mode: Mode,
    sampled: Sampled,
    judged: Judgement | None,
    config: Config,
    stem: str,
) -> Figure:
    """One of those that a run leaves; raises `LookupError` where this run has no such figure."""
    sparing = Sparing()
    derived = _derived(problem, sampled, judged, sparing)
    wanted = _figures(problem, mode, sampled, derived, judged, config, sparing)
    for name, draw_, arguments in wanted:
        if name == stem:
            return draw_(*arguments)
    raise LookupError(f"no figure {stem} of this run; it has {', '.join(one[0] for one in wanted)}")


def _write_tree(tree: DataTree, path: Path) -> None:
    image = io.BytesIO()  # in memory: see pieces.chain_image
    tree.to_netcdf(image, engine="h5netcdf")
    with whole(path) as aside:
        aside.write_bytes(image.getvalue())


def _derived(
    problem: Problem, sampled: Sampled, judged: Judgement | None, sparing: Sparing
) -> Derived:
    with sparing.making("derived quantities"):
        derived = derive(problem, sampled.draws)
        if judged is None:
            return derived
        products = [quantity.exponents for quantity in judged.verdict.products]
        return with_products(derived, problem, sampled.draws, products)
    return Derived(symbols=(), values=np.empty((*sampled.draws.shape[:2], 0)), nominal={})


def _place(folder: Folder, config: Config) -> tuple[Path, dict[str, str]]:
    """Where figures go, and the note in each."""
    figures = folder.path / FIGURES
    figures.mkdir(exist_ok=True)
    return figures, {"Title": config.name, "Creator": f"bayesdrill {bayesdrill.__version__}"}


def _figures(
    problem: Problem,
    mode: Mode,
    sampled: Sampled,
    derived: Derived,
    judged: Judgement | None,
    config: Config,
    sparing: Sparing,
) -> list[Wanted]:
    """Each figure is a task of its own: drawing takes longer than all tables together."""
    # Late: matplotlib takes a second to load, and only reports need it.
    from bayesdrill.report.corner_plot import corner_figure
    from bayesdrill.report.prior_posterior_plot import prior_posterior_figure
    from bayesdrill.report.trace_plot import trace_figure

    space, symbols = problem.posterior.space, problem.symbols
    theta = space.vector(mode.values)[None]
    draws = sampled.draws.reshape(-1, theta.shape[1])
    wanted: list[Wanted] = []
    with sparing.making("figures/corner"):
        shown = derived_words.shown(problem, config.output.corner, sampled.draws, derived, theta)
        corner = (shown.draws, shown.symbols, shown.nominal, shown.mode, space.priors)
        wanted.append(("corner", corner_figure, corner))
    with sparing.making("figures/invariants, figures/ridge"):
        wanted += _of_verdict(problem, judged, draws, mode)
    burn_in = sampled.convergence.burn_in
    trace = (sampled.theta, symbols, burn_in, problem.nominal, mode.values)
    before = (draws, symbols, space.priors, problem.nominal, mode.values)
    return [
        *wanted,
        ("trace", trace_figure, trace),
        ("prior_posterior", prior_posterior_figure, before),
    ]


def _fit(problem: Problem, mode: Mode, tree: Any) -> Wanted:
    from bayesdrill.report.fit_plot import fit_figure

    group = tree["posterior_predictive"]
    channels = problem.experiment.names
    predictive = np.stack([np.asarray(group[name]) for name in channels], axis=-1)
    predictive = predictive.reshape(-1, *predictive.shape[2:]).astype(np.float64)
    likelihood = problem.posterior.likelihood
    theta = problem.posterior.space.vector(mode.values)[None]
    best = likelihood.signals(theta)[0]
    sigma = likelihood.sigmas(theta)[0]
    return "fit", fit_figure, (problem.experiment, best, predictive, sigma)


Wanted = tuple[str, Callable[..., "Figure"], tuple[Any, ...]]


def draw(
    _: Posterior,
    stem: str,
    figure: Callable[..., Figure],
    arguments: tuple[Any, ...],
    folder: Path,
    note: Mapping[str, str],
    warning: str = "",
) -> None:
    from bayesdrill.report.style import save

    save(figure(*arguments), folder, stem, note, warning)


def _of_verdict(
    problem: Problem, judged: Judgement | None, draws: Array, mode: Mode
) -> list[Wanted]:
    """The invariants, and the ridge where there is a symmetry."""
    from bayesdrill.report.invariants_plot import invariants_figure
    from bayesdrill.report.ridge_plot import ridge_figure, strongest_pair

    if judged is None:
        return []
    space, symbols = problem.posterior.space, problem.symbols
    best = space.vector(mode.values)
    wanted: list[Wanted] = []
    if judged.verdict.products:
        wanted.append(("invariants", invariants_figure, (judged.verdict, draws, best, symbols)))
    pair = strongest_pair(draws, judged.study.structure)
    if pair is not None:
        ridge = (draws, pair, symbols, space.priors, problem.nominal, mode.values)
        wanted.append(("ridge", ridge_figure, ridge))
    return wanted


def _summary(
    config: Config,
    mode: Mode,
    left: Sequence[Left],
    sampled: Sampled,
    rows: Sequence[Row],
    judged: Judgement | None,
    derived: str,
) -> str:
    paragraphs = [
        f"# {config.name}",
        *_listed_if(
            words.unbelievable(
                residual_words.reasons(left), converged=sampled.convergence.converged
            )
        ),
        _listed(residual_words.sentences(left)),
        tables.as_markdown(rows).rstrip(),
        "`dev. %` is the deviation of the posterior mean from the nominal value "
        f"({compared_with(config)}); `shrinkage` is one minus the ratio of the posterior's to the "
        "prior's standard deviation.",
        _listed(tables.in_words(rows, tables.notes(rows))),
        "## What follows from these",
        derived,
        *_judged(config, judged, converged=sampled.convergence.converged),
        "## Maximum of the posterior (MAP)",
        _listed(words.mode(mode)),
        *_listed_if(words.maxima(mode, sampled)),
        "## Convergence",
        _listed(words.convergence(sampled)),
    ]
    return "\n\n".join(paragraphs) + "\n"


def _judged(config: Config, judged: Judgement | None, *, converged: bool) -> list[str]:
    if judged is None:
        return []
    verdict, table = judged.verdict, compared_with(config)
    nothing = "nothing found: energy, poles and sampling are as in a real rig"
    return [
        "## Verdict",
        _listed(verdict_words.sentences(verdict, table, converged=converged)),
        verdict_words.rule(verdict),
        verdict_words.as_markdown(verdict).rstrip(),
        verdict_words.EXPLAINED,
        "## What this record can show, at the MAP",
        f"```text\n{identify_words.structure(judged.study)}\n\n{identify_words.knowledge(judged.study)}\n```",
        "## Physical consistency of the posterior",
        _listed("\n".join(judged.findings) or nothing),
    ]


def _listed(text: str) -> str:
    return "\n".join(f"- {line.strip().removeprefix('- ')}" for line in text.splitlines())


def _listed_if(text: str) -> list[str]:
    return [_listed(text)] if text else []


def _attributes(config: Config, sampled: Sampled) -> dict[str, object]:
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
