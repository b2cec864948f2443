"""Variants of a design have the sds that laws of information ask for."""

import numpy as np
from support.array_cases import noisy, two

from bayesdrill.report.sections.design import design_csv


def test_repeats_rates_and_channels_change_the_sds_as_information_adds_up() -> None:
    angle, speed = (np.pi / 180, 0.05), (1.0, 0.1)
    scales = {"theta_1": angle, "theta_2": angle, "w_1": speed, "w_2": speed}
    case = two(channels={name: noisy(name, *scale) for name, scale in scales.items()})
    designed = case.design(("k_s", "t_f"), high=12.0, hold=0.24, duration=4.0, draws=1).design
    sds = np.array([target.designed for target in designed.targets])
    after = {name: np.array(each) / sds for name, each in designed.variants.items()}
    assert [*after] == [
        *(f"{which} {name}" for which in ("only", "without") for name in scales),
        *("half the rate", "twice the rate", "twice the time", "2 repeats", "4 repeats"),
    ]
    # The prior is far wider than these sds, so that records alone count.
    for name, factor, tolerance in (
        ("2 repeats", 2.0**-0.5, 0.01),
        ("4 repeats", 0.5, 0.01),
        ("half the rate", 2.0**0.5, 0.05),
        ("twice the rate", 2.0**-0.5, 0.05),
    ):
        np.testing.assert_allclose(after[name], factor, rtol=tolerance, err_msg=name)
    # The determinant of the sum of two informations is at least that of each.
    assert after["only theta_2"].min() >= 1.0
    assert (after["only w_1"] >= after["without theta_2"]).all()
    assert after["twice the time"].max() < 1.0
    rows = [line.split(",") for line in design_csv(designed).splitlines()]
    assert rows[0] == ["experiment", "k_s", "t_f"]
    assert {row[0]: float(row[1]) for row in rows[1:]}["designed"] == designed.targets[0].designed
