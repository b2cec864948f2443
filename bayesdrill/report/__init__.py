"""What people look at: tables, sentences and figures of results that stand."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.late import late

if TYPE_CHECKING:
    from bayesdrill.report.fit_plot import LINE as LINE
    from bayesdrill.report.fit_plot import extremes as extremes
    from bayesdrill.report.fitted import TIME as TIME
    from bayesdrill.report.html import as_html as as_html
    from bayesdrill.report.identify_words import product as product
    from bayesdrill.report.log_axes import set_decades as set_decades
    from bayesdrill.report.log_axes import set_factors as set_factors
    from bayesdrill.report.log_axes import usable as usable
    from bayesdrill.report.pages import Page as Page
    from bayesdrill.report.provenance_words import made_of as made_of
    from bayesdrill.report.publish import draw as draw
    from bayesdrill.report.schematics import heuristic_figure as heuristic_figure
    from bayesdrill.report.schematics import rig_figure as rig_figure
    from bayesdrill.report.sections import Note as Note
    from bayesdrill.report.sections import Picture as Picture
    from bayesdrill.report.sections import Section as Section
    from bayesdrill.report.sections import Sentences as Sentences
    from bayesdrill.report.sections import Table as Table
    from bayesdrill.report.sections import as_markdown as as_markdown
    from bayesdrill.report.sections import markdown as markdown
    from bayesdrill.report.tables import records_as_csv as records_as_csv
    from bayesdrill.report.view import Drawing as Drawing
    from bayesdrill.report.view import View as View

__getattr__ = late(
    __name__,
    {
        "Drawing": "view",
        "LINE": "fit_plot",
        "Note": "sections",
        "Page": "pages",
        "Picture": "sections",
        "Section": "sections",
        "Sentences": "sections",
        "TIME": "fitted",
        "Table": "sections",
        "View": "view",
        "as_html": "html",
        "as_markdown": "sections",
        "draw": "publish",
        "extremes": "fit_plot",
        "heuristic_figure": "schematics",
        "made_of": "provenance_words",
        "markdown": "sections",
        "product": "identify_words",
        "records_as_csv": "tables",
        "rig_figure": "schematics",
        "set_decades": "log_axes",
        "set_factors": "log_axes",
        "usable": "log_axes",
    },
)
