"""The API: what it tells, what it asks of the ground station, and how it refuses."""

from __future__ import annotations

import orjson
import pytest

from groundstation.web.feed import Refused
from groundstation.web.guards import MOST_BODY_BYTES
from groundstation.web.limits import CHANGES
from groundstation.web.pipe import Who
from tests.groundstation.web.web_site import URL, Served, why

JSON = {"content-type": "application/json"}


@pytest.fixture(scope="module")
def site() -> Served:
    return Served()


@pytest.fixture
def served(site: Served) -> Served:
    site.reset()
    return site


def test_the_newest_picture_is_told_and_before_the_first_that_there_is_none(served: Served) -> None:
    assert why(served.ask("GET", "/api/v1/picture")).startswith("no picture yet")
    served.hub.message({"type": "picture", "t_s": 1.0, "sources": [{"name": "adsb"}]})
    served.hub.message({"type": "picture", "t_s": 2.0, "sources": [{"name": "ais"}]})
    assert served.ask("GET", "/api/v1/picture").json()["t_s"] == 2.0
    assert served.ask("GET", "/api/v1/sources").json() == [{"name": "ais"}]


def test_events_are_told_after_the_one_that_is_named(served: Served) -> None:
    for number in (1, 2, 3):
        served.hub.message({"type": "event", "event": {"number": number}})
    assert served.ask("GET", "/api/v1/events?after=1").json() == [{"number": 2}, {"number": 3}]


def test_a_command_is_passed_on_with_who_gave_it_and_answered_by_its_event(served: Served) -> None:
    answer = served.ask("POST", "/api/v1/commands", {"do": "take-out", "agent": 3})
    assert answer.status_code == 200
    assert answer.json()["event"] == "take-out"
    assert served.feed.commands == [(Who("local", "operator"), {"do": "take-out", "agent": 3})]


@pytest.mark.parametrize(
    ("method", "path", "body", "command"),
    [
        ("POST", "/targets", {"north_m": 1.0, "east_m": 2.0}, {"do": "add-target", "north_m": 1.0, "east_m": 2.0}),
        (
            "POST",
            "/threats",
            {"lat_deg": 1.0, "lon_deg": 2.0, "radius_m": 50},
            {"do": "add-threat", "lat_deg": 1.0, "lon_deg": 2.0, "radius_m": 50},
        ),
        ("PATCH", "/targets/7", {"name": "quarry"}, {"do": "change", "kind": "target", "id": 7, "name": "quarry"}),
        ("PATCH", "/threats/7", {"radius_m": 9.0}, {"do": "change", "kind": "threat", "id": 7, "radius_m": 9.0}),
        ("DELETE", "/targets/7", None, {"do": "retire", "kind": "target", "id": 7}),
        ("DELETE", "/threats/7", None, {"do": "retire", "kind": "threat", "id": 7}),
    ],
)
def test_targets_and_threats_have_paths_of_their_own_that_give_the_same_commands(
    served: Served, method: str, path: str, body: object, command: object
) -> None:
    answer = served.ask(method, "/api/v1" + path, body)
    assert answer.status_code == 200, answer.text
    assert [given for _, given in served.feed.commands] == [command]


def test_what_the_ground_station_refuses_is_answered_with_its_reason(served: Served) -> None:
    served.feed.refusal = Refused("agent 9: no such agent")
    answer = served.ask("POST", "/api/v1/commands", {"do": "take-out", "agent": 9})
    assert answer.status_code == 409
    assert why(answer) == "agent 9: no such agent"


@pytest.mark.parametrize(
    ("body", "status", "reason"),
    [
        (b"[", 422, "the body is no JSON: Expecting value"),
        (b"[" * 60_000, 400, "There was an error parsing the body"),
        (b"\xff\xff", 400, "There was an error parsing the body"),
        (b"{}", 422, "do"),
        (b'{"do":"fly"}', 422, "'add-target'"),
        (b'{"do":"take-out","agent":"3"}', 422, "agent: '3'; allowed: a valid integer"),
        (b'{"do":"take-out","agent":3,"now":true}', 422, "unknown key 'now'"),
        (b'{"do":"add-target","north_m":NaN,"east_m":0}', 422, "north_m"),
        (b'{"do":"add-target","north_m":1e400,"east_m":0}', 422, "north_m"),
        (b'{"do":"add-target","north_m":1,"east_m":0,"name":"\\ud800"}', 422, "name"),
    ],
)
def test_a_body_that_is_no_command_is_refused_with_the_reason(
    served: Served, body: bytes, status: int, reason: str
) -> None:
    answer = served.ask("POST", "/api/v1/commands", content=body, headers=JSON)
    assert answer.status_code == status
    assert reason in why(answer)
    assert served.feed.commands == []


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:8750", "http://127.0.0.1:1"])
def test_a_page_of_another_site_cannot_give_a_command(served: Served, origin: str) -> None:
    answer = served.ask("POST", "/api/v1/commands", {"do": "pause"}, {"origin": origin})
    assert answer.status_code == 403
    assert "Origin" in why(answer)
    assert served.feed.commands == []


@pytest.mark.parametrize("where", ["cross-site", "same-site"])
def test_what_a_browser_says_comes_from_another_site_is_refused(served: Served, where: str) -> None:
    answer = served.ask("DELETE", "/api/v1/targets/1", headers={"sec-fetch-site": where})
    assert answer.status_code == 403
    assert why(answer).startswith("Sec-Fetch-Site")


def test_the_sites_own_page_gives_commands(served: Served) -> None:
    headers = {"origin": URL, "sec-fetch-site": "same-origin"}
    assert served.ask("POST", "/api/v1/commands", {"do": "pause"}, headers).status_code == 200


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8750", "", "127.0.0.1.evil.example", "[::1"])
def test_a_name_of_another_site_that_leads_here_is_refused(served: Served, host: str) -> None:
    answer = served.ask("GET", "/api/v1/picture", headers={"host": host})
    assert answer.status_code == 421
    assert why(answer).startswith("Host")


def test_a_body_that_is_too_long_or_no_json_is_refused_before_it_is_read(served: Served) -> None:
    long = served.ask("POST", "/api/v1/commands", content=b" " * (MOST_BODY_BYTES + 1), headers=JSON)
    form = served.ask("POST", "/api/v1/commands", content=b"do=pause", headers={"content-type": "text/plain"})
    bare = served.ask("POST", "/api/v1/commands", content=b'{"do":"pause"}')
    assert (long.status_code, form.status_code, bare.status_code) == (413, 415, 415)
    assert served.feed.commands == []


def test_commands_that_come_too_fast_are_refused_and_told_when(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("groundstation.web.guards.time.monotonic", lambda: 100.0)
    answers = [served.ask("DELETE", "/api/v1/targets/1") for _ in range(int(CHANGES.burst) + 5)]
    assert answers[0].status_code == 200
    assert answers[-1].status_code == 429
    assert int(answers[-1].headers["retry-after"]) >= 1
    assert "too many requests" in why(answers[-1])


@pytest.mark.parametrize(
    "path", ["/nothing", "/page/nothing.js", "/page/%2e%2e/api.py", "/leaflet/../../x", "/tiles/1"]
)
def test_what_is_not_there_is_refused_in_words(served: Served, path: str) -> None:
    answer = served.ask("GET", path)
    assert answer.status_code == 404
    assert why(answer) == "Not Found"


def test_every_answer_forbids_scripts_from_elsewhere_and_frames_around_it(served: Served) -> None:
    for path in ("/api/v1/session", "/leaflet/leaflet.js", "/nothing"):
        headers = served.ask("GET", path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert headers["x-frame-options"] == "DENY"


def test_leaflet_comes_from_the_installed_package(served: Served) -> None:
    answer = served.ask("GET", "/leaflet/leaflet.js")
    assert answer.status_code == 200
    assert b"Leaflet 1.9" in answer.content


def test_a_failure_of_the_program_shows_nothing_of_it(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_after: int) -> object:
        raise RuntimeError("/secret/path")

    monkeypatch.setattr(served.hub, "events_after", broken)
    answer = served.ask("GET", "/api/v1/events")
    assert answer.status_code == 500
    assert "secret" not in answer.text
    assert why(answer)


def test_a_playback_is_wound_by_whoever_may_look(served: Served) -> None:
    assert served.ask("POST", "/api/v1/playback", {"at_s": 3.0}).json() == {"type": "playback", "at_s": 3.0}
    assert served.ask("POST", "/api/v1/playback", {"speed": 0}).status_code == 422


def test_the_description_names_every_path_and_no_page_of_another_site(served: Served) -> None:
    schema = served.ask("GET", "/openapi.json").json()
    assert {"/api/v1/commands", "/api/v1/picture", "/api/v1/targets/{thing_id}"} <= schema["paths"].keys()
    assert b"cdn" not in orjson.dumps(schema)
    assert served.ask("GET", "/docs").status_code == 404
