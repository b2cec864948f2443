"""Records are simulated from configs: the bundled ones, by seed, and with the true values given."""

from pathlib import Path

import numpy as np
import pytest
from support.command_line import ROOT
from support.config_texts import write
from support.scipy_oracles import NOMINAL, by_expm

from bayesdrill.config import loading
from bayesdrill.config.records import simulation
from bayesdrill.record.formats.csv import CsvOptions, read

CONFIGS = ROOT / "configs"
BUNDLED = CONFIGS / "nominal_step.yaml"


@pytest.mark.parametrize(
    "name", ["nominal_step", "example_ties", "example_experiments", "example_servo"]
)
def test_bundled_records_are_what_simulate_makes(name: str) -> None:
    """Also of several experiments, of which one has a measured voltage, and of a servo's goal."""
    case = loading.load(CONFIGS / f"{name}.yaml")
    texts = simulation.simulate_all(case, case.config.seed)
    assert [len(texts), *texts.values()] == [
        len(case.experiments),
        *(path.read_text() for path in texts),
    ]


def test_the_bundled_record_is_the_nominal_response_with_noise_of_a_tenth() -> None:
    """Against an independent response: residuals are white, of the stated size, and alike."""
    table = read(CONFIGS / "records" / "nominal_step.csv", CsvOptions())
    t, names = table.pick("t"), ("theta_1", "theta_2", "w_1", "w_2")
    clean = by_expm(NOMINAL, t, np.zeros(5), 8.0, 0.0)[:, :4]
    noise = np.column_stack([table.pick(name) for name in names]) - clean
    assert noise.std(axis=0) == pytest.approx([0.1] * 4, rel=0.08)
    assert np.abs(noise.mean(axis=0)).max() < 4 * 0.1 / np.sqrt(len(t))
    assert np.abs(np.corrcoef(noise.T) - np.eye(4)).max() < 0.12


def test_simulated_records_differ_by_seed_and_obey_the_truth(tmp_path: Path) -> None:
    truth = ("rate: 100\n", "rate: 50\n  k_s: 0.31\n  j_1: 0.02\n")
    case = loading.load(write(tmp_path, BUNDLED.read_text(), truth))
    text = simulation.simulate(case, 1)
    assert text == simulation.simulate(case, 1) != simulation.simulate(case, 2)
    (tmp_path / "r.csv").write_text(text)
    table = read(tmp_path / "r.csv", CsvOptions())
    clean = by_expm({**NOMINAL, "k_s": 0.31, "j_1": 0.02}, table.pick("t"), np.zeros(5), 8.0, 0.0)
    assert (table.pick("w_1") - clean[:, 2]).std() == pytest.approx(0.1, rel=0.15)
