"""Health and figures: 200 only while frames are sent, and numbers that are the picture's."""

from __future__ import annotations

import json
import logging
import sys
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from companion.mission.model import parse_mission
from companion.runtime.console import json_line
from groundstation.ground_station import GroundStation
from groundstation.meter import WINDOW_S, Meter
from groundstation.view import Surroundings, picture
from groundstation.web.hub import Hub
from groundstation.web.metrics import metrics_text, unhealthy
from tests.groundstation.web.web_site import Served, why

START_S = 1_790_000_000.0
MISSION = """
name: pair
broadcast_period_s: 4
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 5000}]
targets: [{id: 1, north_m: 20000, east_m: 0}]
"""


def shown(last_frame_age_s: float | None) -> dict[str, Any]:
    station = GroundStation(parse_mission(MISSION, "pair"), START_S)
    broadcast: dict[str, Any] = {
        "bytes_per_s": 90.0,
        "frames": 3,
        "bytes": 300,
        "last_frame_age_s": last_frame_age_s,
        "items": [],
    }
    sources = [{"name": "adsb", "kind": "basestation", "state": "good", "rate_hz": 4.0}]
    return picture(station, START_S, Surroundings(broadcast=broadcast, sources=sources))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now_s = [100.0]
    monkeypatch.setattr("groundstation.web.hub.time.monotonic", lambda: now_s[0])
    return now_s


def test_it_is_well_only_while_pictures_come_and_frames_are_sent(clock: list[float]) -> None:
    hub = Hub()
    assert unhealthy(hub, "live") == "the ground station has shown nothing yet"
    hub.message({"type": "mission", "mission": {"broadcast_period_s": 4.0}})
    hub.message(shown(None))
    assert unhealthy(hub, "live") == "no frame was sent yet"
    hub.message(shown(11.5))
    assert unhealthy(hub, "live") is None
    clock[0] += 1.0
    assert unhealthy(hub, "live") == "no frame was sent for 12 s"
    clock[0] += 5.0
    assert unhealthy(hub, "live") == "the ground station has shown nothing for 6 s"
    assert unhealthy(hub, "playback") is None


def test_health_is_told_to_anybody_by_its_status() -> None:
    served = Served()
    answer = served.ask("GET", "/healthz")
    assert answer.status_code == 503
    assert why(answer) == "the ground station has shown nothing yet"
    served.hub.message(shown(0.1))
    assert served.ask("GET", "/healthz").json() == {"status": "frames are sent"}


def test_figures_are_those_of_the_newest_picture_in_the_format_of_prometheus() -> None:
    hub = Hub()
    hub.message(shown(0.5))
    hub.answered.update([200, 200, 403])
    figures = {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(metrics_text(hub, "live").decode())
        for sample in family.samples
    }
    assert figures["oneway_healthy",] == 1.0
    assert figures["oneway_broadcast_frames_total",] == 3.0
    assert figures["oneway_agents", "under way"] + figures["oneway_agents", "no target"] == 2.0
    assert figures["oneway_targets", "open"] == 1.0
    assert figures["oneway_source_good", "basestation", "adsb"] == 1.0
    assert figures["oneway_http_requests_total", "200"] == 2.0
    assert figures["oneway_directive", "normal"] == 1.0
    assert ("oneway_broadcast_budget_bytes_per_second",) not in figures


def test_before_the_first_picture_the_figures_say_only_that_nothing_is_well() -> None:
    text = metrics_text(Hub(), "live").decode()
    assert "oneway_healthy 0.0" in text
    assert "oneway_agents" not in text


def test_a_meter_tells_rate_periods_and_ages_of_the_last_seconds() -> None:
    meter = Meter()
    for step in range(41):
        meter.sent("state", 100, 0.5 * step)
        if step % 4 == 0:
            meter.sent("motion", 50, 0.5 * step)
    reading = meter.reading(21.0)
    assert reading["frames"] == 52
    assert reading["last_frame_age_s"] == 1.0
    assert [(item["name"], item["period_s"]) for item in reading["items"]] == [("motion", 2.0), ("state", 0.5)]
    assert reading["bytes_per_s"] == pytest.approx((19 * 100 + 5 * 50) / WINDOW_S)
    assert meter.reading(100.0)["items"][0]["period_s"] is None


def test_a_message_as_json_is_one_line_with_its_time_and_of_a_failure_the_traceback() -> None:
    record = logging.LogRecord("groundstation", logging.WARNING, "", 0, "a %s\nb", ("ä",), None)
    line = json_line(record)
    assert "\n" not in line
    values = json.loads(line)
    assert (values["level"], values["program"], values["message"]) == ("warning", "groundstation", "a ä\nb")
    assert values["time"].endswith("+00:00")
    try:
        raise ValueError("x")
    except ValueError:
        record.exc_info = sys.exc_info()
    assert "ValueError: x" in json.loads(json_line(record))["traceback"]
