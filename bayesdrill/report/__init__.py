"""Show results: tables, sentences and figures of runs that are finished.

`section` and `render` build pages; all figures share `style`, `scales` and `pages`. `sections/` has
a module for each section of a report: its sentences, tables and figures. No module computes results.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes

if TYPE_CHECKING:
    from bayesdrill.report.canvas import HOLLOW as HOLLOW
    from bayesdrill.report.canvas import SMALL as SMALL
    from bayesdrill.report.canvas import SOLID as SOLID
    from bayesdrill.report.canvas import Canvas as Canvas
    from bayesdrill.report.pages import build_page as build_page
    from bayesdrill.report.pages import legend_above as legend_above
    from bayesdrill.report.publish import draw as draw
    from bayesdrill.report.render import as_html as as_html
    from bayesdrill.report.rig_drawing import rig_figure as rig_figure
    from bayesdrill.report.run_report import made_of as made_of
    from bayesdrill.report.scales import TIME as TIME
    from bayesdrill.report.section import Note as Note
    from bayesdrill.report.section import Picture as Picture
    from bayesdrill.report.section import Section as Section
    from bayesdrill.report.section import Sentences as Sentences
    from bayesdrill.report.section import Table as Table
    from bayesdrill.report.section import as_markdown as as_markdown
    from bayesdrill.report.section import lines_as_csv as lines_as_csv
    from bayesdrill.report.section import markdown as markdown
    from bayesdrill.report.sections.fit import Fit as Fit
    from bayesdrill.report.sections.fit import every_fit as every_fit
    from bayesdrill.report.sections.fit import fit_figure as fit_figure
    from bayesdrill.report.sections.identifiability import product as product
    from bayesdrill.report.view import Drawing as Drawing
    from bayesdrill.report.view import ReportContext as ReportContext

__getattr__ = lazy_attributes(__name__)
