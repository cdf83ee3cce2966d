"""The API of the ground station: what it knows, and the commands that operators and programs give it.

Everything that changes something is a command (groundstation/events.py), which the ground station accepts as an event
or refuses with its reason; this process decides only who may ask. Every refusal is a JSON object {"detail": why}.

Annotations are evaluated here, as FastAPI reads those of the routes, which name what stands around them. All routes are
coroutines: what they read belongs to the event loop.
"""

import time
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, create_model
from starlette.requests import HTTPConnection

from companion.errors import InputError
from companion.files.yaml import Section
from groundstation.events import AddTarget, AddThreat, AnyCommand, Change, Command, command_from
from groundstation.web.access import SESSION_S, Access
from groundstation.web.feed import Feed, Refused
from groundstation.web.guards import headers_of
from groundstation.web.hub import Hub
from groundstation.web.pipe import CLOCK, Message, Who
from groundstation.web.reckoning import Reckoning
from groundstation.web.site import Site

MOST_ID = 65_535
"""Greatest id in a path: ids are 16 bits wide on the wire."""
Id = Annotated[int, Path(ge=0, le=MOST_ID)]
Json = dict[str, Any]


class Refusal(BaseModel):
    """Why a request was not obeyed."""

    detail: str


class Session(BaseModel):
    """Who asks, what that allows, and what the site shows."""

    name: str
    role: Literal["observer", "operator"]
    login: bool
    """Whether there is a session that can be ended."""
    mode: Literal["live", "sim", "playback"]
    tiles: bool
    """Whether there are map tiles under /tiles."""


class Health(BaseModel):
    """That the ground station is well."""

    status: str


class LogIn(BaseModel):
    """A token of `groundstation token`."""

    model_config = ConfigDict(extra="forbid")
    token: Annotated[str, Field(min_length=1, max_length=200)]


class PlaybackControl(BaseModel):
    """What a playback is to do; what is left out stays."""

    model_config = ConfigDict(extra="forbid")
    at_s: Annotated[float, Field(allow_inf_nan=False)] | None = None
    speed: Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)] | None = None
    playing: bool | None = None


class NewTarget(AddTarget):
    """A target to add."""

    do: Literal["add-target"] = "add-target"


class NewThreat(AddThreat):
    """A threat to add."""

    do: Literal["add-threat"] = "add-threat"


def _changes(name: str, left_out: tuple[str, ...]) -> type[Section]:
    """Return the model of a change without what its path says."""
    fields: dict[str, Any] = {
        key: (field.annotation, field) for key, field in Change.model_fields.items() if key not in left_out
    }
    return create_model(name, __base__=Section, **fields)


_OF_THREATS = ("radius_m", "detection_radius_m", "attack_radius_m", "floor_m", "ceiling_m")
TargetChange = _changes("TargetChange", ("do", "kind", "id", *_OF_THREATS))
ThreatChange = _changes("ThreatChange", ("do", "kind", "id"))

_WORDS = {
    400: "The request cannot be read",
    401: "A token, a session or a client certificate is needed",
    403: "Not allowed: for operators only, or asked by another site's page",
    404: "There is no such thing",
    408: "The body did not come in time",
    409: "The ground station refuses it, and says why",
    413: "The body is too long",
    415: "The body is no JSON",
    421: "The Host header is not this site's",
    422: "A value is not allowed",
    429: "Too many requests",
    503: "The ground station has not told it yet, or does not answer",
}


def answers(*codes: int) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of refusals with these codes, beside those that every request may meet."""
    return {code: {"model": Refusal, "description": _WORDS[code]} for code in sorted({*codes, 401, 403, 421, 429})}


_COMMANDED = answers(400, 408, 409, 413, 415, 422, 503)


class Api:
    """What the routes work with: the hub, the feed, and who may ask."""

    def __init__(self, site: Site, hub: Hub, feed: Feed, access: Access) -> None:
        self.site = site
        self.hub = hub
        self.feed = feed
        self.access = access
        self.reckoning = Reckoning(hub)

    async def who(self, request: HTTPConnection) -> Who:
        """Return who asks, also for a stream; raises Refused 401 if nobody is known."""
        state = request.scope.get("state", {})
        who = self.access.who(headers_of(request.scope), state.get("peer_certificate"), time.time())
        if who is None:
            raise Refused("no token, or one that is not known; allowed: one of `groundstation token`", 401)
        return who

    async def operator(self, request: Request) -> Who:
        """Return who asks; raises Refused 401 if nobody is known, 403 if that is no operator."""
        who = await self.who(request)
        if who.role != "operator":
            raise Refused(f"{who.name} is {who.role}; allowed: for an operator only", 403)
        return who

    async def player(self, request: Request) -> Who:
        """Return who asks for another pace: anybody of a recorded run, but only an operator of a simulator."""
        return await (self.operator(request) if self.site.mode == "sim" else self.who(request))

    async def obey(self, who: Who, command: Command) -> Message:
        """Return the event that a command became; raises Refused."""
        return await self.feed.command(who, command.model_dump(mode="json", exclude_unset=True))

    def command(self, do: str, given: Mapping[str, Any]) -> Command:
        """Return the command in a path and a body; raises Refused 422."""
        try:
            return command_from({"do": do, **given})
        except InputError as error:
            raise Refused(str(error), 422) from error

    def picture(self) -> Json:
        """Return the newest picture; raises Refused 503 before the first."""
        if self.hub.picture is None:
            raise Refused("no picture yet; allowed: a second after the start", 503)
        return self.hub.picture


def api_router(api: Api) -> APIRouter:
    """Return the routes under /api/v1."""
    router = APIRouter(prefix="/api/v1")
    _add_session(router, api)
    _add_reading(router, api)
    _add_commands(router, api)
    for kind, new, change in (("target", NewTarget, TargetChange), ("threat", NewThreat, ThreatChange)):
        _add_things(router, api, kind, new, change)
    return router


def _add_session(router: APIRouter, api: Api) -> None:
    def session(who: Who, login: bool) -> Session:
        role: Literal["observer", "operator"] = "operator" if who.role == "operator" else "observer"
        return Session(name=who.name, role=role, login=login, mode=api.site.mode, tiles=api.site.tiles is not None)

    @router.get("/session", responses=answers(), summary="Say who asks", tags=["session"])
    async def get_session(request: Request, who: Annotated[Who, Depends(api.who)]) -> Session:
        return session(who, api.access.cookie in request.cookies)

    @router.post("/session", responses=answers(400, 408, 413, 415, 422), summary="Log in", tags=["session"])
    async def log_in(login: LogIn, response: Response) -> Session:
        now_s = time.time()
        value, who = api.access.begin_session(login.token, now_s), api.access.holder(login.token)
        if value is None or who is None:
            raise Refused("the token is not known; allowed: one of `groundstation token`", 401)
        is_tls = api.site.certificate is not None
        response.set_cookie(
            api.access.cookie, value, max_age=int(SESSION_S), secure=is_tls, httponly=True, samesite="strict"
        )
        return session(who, True)

    @router.delete("/session", responses=answers(413, 415), summary="Log out", tags=["session"], status_code=204)
    async def log_out() -> Response:
        response = Response(status_code=204)
        is_tls = api.site.certificate is not None
        response.delete_cookie(api.access.cookie, secure=is_tls, httponly=True, samesite="strict")
        return response


def _add_reading(router: APIRouter, api: Api) -> None:
    looks = [Depends(api.who)]

    @router.get("/picture", responses=answers(503), dependencies=looks, tags=["picture"], response_model=Json)
    async def get_picture() -> Response:
        """Return what the ground station knows: agents, targets, threats, the broadcast and its sources."""
        api.picture()
        return _as_json(api.hub.text("picture"))

    @router.get("/sources", responses=answers(503), dependencies=looks, tags=["picture"])
    async def get_sources() -> list[Json]:
        """Return the sources of live tracks, with their health."""
        sources: list[Json] = api.picture().get("sources", [])
        return sources

    @router.get("/routes", responses=answers(), dependencies=looks, tags=["picture"])
    async def get_routes() -> Json:
        """Return the routes that agents should be flying, as points [north, east] in m, by agent id."""
        text = api.hub.text("routes")
        routes: Json = {} if text is None else orjson.loads(text)["routes"]
        return routes

    @router.get("/trails", responses=answers(), dependencies=looks, tags=["picture"], response_model=Json)
    async def get_trails() -> Response:
        """Return where agents, targets and threats have been, as points [time, north, east], by id."""
        return _as_json(orjson.dumps(api.hub.trails.to_dict()))

    @router.get("/why/{agent_id}", responses=answers(404, 422, 503), dependencies=looks, tags=["picture"])
    async def get_why(agent_id: Id) -> Json:
        """Return the decision of the centre's own copy of an agent's companion, with its reasons."""
        return await api.reckoning.why(agent_id)

    @router.get("/events", responses=answers(422), dependencies=looks, tags=["events"], response_model=list[Json])
    async def get_events(after: Annotated[int, Query(ge=0, le=2**53)] = 0) -> Response:
        """Return the events with a number above `after`, in order, as many as are kept at hand."""
        return _as_json(orjson.dumps(api.hub.events_after(after)))


def _as_json(text: str | bytes | None) -> Response:
    """Return JSON that was encoded already."""
    return Response(text, media_type="application/json")


def _add_commands(router: APIRouter, api: Api) -> None:
    @router.post("/commands", responses=_COMMANDED, tags=["commands"])
    async def post_command(command: AnyCommand, who: Annotated[Who, Depends(api.operator)]) -> Json:
        """Give a command; the answer is the event that it became, once that is kept for good."""
        return dict(await api.obey(who, command))

    @router.post("/playback", responses=answers(400, 404, 408, 409, 413, 415, 422), tags=["playback"])
    async def post_playback(control: PlaybackControl, who: Annotated[Who, Depends(api.player)]) -> Json:
        """Wind, slow down, hurry, stop or go on with a playback, or a simulator's clock; the answer is its state."""
        asked = control.model_dump(exclude_none=True)
        if api.site.mode == "sim":
            return dict(await api.feed.command(who, {"do": CLOCK, **asked}))
        return dict(await api.feed.playback(asked))


def _add_things(router: APIRouter, api: Api, kind: str, new: type[Section], change: type[Section]) -> None:
    """Add the routes of targets or threats; `new` and `change` are the models of their bodies."""
    place = f"/{kind}s"
    operator = Depends(api.operator)

    async def add(thing: Section, who: Who = operator) -> Json:
        given = thing.model_dump(exclude={"do"}, exclude_unset=True)
        return dict(await api.obey(who, api.command(f"add-{kind}", given)))

    async def alter(thing_id: Id, values: Section, who: Who = operator) -> Json:
        given = values.model_dump(exclude_unset=True)
        return dict(await api.obey(who, api.command("change", {"kind": kind, "id": thing_id, **given})))

    async def retire(thing_id: Id, who: Who = operator) -> Json:
        return dict(await api.obey(who, api.command("retire", {"kind": kind, "id": thing_id})))

    add.__annotations__["thing"], alter.__annotations__["values"] = new, change
    routes = (
        (place, "POST", add, f"Add a {kind}"),
        (place + "/{thing_id}", "PATCH", alter, f"Change a {kind}"),
        (place + "/{thing_id}", "DELETE", retire, f"Retire a {kind}"),
    )
    for path, method, endpoint, summary in routes:
        router.add_api_route(
            path,
            endpoint,
            methods=[method],
            responses=_COMMANDED,
            summary=summary,
            tags=[f"{kind}s"],
            operation_id=f"{method.lower()}_{kind}",
        )
