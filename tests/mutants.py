"""Break the code in named ways, one line at a time, and see a named test fail.

`make mutants` works on a copy of the tree; a mutant that survives is an error.  Words after
`python tests/mutants.py` choose those that have one of them in name, file or killer.  A mutant whose
line is no longer in the code is an error too, so that this list cannot rot.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PARTS = ("bayesdrill", "benchmarks", "configs", "docs", "tests", "pyproject.toml", "README.md")


@dataclass(frozen=True)
class Mutant:
    name: str
    file: str
    old: str
    new: str
    killer: str  # the test that must fail


MUTANTS = [
    Mutant(
        "a missing torque on the wrong side of the gear",
        "rig/missing_torque.py",
        'return linear.A[row, "i"] / p["k_T"]',
        'return 8 * linear.A[row, "i"] / p["k_T"]',
        "tests/rig/test_missing_torque.py::test_the_likelihood_is_that_of_all_samples_together",
    ),
    Mutant(
        "a missing torque that begins at nothing",
        "rig/kernels/steadily.py",
        "m.put(1.0, start, i * n + i)",
        "m.put(0.0, start, i * n + i)",
        "tests/rig/test_missing_torque.py::test_the_likelihood_is_that_of_all_samples_together",
    ),
    Mutant(
        "a gain that has settled after a few samples",
        "rig/kernels/settling.py",
        "LEAST, MOST = 7, 44",
        "LEAST, MOST = 2, 3",
        "tests/rig/test_missing_torque.py::test_one_gain_is_as_good_as_all_of_them",
    ),
    Mutant(
        "a missing torque whose covariance no parameter moves",
        "inference/noise/shaken.py",
        "if self.pinned is not None:\n            found[..., :count] = 0.0",
        "if True:\n            found[..., :count] = 0.0",
        "tests/inference/test_shaken.py::test_slopes_are_those_of_differences",
    ),
    Mutant(
        "a missing torque beside friction",
        "setup/missing_torque.py",
        "    if rubbing:",
        "    if False:",
        "tests/setup/test_missing_torque.py::test_what_cannot_be_is_said_with_a_way_out",
    ),
    Mutant(
        "an imposed angle for its speed",
        "record/angles.py",
        "speeds = np.diff(x) / np.diff(t)",
        "speeds = x[:-1]",
        "tests/rig/test_driven_shaft.py::"
        "test_an_angle_straight_between_samples_is_a_speed_that_is_held",
    ),
    Mutant(
        "an imposed angle that begins at zero",
        "setup/reading.py",
        "begin[entry] = float(np.interp(t[0], clock, values))",
        "begin[entry] = 0.0",
        "tests/setup/test_inputs.py::test_an_imposed_angle_is_its_speed_between_samples",
    ),
    Mutant(
        "the lag of one input for the delay of all",
        "setup/sensors.py",
        'late = one.kind == "lag" and alone',
        'late = one.kind == "lag"',
        "tests/setup/test_inputs.py::test_one_measured_input_has_the_delay_of_all",
    ),
    Mutant(
        "samples that an input moved after the end of the record",
        "setup/beginning.py",
        "& (first < 0.0)",
        "& (first > 0.0)",
        "tests/setup/test_inputs.py::test_what_no_record_tells_of_a_late_input_is_left_out",
    ),
    Mutant(
        "an input that the model has not, taken without a word",
        "setup/consistency/inputs.py",
        "if entry not in entries:",
        "if not entries:",
        "tests/setup/test_inputs.py::test_a_mistake_is_told_at_its_entry[a voltage]",
    ),
    Mutant(
        "the damping of the shaft against rotor 1 alone",
        "rig/models/driven_shaft.py",
        'b["w_1", "w_2"] = -p["c_s"] / j_1, p["c_s"] / j_1',
        'b["w_1", "w_2"] = -p["c_s"] / j_1, 0.0 / j_1',
        "tests/rig/test_driven_shaft.py::"
        "test_measured_speed_and_torque_move_it_as_the_equations_do",
    ),
    Mutant(
        "the torque of rock without the weight on the bit",
        "rig/models/friction.py",
        "return seen[self.weight] * p[self.factor] * (rising + hump)",
        "return 500.0 * p[self.factor] * (rising + hump)",
        "tests/rig/test_driven_shaft.py::test_rock_holds_the_bit_as_its_law_and_the_weight_say",
    ),
    Mutant(
        "the torque of a motor not seen through the gear",
        "rig/models/motor.py",
        'b["w_2", "t_m"] = i_m / j_m',
        'b["w_2", "t_m"] = 1.0 / j_m',
        "tests/rig/test_motor.py::test_a_torque_brings_it_to_speed_as_an_exponential",
    ),
    Mutant(
        "the gear of a motor twice in its current",
        "rig/models/motor.py",
        '-p["k_e"] / (i_m * l_m)',
        '-p["k_e"] / (i_m**2 * l_m)',
        "tests/rig/test_motor.py::test_a_voltage_drives_it_through_its_circuit",
    ),
    Mutant(
        "the inertia of the shaft whole at each of its ends",
        "rig/models/long_shaft.py",
        'half = p["j_s"] / (2.0 * self.elements)',
        'half = p["j_s"] / self.elements',
        "tests/rig/test_long_shaft.py::"
        "test_pieces_come_to_the_wave_equation_as_their_number_squared",
    ),
    Mutant(
        "nodes of a shaft as if its ends stood still",
        "rig/models/long_shaft.py",
        "within[of] = within.get(of, 0.0) - share * value",
        "within[of] = within.get(of, 0.0)",
        "tests/rig/test_long_shaft.py::test_it_moves_as_its_pieces_do",
    ),
    Mutant(
        "the least damped pair of poles, however fast",
        "insight/derived.py",
        "seen = swings & (size <= _FAST * slowest)",
        "seen = swings",
        "tests/insight/test_derived_of_others.py::"
        "test_the_swing_of_a_long_shaft_is_not_one_within_it",
    ),
    Mutant(
        "the time of a motor without a circuit for that of a current",
        "insight/derived.py",
        "[:, 0] if current else _none(n)",
        "[:, 0]",
        "tests/insight/test_derived_of_others.py::"
        "test_a_motor_has_the_times_of_what_it_consists_of",
    ),
    Mutant(
        "the mean of what drives a rig both ways",
        "record/experiment.py",
        "if name in DRIVES else np.mean(series)",
        'if name == "v" else np.mean(series)',
        "tests/insight/test_derived_of_others.py::test_what_drives_a_rig_is_usual_by_its_size",
    ),
    Mutant(
        "inputs that are never late",
        "insight/candidates.py",
        "for name in every[1:]:",
        "for name in every[2:]:",
        "tests/insight/test_late_inputs.py::test_a_late_torque_is_named_with_the_line_of_a_config",
    ),
    Mutant(
        "what explains as much is kept to itself",
        "insight/causes.py",
        "return dataclasses.replace(best, other=other) if alike else best",
        "return best",
        "tests/insight/test_lacking.py::test_where_both_would_do_both_are_said",
    ),
    Mutant(
        "a table that is tried with physics is free to change",
        "insight/instead.py",
        "fixed[[*held, *range(m, m + len(wide.every))]] = True",
        "fixed[[*range(m, m + len(wide.every))]] = True",
        "tests/insight/test_lacking.py::test_a_table_is_right_with_what_is_missing",
    ),
    Mutant(
        "an experiment instead of one more",
        "insight/identifiability/frictions.py",
        "return np.vstack([self.rows, self.scenery.every(self.theta, scene)])",
        "return self.scenery.every(self.theta, scene)",
        "tests/insight/test_told_apart.py::test_what_is_proposed_does_what_is_said",
    ),
    Mutant(
        "what is known is never worse than what it is like",
        "insight/identifiability/frictions.py",
        "if alone < KNOWN or fall < ALIKE:",
        "if fall < ALIKE:",
        "tests/insight/test_told_apart.py::test_two_levels_and_both_ways_tell_it",
    ),
    Mutant(
        "a supply that is felt as it is recorded",
        "rig/stepped.py",
        "felt[name] = gain * u + told(sensing.input_offsets, name, 0.0)[:, None]",
        "felt[name] = u",
        "tests/rig/test_energy.py::test_without_friction_it_closes_to_rounding",
    ),
    Mutant(
        "the motor weighed as rotor 1",
        "rig/energy.py",
        '"w_2": j_1 * linear.A["w_1", "theta_2"] / linear.A["w_2", "theta_1"],',
        '"w_2": j_1,',
        "tests/rig/test_energy.py::test_each_part_is_the_integral_of_its_power",
    ),
    Mutant(
        "what sticks taken to move",
        "rig/energy.py",
        "still[:-1, e] = zero[:-1] & zero[1:]",
        "still[:-1, e] = False",
        "tests/rig/test_energy.py::test_what_is_held_takes_nothing",
    ),
    Mutant(
        "a friction at the speed of the shaft",
        "insight/rubbing.py",
        "return Curve(speeds=speeds * rubbing.gear, sizes=np.asarray(signed))",
        "return Curve(speeds=speeds, sizes=np.asarray(signed))",
        "tests/report/test_rubbing.py::"
        "test_a_law_is_drawn_at_the_speeds_of_the_motor_with_map_and_nominal_values",
    ),
    Mutant(
        "a passing zero taken for sticking",
        "insight/rubbing.py",
        "sticks=np.append(still[:-1] & still[1:], False),",
        "sticks=np.append(np.abs(speed[1:]) < 1.0, False),",
        "tests/report/test_rubbing.py::"
        "test_the_fit_shows_frictions_with_their_bands_and_where_they_stick",
    ),
    Mutant(
        "a late input moves the unknowns the other way",
        "insight/moments.py",
        "moved = np.linalg.lstsq(",
        "moved = -np.linalg.lstsq(",
        "tests/insight/test_nuisances.py::test_half_a_sample_moves_what_a_late_step_moves",
    ),
    Mutant(
        "experiments weighed by their sds",
        "insight/repeats.py",
        "weights = np.array(x), 1.0 / np.array(sds) ** 2",
        "weights = np.array(x), 1.0 / np.array(sds)",
        "tests/insight/test_repeats.py::test_one_rig_tells_the_same_each_time",
    ),
    Mutant(
        "a table in the unit of a user with the numbers of SI",
        "setup/own_units.py",
        "values = {key: x / own.factor for",
        "values = {key: x / 1.0 for",
        "tests/report/test_own_units.py::test_tables_show_what_was_found_over_the_unit_of_the_user",
    ),
    Mutant(
        "several runs in the units of the last",
        "setup/own_units.py",
        "{**others.units, **self.units}",
        "{**self.units, **others.units}",
        "tests/report/test_own_units.py::test_runs_are_shown_in_the_units_of_the_first_and_saved_in_si",
    ),
    Mutant(
        "a unit that cannot be typeset keeps its factor",
        "basics/units.py",
        "    except ValueError:\n        return usual",
        "    except ValueError:\n        return Unit(inside, times, usual.latex)",
        "tests/report/test_own_units.py::test_a_unit_that_formulas_do_not_have_is_shown_in_si",
    ),
    Mutant(
        "a start of sigma taken for SI",
        "setup/build.py",
        "return prior(rescaled(spec.sigma, factor), 1.0), begin * factor",
        "return prior(rescaled(spec.sigma, factor), 1.0), begin",
        "tests/report/test_own_units.py::test_beliefs_in_users_units_are_those_in_si",
    ),
    Mutant(
        "a prior in a user's unit told in numbers of SI",
        "inference/priors.py",
        "getattr(si, name) / self.factor for",
        "getattr(si, name) for",
        "tests/report/test_own_units.py::test_every_prior_of_a_sigma_is_in_the_unit_of_its_column_and_said_so",
    ),
    Mutant(
        "inputs without a unit in the tree",
        "results/arviz_tree.py",
        "values.attrs.update(units=symbol.unit, long_name",
        "values.attrs.update(long_name",
        "tests/report/test_own_units.py::test_every_variable_of_the_tree_has_a_unit",
    ),
    Mutant(
        "an overlay on plain axes",
        "report/overlay_shown.py",
        "return flat_in_logs(next(found, None))",
        "return False",
        "tests/report/test_own_units.py::test_axes_of_several_runs_have_the_unit_and_the_logs_of_the_first",
    ),
    Mutant(
        "even times moved to a grid",
        "record/clocks.py",
        "found = None if even(t) else grid(t)",
        "found = grid(t)",
        "tests/record/test_clocks.py::test_even_times_stay_as_they_are",
    ),
    Mutant(
        "an input that answers one sample late",
        "record/clocks.py",
        'last = np.searchsorted(clock, t + slack, side="right") - 1',
        'last = np.searchsorted(clock, t - slack, side="left") - 1',
        "tests/record/test_clocks.py::test_inputs_are_held_exactly_between_samples_of_their_own",
    ),
    Mutant(
        "spikes to one side only",
        "record/glitches.py",
        "for sign in (1.0, -1.0):",
        "for sign in (1.0,):",
        "tests/record/test_glitches.py::test_spikes_are_found_where_they_were_put",
    ),
    Mutant(
        "a departure that need not come back as fast",
        "record/glitches.py",
        "and 1 / AS_FAST < down / up < AS_FAST",
        "and down > 0",
        "tests/record/test_glitches.py::test_sound_signals_have_none",
    ),
    Mutant(
        "the slope of a steady start without the angle that is held",
        "rig/walkers.py",
        "held=dict.fromkeys(self.experiment.start, 0.0)",
        "held={}",
        "tests/rig/test_measured.py::test_slopes_of_a_steady_start_leave_a_held_angle_where_it_is",
    ),
    Mutant(
        "a mistake of an experiment placed as if it were alone",
        "setup/yaml_source.py",
        "stands = (*self.moved.get(known, known), *place[len(known) :])",
        "stands = place",
        "tests/setup/test_experiments.py::test_mistakes_of_all_experiments_are_told_at_once",
    ),
    Mutant(
        "what is shared taken for each experiment's own",
        "setup/experiments.py",
        "return name if name in config.shared else of_label(name, label)",
        "return of_label(name, label)",
        "tests/setup/test_experiments.py::test_names_say_whose_an_unknown_is",
    ),
    Mutant(
        "a lag from zero on counted in logs",
        "inference/unknowns.py",
        "return self.between is not None or signed(self.prior) or small",
        "return self.between is not None or signed(self.prior)",
        "tests/inference/test_joint.py::test_what_may_be_next_to_nothing_has_no_logarithmic_scale",
    ),
    Mutant(
        "sensors left in the information of the rig",
        "insight/identifiability/scenes.py",
        "return without(self._with_priors(rows, m), m)",
        "return rows[:, :m]",
        "tests/inference/test_joint.py::test_the_rig_without_its_sensors_is_a_schur_complement",
    ),
    Mutant(
        "refits that see what was measured",
        "commands/calibrate.py",
        "return Job(config=config, source=source, problem=_blank(problem))",
        "return Job(config=config, source=source, problem=problem)",
        "tests/system/test_experiments.py::test_refits_of_free_states_have_the_priors_of_the_run",
    ),
    Mutant(
        "the same noise in each simulated experiment",
        "setup/simulating.py",
        'seeds.stream(seed, "record", index)',
        'seeds.stream(seed, "record")',
        "tests/system/test_experiments.py::"
        "test_simulated_noise_differs_between_experiments_and_truth_is_what_is_said",
    ),
    Mutant(
        "a derived channel that counts",
        "setup/build.py",
        " for name, spec in every if spec.derived_from is None\n    ]",
        " for name, spec in every\n    ]",
        "tests/setup/test_records_as_they_come.py::"
        "test_a_derived_channel_is_compared_and_not_counted",
    ),
    Mutant(
        "inputs thinned like channels",
        "setup/thinning.py",
        "    if experiment.series:",
        "    if not experiment.t.size:",
        "tests/setup/test_records_as_they_come.py::"
        "test_inputs_stay_at_every_time_when_channels_are_decimated",
    ),
    Mutant(
        "a speed that is foretold taken for differences",
        "record/angles.py",
        "return rough and both < SHARED * alone",
        "return rough and both < alone",
        "tests/record/test_angles.py::test_a_speed_that_was_measured_has_noise_of_its_own",
    ),
    Mutant(
        "other files of a record lost from results",
        "results/provenance.py",
        "for section, key in sources.named_in(sections):",
        "for section, key in sources.named_in(sections)[:1]:",
        "tests/system/test_verify.py::test_every_file_of_a_record_is_part_of_its_run",
    ),
    Mutant(
        "what leans by values, not by ranks",
        "insight/leaning.py",
        "ranks = rankdata(some, axis=0)",
        "ranks = some",
        "tests/insight/test_leaning.py::"
        "test_what_others_left_to_their_priors_explain_leans_on_them",
    ),
    Mutant(
        "a gear taken for its inverse",
        "insight/plausibility.py",
        "for own in (1.0, i_m))",
        "for own in (1.0, 1 / i_m))",
        "tests/insight/test_plausibility.py::"
        "test_a_channel_of_another_gear_than_the_model_is_named",
    ),
    Mutant(
        "texts of users read as HTML",
        "report/html.py",
        "autoescape=True",
        "autoescape=False",
        "tests/report/test_pages.py::test_texts_of_users_stay_texts",
    ),
    Mutant(
        "examples written through a link that leads nowhere",
        "setup/examples.py",
        "for path in paths if own_files.what(path)",
        "for path in paths if path.exists()",
        "tests/cli/test_example.py::test_nothing_is_overwritten_and_nothing_written_beside_it",
    ),
    Mutant(
        "a run cited with what is installed today",
        "basics/citation.py",
        "{**software.versions(), **(versions or {})}",
        "{**(versions or {}), **software.versions()}",
        "tests/basics/test_citation.py::test_a_run_is_cited_with_the_versions_that_made_it",
    ),
    Mutant(
        "an accent lost in BibTeX",
        "basics/bibliography.py",
        "if mark else letter)",
        "if not mark else base)",
        "tests/basics/test_citation.py::test_entries_are_plain_and_whole",
    ),
    Mutant(
        "ranks that are not those of all draws",
        "insight/ensemble_ranks.py",
        "draws[..., d], axis=None)",
        "draws[..., d], axis=-1)",
        "tests/insight/test_ensemble_ranks.py::"
        "test_an_ensemble_that_is_elsewhere_leaves_the_band_and_is_named",
    ),
    Mutant(
        "a band of ranks for one ensemble alone",
        "insight/ensemble_ranks.py",
        "away.max(axis=(1, 2))",
        "away[:, :, 0].max(axis=1)",
        "tests/insight/test_ensemble_ranks.py::"
        "test_ensembles_alike_leave_the_band_as_often_as_is_said",
    ),
    Mutant(
        "a sample that helps to predict itself",
        "insight/predictive.py",
        "np.exp(log_p.min(axis=0) - log_p)",
        "np.ones_like(log_p)",
        "tests/insight/test_predictive.py::test_each_sample_is_predicted_without_itself",
    ),
    Mutant(
        "runs apart by the sd of a difference",
        "insight/overlay.py",
        "math.sqrt(0.5 * (one.sd**2 + other.sd**2))",
        "math.sqrt(one.sd**2 + other.sd**2)",
        "tests/insight/test_overlay.py::test_a_shift_of_the_draws_is_how_far_they_are_apart",
    ),
    Mutant(
        "a prediction in SI",
        "report/prediction.py",
        "signals[:, k] / unit.factor",
        "signals[:, k]",
        "tests/system/test_map.py::test_the_prediction_is_the_response_in_the_units_of_the_record",
    ),
    Mutant(
        "an overlay of other runs than it says",
        "commands/verify.py",
        'if layer.mark != one["run"]:',
        "if False:",
        "tests/system/test_overlay.py::test_what_does_not_belong_to_an_overlay_is_named",
    ),
    Mutant(
        "contours of noise",
        "report/contours.py",
        "np.median(slope[near]) > STEEP * noise",
        "np.median(slope[near]) > 0.0",
        "tests/report/test_figures.py::"
        "test_a_flat_density_has_no_contour_and_a_box_is_full_to_its_ends",
    ),
    Mutant(
        "bins that reach beyond the end of a prior",
        "report/corner_plot.py",
        "first = max(column.scale.low, column.ends[0])",
        "first = column.scale.low",
        "tests/report/test_figures.py::"
        "test_a_flat_density_has_no_contour_and_a_box_is_full_to_its_ends",
    ),
    Mutant(
        "a bend of the logit's Jacobian forgotten",
        "inference/coordinates.py",
        "1.0 - 2.0 * share, 2.0 * share",
        "1.0, 2.0 * share",
        "tests/inference/test_coordinates.py::"
        "test_slopes_and_jacobian_between_two_ends_are_differences",
    ),
    Mutant(
        "the width between two ends forgotten",
        "inference/coordinates.py",
        "jacobian += np.log(high - low) + log_expit",
        "jacobian += log_expit",
        "tests/inference/test_coordinates.py::"
        "test_slopes_and_jacobian_between_two_ends_are_differences",
    ),
    Mutant(
        "channels of mixed noise in the order of their kinds",
        "inference/noise/mixed.py",
        "out[..., list(columns)] = values",
        "out[..., [len(found) - 1 - k for k in columns]] = values",
        "tests/contracts/test_noises.py::test_slopes_are_those_of_the_density",
    ),
    Mutant(
        "a pull over the scale and not its square",
        "inference/noise/white.py",
        "return samples / self.scales(own)[:, None, :] ** 2",
        "return samples / self.scales(own)[:, None, :]",
        "tests/contracts/test_noises.py::test_slopes_are_those_of_the_density",
    ),
    Mutant(
        "the noise of a second record takes the unknowns of the first",
        "inference/likelihood.py",
        "levels=[*islice(levels, len(noise.unknowns))],",
        'levels=[space.free[c] for c in space.columns("noise")][: len(noise.unknowns)],',
        "tests/contracts/test_noises.py::test_two_records_say_together_what_each_says",
    ),
    Mutant(
        "an entry of another member given in vain",
        "basics/entries.py",
        "if entry not in own and getattr(section, entry) is not None",
        "if entry in own and getattr(section, entry) is not None and False",
        "tests/rig/test_models.py::test_a_constant_of_another_model_is_an_error_with_its_line",
    ),
    Mutant(
        "an edited table belongs to its run",
        "commands/verify.py",
        "elif own_files.digest(folder / name) != digest:",
        "elif False:",
        "tests/system/test_verify.py::test_what_does_not_belong_is_named",
    ),
    Mutant(
        "a figure of any run belongs",
        "commands/verify.py",
        "if mark.encode() not in content:",
        "if False:",
        "tests/system/test_verify.py::test_what_does_not_belong_is_named",
    ),
    Mutant(
        "a rig with a state of another is one",
        "rig/models/trial.py",
        '    if strange:\n        raise ValueError(f"`linear` names',
        '    if False:\n        raise ValueError(f"`linear` names',
        "tests/contracts/test_extensions.py::test_what_is_none_is_named_and_takes_no_other_with_it",
    ),
    Mutant(
        "no Jacobian of the logs",
        "inference/coordinates.py",
        "np.ascontiguousarray(z[:, self.logs]).sum(axis=-1)",
        "0.0 * z.sum(axis=-1)",
        "tests/inference/test_coordinates.py::test_jacobian_equals_a_numerical_determinant",
    ),
    Mutant(
        "drop the Jacobian",
        "inference/posterior.py",
        "log_p[inside] += log_jacobian[inside]",
        "pass",
        "tests/inference/test_posterior.py::test_density_over_coordinates_carries_the_jacobian",
    ),
    Mutant(
        "ignore a tie",
        "inference/unknowns.py",
        "return named | {name: r.value(named) for name, r in self.relations.items()}",
        "return dict.fromkeys(self.relations, 1.0) | named",
        "tests/setup/test_relations.py::test_tied_parameters_follow",
    ),
    Mutant(
        "take a formula's parameter for one without slope",
        "inference/unknowns.py",
        "duals |= {name: r.value(duals) for name, r in self.relations.items()}",
        "duals |= dict.fromkeys(self.relations, 1.0)",
        "tests/setup/test_relations.py::test_slopes_are_those_of_differences",
    ),
    Mutant(
        "the slope of a power that is no whole number without its factor",
        "basics/duals.py",
        "slope = power * self.value ** (power - 1) * self.slope",
        "slope = self.value ** (power - 1) * self.slope",
        "tests/basics/test_formulas.py::test_derivatives_are_those_of_differences",
    ),
    Mutant(
        "a load that does not slow the rig down in its steady state",
        "rig/models/linear.py",
        "out[:, index[row]] += value * inputs.get(name, 0.0)",
        'out[:, index[row]] += value * inputs.get(name, 0.0) * (name == "v")',
        "tests/insight/test_derived.py::test_a_long_simulation_ends_at_the_steady_speed_and_current",
    ),
    Mutant(
        "drop -log sigma",
        "inference/noise/white.py",
        "constant - self._n * np.log(sigma) - 0.5",
        "constant - 0.5",
        "tests/inference/test_posterior.py::test_unknown_sigma_per_channel",
    ),
    Mutant(
        "forget the half of the misfit",
        "inference/noise/white.py",
        "np.log(sigma) - 0.5 * residuals.squares",
        "np.log(sigma) - 1.0 * residuals.squares",
        "tests/inference/test_posterior.py::test_known_sigma_is_a_sum_of_normal_densities",
    ),
    Mutant(
        "exchange the sigmas of two channels",
        "inference/noise/white.py",
        "for column, k in enumerate(self.unknown):",
        "for column, k in enumerate(self.unknown[::-1]):",
        "tests/inference/test_posterior.py::test_unknown_sigma_per_channel",
    ),
    Mutant(
        "exchange k_T and k_e",
        "rig/models/motor_shaft.py",
        'p["j_m"], p["c_m"], p["k_e"], p["k_T"]',
        'p["j_m"], p["c_m"], p["k_T"], p["k_e"]',
        "tests/rig/test_response.py::test_energy_is_balanced",
    ),
    Mutant(
        "exchange two parameters in the vector",
        "inference/unknowns.py",
        "theta[:, self.free.index(name)]",
        "theta[:, -1 - self.free.index(name)]",
        "tests/inference/test_posterior.py::test_fixed_parameters_are_held_and_named",
    ),
    Mutant(
        "wrong sign of friction",
        "rig/models/motor_shaft.py",
        'c={"w_2": -i_m * t_f / j_m}',
        'c={"w_2": i_m * t_f / j_m}',
        "tests/rig/test_response.py::test_ends_at_the_equilibrium",
    ),
    Mutant(
        "A(5,1) over j_1, as printed",
        "rig/models/motor_shaft.py",
        '("w_2", "theta_1"): shaft,',
        '("w_2", "theta_1"): i_m**2 * k_s / j_1,',
        "tests/rig/test_response.py::test_the_papers_six_state_matrix",
    ),
    Mutant(
        "A(6,5) without the gear, as printed",
        "rig/models/motor_shaft.py",
        "-k_e / (i_m * l_m)",
        "-i_m * k_e / l_m",
        "tests/rig/test_response.py::test_equals_scipys_expm_per_sample",
    ),
    Mutant(
        "no squarings",
        "rig/kernels/exponential.py",
        "least = b.add(exponent, b.zext(above, INT_VEC))",
        "least = b.sub(exponent, whole_numbers(99))",
        "tests/rig/test_response.py::test_equals_scipys_expm_per_sample",
    ),
    Mutant(
        "increments of a first-order hold from the wrong sample",
        "rig/kernels/recurrence.py",
        "following = b.add(index, I64(1))",
        "following = b.add(index, I64(0))",
        "tests/rig/test_response.py::test_measured_inputs_against_radau",
    ),
    Mutant(
        "a search walks down to where numbers end",
        "inference/surface.py",
        "low = prior.low if bounded else float(prior.quantile(np.array(NOTHING)))",
        "low = prior.low",
        "tests/engines/test_mode.py::test_a_search_for_a_zero_ends_where_its_prior_does",
    ),
    Mutant(
        "no Jacobian of the ridge in the proposal's density",
        "engines/samplers/mixture.py",
        "self.constants[:, None] - jacobian[self.sheet] - 0.5 * squares",
        "self.constants[:, None] - 0.5 * squares",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "the density of a mixture that is not normalised",
        "engines/samplers/mixture.py",
        "- log_det - 0.5 * means.shape[1] * LOG_2PI",
        "- 0.5 * means.shape[1] * LOG_2PI",
        "tests/contracts/test_independence.py::test_a_mixture_is_a_normalised_density_that_its_draws_follow",
    ),
    Mutant(
        "the weights of components left out of the density",
        "engines/samplers/mixture.py",
        "constants = np.log(weights) - log_det",
        "constants = 0.0 * weights - log_det",
        "tests/contracts/test_independence.py::test_target_is_kept_exactly_over_two_ridges",
    ),
    Mutant(
        "the weights of ridges left out of the importance weights",
        "engines/samplers/mixture.py",
        "constants = np.log(weights) - log_det",
        "constants = 0.0 * weights - log_det",
        "tests/engines/test_learning.py::test_weights_of_two_maxima_without_a_chain",
    ),
    Mutant(
        "the weights of ridges left out of the walkers' proposals",
        "engines/samplers/mixture.py",
        "constants = np.log(weights) - log_det",
        "constants = 0.0 * weights - log_det",
        "tests/engines/test_learning.py::test_weights_of_two_maxima_from_walkers_that_start_on_both_alike",
    ),
    Mutant(
        "draws cut off in the order of their components",
        "engines/samplers/mixture.py",
        "chosen = np.searchsorted(np.cumsum(self.weights)[:-1], random.random_sample(n))",
        "chosen = np.sort(np.searchsorted(np.cumsum(self.weights)[:-1], random.random_sample(n)))",
        "tests/contracts/test_independence.py::test_target_is_kept_exactly_over_two_ridges",
    ),
    Mutant(
        "the Jacobian of another draw",
        "engines/samplers/mixture.py",
        "return Drawn(self.u[good], self.jacobian[good], self.y[good], self.sheet[good])",
        "return Drawn(self.u[good], self.jacobian[: good.sum()], self.y[good], self.sheet[good])",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "do not fill up what the prior cuts off",
        "engines/samplers/mixture.py",
        "FILL / (share * len(u))",
        "1e-9 / (share * len(u))",
        "tests/contracts/test_independence.py::test_what_the_prior_cuts_off_is_filled_up",
    ),
    Mutant(
        "walkers start where the posterior is thought to be",
        "engines/samplers/mixture.py",
        "weights = self.weights / each",
        "weights = self.weights",
        "tests/engines/test_sampling.py::test_walkers_start_on_all_maxima_alike",
    ),
    Mutant(
        "the proposal's density forgotten",
        "engines/samplers/moves.py",
        "fresh, before - after)",
        "fresh, 0.0 * after)",
        "tests/contracts/test_independence.py::test_target_is_kept_exactly_over_two_ridges",
    ),
    Mutant(
        "a walker that would wait never steps by itself",
        "engines/samplers/moves.py",
        "if len(which) > 0:",
        "if len(which) < 0:",
        "tests/contracts/test_independence.py::test_a_walker_in_a_tail_does_not_wait_for_ever",
    ),
    Mutant(
        "a walker steps over the limit of its steps",
        "engines/samplers/moves.py",
        "moved &= log_p > above",
        "moved &= log_p > -np.inf",
        "tests/contracts/test_independence.py::test_steps_of_walkers_by_themselves_keep_the_target",
    ),
    Mutant(
        "the share of a component forgotten where a step ends",
        "engines/samplers/local.py",
        "factor = share_after - share + after",
        "factor = after",
        "tests/contracts/test_independence.py::test_steps_of_walkers_by_themselves_keep_the_target",
    ),
    Mutant(
        "no Jacobian of the ridge in a walker's own step",
        "engines/samplers/local.py",
        "share_after - share + after[sheet, walker] - before[sheet, walker]",
        "share_after - share",
        "tests/contracts/test_independence.py::test_steps_of_walkers_by_themselves_keep_the_target",
    ),
    Mutant(
        "the settled proposal is never drawn from",
        "engines/samplers/independence.py",
        "random.random_sample() > SETTLED",
        "random.random_sample() > 0.0",
        "tests/engines/test_settled.py::test_walkers_reach_what_the_proposal_leaves_out",
    ),
    Mutant(
        "the settled proposal weighed with the other's density",
        "engines/samplers/moves.py",
        "known = self.remembered[one is self.proposal.settled]",
        "known = self.remembered[0]",
        "tests/engines/test_settled.py::test_walkers_reach_what_the_proposal_leaves_out",
    ),
    Mutant(
        "what a density was before a walker moved",
        "engines/samplers/independence.py",
        "moved = np.flatnonzero((self._u != u).any(axis=1))",
        "moved = np.flatnonzero((self._u != self._u).any(axis=1))",
        "tests/contracts/test_independence.py::test_densities_are_remembered_of_walkers_that_stay",
    ),
    Mutant(
        "draws that are coordinates of another ridge",
        "engines/samplers/mixture.py",
        "others = np.flatnonzero(drawn.sheet != s)",
        "others = np.flatnonzero(drawn.sheet < -1)",
        "tests/contracts/test_independence.py::test_target_is_kept_exactly_over_two_ridges",
    ),
    Mutant(
        "points that are far astray are given up",
        "engines/learning/settled.py",
        "ITERATIONS = 9 ",
        "ITERATIONS = 4 ",
        "tests/engines/test_settled.py::test_points_are_brought_to_the_ridge",
    ),
    Mutant(
        "no look at what a proposal leaves out",
        "engines/learning/left_out.py",
        "(k == 0 and _nothing(surface, proposal, draws))",
        "k == 0",
        "tests/engines/test_settled.py::test_what_a_proposal_leaves_out_is_found",
    ),
    Mutant(
        "no walkers that look beyond the corner of a ridge",
        "engines/learning/left_out.py",
        "MORE = 4 ",
        "MORE = 0 ",
        "tests/engines/test_settled.py::test_a_ridge_that_turns_a_corner_is_seen_on_both_sides",
    ),
    Mutant(
        "a look that always finds something left out",
        "engines/learning/left_out.py",
        "return left_out < LEFT_OUT and",
        "return left_out < 0.0 and",
        "tests/engines/test_settled.py::test_a_proposal_that_leaves_nothing_out_is_enough",
    ),
    Mutant(
        "points beyond the ends of the priors left out",
        "engines/learning/ridges.py",
        "np.isfinite(value) | near.all(axis=1)",
        "np.isfinite(value)",
        "tests/engines/test_ridges.py::test_a_ridge_is_followed_up_to_the_ends_of_the_priors",
    ),
    Mutant(
        "a root's polynomial followed for ever",
        "engines/samplers/ridge.py",
        "np.clip(entries, self.ends[0][:, None], self.ends[1][:, None], out=entries)",
        "pass",
        "tests/engines/test_learning.py",
    ),
    Mutant(
        "what is not found wider is mirrored",
        "engines/preparation.py",
        "elif mirrored < 0:",
        "elif wanted < 0:",
        "tests/engines/test_sampling.py::test_no_walker_starts_where_it_would_wait",
    ),
    Mutant(
        "no end of a prior is moved",
        "insight/opened_priors.py",
        "ends[name] = end * math.exp(-sign * max(min(own, REACH), past))",
        "ends[name] = end",
        "tests/insight/test_opened_priors.py",
    ),
    Mutant(
        "the proposal's factor with the wrong sign",
        "engines/samplers/moves.py",
        "fresh, before - after)",
        "fresh, after - before)",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "no Jacobian of the ridge in a move along it",
        "engines/samplers/moves.py",
        "return fresh, factor + after - before[half]",
        "return fresh, factor",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "the Jacobian of a move along a ridge with the wrong sign",
        "engines/samplers/moves.py",
        "return fresh, factor + after - before[half]",
        "return fresh, factor - after + before[half]",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "the Jacobian of another walker",
        "engines/samplers/moves.py",
        "return fresh, factor + after - before[half]",
        "return fresh, factor + after - before[others]",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "the ridge's root at its middle on the way back",
        "engines/samplers/ridge.py",
        "e = _solved(root, tau - place)",
        "e = _solved(self.along(0.0 * psi)[1], tau - place)",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "the ridge's volume at its middle",
        "engines/samplers/ridge.py",
        "return sheet.frame.join(psi, tau + _times(root, e)), log_det",
        "return sheet.frame.join(psi, tau + _times(root, e)), sheet.along(0.0 * psi)[2]",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "the volume of a basis forgotten",
        "engines/samplers/ridge.py",
        "volume = float(np.linalg.slogdet(columns)[1])",
        "volume = 0.0",
        "tests/contracts/test_independence.py::test_target_is_kept_exactly_over_two_ridges",
    ),
    Mutant(
        "one root for the whole ridge",
        "engines/samplers/ridge.py",
        "entries = self.root.T @ rows[: self.root_powers.terms]",
        "entries = self.root[:1].T @ rows[:1]",
        "tests/engines/test_ridges.py::test_a_strongly_bent_ridge_is_followed",
    ),
    Mutant(
        "a polynomial followed for ever",
        "engines/samplers/ridge.py",
        "scaled *= self.reach / np.maximum(far, self.reach)",
        "scaled *= 1.0",
        "tests/engines/test_ridges.py::test_a_polynomial_says_nothing_of_what_lies_beyond_its_points",
    ),
    Mutant(
        "no slope taken for no density",
        "engines/learning/ridges.py",
        'good = np.einsum("nii->n", here.curvature) > 0',
        "good = np.abs(here.slope).sum(axis=1) > 0",
        "tests/engines/test_ridges.py::test_a_point_that_is_on_the_ridge_has_arrived",
    ),
    Mutant(
        "a polynomial judged where none reaches",
        "engines/learning/ridges.py",
        "held = within if within.any() else held",
        "pass",
        "tests/engines/test_ridges.py::test_the_outermost_point_does_not_decide_how_bent_a_ridge_is",
    ),
    Mutant(
        "nothing above a quadratic",
        "engines/learning/ridges.py",
        "MOST_DEGREE = 14",
        "MOST_DEGREE = 2",
        "tests/engines/test_ridges.py::test_a_strongly_bent_ridge_is_followed",
    ),
    Mutant(
        "flat at one point for flat everywhere",
        "engines/learning/directions.py",
        "PROBES = 12",
        "PROBES = 1",
        "tests/engines/test_ridges.py::test_a_direction_along_which_nothing_changes_anywhere_is_known",
    ),
    Mutant(
        "a tight direction out of the box",
        "engines/learning/directions.py",
        "> PRESSED:",
        "> np.inf:",
        "tests/engines/test_ridges.py::test_an_unknown_that_its_wall_holds_back_is_loose",
    ),
    Mutant(
        "what a wall holds is never let go",
        "engines/climb.py",
        "held[let_go, np.argmax(inward, axis=1)[let_go]] = False",
        "pass",
        "tests/engines/test_climb.py::test_a_step_within_a_box_is_that_of_bounded_least_squares",
    ),
    Mutant(
        "a step cut off at the first wall",
        "engines/climb.py",
        "for _ in range(3 * d):",
        "for _ in range(1):",
        "tests/engines/test_climb.py::test_a_step_within_a_box_is_that_of_bounded_least_squares",
    ),
    Mutant(
        "no damping",
        "engines/climb.py",
        "tried = [_stepped(surface, u, here, damping * factor) for factor in DAMPINGS]",
        "tried = [_stepped(surface, u, here, 0.0 * damping) for factor in DAMPINGS]",
        "tests/engines/test_climb.py::test_a_valley_shaped_like_a_banana_is_followed",
    ),
    Mutant(
        "down where it curves upward",
        "engines/climb.py",
        "(vectors * np.abs(values)[:, None, :])",
        "(vectors * values[:, None, :])",
        "tests/engines/test_climb.py::test_second_derivatives_lead_to_the_very_maximum",
    ),
    Mutant(
        "one leap from point to point of a ridge",
        "engines/maxima.py",
        "PATH = 10",
        "PATH = 1",
        "tests/engines/test_maxima.py::test_a_second_ridge_beside_the_first_is_another",
    ),
    Mutant(
        "wherever a path ends is the same maximum",
        "engines/maxima.py",
        "np.linalg.norm(off, axis=1) < SAME",
        "np.linalg.norm(off, axis=1) < np.inf",
        "tests/engines/test_maxima.py::test_two_humps_are_two_maxima_the_highest_first",
    ),
    Mutant(
        "a maximum that holds nothing",
        "engines/maxima.py",
        "values[left[0]] - LOWER",
        "values[left[0]] - 1e9",
        "tests/engines/test_maxima.py::test_what_is_much_lower_holds_nothing",
    ),
    Mutant(
        "aliases on one side only",
        "engines/aliases.py",
        "ROUNDS = (-2, -1, 1, 2)",
        "ROUNDS = (1, 2)",
        "tests/engines/test_aliases.py::test_the_other_stiffness_of_a_torsion_near_half_the_sampling_rate",
    ),
    Mutant(
        "weights flattened as far as it goes",
        "engines/samplers/weighing.py",
        "if effective(flat(middle)) >= least else",
        "if False else",
        "tests/engines/test_learning.py::test_weights_are_flattened_no_more_than_they_must",
    ),
    Mutant(
        "no slope of the coordinates' Jacobian",
        "inference/surface.py",
        "slope, curvature = slope + tilt, curvature + bend",
        "pass",
        "tests/inference/test_surface.py::test_slopes_are_those_of_the_density",
    ),
    Mutant(
        "no slope of the prior",
        "inference/surface.py",
        "slope += _along(prior_slope, directions)",
        "pass",
        "tests/inference/test_surface.py::test_slopes_are_those_of_the_density",
    ),
    Mutant(
        "a noise level that fits any residual",
        "inference/noise/white.py",
        "return left - n, 2.0",
        "return left, 2.0",
        "tests/inference/test_surface.py::test_slopes_are_those_of_the_density",
    ),
    Mutant(
        "the curvature of a noise level halved",
        "inference/noise/white.py",
        "2.0 * np.maximum(left",
        "1.0 * np.maximum(left",
        "tests/inference/test_surface.py::test_curvatures_are_those_of_least_squares",
    ),
    Mutant(
        "every coordinate for a log",
        "inference/surface.py",
        "by_log = coordinates.slopes(theta) / coordinates.natural(theta)",
        "by_log = np.ones_like(theta)",
        "tests/inference/test_surface.py::test_slopes_are_those_of_the_density",
    ),
    Mutant(
        "slopes that depend on how many points there are",
        "inference/surface.py",
        "(slope[:, None, :] @ directions)[:, 0]",
        "slope @ directions",
        "tests/inference/test_surface.py::test_a_point_does_not_depend_on_its_neighbours",
    ),
    Mutant(
        "cells of steps from their beginning, series from their middle",
        "rig/kernels/steps.py",
        "fma(b, inside, middle, ",
        "fma(b, inside, vector(0.0), ",
        "tests/rig/test_dense.py::test_equals_steps_in_extended_precision",
    ),
    Mutant(
        "the degree of a series that lanes share",
        "rig/kernels/series.py",
        'wanted = b.icmp_signed(">=", degree, whole_numbers(k))',
        'wanted = b.icmp_signed(">=", degree, whole_numbers(0))',
        "tests/rig/test_dense.py::test_a_walker_does_not_depend_on_its_neighbours",
    ),
    Mutant(
        "inputs with slopes that stand still between knots",
        "rig/kernels/steps.py",
        "    if not slopes:\n",
        "    if slopes or not slopes:\n",
        "tests/rig/test_dense.py::test_equals_steps_in_extended_precision",
    ),
    Mutant(
        "a shift's part of a step taken backwards",
        "rig/dense.py",
        "np.ceil(ratio)",
        "np.floor(ratio)",
        "tests/rig/test_dense.py::test_equals_steps_in_extended_precision",
    ),
    Mutant(
        "no slope of the time before the first sample",
        "rig/kernels/normal.py",
        "_next_slope(b, layout, phi, slope, start, zero, [])",
        "_next_slope(b, layout, phi, slope, zero, zero, [])",
        "tests/inference/test_surface.py::test_normal_equations_are_sums_over_the_signals",
    ),
    Mutant(
        "no slope of what drives the rig",
        "rig/kernels/normal.py",
        "[*enumerate(state), *enumerate(drive, start=x + 1)]",
        "[*enumerate(state)]",
        "tests/inference/test_surface.py::test_normal_equations_are_sums_over_the_signals",
    ),
    Mutant(
        "all ensembles from the same start points",
        "engines/preparation.py",
        'seeds.bits(seed, "start", ensemble)',
        'seeds.bits(seed, "start", 0)',
        "tests/engines/test_sampling.py::test_ensembles_start_at_different_points_with_different_streams",
    ),
    Mutant(
        "all ensembles with the same random stream",
        "engines/preparation.py",
        'seeds.legacy_state(seed, "walk", ensemble)',
        'seeds.legacy_state(seed, "walk", 0)',
        "tests/engines/test_sampling.py::test_ensembles_have_no_step_in_common",
    ),
    Mutant(
        "every ensemble is the first",
        "engines/sampling.py",
        "self.plan.seed, ensemble)",
        "self.plan.seed, 0)",
        "tests/engines/test_sampling.py::test_ensembles_have_no_step_in_common",
    ),
    Mutant(
        "ensembles start no wider than they end",
        "engines/preparation.py",
        "mixture.widened(START_SPREAD)",
        "mixture",
        "tests/engines/test_sampling.py::test_starts_are_inside_the_priors_and_wider_than_the_proposal",
    ),
    Mutant(
        "the stretch's factor off by one power",
        "engines/samplers/moves.py",
        "(d - 1.0) * np.log(factor)",
        "d * np.log(factor)",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "believe a symmetry without proving it",
        "insight/identifiability/structure.py",
        "proven = tuple(exponents for exponents in found if unchanged(exponents))",
        "proven = tuple(found)",
        "tests/insight/test_identifiability.py::test_a_direction_that_is_no_symmetry_is_not_claimed",
    ),
    Mutant(
        "the quotient rule of a derivative with the wrong sign",
        "basics/duals.py",
        "(self.slope - quotient * right.slope) / right.value",
        "(self.slope + quotient * right.slope) / right.value",
        "tests/insight/test_identifiability.py::test_sensitivities_are_the_slopes_of_the_response",
    ),
    Mutant(
        "a bound for what leaves no trace",
        "insight/identifiability/information.py",
        "hidden > BLIND * np.linalg.norm(exponents, axis=1)",
        "hidden > np.inf",
        "tests/insight/test_identifiability.py::test_a_parameter_without_a_trace_has_no_bound",
    ),
    Mutant(
        "bands of ranks not shared by the quantities",
        "insight/calibration/verdict.py",
        "0.5 * FALSE_ALARM / len(names))",
        "0.5 * FALSE_ALARM * len(names))",
        "tests/insight/test_calibration.py::test_a_right_posterior_is_found_wrong_as_seldom_as_stated",
    ),
    Mutant(
        "transpose the chain",
        "engines/convergence.py",
        "kept.reshape(kept.shape[0], -1, *kept.shape[3:])",
        "kept.swapaxes(1, 2).reshape(kept.shape[0], -1, *kept.shape[3:])",
        "tests/engines/test_convergence.py::test_thinning_keeps_time_and_ensembles_apart",
    ),
    Mutant(
        "ignore the seed",
        "engines/samplers/ensemble.py",
        "random_state=state.random)",
        "random_state=None)",
        "tests/engines/test_ensemble.py::test_same_seed_same_chain_other_seed_another",
    ),
    Mutant(
        "the same stream for every ensemble",
        "basics/seeds.py",
        "spawn_key=(_ORDER.index(purpose), index)",
        "spawn_key=(_ORDER.index(purpose), 0)",
        "tests/engines/test_ensemble.py::test_streams_differ_by_purpose_and_index",
    ),
    Mutant(
        "starts outside the priors are not mirrored into them",
        "engines/preparation.py",
        "    z = np.where(z < surface.low, 2.0 * surface.low - z, z)\n",
        "",
        "tests/engines/test_sampling.py::test_starts_in_a_corner_of_the_priors_are_mirrored_into_it",
    ),
    Mutant(
        "mirrored starts stay as far away as they were",
        "engines/preparation.py",
        "0.25**mirrored",
        "1.0",
        "tests/engines/test_sampling.py::test_starts_in_a_corner_of_the_priors_are_mirrored_into_it",
    ),
    Mutant(
        "any density is a place to start at",
        "engines/preparation.py",
        "log_p > log_p.max() - DEEP",
        "log_p > -np.inf",
        "tests/engines/test_sampling.py::test_no_walker_starts_far_off_the_ridge",
    ),
    Mutant(
        "a proposal that looks only where it goes",
        "engines/learning/learn.py",
        "_inside(wide, WIDER_DRAWS, surface, seed)",
        "_inside(found, WIDER_DRAWS, surface, seed)",
        "tests/engines/test_learning.py",
    ),
    Mutant(
        "all draws weighed as if from the proposal alone",
        "engines/learning/learn.py",
        "Weighed(u, log_w, log_q - log_every)",
        "Weighed(u, log_w, 0.0 * log_q)",
        "tests/engines/test_learning.py",
    ),
    Mutant(
        "checks that do not ask for tau",
        "engines/convergence.py",
        "AMPLY * (BURN_IN_TAUS + n_tau) * float(self.tau.max())",
        "1.25 * steps",
        "tests/engines/test_convergence.py::test_the_next_check_is_when_the_chain_is_long_enough",
    ),
    Mutant(
        "a verdict that does not ask for the fit",
        "insight/verdict.py",
        'return "disagrees" if fits else "in doubt"',
        'return "disagrees"',
        "tests/insight/test_verdict.py::test_a_fit_that_is_not_noise_leaves_the_table_in_doubt",
    ),
    Mutant(
        "drop the accept test",
        "engines/samplers/ensemble.py",
        "log_p, failed = evaluate(z)\n",
        "log_p, failed = evaluate(z)\n        log_p = 0 * np.nan_to_num(log_p, neginf=0.0)\n",
        "tests/contracts/test_moves.py::test_target_is_kept_exactly",
    ),
    Mutant(
        "tau of the walkers' own means",
        "engines/convergence.py",
        "chain - chain.mean(axis=(0, 1))",
        "chain - chain.mean(axis=0)",
        "tests/engines/test_convergence.py::"
        "test_walkers_that_disagree_alike_in_all_ensembles_are_not_independent_chains",
    ),
    Mutant(
        "an interval with equal tails under the HDI header",
        "insight/diagnostics.py",
        "low, high = array_stats.hdi(x, prob=probability, axis=0)",
        "low, high = np.quantile(x, [0.03, 0.97])",
        "tests/engines/test_convergence.py::"
        "test_hdi_is_the_narrowest_interval_not_the_one_with_equal_tails",
    ),
    Mutant(
        "a prior cut at zero without renormalising",
        "inference/priors.py",
        "- math.log(self.sd) - self._log_mass()",
        "- math.log(self.sd)",
        "tests/inference/test_priors.py::test_density_integrates_to_one",
    ),
    Mutant(
        "NaN instead of minus infinity",
        "inference/posterior.py",
        "log_p[failed] = -np.inf",
        "pass",
        "tests/inference/test_posterior.py::test_failures_are_counted_never_nan",
    ),
    Mutant(
        "sigma's prior left in the unit of the column",
        "setup/build.py",
        "prior(rescaled(spec.sigma, factor), 1.0), begin",
        "prior(spec.sigma, 1.0), begin",
        "tests/setup/test_reading.py::test_sigma_and_its_prior_are_in_the_columns_unit",
    ),
    Mutant(
        "let walkers stand still",
        "engines/walker_checks.py",
        "return np.asarray((step - last).max(axis=1))",
        "return np.asarray((step - last).min(axis=1))",
        "tests/engines/test_walker_checks.py::"
        "test_one_stuck_walker_in_the_middle_of_the_posterior_is_found",
    ),
    Mutant(
        "compare a walker's log density with that of the worse walkers",
        "engines/walker_checks.py",
        "[medians >= np.median(medians)]",
        "[medians <= np.median(medians)]",
        "tests/engines/test_walker_checks.py::test_a_walker_caught_in_a_lesser_maximum_is_found",
    ),
    Mutant(
        "do not count crossings",
        "engines/walker_checks.py",
        "max(0.5 * crossings, 1.0) < STAY * len(x)",
        "1.0 < STAY * len(x)",
        "tests/engines/test_walker_checks.py::test_two_places_between_which_walkers_cross_are_no_trouble",
    ),
    Mutant(
        "never find two places",
        "engines/walker_checks.py",
        "high - low > APART * sd[d]",
        "high - low > 1e9 * sd[d]",
        "tests/engines/test_walker_checks.py::"
        "test_two_places_alike_in_all_ensembles_are_found_where_r_hat_is_blind",
    ),
    Mutant(
        "never see tau grow",
        "engines/walker_checks.py",
        "(whole > by_chance * kept.tau)",
        "(whole > 100 * by_chance * kept.tau)",
        "tests/engines/test_walker_checks.py::test_slow_motion_that_a_window_does_not_see_is_found",
    ),
    Mutant(
        "believe a run whose burn-in could not be judged",
        "engines/convergence.py",
        "capped = found.wanted > burn_in",
        "capped = found.wanted > n_steps",
        "tests/engines/test_walker_checks.py::"
        "test_sound_but_short_chains_are_called_short_and_nothing_else",
    ),
    Mutant(
        "take near for pressed",
        "insight/diagnostics.py",
        "> RISING for half in halves",
        "> -1.0 for half in halves",
        "tests/insight/test_pressed.py::"
        "test_a_peak_near_an_end_that_does_not_touch_it_is_not_reported",
    ),
    Mutant(
        "believe a chain whatever its checksum",
        "results/chain_files.py",
        "if group.attrs[SEAL] != _checksum(found):",
        "if False:",
        "tests/results/test_run_folder.py::test_a_damaged_chain_is_named_or_harmless",
    ),
    Mutant(
        "take a later piece for the next one",
        "results/run_folder.py",
        'if first == f"{have:09d}":',
        'if first >= f"{have:09d}":',
        "tests/results/test_run_folder.py::test_pieces_after_a_gap_wait_until_it_is_filled",
    ),
    Mutant(
        "remove run.json while a folder is cleared",
        "basics/own_files.py",
        "if name != kind.mark and what(folder / name)",
        "if what(folder / name)",
        "tests/basics/test_own_files.py::test_run_json_is_there_all_the_time",
    ),
    Mutant(
        "follow links in a results folder",
        "basics/own_files.py",
        "mode = path.lstat().st_mode",
        "mode = path.stat().st_mode",
        "tests/basics/test_own_files.py::test_what_no_run_can_have_made_is_named_first",
    ),
    Mutant(
        "take away what only begins with a name of ours",
        "basics/own_files.py",
        "any(_pattern(one).fullmatch(name) for",
        "any(_pattern(one).match(name) for",
        "tests/basics/test_own_files.py::test_force_takes_what_such_a_run_writes_and_nothing_else",
    ),
    Mutant(
        "take any run.json for ours",
        "basics/sealed.py",
        "if seal is None or seal != _checksum(data):",
        "if not isinstance(data, dict):",
        "tests/basics/test_own_files.py::test_a_run_json_of_others_gives_no_right_to_a_folder",
    ),
    Mutant(
        "one tail for both sides of the posterior",
        "insight/tension.py",
        "ndtr(side * scores)",
        "ndtr(scores)",
        "tests/insight/test_verdict.py::test_tension_of_a_skewed_posterior_is_its_tail_probability",
    ),
    Mutant(
        "judge what lies along a symmetry",
        "insight/verdict.py",
        "if self._blind(exponents):",
        "if False:",
        "tests/insight/test_verdict.py::test_the_corners_of_a_prior_determine_nothing",
    ),
    Mutant(
        "two sigma, however many quantities are judged",
        "insight/verdict.py",
        "return float(norm.isf(0.5 * FALSE_ALARM / n))",
        "return 2.0",
        "tests/insight/test_verdict.py::test_a_nominal_rig_is_rarely_said_to_disagree",
    ),
    Mutant(
        "a motor may give more than it takes",
        "insight/plausibility.py",
        "if ratio <= 1 + APPRECIABLE:",
        "if 1 / ratio <= 1 + APPRECIABLE:",
        "tests/insight/test_plausibility.py::test_a_motor_that_gives_more_than_it_takes_is_named",
    ),
    Mutant(
        "resume under another seed",
        "results/provenance.py",
        '"the seed": str(config.seed),\n        f"',
        'f"',
        "tests/setup/test_config.py::test_what_decides_a_chain_is_in_its_fingerprint",
    ),
    Mutant(
        "only directions that are blind everywhere alike count",
        "insight/identifiability/structure.py",
        "blind = min(map(len, each), default=len(null))",
        "blind = len(null)",
        "tests/insight/test_identifiability.py::"
        "test_a_direction_that_turns_from_place_to_place_is_still_blind",
    ),
    Mutant(
        "a pair of the heuristic moves all unknowns",
        "paper/searches/pairwise.py",
        "changed[pair] = values",
        "changed[pair] = values; changed[:] = changed * (1 + 1e-6)",
        "tests/engines/test_mode.py::test_pairwise_moves_two_unknowns_at_a_time_in_the_order_given",
    ),
    Mutant(
        "the last pair of the circle forgotten",
        "paper/searches/pairwise.py",
        "[*chain[1:], chain[0]]",
        "[*chain[1:], chain[-1]]",
        "tests/engines/test_mode.py::test_pairs_are_the_papers_for_its_nine_and_a_circle_for_fewer",
    ),
    Mutant(
        "a prior in the estimates of Table 2",
        "paper/studies/verification.py",
        "return np.nan_to_num(target.likelihood(theta), nan=-np.inf, neginf=-np.inf)",
        "return np.nan_to_num(target.density(theta), nan=-np.inf, neginf=-np.inf)",
        "tests/paper/test_reproduction.py::test_estimates_are_those_of_least_squares",
    ),
    Mutant(
        "a rotor at the wrong side of the gearbox",
        "rig/models/motor_shaft.py",
        'p["j_m"] + self.i_m**2 * p["j_2"]',
        'p["j_m"] + self.i_m * p["j_2"]',
        "tests/rig/test_models.py",
    ),
    Mutant(
        "a shaft that damps its rotor alone",
        "rig/models/motor_shaft.py",
        'a["w_2", "w_1"], a["w_2", "w_2"] = shaft, a["w_2", "w_2"] - shaft',
        'a["w_2", "w_1"] = shaft',
        "tests/rig/test_composed.py::test_it_is_what_the_balances_of_its_bodies_give",
    ),
    Mutant(
        "friction of the motor as large as on the shaft",
        "rig/models/motor_shaft.py",
        '"w_2": ("j_m", -self.i_m)',
        '"w_2": ("j_m", -1.0)',
        "tests/rig/test_composed.py::test_it_is_what_the_balances_of_its_bodies_give",
    ),
    Mutant(
        "static friction of the motor at the speed of the shaft",
        "rig/models/motor_shaft.py",
        "self.stribeck, times=1 / self.i_m)",
        "self.stribeck)",
        "tests/rig/test_composed.py::test_its_frictions_have_the_laws_of_what_is_named",
    ),
    Mutant(
        "frictions lost behind the sensors of inputs",
        "rig/sensing.py",
        "return frictions_of(self.rig)",
        "return ()",
        "tests/rig/test_composed.py::"
        "test_frictions_pass_through_the_sensors_of_inputs_and_not_through_slopes",
    ),
    Mutant(
        "what is named is not switched on",
        "setup/build.py",
        "return with_named(rig, {*named, *more})",
        "return rig",
        "tests/setup/test_composed.py::test_to_name_a_parameter_is_to_switch_its_physics_on",
    ),
    Mutant(
        "an efficiency above one",
        "setup/consistency/unknowns.py",
        "if built.high > most:",
        "if built.high > 2 * most:",
        "tests/setup/test_composed.py::test_mistakes_are_said_with_their_way_out",
    ),
    Mutant(
        "the printed matrix is the right one",
        "paper/as_printed.py",
        'self.i_m**2 * p["k_s"] / p[self.a_51]',
        'self.i_m**2 * p["k_s"] / p["j_m"]',
        "tests/rig/test_models.py",
    ),
    Mutant(
        "a truth is believed of any record",
        "paper/studies/truths.py",
        "if _same(simulating.simulate(other, its_source, other.seed), text):",
        "if True:",
        "tests/paper/test_reproduction.py::"
        "test_truth_is_known_only_of_a_record_that_comes_out_again",
    ),
    Mutant(
        "the end of the record for the end of a step",
        "paper/studies/forward.py",
        "w_end=float(end[0]),",
        "w_end=float(w_2[-1]),",
        "tests/paper/test_studies.py::"
        "test_readings_settle_where_they_are_after_hours_and_their_errors_are_the_largest",
    ),
    Mutant(
        "the integrator starts with the record, wherever the state is given",
        "paper/studies/forward.py",
        "if experiment.t_start < experiment.t[0] else []",
        "if False else []",
        "tests/paper/test_studies.py::test_the_integrator_starts_where_the_state_is_given",
    ),
    Mutant(
        "the truth of another model",
        "paper/studies/truths.py",
        "if own == rig:",
        "if False:",
        "tests/paper/test_reproduction.py::"
        "test_truth_is_known_only_of_a_record_that_comes_out_again",
    ),
    Mutant(
        "a bad fit without a word",
        "paper/studies/findings.py",
        "return self.map <= self.high",
        "return True",
        "tests/paper/test_tables.py::"
        "test_doubts_are_said_in_words_and_above_the_tables_of_their_record",
    ),
    Mutant(
        "each look at what a fit leaves as if it were the only one",
        "inference/residual_checks.py",
        "tail = FALSE_ALARM / (LOOKS * channels)",
        "tail = FALSE_ALARM",
        "tests/inference/test_residual_checks.py::"
        "test_records_of_the_model_give_a_finding_as_seldom_as_stated",
    ),
    Mutant(
        "a sample beside itself",
        "inference/residual_checks.py",
        "residuals[1:] @ residuals[:-1]",
        "residuals[1:] @ residuals[1:]",
        "tests/inference/test_residual_checks.py::test_sizes_and_correlations_are_those_of_the_channel",
    ),
    Mutant(
        "only samples that are like the next count",
        "inference/residual_checks.py",
        "return abs(self.correlation) > self.limits.correlation",
        "return self.correlation > self.limits.correlation",
        "tests/inference/test_residual_checks.py::test_a_differenced_column_and_one_bad_sample_are_told",
    ),
    Mutant(
        "the record bounds what the priors of others bound",
        "report/identify_words.py",
        "meant = THROUGH_OTHERS",
        "pass",
        "tests/insight/test_identifiability.py::"
        "test_a_profile_through_the_priors_of_others_is_no_limit_of_the_record",
    ),
    Mutant(
        "the integrator's error squared and not rooted",
        "paper/studies/forward.py",
        "np.sqrt(np.mean(off[:, k] ** 2))",
        "np.mean(off[:, k] ** 2)",
        "tests/paper/test_studies.py::test_the_integrators_error_in_each_channel",
    ),
    Mutant(
        "an exact record for the integrator's own",
        "paper/studies/verification.py",
        '"trapezoid_both": {"own": True,',
        '"trapezoid_both": {"own": False,',
        "tests/paper/test_studies.py::"
        "test_each_search_ends_low_in_the_misfit_of_its_own_record_and_model",
    ),
    Mutant(
        "the bound of sigma 1 for every sigma",
        "paper/studies/verification.py",
        '"bound": sigma * one',
        '"bound": one',
        "tests/paper/test_studies.py::test_bounds_and_posteriors_grow_with_the_noise",
    ),
    Mutant(
        "the posterior twice as wide as it is",
        "paper/studies/verification.py",
        "draws.std(axis=0, ddof=1), sampled",
        "2 * draws.std(axis=0, ddof=1), sampled",
        "tests/paper/test_studies.py::test_bounds_and_posteriors_grow_with_the_noise",
    ),
    Mutant(
        "a zero density is the smallest number",
        "paper/studies/stepped.py",
        "np.nan_to_num(values, nan=-np.inf, neginf=-np.inf)",
        "np.nan_to_num(values, nan=-np.inf)",
        "tests/paper/test_studies.py::test_a_search_with_the_integrator_ends_at_the_priors",
    ),
    Mutant(
        "the same record again and again",
        "paper/studies/verification.py",
        "made.record(target, truth, seed, k), start",
        "made.record(target, truth, seed, 0), start",
        "tests/paper/test_studies.py::test_records_differ_in_the_size_of_their_noise_alone",
    ),
    Mutant(
        "searches that leave more than noise are said to have reached it",
        "paper/studies/simultaneous.py",
        "reached=bool(left < floor)",
        "reached=bool(left > floor)",
        "tests/paper/test_studies.py::test_ends_of_searches_are_told_apart_by_their_misfits",
    ),
    Mutant(
        "nearly every end is as good as the best",
        "paper/studies/simultaneous.py",
        "SAME = 4.0",
        "SAME = 400.0",
        "tests/paper/test_studies.py::test_ends_of_searches_are_told_apart_by_their_misfits",
    ),
    Mutant(
        "the least distance of the control for the largest",
        "paper/studies/control.py",
        ".max(axis=0)",
        ".min(axis=0)",
        "tests/paper/test_studies.py::"
        "test_the_control_tells_the_largest_of_what_a_search_makes_of_records_with_that_noise",
    ),
    Mutant(
        "another noise in the control",
        "paper/studies/control.py",
        "made.with_sigma(posterior, sigma)",
        "made.with_sigma(posterior, 2 * sigma)",
        "tests/paper/test_studies.py::"
        "test_the_control_tells_the_largest_of_what_a_search_makes_of_records_with_that_noise",
    ),
    Mutant(
        "half of the records are enough",
        "paper/studies/misfit.py",
        "SHARE = 0.95",
        "SHARE = 0.5",
        "tests/paper/test_studies.py::"
        "test_records_have_the_misfit_that_is_expected_in_nineteen_of_twenty",
    ),
    Mutant(
        "the exact misfit in the heuristic with the paper's integrator",
        "paper/studies/heuristic.py",
        "task = stepped.task(misfit.task(posterior), posterior.likelihood)",
        "task = misfit.task(posterior)",
        "tests/paper/test_studies.py::test_the_heuristic_ends_lower_in_the_misfit_that_it_searches",
    ),
    Mutant(
        "the exact misfit told of the end by the integrator",
        "paper/studies/heuristic.py",
        "None if end is None else stepped.per_number(posterior.likelihood, end)",
        "None if end is None else misfit.per_number(posterior, end)",
        "tests/paper/test_studies.py::test_the_heuristic_ends_lower_in_the_misfit_that_it_searches",
    ),
    Mutant(
        "per cent taken for shares in the implied noise",
        "paper/studies/bounds.py",
        'row["c_m"] / 100 / one["c_m"]',
        'row["c_m"] / one["c_m"]',
        "tests/paper/test_studies.py::"
        "test_the_implied_noise_is_that_at_which_the_bound_is_the_deviation",
    ),
    Mutant(
        "a mean square for its root",
        "paper/studies/bounds.py",
        "math.sqrt(square) for",
        "square for",
        "tests/paper/test_studies.py::"
        "test_the_implied_noise_is_that_at_which_the_bound_is_the_deviation",
    ),
    Mutant(
        "slopes twice as steep in what a record says alone",
        "paper/studies/causes.py",
        "/ (2 * STEP) for",
        "/ STEP for",
        "tests/paper/test_studies.py::"
        "test_what_a_record_says_alone_is_its_information_without_any_prior",
    ),
    Mutant(
        "the current for the speed in the end",
        "paper/studies/causes.py",
        "{name: both[name] for name in FOLLOWING}",
        "{'w_end': both['i_end'], 'zeta': both['zeta']}",
        "tests/paper/test_studies.py::"
        "test_the_end_of_a_step_and_the_damping_are_those_of_the_equations",
    ),
    Mutant(
        "of several files the first is believed",
        "setup/guessing/several.py",
        "lead = min(channels, key=_unsure)",
        "lead = channels[0]",
        "tests/setup/test_guessing_several.py::test_meanings_are_those_of_the_file_that_tells_most",
    ),
    Mutant(
        "what is late is taken for early",
        "setup/guessing/lags.py",
        "np.interp(k[self.inner] + shift, k, x)",
        "np.interp(k[self.inner] - shift, k, x)",
        "tests/setup/test_guessing_several.py::test_a_late_twist_is_told_by_what_it_does_to_rotor_1",
    ),
    Mutant(
        "inputs of the first file for all",
        "setup/guessing/several.py",
        "found = [max(inputs, key=lambda other: _alike(one.path, other.path)) for one in channels]",
        "found = list(inputs)",
        "tests/setup/test_guessing_several.py::test_channels_and_inputs_in_files_of_their_own",
    ),
    Mutant(
        "a start in motion taken for rest",
        "setup/guessing/start.py",
        "return speeds or turning or own",
        "return []",
        "tests/setup/test_guessing_several.py::test_how_a_start_is_said",
    ),
    Mutant(
        "glitches left in what is looked at",
        "setup/guessing/drafts.py",
        "t, x = len(values) - len(known), t[~spikes], x[~spikes]",
        "t, x = len(values) - len(known), t, x",
        "tests/setup/test_guessing_several.py::test_glitches_are_masked_and_do_not_mislead",
    ),
    Mutant(
        "off the guess for off the truth",
        "paper/pages/lines.py",
        "off_percent=_off(estimate, truth)",
        "off_percent=_off(estimate, guess)",
        "tests/paper/test_tables.py::test_lines_of_table_3_lead_back_to_what_was_found",
    ),
    Mutant(
        "the spread of one way for the other's",
        "paper/pages/lines.py",
        "percent * cell.sd_fminsearch",
        "percent * cell.sd_scaled",
        "tests/paper/test_tables.py::test_lines_of_table_2_lead_back_to_what_was_found",
    ),
    Mutant(
        "a bound a thousand times too wide",
        "paper/pages/lines.py",
        '0.1 * line.bounds["c_m"]',
        '100 * line.bounds["c_m"]',
        "tests/paper/test_tables.py::"
        "test_bounds_of_lengths_are_those_at_a_thousandth_and_repeats_attain_what_is_wanted",
    ),
    Mutant(
        "no scatter for the scatter of none",
        "paper/pages/lines.py",
        "float(np.std(values)) if values else None",
        "float(np.std(values)) if values else 0.0",
        "tests/paper/test_tables.py::test_a_way_without_a_best_end_has_no_scatter",
    ),
    Mutant(
        "one column of Table 2 twice",
        "paper/pages/tables.py",
        '"scaled": (line.scaled, line.scaled_percent)',
        '"scaled": (line.fminsearch, line.fminsearch_percent)',
        "tests/paper/test_tables.py::test_the_layout_of_table_2_is_the_papers",
    ),
    Mutant(
        "fminsearch ten times as patient",
        "paper/searches/fminsearch.py",
        "PER_UNKNOWN = 200 ",
        "PER_UNKNOWN = 2000 ",
        "tests/paper/test_studies.py::test_fminsearch_gives_up_where_matlab_documents_it",
    ),
]


def run(tree: Path, killer: str) -> bool:
    """Whether the test passes in `tree`."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", killer],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"{killer} did not run:\n{done.stdout}{done.stderr}")
    return done.returncode == 0


def chosen(words: list[str]) -> list[Mutant]:
    """Those of which the name, the file or the killer has one of `words`; all of them without any."""
    texts = [f"{mutant.name} {mutant.file} {mutant.killer}" for mutant in MUTANTS]
    return [
        mutant
        for mutant, text in zip(MUTANTS, texts, strict=True)
        if not words or any(word in text for word in words)
    ]


def main() -> None:
    survivors = []
    mutants = chosen(sys.argv[1:])
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        tree.mkdir()
        for part in PARTS:
            copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy2
            copy(ROOT / part, tree / part)
        for killer in sorted({mutant.killer for mutant in mutants}):
            if not run(tree, killer):
                raise SystemExit(f"{killer} fails without any mutant")
        for mutant in mutants:
            begun = time.perf_counter()
            path = tree / "bayesdrill" / mutant.file
            text = path.read_text()
            path.write_text(text.replace(mutant.old, mutant.new))
            survived = run(tree, mutant.killer)
            path.write_text(text)
            seconds = time.perf_counter() - begun
            print(f"{'SURVIVED' if survived else 'killed  '}  {mutant.name}  ({seconds:.1f} s)")
            if survived:
                survivors.append(mutant.name)
    print(f"{len(mutants) - len(survivors)} of {len(mutants)} mutants killed")
    sys.exit(bool(survivors))


if __name__ == "__main__":
    main()
