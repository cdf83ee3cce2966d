"""`groundstation import`: which kind of file it is, and where the mission goes."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any, TypedDict

from companion.autopilot.kinds import KINDS
from companion.errors import InputError, nearest_hint, one_line
from companion.files.regular import read_regular
from companion.files.yaml import is_there
from companion.mission.places import Position
from companion.mission.values import MAX_KEY
from groundstation.choices import one_of, without_null
from groundstation.imports.drawing import MAX_FILE_BYTES, Drawing, plain, position, shown
from groundstation.imports.mission_text import Wanted, mission_text

MAX_HOME_ALT_M = 20_000.0


class ImportArguments(TypedDict):
    """Arguments of the command line as they were typed; None for one that was left out."""

    file: str
    out: str | None
    home: str | None
    autopilot: str | None
    agents: int


def imported(given: ImportArguments) -> tuple[str, list[str]]:
    """Return the text of a mission and what must be said about it; with `--out` write it, too.

    Raises:
        InputError: the file cannot be read or used, an argument cannot be used, or the file to write is there.

    """
    source, out = given["file"], given["out"]
    without_null({"FILE": source, "--out": out})
    if given["autopilot"] is not None:
        one_of("--autopilot", given["autopilot"], tuple(KINDS))
    if out is not None and is_there(Path(out)):
        raise InputError(f"--out: {out} is there already; allowed: the name of a new file")
    wanted = Wanted(given["autopilot"], given["agents"], None if given["home"] is None else _home(given["home"]))
    try:
        drawing = read_drawing(_content(source))
    except InputError as error:
        raise InputError(one_line(f"{source}: {error}")) from error
    name = plain(Path(source).stem)[:MAX_KEY] or "imported"
    text, notes = mission_text(drawing, wanted, name, source)
    if out is not None:
        try:
            with Path(out).open("x", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            raise InputError(f"--out: {out}: cannot be written: {error.strerror}") from error
    return text, notes


def read_drawing(content: bytes) -> Drawing:
    """Return what a file draws, of whichever of the three formats it is.

    Raises:
        InputError: it is of none of them, or cannot be used; the message begins with the place in the file.

    """
    start = content.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    try:
        if start in (b"{", b"["):
            return _read_json(content)
        if start == b"<" or content[:2] in (b"\xff\xfe", b"\xfe\xff"):
            from groundstation.imports.kml import read_kml

            return read_kml(content)
    except RecursionError as error:
        raise InputError("nested too deeply") from error
    if content[:2] == b"PK":
        raise InputError("a zip archive; allowed: KML, so of a KMZ the doc.kml in it")
    raise InputError("neither JSON nor XML; allowed: a plan of QGroundControl, KML, GeoJSON")


def _read_json(content: bytes) -> Drawing:
    try:
        data = json.loads(content.decode("utf-8-sig"), parse_constant=_refuse_constant)
    except ValueError as error:  # UnicodeDecodeError and JSONDecodeError are two of them.
        raise InputError(f"not valid JSON: {one_line(str(error))}") from error
    if not isinstance(data, dict):
        raise InputError(f"holds a {type(data).__name__}; allowed: a JSON object")
    if "fileType" not in data:
        from groundstation.imports.geojson import read_geojson

        return read_geojson(data)
    if data["fileType"] != "Plan":
        raise InputError(f"fileType: {shown(data['fileType'])}{_hint(data)}; allowed: Plan")
    from groundstation.imports.qgc_plan import read_plan

    return read_plan(data)


def _hint(data: dict[str, Any]) -> str:
    kind = data["fileType"]
    return nearest_hint(kind, ("Plan",)) if isinstance(kind, str) else ""


def _refuse_constant(word: str) -> float:
    raise ValueError(f"{word} is no number")


def _content(source: str) -> bytes:
    path = Path(source)
    try:
        content, _ = read_regular(path.resolve(strict=True), MAX_FILE_BYTES)
    except OSError as error:
        if error.errno == errno.EFBIG:
            raise InputError(f"too large; allowed: at most {MAX_FILE_BYTES} bytes") from error
        raise InputError(f"cannot be read: {error.strerror}") from error
    except RuntimeError as error:
        raise InputError("cannot be read: a link that leads to itself") from error
    return content


def _home(text: str) -> tuple[Position, float | None]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(f"--home: {shown(text)}; allowed: LAT,LON[,ALT] in degrees and metres") from error
    if len(numbers) not in (2, 3) or (len(numbers) == 3 and not abs(numbers[2]) <= MAX_HOME_ALT_M):
        raise InputError(f"--home: {shown(text)}; allowed: LAT,LON[,ALT] in degrees and metres")
    return position(numbers, "--home"), numbers[2] if len(numbers) == 3 else None
