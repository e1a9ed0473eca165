"""The supervisor's values: none missing, none out of its bounds."""

from collections.abc import Iterator
from typing import Any

import pytest

from configs.strict import parse, read_yaml
from messages.errors import ConfigError
from messages.topics import TOPICS
from safety.supervisor_config import SupervisorConfig
from tests.safety.safety_world import ROOT


def values() -> dict[str, Any]:
    return read_yaml(ROOT / "configs/stack/safety.yaml")


def keys(tree: dict[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for key, value in tree.items():
        yield (*above, key)
        if isinstance(value, dict):
            yield from keys(value, (*above, key))


def changed(path: tuple[str, ...], value: Any) -> dict[str, Any]:
    tree = values()
    branch = tree
    for key in path[:-1]:
        branch = branch[key]
    if value is None:
        del branch[path[-1]]
    else:
        branch[path[-1]] = value
    return tree


@pytest.mark.parametrize("path", list(keys(values())), ids=".".join)
def test_no_value_has_a_default(path: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError, match=path[-1]):
        parse(SupervisorConfig, changed(path, None), "stack/safety.yaml")


@pytest.mark.parametrize(("path", "bad"), [
    (("field", "lateral_margin_far_m"), 0.05), (("detection_range", "good_ratio"), 0.2),
    (("detection_range", "beams_m"), [4.0, 9.0, 6.0]), (("braking",
    "deceleration_mps2"), 0.0),
    (("rules", "localization", "gnss_stop_s"), 120.1), (("rules", "driver_override", "rate_dps"), 50.1),
    (("rules", "driver_override",
    "angle_deg"), 30.1),
    (("rules", "driver_override", "forced_s"), 1.01), (("field", "margin_m"), float("nan")), (("field",
    "slow_range_factor"),
    0.9),
    (("modes", "authorities"), []), (("field", "extra"), 1.0),
])  # fmt: skip
def test_error_names_the_key(path: tuple[str, ...], bad: Any) -> None:
    with pytest.raises(ConfigError, match=path[-1]):
        parse(SupervisorConfig, changed(path, bad), "stack/safety.yaml")


def test_what_is_lost_is_noticed_within_the_reaction_time() -> None:
    """The brake's dead time and the longest wait for what stops the machine are within τ."""
    config = parse(SupervisorConfig, values(), "stack/safety.yaml")
    decision_s = config.braking.reaction_s - config.braking.dead_time_s + 1e-9
    own = ("lidar", "imu", "wheel", "machine", "odom", "control_command", "supervisor", "order_status")
    assert [kind for kind in own if TOPICS[kind].max_age_s > decision_s] == []
    assert config.limits.max_group_age_s <= decision_s
    assert TOPICS["lidar"].period_s + config.lidar_agreement.hold_s <= decision_s
