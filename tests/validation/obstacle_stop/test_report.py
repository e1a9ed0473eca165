"""Report on obstacle stops: findings and reasons first, encounters linked to time and picture, texts escaped."""

import html
import re
from typing import Any

import pytest

from validation.obstacle_stop.figures import recall_figure
from validation.obstacle_stop.report import render

NAME = "<b>Öhr & 1.mcap"
PICTURE = f"logs/{NAME}/encounter-1.png"
PNG = recall_figure([{"class": "all", "from_m": 0, "to_m": 10, "n": 1, "found": 1, "recall": 1.0, "low": 0, "high": 1}])


def encounter(outcome: str, **more: Any) -> dict[str, Any]:
    return {
        "log": NAME, "id": 7, "role": "person", "class": "person", "outcome": outcome, "entry_s": 12.5,
        "clearance_m": 9.0, "stopping_distance_m": 6.0, "margin_m": None, "stop_requested_s": 12.6,
        "impact_speed_mps": 1.5, "has_contact": True, "picture": PICTURE, "gaps": [[0.0, 1.0, 2.0]],
    } | more  # fmt: skip


@pytest.fixture
def page() -> str:
    stop = {"log": NAME, "t_s": 1.0, "until_s": 2.0, "reason": "x", "class": "unknown", "clearance_m": None,
            "objects": [], "is_stop": True, "is_false": True}  # fmt: skip
    finding = {"log": NAME, "code": "truth_offset", "text": "labels fit 1.9 m further", "numbers": {"shift_m": 1.9},
               "is_blocking": True}  # fmt: skip
    result = {
        "state": "failed", "headline": "failed: 1 of 2 encounters missed", "logs": 1, "hours": 0.1, "driven_m": 10.0,
        "findings": [finding], "not_shown": [{"log": NAME, "reason": finding["text"]}, {"log": "", "reason": "why"}],
        "encounters": [encounter("in time"), encounter("missed", id=8, picture=None)],
        "missed_share": {"count": 1, "of": 2, "low": 0.1, "high": 0.99}, "false_stops_per_hour": None,
        "false_stop_scans": {"count": 4, "of": 90, "low": 0.0, "high": 0.1}, "false_stop_causes": {"field, unknown": 2},
        "outcomes": {"in time": 1, "missed": 1}, "safe_speed_kmh": {"2x": None, "1.5x": 8.0}, "violations": [],
        "stops": [stop], "recall": [], "failed_to_read": [], "damaged": [], "run_dir": "/runs/a b",
    }  # fmt: skip
    stream = {"source": "/top", "source_type": "PointCloud2", "topic": "", "read": 0, "skipped": 3,
              "reasons": {"no fields": 3}}  # fmt: skip
    inspection = {"log": "/x", "format": "ROS 2", "span_s": 30.0, "notes": ["a <note>"], "not_shown": [], "topics": [],
                  "streams": [stream]}  # fmt: skip
    log = {"log": NAME, "first_ns": 1_700_000_000_000_000_000, "inspection": inspection}
    unread = {"log": "bad.mcap", "failed": "no lidar"}
    return render(result, [log, unread], {PICTURE: PNG})


def text_of(page: str) -> str:
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", page)).split())


def test_findings_and_reasons_come_first_and_once(page: str) -> None:
    text = text_of(page)
    order = [
        "failed: 1 of 2 encounters missed",
        "labels fit 1.9 m further",
        "shift m 1.9",
        "why",
        "Totals",
        "Encounters",
    ]
    assert [text.index(part) for part in order] == sorted(text.index(part) for part in order)
    assert text.count("labels fit 1.9 m further") == 1


def test_encounters_have_time_command_and_picture_the_bad_ones_first(page: str) -> None:
    text = text_of(page)
    assert text.index("person · missed") < text.index("person · in time")
    assert text.count("2023-11-14 22:13:32.500 UTC") == 2
    assert f"./headland import '/runs/a b/logs/{NAME}/replay.mcap' --from 9.5 --to 16.5" in text
    assert page.count('src="data:image/png;base64,') == 1
    assert "impact speed 1.50 m/s" in text
    assert "has contact yes" in text


def test_false_stops_by_scan_and_cause_and_all_streams(page: str) -> None:
    text = text_of(page)
    assert "scans with a false stop 4 of 90" in text
    assert "2 × field, unknown" in text
    assert "/top PointCloud2 0 3 3 × no fields" in text


def test_page_is_self_contained_and_escaped(page: str) -> None:
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in page
    assert "<b>Öhr" not in page
    assert "<note>" not in page
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    outside = re.sub(r'<div class="scroll">.*?</div>', "", page, flags=re.DOTALL)
    assert "<table" not in outside
