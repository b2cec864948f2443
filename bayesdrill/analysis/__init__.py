"""Interpret a posterior: identifiability, verdict, causes of a bad fit, comparison, calibration.

Modules take a `Problem` and draws, and return dataclasses of numbers. The package `report` turns
these into sentences, tables and figures.
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
