"""Say what to believe of a posterior.

Identifiability, verdict, causes of a bad fit, physics, comparison, and calibration.

All of it looks at a `Problem` and at draws, and says it in numbers. Sentences, tables and figures
of it are in `report`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes

if TYPE_CHECKING:
    from bayesdrill.analysis.identifiability.information import SensitivityStudy as SensitivityStudy
    from bayesdrill.analysis.identifiability.information import (
        from_sensitivities as from_sensitivities,
    )
    from bayesdrill.analysis.identifiability.structure import Exponents as Exponents
    from bayesdrill.analysis.identifiability.study import study_of as study_of
    from bayesdrill.analysis.verdict import Verdict as Verdict

__getattr__ = lazy_attributes(__name__)
