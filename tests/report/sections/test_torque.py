"""Sentences about a missing torque: how good its approximation is, and what it can replace."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from support.case_tables import run_cases
from support.linear_study import LINEAR

from bayesdrill.analysis.latent_torque import ChannelMotion
from bayesdrill.analysis.run_analysis import TorqueSummary
from bayesdrill.report.sections.torque import (
    beside,
    law_sentences,
    stand_ins,
    strayed,
    torque_table,
)
from bayesdrill.rig import MotorShaft

COURSE = ChannelMotion(channel="w_1", spread=2.0, without=0.5, left=0.1, moved=1.0, strayed=0.3)
SUMMARY = TorqueSummary(
    label="", at="rotor_1", low=-0.2, high=0.3, width=0.05, rms=0.1, sd=0.02, sure=0.7, turning=1.0,
    follows=(), courses=(COURSE, replace(COURSE, channel="w_2", strayed=float("nan"))),
)  # fmt: skip


@run_cases(
    "frictions, saturation, size, words",
    [
        ((), None, 0.3, "with gravity it is an approximation"),
        ((), None, 0.7, "0.7 (`w_1`) sds of the noise, rms. Weight and inertia are NOT as sure"),
        ((), "duty", 0.7, "The loop and inertia are NOT as sure as their sds say"),
        (
            ("t_c1",),
            None,
            0.7,
            "as their sds say. Leave the friction out: the torque then shows it",
        ),
        ((), None, float("nan"), ""),
    ],
)
def test_an_approximation_that_is_off_by_more_than_half_the_noise_is_not_believed(
    frictions: tuple[str, ...], saturation: str | None, size: float, words: str
) -> None:
    rig: Any = SimpleNamespace(frictions=frictions, saturation=saturation)
    courses = (replace(COURSE, strayed=size), SUMMARY.courses[1])
    text = strayed(replace(SUMMARY, courses=courses), rig)
    assert words in text
    assert bool(text) == bool(words)
    assert ("which does little harm" in text) == (size <= 0.5)


def test_a_servo_that_saturates_is_named_before_anything_is_sampled() -> None:
    rig: Any = SimpleNamespace(frictions=(), saturation="duty")
    assert "with a servo that saturates it is an approximation" in beside(rig)


def test_residuals_with_and_without_the_torque_are_shares_of_the_spread_of_the_channel() -> None:
    assert torque_table(SUMMARY).lines[0] == ("w_1", "25 %", "5 %", "50 %")


def test_a_torque_without_any_candidate_law_has_no_share_to_name() -> None:
    text = law_sentences(SUMMARY, MotorShaft(1 / 8))
    assert text == "missing torque: it follows no speed, angle, input or time by a law known here"


def test_parameters_that_scale_with_the_size_of_the_torque_are_named_with_a_way_out() -> None:
    study = replace(LINEAR, scaled=(("k_s", "j_1", "size"),))
    text = stand_ins(study, MotorShaft(1 / 8))
    assert (
        "k_s and j_1 and size can be changed together without changing any measured signal" in text
    )
    assert text.endswith("Hold one of k_s and j_1, or measure the torque.")
