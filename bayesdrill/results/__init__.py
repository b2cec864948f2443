"""What stays on disk: the folder of a run with its chain, the ArviZ tree, and where it comes from.

What may be written at all, and how, is in `output_files`. Tables and figures are made in
`report`.
"""

from __future__ import annotations

from bayesdrill.results.run_folder import Folder as Folder
