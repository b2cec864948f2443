"""A config becomes objects, or every mistake of it at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.late import late

if TYPE_CHECKING:
    from bayesdrill.setup.config import Config as Config
    from bayesdrill.setup.job import Job as Job
    from bayesdrill.setup.yaml_source import Source as Source

__getattr__ = late(
    __name__,
    {
        "Config": "config",
        "Job": "job",
        "Source": "yaml_source",
    },
)
