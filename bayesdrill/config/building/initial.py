"""Build the initial state: given, steady, or free with priors from the record."""

from __future__ import annotations

from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.building.parsed_numbers import to_si
from bayesdrill.config.schema import numbers
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import IssueCollector
from bayesdrill.rig.models.linear import Model


def check_initial(errors: IssueCollector, config: Config, model: Model) -> dict[str, float]:
    """Return the fixed initial states in SI; for a steady start, only the named states."""
    initial, states = config.initial, {}
    for name in model.outer:
        value, unit = initial.get(name), model.symbols[name].unit
        silent = initial.state == "steady" and name not in initial.model_fields_set
        if isinstance(value, float | int | numbers.Quantity) and not silent:
            states[name] = errors.run(("initial", name, "unit"), to_si, value, unit)
    for motor in model.roles.motors:
        name, known = motor.current, (*model.states, *model.inputs)
        if name not in known and initial.get(name) not in (None, 0):  # a resolved config has 0
            message = f"without {motor.inductance} the current has no start of its own"
            errors.add(("initial", name), f"{message}; remove this entry")
    if initial.state == "steady":
        _check_steady(errors, config, model)
    return {name: value for name, value in states.items() if value is not None}


def state_name(state: str) -> str:
    """Return the name of the initial value of a state."""
    return f"{state}_0"


def symbol_of_state(model: Model, name: str) -> Symbol:
    """Return the symbol of the initial value of a state."""
    state = model.symbols[name]
    latex, about = rf"{state.latex}(0)", f"{name} at the start"
    return Symbol(state_name(name), state.unit, latex, state.latex_unit, about)


def free_states(config: Config, model: Model) -> tuple[str, ...]:
    """Return the states whose initial values have priors from the record, except imposed angles."""
    initial, angles = config.initial, config.vocabulary.imposed.values()
    imposed = [angle for angle in angles if config.inputs.get(angle) is not None]
    silent = {*model.outer} - initial.model_fields_set if initial.state == "free" else set()
    free = [name for name in model.outer if initial.get(name) == "free" or name in silent]
    return tuple(name for name in free if name not in imposed)


def _check_steady(errors: IssueCollector, config: Config, model: Model) -> None:
    """Check a steady start: the inputs determine all states except one free angle."""
    if not model.smooth:
        how = "with dry friction" if model.frictions else "that swings"
        how = how if model.frictions or model.gravities else "that may saturate"
        where = f"the steady state of a rig {how} is not computed"
        errors.add(("initial",), f"{where}; write `initial: free`, or the states at the start")
        return
    named = [name for name in model.states if name in config.initial.model_fields_set]
    angles = [name for name in named if name in model.angles]
    for name in named:
        if name not in angles:
            message = "the steady state gives it; remove this entry, or `state: steady`"
            errors.add(("initial", name), message)
    for name in angles[1:]:
        both = f"the steady state gives the twist, and {angles[0]} all other angles"
        errors.add(("initial", name), f"{both}; remove one of the two")
