"""What to believe: identifiability, verdict, physics, what follows, calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.late import late

if TYPE_CHECKING:
    from bayesdrill.insight.diagnostics import HDI_PROBABILITY as HDI_PROBABILITY
    from bayesdrill.insight.diagnostics import hdi as hdi
    from bayesdrill.insight.identifiability.information import (
        from_sensitivities as from_sensitivities,
    )
    from bayesdrill.insight.identifiability.scenes import Scenery as Scenery
    from bayesdrill.insight.identifiability.structure import Exponents as Exponents
    from bayesdrill.insight.identifiability.study import study_of as study_of
    from bayesdrill.insight.verdict import Verdict as Verdict

__getattr__ = late(
    __name__,
    {
        "Exponents": "identifiability.structure",
        "HDI_PROBABILITY": "diagnostics",
        "Scenery": "identifiability.scenes",
        "Verdict": "verdict",
        "from_sensitivities": "identifiability.information",
        "hdi": "diagnostics",
        "study_of": "identifiability.study",
    },
)
