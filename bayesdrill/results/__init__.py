"""Store results on disk: the folder of a run with its chain, the ArviZ tree, and the provenance.

`output_files` defines which files may be written, and how. `report` makes tables and figures.
"""

from __future__ import annotations

from bayesdrill.results.run_folder import Folder as Folder
