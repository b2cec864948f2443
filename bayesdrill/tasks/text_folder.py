"""Save the printed text and the figures of a command in a folder (`identify`, `design`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from bayesdrill import output_files
from bayesdrill.config.job import Job
from bayesdrill.config.records import sources
from bayesdrill.output_files import FIGURES, Kind

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NO_TEXTS: Mapping[str, str] = MappingProxyType({})


def save_text(
    folder: str | Path,
    kind: Kind,
    job: Job,
    title: str,
    text: str,
    draw: Callable[[], Mapping[str, Figure]],
    others: Mapping[str, str] = NO_TEXTS,
    *,
    force: bool,
) -> Path:
    """Save a text, the figures that `draw` makes, and the texts `others` by their file names.

    Returns the folder.  Raises `InputError` if a file of the record or of another kind would be
    replaced or, without `force`, a file of the same kind.  An interrupted call leaves no files.
    """
    from bayesdrill.report import style  # imported late, as matplotlib takes a second to load

    place, output = Path(folder).expanduser(), job.config.output
    output_files.refuse_other_text(place, kind, force=force)
    replaced = [place / name for name in output_files.output_names(place, kind)]
    output_files.refuse_replacing(sources.files(job.case), replaced)
    figures, formats = draw(), output.formats_or_default
    ending = output_files.preferred_format(formats)
    shown = "" if ending == "pdf" else "!"  # Markdown pages cannot show a PDF
    pictures = "\n\n".join(f"{shown}[{name}]({FIGURES}/{name}.{ending})" for name in figures)
    mark = output_files.text_mark(kind)
    page = f"{mark}\n# {title}\n\n```text\n{text}\n```\n\n{pictures}\n"
    with output_files.renewed(place, kind), _all_or_none(place, kind):
        (place / FIGURES).mkdir(parents=True, exist_ok=True)
        for name, content in {kind.mark: page, **others}.items():
            output_files.write_text(place / name, content)
        for name, figure in figures.items():
            note = {"Title": job.config.name}
            style.save(figure, place / FIGURES, name, note, formats=formats, dpi=output.dpi)
    return place


@contextmanager
def _all_or_none(folder: Path, kind: Kind) -> Iterator[None]:
    """Remove the files of a kind, and folders that are then empty, if the block fails."""
    try:
        yield
    except BaseException:
        output_files.remove_outputs(folder, kind)
        (folder / kind.mark).unlink(missing_ok=True)
        with suppress(OSError):  # the folder contains other files
            folder.rmdir()
        raise
