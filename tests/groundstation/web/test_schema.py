"""The API against its own description, with requests that a fuzzer makes: never a failure, every refusal says why."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, settings
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)
from starlette.types import Receive, Scope, Send

from companion.mission.model import load_mission
from groundstation.ground_station import GroundStation
from groundstation.view import Surroundings, picture
from groundstation.web.feed import Refused
from groundstation.web.limits import Limits
from groundstation.web.pipe import Who
from groundstation.web.site import Site
from groundstation.web.tokens import add_token
from tests.groundstation.web.web_site import Served

EXAMPLES = 4
"""Number of requests that are made up for each operation."""
CHECKS: Any = [
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
]


class _Reckoning:
    """Says why an agent with an even id does something."""

    async def why(self, agent_id: int) -> dict[str, Any]:
        if agent_id % 2:
            raise Refused(f"no agent {agent_id}; allowed: one of the picture's", 404)
        return {"agent": agent_id}


class _Unlimited:
    """The site, to which everybody may send as many requests as a fuzzer does."""

    def __init__(self, served: Served) -> None:
        self.served = served
        station = GroundStation(load_mission("copter-demo"), 0.0)
        served.hub.message(picture(station, 0.0, Surroundings()))
        served.api.reckoning = _Reckoning()  # type: ignore[assignment]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.served.app.limits = Limits()
        await self.served.app(scope, receive, send)


OPEN = _Unlimited(Served(hosts=("testserver",)))
SCHEMA = schemathesis.openapi.from_asgi("/openapi.json", OPEN)


@pytest.mark.slow
@SCHEMA.parametrize()
@settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
def test_whatever_is_asked_the_answer_is_as_described_and_no_failure(case: schemathesis.Case[Any]) -> None:
    response = case.call()
    assert response.status_code != 500
    case.validate_response(response, checks=CHECKS)
    if response.status_code >= 400:
        detail = response.json()["detail"]
        assert isinstance(detail, str)
        assert detail


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> _Unlimited:
    path = tmp_path_factory.mktemp("web") / "tokens.json"
    add_token(path, Who("anna", "operator"))
    return _Unlimited(Served(Site(tokens=path), hosts=("testserver",)))


def test_without_rights_no_operation_that_is_described_shows_or_changes_anything(guarded: _Unlimited) -> None:
    open_to_all = {("GET", "/healthz"), ("POST", "/api/v1/session"), ("DELETE", "/api/v1/session")}
    schema = guarded.served.ask("GET", "/openapi.json", headers={"host": "testserver"}).json()
    asked = 0
    for path, operations in schema["paths"].items():
        for method in operations:
            if (method.upper(), path) in open_to_all:
                continue
            place = path.replace("{agent_id}", "1").replace("{thing_id}", "1")
            body = BODIES.get((method.upper(), path))
            answer = guarded.served.ask(method.upper(), place, body, headers={"host": "testserver"})
            assert answer.status_code == 401, (method, path, answer.text)
            assert answer.json()["detail"]
            asked += 1
    assert asked >= 15
    assert guarded.served.feed.commands == []


BODIES = {
    ("POST", "/api/v1/commands"): {"do": "pause"},
    ("POST", "/api/v1/playback"): {"playing": True},
    ("POST", "/api/v1/targets"): {"north_m": 0, "east_m": 0},
    ("POST", "/api/v1/threats"): {"north_m": 0, "east_m": 0, "radius_m": 1},
    ("PATCH", "/api/v1/targets/{thing_id}"): {"name": "x"},
    ("PATCH", "/api/v1/threats/{thing_id}"): {"name": "x"},
}


def test_the_description_holds_no_path_of_this_computer() -> None:
    text = OPEN.served.ask("GET", "/openapi.json", headers={"host": "testserver"}).text
    assert str(Path.home()) not in text
    assert "tokens.json" not in text


def _integers(schema: Any, where: str = "") -> Iterator[tuple[str, dict[str, Any]]]:  # noqa: ANN401 JSON
    """Yield the integers that requests hold, each with where it stands in the description."""
    if isinstance(schema, list):
        for index, part in enumerate(schema):
            yield from _integers(part, f"{where}/{index}")
    elif isinstance(schema, dict):
        if schema.get("type") == "integer":
            yield where, schema
        for key, part in schema.items():
            yield from _integers(part, f"{where}/{key}")


def test_every_integer_that_can_be_asked_is_bounded_to_what_every_json_reader_keeps() -> None:
    description = OPEN.served.ask("GET", "/openapi.json", headers={"host": "testserver"}).json()
    integers = dict(_integers(description))
    assert len(integers) >= 15
    for where, schema in integers.items():
        assert "minimum" in schema and schema.get("maximum", 2**64) <= 2**53, (where, schema)


@pytest.mark.parametrize(
    "body",
    [
        {"do": "undo", "number": 2**64},
        {"do": "change", "kind": "target", "id": 10**400, "name": "x"},
        {"do": "add-target", "north_m": 10**400, "east_m": 0},
        {"do": "add-target", "north_m": 0, "east_m": 0, "name": "\ud800"},
        {"do": "pause", "\ud800": 1},
        {"do": "\ud800"},
        [],
        None,
    ],
)
def test_what_no_json_of_the_pipe_can_hold_is_refused_with_the_reason(body: object) -> None:
    headers = {"host": "testserver", "content-type": "application/json"}
    answer = OPEN.served.ask("POST", "/api/v1/commands", headers=headers, content=json.dumps(body).encode())
    assert answer.status_code == 422
    assert answer.json()["detail"].isprintable()
    assert not answer.json()["detail"].startswith(":")
