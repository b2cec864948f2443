"""Which names a config may have: those that rigs share, or those of a described train."""

from pathlib import Path

from support.described_rigs import LINEAR, ROTARY

from bayesdrill.config import loading
from bayesdrill.config.schema.vocabulary import HOUSE, vocabulary_of
from bayesdrill.config.yaml_source import parse
from bayesdrill.rig.models import MODELS


def test_rigs_of_one_vocabulary_share_it() -> None:
    for kind in MODELS.usable().values():
        rig = kind()
        assert (vocabulary_of(rig) is HOUSE) != rig.has_private_names
    house, rotary, linear = (
        loading.load_vocabulary(parse(Path("x.yaml"), text))
        for text in ("model: motor_shaft", ROTARY, LINEAR)
    )
    assert house is HOUSE
    assert {*rotary.inputs} == {"i_motor"}
    assert {*linear.inputs} == {"f_first"}
    assert "theta_motor" in rotary.signals
    assert "theta_motor" not in rotary.starts
