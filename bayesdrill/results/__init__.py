"""What stays on disk: the folder of a run, its chain, the ArviZ tree, its origin."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.late import late

if TYPE_CHECKING:
    from bayesdrill.results.run_folder import Folder as Folder

__getattr__ = late(
    __name__,
    {
        "Folder": "run_folder",
    },
)
