"""Several runs side by side, for readers: a table, what differs between them, and a warning for each."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

from bayesdrill.insight.diagnostics import HDI_PROBABILITY
from bayesdrill.insight.overlay import Layer, Place, Row, differing
from bayesdrill.report.overlay_shown import shown
from bayesdrill.report.sections import Note, Picture, Section, Sentences, Table
from bayesdrill.setup.own_units import OwnUnits

LONGEST = 60  # letters of a setting
SAID = 3  # unknowns that are farthest apart
FAR = 0.5  # sds, below which nothing is said of it
APART = "apart [sd]"
READ = (
    "Mean and sd of each run, in the unit in which the first of them says it. "
    f"`{APART}` is the largest difference of two means over the root mean "
    "square of their sds: by chance two independent records of one rig are more than 2.8 apart once in "
    "twenty times; runs of one record differ by what was believed, held and modelled."
)
COLUMNS = (
    *("name", "unit", "run", "nominal", "mean", "sd"),
    *(f"hdi{100 * HDI_PROBABILITY:.0f}_{end}" for end in ("low", "high")),
    *("held", "apart"),
)


def sections(
    layers: Sequence[Layer],
    rows: Sequence[Row],
    own: OwnUnits,
    pictures: Sequence[Picture] = (),
) -> tuple[Section, ...]:
    """In the order in which they are read; `rows` in SI."""
    drawn = (Section("Figures", tuple(pictures), brief=False),) if pictures else ()
    differs = differing(layers)
    doubts = [doubt(layer) for layer in layers if layer.warning]
    first = Sentences("\n".join([f"{len(layers)} runs: {_names(layers)}", *doubts]))
    said = Sentences("\n".join([*farthest(layers, rows), _what_differs(layers, differs)]))
    return (
        Section("", (first,)),
        Section("", (table(layers, [shown(row, own) for row in rows]), Note(READ), said)),
        *drawn,
        Section("What differs between the runs", (settings(layers, differs),), brief=False),
    )


def as_csv(layers: Sequence[Layer], rows: Sequence[Row]) -> str:
    """A line for each unknown and run that has it, SI, all digits; `apart` is of all runs."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        for layer, place, nominal in zip(layers, row.places, row.nominal, strict=True):
            if place is not None:
                sd = (place.sd, place.low, place.high)
                numbers = (nominal, place.mean, *((None,) * 3 if place.held else sd))
                last = ("yes" if place.held else "no", row.apart)
                values = (row.symbol.name, row.symbol.unit, layer.name, *numbers, *last)
                writer.writerow(["" if value is None else value for value in values])
    return out.getvalue()


def _names(layers: Sequence[Layer]) -> str:
    return ", ".join(layer.name for layer in layers)


def doubt(layer: Layer) -> str:
    """What its figures carry, and why it must not be believed."""
    because = "".join(f"\n  - {reason}" for reason in layer.reasons)
    return f"{layer.name}: {layer.warning}{because}"


def table(layers: Sequence[Layer], rows: Sequence[Row]) -> Table:
    heads = ("", "unit", "nominal", *(layer.name for layer in layers), APART)
    lines = []
    for row in rows:
        known = [value for value in row.nominal if value is not None]
        nominal = "" if not known else "differs" if row.agreed is None else f"{row.agreed:.4g}"
        apart = "" if row.apart is None else f"{row.apart:.2f}"
        if row.pair is not None and len(layers) > 2:
            apart += f" ({', '.join(layers[k].name for k in row.pair)})"
        cells = map(_cell, row.places)
        lines.append((row.symbol.name, row.symbol.plain_unit, nominal, *cells, apart))
    return Table(heads, tuple(lines), frozenset(heads[:2])).filled("nominal", APART)


def _cell(place: Place | None) -> str:
    if place is None:
        return ""
    if place.held:
        return f"{place.mean:.4g} held"
    return f"{place.mean:.4g} \N{PLUS-MINUS SIGN} {place.sd:.2g}"


def farthest(layers: Sequence[Layer], rows: Sequence[Row]) -> Iterator[str]:
    found = [(row.apart, row) for row in rows if row.apart is not None]
    if not found:
        yield "no unknown is shared by two of the runs"
        return
    ordered = sorted(found, key=lambda one: -one[0])
    far = [(apart, row) for apart, row in ordered if apart >= FAR]
    if not far:
        yield f"nowhere are two of them more than {ordered[0][0]:.2g} sd apart"
    for apart, row in far[:SAID]:
        assert row.pair is not None
        one, other = (layers[k].name for k in row.pair)
        yield f"{row.symbol.name}: {one} and {other} are {apart:.2g} sd apart"


def _what_differs(layers: Sequence[Layer], differs: dict[str, tuple[str | None, ...]]) -> str:
    unknown = {name for layer in layers for name in _quantities(layer)}
    believed = [name for name in differs if name in unknown]
    others = dict.fromkeys(_kind(name) for name in differs if name not in unknown)
    listed = [*([f"what is believed of {', '.join(believed)}"] if believed else []), *others]
    if not listed:
        return "record, noise, priors and seed are the same"
    return f"not the same: {'; '.join(listed)}"


def _kind(setting: str) -> str:
    """All channels, and the noise of all of them, in one word."""
    kinds = {"the channel ": "the channels", "the noise of ": "the noise"}
    return next((kind for start, kind in kinds.items() if setting.startswith(start)), setting)


def _quantities(layer: Layer) -> set[str]:
    space = layer.problem.posterior.space
    return {*space.free, *space.fixed, *space.relations}


def settings(layers: Sequence[Layer], differs: dict[str, tuple[str | None, ...]]) -> Table | Note:
    if not differs:
        return Note("nothing")
    heads = ("", *(layer.name for layer in layers))
    lines = [(name, *(_short(value) for value in values)) for name, values in differs.items()]
    return Table(heads, tuple(lines), frozenset(heads))


def _short(value: str | None) -> str:
    return elided(value or "", LONGEST)


def elided(text: str, most: int) -> str:
    """Without letters of its middle, where it has more than so many: names differ at their ends."""
    left = most - 3
    return text if len(text) <= most else f"{text[: left // 2]}...{text[-(left - left // 2) :]}"


def warned(layer: Layer) -> str:
    """Its name, for legends, with what it must be doubted for."""
    return f"{layer.name} ({layer.warning})" if layer.warning else layer.name
