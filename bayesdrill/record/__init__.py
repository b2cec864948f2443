"""Read records: files of every format (`formats/`) become one `Experiment` in SI.

`clocks` handles times, and `anomalies` finds errors of sensors. Nothing here depends on
a rig, an unknown or a config.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes

if TYPE_CHECKING:
    from bayesdrill.record.experiment import Experiment as Experiment
    from bayesdrill.record.experiment import typical_inputs as typical_inputs
    from bayesdrill.record.formats import Format as Format
    from bayesdrill.record.formats import Wanted as Wanted
    from bayesdrill.record.formats.table import RecordTable as RecordTable

__getattr__ = lazy_attributes(__name__)
