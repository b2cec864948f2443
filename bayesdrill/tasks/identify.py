"""Predict what a record can determine, before anything is sampled (`bayesdrill identify`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bayesdrill.analysis import plausibility
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.profile import Fitter, Profile, profile
from bayesdrill.analysis.identifiability.study import (
    IdentifiabilityStudy,
    StudyPoint,
    study_of,
    study_point,
)
from bayesdrill.analysis.latent_torque import is_approximate
from bayesdrill.analysis.suspicions import InputTiming, half_sample_shift
from bayesdrill.basics.arguments import check_arguments
from bayesdrill.basics.equality import Value
from bayesdrill.basics.errors import InputError, did_you_mean
from bayesdrill.basics.progress import Reporter
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.job import Job
from bayesdrill.inference.priors import flat_in_logs
from bayesdrill.output_files import IDENTIFY
from bayesdrill.report.doubts import describe_timing
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.sections.friction import friction_sentences
from bayesdrill.report.sections.identifiability import (
    describe_profiles,
    describe_study,
    describe_study_point,
    next_experiment,
    open_products,
    profile_figure,
    spectrum_figure,
    summarise_study,
)
from bayesdrill.report.sections.torque import approximation_note, stand_ins
from bayesdrill.sampling.mode_search import Mode
from bayesdrill.tasks import conclusions
from bayesdrill.tasks.text_folder import save_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALL = "all"
NO_UNKNOWN = "nothing to identify: all unknowns are of sensors, starts or noise, or may be negative"


@check_arguments
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Findings(Value):
    """Findings are the results of `case.identify()`; `print` shows them, and `save` writes them.

    Parameters
    ----------
    job : Job
        The config with its record.
    study : IdentifiabilityStudy
        Symmetries, bounds of standard deviations, identifiable products and remedies at `point`.
    profiles : tuple of Profile
        The profile likelihoods of the requested parameters, in SI.
    moment : InputTiming or None
        The shifts of unknowns if the inputs act half a sample later; None if they are not known.
    point : StudyPoint
        The point at which the sensitivities are evaluated.
    reasons : tuple of str
        The reasons why the results must not be believed.
    """

    job: Job
    study: IdentifiabilityStudy
    profiles: tuple[Profile, ...]
    moment: InputTiming | None
    point: StudyPoint
    reasons: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Return the whole text for the terminal."""
        parts = [describe_study_point(self.point, self.job.problem)]
        if self.point.description:
            parts += [describe_study(self.study, self.job.problem.model, self.reasons)]
            parts += describe_timing(self.moment)
            config = "CONFIG" if self.job.files.array_table else str(self.job.source.path)
            left_open = open_products(self.study, self.job.config.identify)
            parts.append(next_experiment(self.study.names, left_open, config))
        if self.profiles:
            parts.append(describe_profiles(self.shown, self.study, self.symbols))
        return "\n\n".join(filter(None, parts))

    @property
    def symbols(self) -> tuple[Symbol, ...]:
        """Return the symbols of all unknowns, in the units of the user."""
        return self.job.problem.units.symbols(self.job.problem.symbols)

    @property
    def shown(self) -> tuple[Profile, ...]:
        """Return the profiles in the units of the user."""
        units = self.job.problem.units
        return tuple(profile.in_unit(units.factor(profile.name)) for profile in self.profiles)

    def save(self, folder: str | Path, *, force: bool = False) -> str:
        """Save text and figures in a folder, which may also contain other results.

        Parameters
        ----------
        folder : str or path
            The folder, which is made if needed.
        force : bool
            Whether to replace text and figures of an earlier call.

        Returns
        -------
        str
            A line that names the files.

        Raises
        ------
        InputError
            If other files have these names, or if earlier results exist and `force` is false.
        """
        title = f"What {self.job.config.name} can determine"
        draw = self._drawn
        place = save_text(folder, IDENTIFY, self.job, title, self.text, draw, force=force)
        return f"{place}/ ({IDENTIFY.mark}, figures/)"

    def _drawn(self) -> dict[str, Figure]:
        """Return all figures by the stems of their files."""
        problem, width = self.job.problem, WIDTHS[self.job.config.output.size]
        symbols = {symbol.name: symbol for symbol in self.symbols}
        latex = {name: symbol.latex for name, symbol in symbols.items()}
        figures = {"spectrum": spectrum_figure(self.study, latex, width)}
        if self.profiles:
            priors = problem.posterior.space.priors
            logs = [name for name, prior in priors.items() if flat_in_logs(prior)]
            nominal = problem.units.values(problem.nominal)
            figures["profiles"] = profile_figure(self.shown, symbols, nominal, logs, width)
        return figures

    def __str__(self) -> str:
        return self.text


def identify(job: Job, best: Mode | None, profiled: Sequence[str], report: Reporter) -> Findings:
    """Study a job at the maximum `best`, or else its start; make profiles of `profiled` parameters.

    Raises `InputError` if no unknown can be studied, or if one of `profiled` is not such an unknown.
    """
    posterior = job.problem.posterior
    sensitivities = SensitivityStudy(posterior.likelihood)
    if not sensitivities.unknowns:
        raise InputError.at("parameters", NO_UNKNOWN)
    columns = _columns(sensitivities.unknowns, profiled)
    report.update(0.0, "computing what the record can determine")
    if best is None:
        point = study_point(sensitivities, posterior, job.config.seed)
    else:
        point = StudyPoint(theta=posterior.space.vector(best.values), description="the MAP")
    theta = point.theta
    asked = job.config.identify, job.config.seed, point.description
    study = study_of(sensitivities, posterior, theta, *asked, seek_remedies=True)
    profiles = []
    if columns:
        fitter = Fitter(posterior, sensitivities, theta)
        for done, column in enumerate(columns):
            report.update(done / len(columns), f"profile of {sensitivities.unknowns[column]}")
            profiles.append(profile(fitter, sensitivities.unknowns, column))
    report.update(1.0, "")
    timing = half_sample_shift(sensitivities, theta)
    reasons = () if best is None else conclusions.doubts(job, best, study)
    return Findings(
        job=job, study=study, profiles=tuple(profiles), moment=timing, point=point, reasons=reasons
    )


def preflight(job: Job, sensitivities: SensitivityStudy) -> str:
    """Describe in a few lines what the record can determine, at a point where the rig moves."""
    if not sensitivities.unknowns:
        return NO_UNKNOWN
    posterior = job.problem.posterior
    point, rig = study_point(sensitivities, posterior, job.config.seed), job.problem.model
    at_rest = describe_study_point(point, job.problem)
    if not point.description:
        return at_rest
    asked = job.config.identify, job.config.seed, point.description
    study = study_of(sensitivities, posterior, point.theta, *asked)
    lines = [at_rest, summarise_study(study), friction_sentences(study.frictions, rig)]
    lines += [stand_ins(study, rig)]
    lines += [approximation_note(rig)] if is_approximate(posterior) else []
    timing = describe_timing(half_sample_shift(sensitivities, point.theta))
    course = finding_sentences(plausibility.plausibility_of_course(sensitivities, point.theta))
    return "\n".join([*filter(None, lines), *timing, *course])


def _columns(unknowns: tuple[str, ...], profiled: Sequence[str]) -> list[int]:
    if ALL in profiled:
        return list(range(len(unknowns)))
    for name in profiled:
        if name not in unknowns:
            hint = did_you_mean(name, [*unknowns, ALL])
            raise InputError.at("--profile", f"{name} is not an unknown of this config{hint}")
    return [unknowns.index(name) for name in profiled]
