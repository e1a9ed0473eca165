"""Operational design domain: promises by condition, and strict refusal of bad values."""

import math

import pytest
import yaml

from configs.odd import OddConfig, load_odd
from configs.strict import CONFIGS, parse
from messages.errors import ConfigError
from validation.hazards.conditions import conditions_of

ODD = load_odd()
LYING, FAWN, STANDING_CHILD, WIRE = (0.18, 0.35), (0.3, 0.3), (0.9, 0.3), (1.0, 0.003)


def values():
    return yaml.safe_load((CONFIGS / "odd.yaml").read_text())


@pytest.mark.parametrize("conditions", [{}, {"stubble_height_m": 0.10}, {"crop_height_m": 0.05}])
def test_lying_persons_and_fawns_are_promised_on_bare_ground_and_stubble(conditions):
    promise = ODD.promise(conditions)
    assert promise.covers(*LYING)
    assert promise.covers(*FAWN)
    assert promise.covers(*STANDING_CHILD)
    assert not promise.covers(*WIRE)


def test_upright_persons_are_promised_up_to_crop_of_35_cm():
    promise = ODD.promise({"crop_height_m": 0.35, "visibility_m": 50.0})
    assert not promise.outside
    assert promise.covers(*STANDING_CHILD)
    assert not promise.covers(*LYING)
    assert not promise.covers(*FAWN)


@pytest.mark.parametrize("conditions", [{"crop_height_m": 0.36}, {"visibility_m": 49.0}, {"slope_deg": 20.0}])
def test_outside_nothing_is_promised(conditions):
    promise = ODD.promise(conditions)
    assert len(promise.outside) == 1
    assert not promise.covers(2.0, 2.0)


def test_a_value_that_is_no_number_is_refused():
    with pytest.raises(ConfigError, match="visibility_m nan"):
        ODD.promise({"visibility_m": math.nan})
    with pytest.raises(ConfigError, match="moon"):
        ODD.promise({"moon": 1.0})


def _changed(change):
    new = values()
    change(new)
    return new


BAD = {
    "lacks wind_mps": lambda v: v["quantities"].pop("wind_mps"),
    "moon": lambda v: v["quantities"].update(moon=[]),
    "crop_height_m needs a band": lambda v: v["quantities"].update(crop_height_m=[]),
    "easy to hard": lambda v: v["quantities"]["visibility_m"].reverse(),
    "promises more": lambda v: v["quantities"]["crop_height_m"][1].update(object_height_m=0.01),
    "object_height_m": lambda v: v["quantities"]["crop_height_m"][0].update(object_height_m=-1.0),
    "version": lambda v: v.update(version=2),
}


@pytest.mark.parametrize("expected", BAD)
def test_bad_domain_is_refused_with_key_and_value(expected):
    with pytest.raises(ConfigError, match=expected):
        parse(OddConfig, _changed(BAD[expected]), "odd.yaml")


def test_conditions_are_the_hard_end_of_an_environment():
    environment = {
        "wind_mps": [2.0, 5.0], "fog": {"visibility_m": [60.0, 90.0]}, "dust": {"ray_share": 0.01},
        "vegetation": [{"kind": "crop", "height_m": [0.3, 0.4]}, {"kind": "stubble", "height_m": 0.1}],
        "ground": {"waves": {"height_m": 0.05}, "clods": {"height_m": [0.1, 0.15]}, "side_slope_deg": [-6.0, 4.0]},
    }  # fmt: skip
    assert conditions_of({"environment": environment}) == {
        "wind_mps": 5.0, "visibility_m": 60.0, "dust_ray_share": 0.01, "crop_height_m": 0.4, "stubble_height_m": 0.1,
        "roughness_m": 0.15, "slope_deg": 6.0,
    }  # fmt: skip
    assert conditions_of({}) == {}
