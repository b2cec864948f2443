"""Which names a config may have: those that rigs share, or those of a described train."""

from pathlib import Path

from support.described_rigs import LINEAR, ROTARY

from bayesdrill.config import loading
from bayesdrill.config.schema.config import HOUSE_CONFIG
from bayesdrill.config.schema.vocabulary import HOUSE, vocabulary_of
from bayesdrill.config.yaml_source import parse
from bayesdrill.rig.models import MODELS


def test_rigs_of_one_vocabulary_share_a_config() -> None:
    for kind in MODELS.usable().values():
        rig = kind()
        assert (vocabulary_of(rig) is HOUSE) != rig.has_private_names
    assert loading.load_kind(parse(Path("x.yaml"), "model: motor_shaft")) is HOUSE_CONFIG
    rotary, linear = (loading.load_kind(parse(Path("x.yaml"), text)) for text in (ROTARY, LINEAR))
    assert rotary is loading.load_kind(parse(Path("y.yaml"), ROTARY))
    assert {*rotary.vocabulary.inputs} == {"i_motor"}
    assert {*linear.vocabulary.inputs} == {"f_first"}
    assert "theta_motor" in rotary.vocabulary.signals
    assert "theta_motor" not in rotary.vocabulary.starts
