"""Load what workers search, walk and draw with; only the server of `basics.processes` imports this."""

import importlib
import sys

# The package corner works without ArviZ, which takes longer to load than all others together.
sys.modules.setdefault("arviz", None)  # type: ignore[arg-type]
for _name in (
    "scipy.linalg",
    "scipy.optimize",
    "emcee",
    "matplotlib.backends.backend_agg",
    "corner",
    "bayesdrill.report.publish",
):
    importlib.import_module(_name)
