"""Check the settings of the job: search, sampling, calibration, simulation, output."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from bayesdrill import output_files
from bayesdrill.basics import symbols
from bayesdrill.basics.entries import build_member, entries_of, unknown_keys
from bayesdrill.basics.errors import count_noun
from bayesdrill.basics.registry import lookup
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector, Location
from bayesdrill.output_files import RUN_FIGURES
from bayesdrill.sampling.optimisers import OPTIMISERS
from bayesdrill.sampling.optimisers.contract import Optimiser
from bayesdrill.sampling.samplers.ensemble import MOVES, always_inside, moves_with_weights


def optimiser(config: Config) -> Optimiser:
    """Return the optimiser that searches the MAP."""
    return build_member(lookup(OPTIMISERS, config.map.method, "method"), config.map)


def check_settings(errors: IssueCollector, config: Config) -> None:
    """Check the names of optimiser, moves and figures, and the optimiser's entries."""
    kind = errors.run(("map", "method"), lookup, OPTIMISERS, config.map.method, "method")
    if kind is not None:
        surplus = unknown_keys(("method", "method"), OPTIMISERS.usable(), kind, config.map)
        errors.add_all(("map",), surplus)
    weights = config.sampler.moves
    for name in weights:
        errors.run(("sampler", "moves", name), lookup, MOVES, name, "move")
    known_moves = {name: weight for name, weight in weights.items() if name in MOVES}
    if not moves_with_weights(known_moves, None, always_inside):
        alone = [(n, moves_with_weights({n: 1.0}, None, always_inside)) for n in MOVES.usable()]
        waiting = [name for name, moves in alone if not moves]
        stays = "with which some walkers may never move; give another move a weight"
        message = f"no move has a weight except {' or '.join(waiting)}, {stays}"
        errors.add(("sampler", "moves"), message)
    for k, name in enumerate(config.output.figures or ()):
        errors.run(("output", "figures", k), lookup, RUN_FIGURES, name, "figure of a run")


def check_unknown(
    errors: IssueCollector, config: Config, unknown: Sequence[str], related: Iterable[str]
) -> None:
    """Check search, walkers and figures against the unknowns; `related` are computed parameters."""
    if kind := OPTIMISERS.usable().get(config.map.method):
        given_entries = [e for e in entries_of(kind) if getattr(config.map, e) is not None]
        location = ("map", *(given_entries or ["method"])[:1])
        errors.run(location, optimiser(config).check, list(unknown))
    sampler, n_unknown = config.sampler, len(unknown)
    if unknown:
        if sampler.walkers % 2 or sampler.walkers < 2 * n_unknown:
            unknowns = count_noun(n_unknown, "unknown")
            wanted = f"an even number, at least twice the {unknowns}, is wanted"
            errors.add(("sampler", "walkers"), f"{sampler.walkers} walkers: {wanted}")
        arguments = (sampler.ensembles, sampler.walkers, n_unknown)
        errors.run(("sampler", "walkers"), output_files.check_chain, *arguments)
    shown_names = [*unknown, *related, *symbols.DERIVED, *config.derived]
    for k, name in enumerate(config.output.parameters or ()):
        errors.expect(("output", "parameters", k), name, unknown, f"{name} is no unknown")
    for k, name in enumerate(config.output.corner or ()):
        message = f"{name} is neither unknown nor derived"
        errors.expect(("output", "corner", k), name, shown_names, message)


def check_calibration(errors: IssueCollector, config: Config) -> None:
    """Check that a refit has enough effective draws for its ranks."""
    settings = config.calibration
    if settings.ess < settings.draws:
        few = f"{settings.ess:g} effective draws are fewer than {settings.draws} independent ones"
        errors.add(("calibration", "ess"), f"{few}; make it larger")


def check_simulation(errors: IssueCollector, config: Config) -> None:
    """Check the time grid and the true quantities of `simulation:`."""
    simulation: Any = config.simulation
    if simulation is None:
        return
    if (simulation.duration is None) != (simulation.rate is None):
        errors.add(("simulation",), "`duration:` and `rate:` belong together; give both or neither")
    elif simulation.duration is not None and simulation.duration * simulation.rate < 1:
        message = "the record would have only one sample; make it longer"
        errors.add(("simulation", "duration"), message)
    elif simulation.duration is not None:
        samples, channels = simulation.duration * simulation.rate, len(config.record.channels)
        errors.run(("simulation", "duration"), output_files.check_record, samples, channels)
    for name in simulation.quantities:
        if not errors.is_reported(("quantities", name)):
            location: Location = ("simulation", "quantities", name)
            errors.expect(location, name, config.quantities, "there is no such quantity")


def check_identify(errors: IssueCollector, config: Config, unknown: Sequence[str]) -> None:
    """Check the settings of `identify` against the `unknown` parameters."""
    settings = config.identify
    for k, name in enumerate(settings.of_interest):
        message = f"{name} is no unknown parameter"
        errors.expect(("identify", "of_interest", k), name, unknown, message)
    if settings.determined > settings.left_to_prior:
        above = f"{settings.determined:g} is above left_to_prior, {settings.left_to_prior:g}"
        errors.add(("identify", "determined"), f"{above}; exchange them")
