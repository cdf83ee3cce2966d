"""YAML files as the programs accept them: strict scalars, no unknown or repeated keys, one-line errors.

The mission file and the vehicle's configuration share this module: it has their base model, reads the file, and turns a
fault of validation into an InputError naming file, key, value and what is allowed.
"""

from __future__ import annotations

import errno
import re
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Strict, ValidationError, model_validator
from pydantic_core import ErrorDetails

from companion.errors import InputError, nearest_hint, one_line, printable
from companion.files.regular import read_regular

MAX_FILE_BYTES = 1_000_000
"""Largest file that is read: four times what 2000 listed agents need, and small enough for the slow YAML parser."""
MAX_VALUES = MAX_FILE_BYTES // 2
"""Greatest number of values in a file, each as often as an alias stands for it: without aliases no file has so many, as
each value takes two bytes at least."""
UNION_TAG = "kind:"
"""Beginning of the tags by which pydantic tells the members of a union apart; errors leave tags out of a key's path."""

_SHOWN_CHARACTERS = 60
"""Length to which keys and values are cut in errors."""

_UNITS = {
    "_per_s": "per s",
    "_m_s2": "m/s^2",
    "_m_s": "m/s",
    "_km": "km",
    "_m": "m",
    "_s": "s",
    "_deg": "degrees",
    "_percent": "%",
    "_hz": "Hz",
    "_mb": "MB",
    "fence": "m",
    "exclusions": "m",
    "path": "s and m",
    "weights": "m^2",
    "n_max": "g",
}
"""Units of values by how their keys end, and of those whose keys do not say it, in the order of looking."""

_MESSAGES = {
    "missing": "missing; it has no default",
    "too_short": "{actual_length} given; allowed: at least {min_length}",
    "too_long": "too many given; allowed: at most {max_length}",
}
"""Messages, by type, for those of pydantic's errors that have no value to show."""

_ALLOWED = {
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "keys with their values",
    "model_type": "keys with their values",
    "model_attributes_type": "keys with their values",
}
"""What is allowed, by type, for those of pydantic's errors that speak of Python's own types."""

SectionT = TypeVar("SectionT", bound="Section")
ItemT = TypeVar("ItemT")
AsList = Strict(False)
"""Annotation of a tuple that YAML writes as a list; the items in it are still validated strictly."""
ListOf = Annotated[tuple[ItemT, ...], AsList]


class Section(BaseModel):
    """The model of one part of a file: frozen, strict, and an unknown key is an error that names the nearest known one.

    Strict means that text, numbers and truth values are not converted into each other, and numbers must be finite. Of
    several faults one is reported: the first of the outermost part that has any.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
    converted: ClassVar[tuple[str, ...]] = ()
    """Keys that a file may have though this model does not: the model above it converts them before this one checks."""

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: object) -> object:
        if isinstance(data, Mapping):
            names = [field.alias or name for name, field in cls.model_fields.items()]
            for key in data:
                if key not in names:
                    known = (*names, *cls.converted)
                    hint = nearest_hint(str(key), known)
                    raise ValueError(f"unknown key '{printable(_cut(str(key)))}'{hint}; allowed: {', '.join(known)}")
        return data


class _Loader(yaml.SafeLoader):
    """YAML with the scalars of YAML 1.2 (1.0e11 is a number, 12:30 is not) and without duplicate keys."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, Any]]] = {}  # noqa: RUF012  (PyYAML's own class attribute)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                problem = f"key {_shown(key)} is not a word"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            if key in seen:
                problem = f"key '{_cut(key)}' is given twice"
                raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_whole(self, node: yaml.ScalarNode) -> int:
        return int(str(self.construct_scalar(node)))  # 010 is ten; YAML 1.1 would say eight


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_whole)


class _Dumper(yaml.SafeDumper):
    """A dumper that quotes every word that _Loader would read back as something else, such as a number."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, Any]]] = {}  # noqa: RUF012  (as above)


def _add_resolver(tag: str, pattern: str, first: str) -> None:
    for reader_or_writer in (_Loader, _Dumper):
        reader_or_writer.add_implicit_resolver(tag, re.compile(pattern), list(first))


_add_resolver("tag:yaml.org,2002:null", r"^(?:~|null|Null|NULL|)$", "~nN")
for _reader_or_writer in (_Loader, _Dumper):
    _reader_or_writer.yaml_implicit_resolvers[""] = [_reader_or_writer.yaml_implicit_resolvers["~"][0]]
_add_resolver("tag:yaml.org,2002:bool", r"^(?:true|True|TRUE|false|False|FALSE)$", "tTfF")
_add_resolver("tag:yaml.org,2002:int", r"^[-+]?[0-9]+$", "-+0123456789")
_add_resolver(
    "tag:yaml.org,2002:float",
    r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
    "-+.0123456789",
)


def is_there(path: Path) -> bool:
    """Return whether there is a file or folder at a path; False, too, for a text that cannot be a path."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def read_text_file(path: Path) -> str:
    """Return the text of a file, or of the one that a link leads to.

    Raises:
        InputError: it cannot be read, is a pipe, a device or a folder, exceeds MAX_FILE_BYTES or is not UTF-8.

    """
    try:
        data, _ = read_regular(path.resolve(strict=True), MAX_FILE_BYTES)
    except OSError as error:
        if error.errno == errno.EFBIG:
            raise InputError(f"{path}: too large; allowed: at most {MAX_FILE_BYTES} bytes") from error
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except RuntimeError as error:
        raise InputError(f"{path}: cannot be read: a link that leads to itself") from error
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file (byte {error.start} is not UTF-8)") from error


def dump_yaml(data: object) -> str:
    """Return YAML text that `parse_yaml` reads back to the same data."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=1_000)


def parse_yaml(text: str, source: str) -> object:
    """Return the content of a YAML document whose top is a mapping; raise InputError, naming `source`, otherwise."""
    try:
        data = yaml.load(text, Loader=_Loader)  # noqa: S506  (a SafeLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" (line {mark.line + 1}, column {mark.column + 1})" if mark is not None else ""
        problem = getattr(error, "problem", None) or str(error)
        raise InputError(f"{source}: not valid YAML: {one_line(problem)}{where}") from error
    except RecursionError as error:
        raise InputError(f"{source}: not valid YAML: nested too deeply") from error
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        # What PyYAML's constructors raise for a scalar that is not what its explicit tag (!!int, ...) says.
        raise InputError(f"{source}: not valid YAML: {_cut(one_line(str(error)))}") from error
    if data is None:
        raise InputError(f"{source}: the file is empty; a YAML mapping is expected")
    if not isinstance(data, dict):
        raise InputError(f"{source}: holds a {type(data).__name__}; a YAML mapping of keys is expected")
    return data


def with_numbers(text: str, section: str, values: Mapping[str, float], source: str) -> str:
    """Return a YAML document with numbers set in one of its sections, and everything else as it was.

    Comments and layout stay. A key that is not there goes before the section's others, a section after the document.

    Raises:
        InputError: not YAML, or the section is no mapping of its own.

    """
    parse_yaml(text, source)
    top = yaml.compose(text, Loader=_Loader)
    assert isinstance(top, yaml.MappingNode)
    found = next((value for key, value in top.value if key.value == section), None)
    if found is None:
        inner = ", ".join(f"{key}: {value:g}" for key, value in values.items())
        return f"{text.rstrip()}\n{section}: {{{inner}}}\n"
    if not isinstance(found, yaml.MappingNode) or not found.value:
        raise InputError(f"{source}: {section}: not a mapping that numbers can be written into")
    present = {key.value: value for key, value in found.value}
    first = found.value[0][0].start_mark
    between = ", " if found.flow_style else "\n" + " " * first.column
    edits = [
        (present[key].start_mark.index, present[key].end_mark.index, f"{value:g}")
        if key in present
        else (first.index, first.index, f"{key}: {value:g}{between}")
        for key, value in values.items()
    ]
    for start, end, written in sorted(edits, reverse=True):
        text = text[:start] + written + text[end:]
    return text


def validated(model: type[SectionT], data: object, source: str) -> SectionT:
    """Return parsed data as a model; raise InputError, naming `source`, with the first fault on one line."""
    try:
        if isinstance(data, Mapping) and data.keys() <= model.model_fields.keys():
            _refuse_bombs(data, source)
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{source}: {fault_text(error.errors()[0])}") from error


def _refuse_bombs(data: Mapping[str, object], source: str) -> None:
    """Raise InputError if the values are too many when those that aliases share count as often as they are there.

    A few hundred bytes of aliases can stand for more values than any computer could check one by one.
    """
    counts: dict[int, float] = {}
    total = 0.0
    for key, value in data.items():
        total += _count(value, counts)
        if total > MAX_VALUES:
            raise InputError(f"{source}: {_cut(key)}: aliases stand for too much; allowed: {MAX_VALUES} values in all")


def _count(value: object, counts: dict[int, float]) -> float:
    """Return the number of values in a value, itself included; `counts` has those of lists and mappings, by identity.

    Where a list or mapping contains itself it counts once: the model refuses it there.
    """
    if not isinstance(value, Mapping | list):
        return 1.0
    known = counts.get(id(value))
    if known is None:
        counts[id(value)] = 1.0
        parts = value.values() if isinstance(value, Mapping) else value
        known = counts[id(value)] = 1.0 + sum(_count(part, counts) for part in parts)
    return known


def _shown(value: object) -> str:
    """Return a value as text for an error; only its beginning is read, as YAML aliases can make a value without end."""
    brief = reprlib.Repr()
    brief.maxlevel = 3
    brief.maxstring = brief.maxother = brief.maxlong = 2 * _SHOWN_CHARACTERS
    return _cut(brief.repr(value))


def _cut(text: str) -> str:
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 3] + "..."


def fault_text(details: ErrorDetails) -> str:
    """Return one line about a fault that pydantic found: where, the value, and what is allowed."""
    where = ""
    for part in details["loc"]:
        if isinstance(part, int):
            where += f"[{part}]"
        elif not part.startswith(UNION_TAG):
            where += f".{part}" if where else part
    kind, before = details["type"], f"{where}: " if where else ""
    if kind in _MESSAGES:
        return one_line(f"{before}{_MESSAGES[kind].format_map(details.get('ctx', {}))}")
    message = _ALLOWED.get(kind, details["msg"].removeprefix("Value error, ").removeprefix("Input should be "))
    if kind == "value_error":
        return one_line(f"{before}{message}")
    unit = _unit(details["loc"]) if kind.startswith(("greater_than", "less_than", "float", "int", "finite")) else ""
    return one_line(f"{before}{_shown(details['input'])}; allowed: {message}{unit}")


def _unit(path: Sequence[int | str]) -> str:
    """Return the unit of a value, with a blank before it, by the keys that lead to it; empty if it has none."""
    for key in reversed(path):
        for ending, unit in _UNITS.items():
            if isinstance(key, str) and not key.startswith(UNION_TAG) and key.endswith(ending):
                return f" {unit}"
    return ""
