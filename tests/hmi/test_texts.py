"""Texts of the page: the same keys and placeholders in both languages, and one for each value of a message."""

import re
from enum import Enum

import pytest

from hmi.config import LANGUAGES
from hmi.drive_view.controls import ORDERS
from hmi.drive_view.machine import ROWS
from hmi.texts import FOLDER, Texts, texts_of
from interfaces.orders.verifier import Reason
from messages.command import Mode
from messages.errors import ConfigError
from messages.motion import PositionSource
from messages.perception import HealthState, ObstacleClass
from messages.plan import PathSectionType
from messages.sensors import GnssSolution
from tests.recordings import ROOT

PLACEHOLDER = re.compile(r"\{(\w+)\}")
LITERAL = re.compile(r"\btexts\(\s*\"([a-z_.]+)\"")
GROUPS: dict[str, type[Enum]] = {
    "mode": Mode, "cause": Mode, "section": PathSectionType, "solution": GnssSolution, "source": PositionSource,
    "health": HealthState, "class": ObstacleClass, "refusal": Reason,
}  # fmt: skip


def source_files() -> list[str]:
    return [path.read_text(encoding="utf-8") for path in sorted((ROOT / "hmi").rglob("*.py"))]


def test_languages_have_the_same_keys_and_placeholders() -> None:
    english, chinese = (texts_of(language) for language in LANGUAGES)
    assert english.keys == chinese.keys
    assert len(english.keys) > 150
    for key in english.keys:
        found = [set(PLACEHOLDER.findall(texts._texts[key])) for texts in (english, chinese)]
        assert found[0] == found[1], key


@pytest.mark.parametrize("group", GROUPS)
def test_each_value_of_a_message_has_a_text(group: str) -> None:
    texts = texts_of("zh")
    for value in GROUPS[group]:
        name = value.name.lower() if isinstance(value.value, int) else value.value
        assert f"{group}.{name}" in texts


def test_each_literal_key_of_the_code_has_a_text() -> None:
    keys = {key for source in source_files() for key in LITERAL.findall(source)}
    assert len(keys) > 15
    assert not {key for key in keys if key not in texts_of("en")}


def test_orders_and_machine_rows_have_texts() -> None:
    texts = texts_of("en")
    assert all(f"order.{order}" in texts for order in ORDERS)
    assert all(f"machine.{key}" in texts for key, _ in ROWS)
    assert all(f"next.{mode}" in texts for mode in Mode)


def test_a_chinese_text_contains_chinese() -> None:
    texts = texts_of("zh")
    without = [k for k in texts.keys if not re.search(r"[\u4e00-\u9fff]", texts._texts[k])]
    assert {key for key in without if not key.startswith(("level.", "page."))} == {"cause.obstacle"}


def test_unknown_key_is_an_error_and_unknown_language_is_english() -> None:
    with pytest.raises(ConfigError, match=r"en\.yaml: no text 'mode\.flying'"):
        texts_of("en")("mode.flying")
    assert texts_of("fr").language == "en"
    assert sorted(path.stem for path in FOLDER.glob("*.yaml")) == sorted(LANGUAGES)


def test_named_value_without_a_text_is_shown_as_it_is() -> None:
    assert texts_of("en").named("place", "roof") == "roof"
    assert Texts("en", {"place.roof": "on the roof"}).named("place", "roof") == "on the roof"
