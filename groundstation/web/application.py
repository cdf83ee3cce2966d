"""The web application: API, stream, page, map library and tiles, behind the guards."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.exceptions import RequestValidationError
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse
from starlette.staticfiles import StaticFiles

from companion.errors import printable
from companion.files.yaml import fault_text
from groundstation.events import COMMAND_WORDS
from groundstation.web.api import Api, Health, answers, api_router
from groundstation.web.feed import Refused
from groundstation.web.guards import Guards
from groundstation.web.metrics import metrics_text, unhealthy
from groundstation.web.stream import stream_router

_DESCRIPTION = "What the ground station knows and broadcasts, and the commands that it takes (docs/ground-station.md)."


def application(api: Api, hosts: list[str]) -> Guards:
    """Return the ASGI application; `hosts` are the names and addresses under which it may be asked for."""
    app = FastAPI(
        title="Ground station", version="1", description=_DESCRIPTION, docs_url=None, redoc_url=None, openapi_url=None
    )
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(Refused, _refused)
    app.add_exception_handler(HTTPException, _unserved)
    app.add_exception_handler(Exception, _failed)
    app.include_router(api_router(api))
    app.include_router(stream_router(api))
    _add_monitoring(app, api)
    _add_page(app, api)
    return Guards(app, hosts, api.site.certificate is not None, lambda status: api.hub.answered.update([status]))


def _add_monitoring(app: FastAPI, api: Api) -> None:
    @app.get("/healthz", tags=["monitoring"], responses=answers(503), response_model=Health)
    async def healthz() -> JSONResponse:
        """Say whether frames are sent: 200 only while they are. Nothing else is told, so nobody is asked who he is."""
        why = unhealthy(api.hub, api.site.mode)
        return JSONResponse({"status": "frames are sent"}) if why is None else JSONResponse({"detail": why}, 503)

    figures: dict[int | str, dict[str, Any]] = {200: {"content": {"text/plain": {"schema": {"type": "string"}}}}}
    dependencies = [Depends(api.who)]

    @app.get(
        "/metrics",
        tags=["monitoring"],
        responses=answers() | figures,
        dependencies=dependencies,
        response_class=PlainTextResponse,
    )
    async def metrics() -> PlainTextResponse:
        """Return figures in the text format of Prometheus."""
        return PlainTextResponse(metrics_text(api.hub, api.site.mode), media_type=CONTENT_TYPE_LATEST)


def _add_page(app: FastAPI, api: Api) -> None:
    page = Path(str(resources.files("groundstation.web"))) / "page"

    @app.get("/openapi.json", include_in_schema=False)
    async def schema() -> dict[str, Any]:
        return app.openapi()

    @app.get("/", include_in_schema=False)
    async def index() -> FileResponse:
        return FileResponse(page / "index.html", headers={"cache-control": "no-cache"})

    app.mount("/page", _Revalidated(directory=page, check_dir=False))
    app.mount("/leaflet", StaticFiles(directory=leaflet_folder()))
    if api.site.tiles is not None:
        app.mount("/tiles", StaticFiles(directory=api.site.tiles))


class _Revalidated(StaticFiles):
    """Files of which a browser asks each time whether they have changed: a new release must not meet old modules."""

    def file_response(self, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401
        """Return the answer with a file, or that it has not changed."""
        response = super().file_response(*args, **kwargs)
        response.headers["cache-control"] = "no-cache"
        return response


def leaflet_folder() -> Path:
    """Return the folder of Leaflet's files, as the package XStatic-Leaflet brings them."""
    spec = find_spec("xstatic.pkg.leaflet")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("No module named 'xstatic'", name="xstatic")
    return Path(spec.origin).parent / "data"


async def _invalid(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    first = dict(error.errors()[0])
    if first["type"] == "json_invalid":
        return _refusal(f"the body is no JSON: {first.get('ctx', {}).get('error', '')}", 422)
    if first["type"] == "union_tag_invalid":
        first["ctx"] = {}
    # The first part of the place says body, path or query; the second, in a body of commands, which command.
    loc = first["loc"][1:]
    loc = loc[1:] if loc and loc[0] in COMMAND_WORDS else loc
    first["loc"] = loc or (() if first["type"] == "value_error" else ("the body",))
    return _refusal(fault_text(first), 422)  # type: ignore[arg-type]


async def _refused(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, Refused)
    return _refusal(str(error), error.status)


async def _unserved(_request: Request, error: Exception) -> JSONResponse:
    # Of the framework itself: a path or method that there is not.
    assert isinstance(error, HTTPException)
    return _refusal(error.detail, error.status_code, error.headers)


def _refusal(why: str, status: int, headers: Mapping[str, str] | None = None) -> JSONResponse:
    # What was asked may stand in it, with halves of characters that no encoding has.
    return JSONResponse({"detail": printable(why)}, status, headers=headers)


async def _failed(_request: Request, _error: Exception) -> JSONResponse:
    # What went wrong stands in the log: an answer must not show paths or values of the program.
    return JSONResponse({"detail": "the ground station's page has failed; its log says where"}, 500)
