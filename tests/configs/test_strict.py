"""Strict configuration: a changed copy has no unknown keys."""

import pytest

from configs.vehicle import Fold
from messages.errors import ConfigError


def test_copy_with_a_changed_value() -> None:
    assert Fold(width_m=2.5, duration_s=8.0).model_copy(update={"width_m": 3.0}) == Fold(width_m=3.0, duration_s=8.0)


def test_copy_with_an_unknown_key_is_refused() -> None:
    with pytest.raises(ConfigError, match="Fold has no key 'wide_m'"):
        Fold(width_m=2.5, duration_s=8.0).model_copy(update={"wide_m": 3.0})
