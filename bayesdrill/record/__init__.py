"""What was measured: files of every format, and the experiment that they make."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.late import late

if TYPE_CHECKING:
    from bayesdrill.record.experiment import Experiment as Experiment
    from bayesdrill.record.experiment import regular as regular
    from bayesdrill.record.experiment import usual_inputs as usual_inputs
    from bayesdrill.record.formats import Format as Format
    from bayesdrill.record.formats import Table as Table
    from bayesdrill.record.formats import Wanted as Wanted

__getattr__ = late(
    __name__,
    {
        "Experiment": "experiment",
        "Format": "formats",
        "Table": "formats",
        "Wanted": "formats",
        "regular": "experiment",
        "usual_inputs": "experiment",
    },
)
