"""The trajectory of a flight: the true state of everything at every step, in memory and as `trajectory.csv`.

Scores and figures are computed from it and the mission alone. Its values in memory are rounded to the decimals of the
file, so that a score computed in flight equals the one that anybody computes from the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from companion.errors import InputError, one_line

HEADER = "t_s,kind,id,north_m,east_m,heading_deg,speed_m_s"
KINDS = ("agent", "target", "threat")
"""Kinds of objects, in the order of a step's rows."""
TIME_DECIMALS = 3
POSITION_DECIMALS = 3
HEADING_DECIMALS = 4
SPEED_DECIMALS = 3
FULL_TURN_DEG = 360.0

_FIRST_CAPACITY = 1024
"""Number of steps for which the builder's buffer has room at first; a full buffer doubles."""
_WRITE_BATCH = 1000
"""Number of steps that are formatted at once, which limits the memory of the text."""
_ROW_FORMAT = f"%.{TIME_DECIMALS}f,{{kind}},{{id}},%.{POSITION_DECIMALS}f,%.{POSITION_DECIMALS}f"
_ROW_FORMAT += f",%.{HEADING_DECIMALS}f,%.{SPEED_DECIMALS}f\n"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The true states of N agents, K targets and M threats at S samples, with ids in file order.

    Headings are in degrees clockwise from north in [0, 360). Values have no more decimals than in `trajectory.csv`.
    A target or threat that is not there at a sample, as it was added later or retired before, has NaN in it.
    """

    t_s: np.ndarray  # (S,) s, strictly increasing
    agent_ids: tuple[int, ...]
    target_ids: tuple[int, ...]
    threat_ids: tuple[int, ...]
    agents_ned_m: np.ndarray  # (S, N, 2) north, east m
    agents_heading_deg: np.ndarray  # (S, N) deg
    agents_speed_m_s: np.ndarray  # (S, N) m/s
    targets_ned_m: np.ndarray  # (S, K, 2) north, east m
    targets_heading_deg: np.ndarray  # (S, K) deg
    targets_speed_m_s: np.ndarray  # (S, K) m/s
    threats_ned_m: np.ndarray  # (S, M, 2) north, east m
    threats_heading_deg: np.ndarray  # (S, M) deg
    threats_speed_m_s: np.ndarray  # (S, M) m/s

    def write_csv(self, path: Path) -> None:
        """Write `trajectory.csv`: per step the agents, the targets, the threats. The same data give the same bytes.

        Raises:
            OSError: the file cannot be written.

        """
        with path.open("w", encoding="ascii", newline="\n") as file:
            file.write(HEADER + "\n")
            for text, _ in self.csv_text():
                file.write(text)

    def csv_text(self) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the text of all rows, some steps at a time, and the number of rows of each of these steps."""
        ids_by_kind = (self.agent_ids, self.target_ids, self.threat_ids)
        formats = [
            _ROW_FORMAT.format(kind=kind, id=identity)
            for kind, ids in zip(KINDS, ids_by_kind, strict=True)
            for identity in ids
        ]
        step_format = "".join(formats)
        values = self._rows()  # (S, (N + K + M) * 5)
        for begin in range(0, len(values), _WRITE_BATCH):
            batch = values[begin : begin + _WRITE_BATCH]
            there = ~np.isnan(batch[:, 1::5])  # (C, N + K + M)
            if there.all():
                text = "".join([step_format % tuple(row) for row in batch.tolist()])
            else:
                text = "".join([_step_text(formats, *step) for step in zip(batch, there, strict=True)])
            yield text, there.sum(axis=1)

    def _rows(self) -> np.ndarray:
        """Return (S, (N + K + M) * 5): time, north, east, heading, speed of each object, in the file's order."""
        ned_m = np.concatenate((self.agents_ned_m, self.targets_ned_m, self.threats_ned_m), axis=1)
        heading_deg = np.concatenate(
            (self.agents_heading_deg, self.targets_heading_deg, self.threats_heading_deg), axis=1
        )
        speed_m_s = np.concatenate((self.agents_speed_m_s, self.targets_speed_m_s, self.threats_speed_m_s), axis=1)
        t_s = np.broadcast_to(self.t_s[:, None], speed_m_s.shape)
        stacked = np.stack((t_s, ned_m[..., 0], ned_m[..., 1], heading_deg, speed_m_s), axis=-1)
        rows: np.ndarray = stacked.reshape(len(self.t_s), -1)
        return rows


class TrajectoryBuilder:
    """Collects the rows of each integration step, and builds the Trajectory at the end."""

    def __init__(self, agent_ids: Sequence[int], target_ids: Sequence[int], threat_ids: Sequence[int]) -> None:
        self._present: list[tuple[int, ...]] = [tuple(agent_ids), tuple(target_ids), tuple(threat_ids)]
        """Ids of the objects of each kind that the next step has, in order."""
        self._columns: list[dict[int, int]] = [{}, {}, {}]
        """Column of each object of a kind that any step has had, by id."""
        self._t_s = np.empty(_FIRST_CAPACITY)
        self._values = np.empty((_FIRST_CAPACITY, 0, 4))
        self._count = 0
        self._make_room()

    def __len__(self) -> int:
        """Return the number of steps that were recorded."""
        return self._count

    def follow(self, target_ids: Sequence[int], threat_ids: Sequence[int]) -> None:
        """Record these targets and threats from the next step on: some were added or retired."""
        self._present[1:] = [tuple(target_ids), tuple(threat_ids)]
        self._make_room()

    def _make_room(self) -> None:
        """Give every object that the next step has a column."""
        columns = self._values.shape[1]
        for of_kind, ids in zip(self._columns, self._present, strict=True):
            for identity in ids:
                of_kind.setdefault(identity, sum(map(len, self._columns)))
        more = sum(map(len, self._columns)) - columns
        if more:
            room = np.full((len(self._values), more, 4), np.nan)
            self._values = np.concatenate((self._values, room), axis=1)

    def append(self, t_s: float, agents: npt.ArrayLike, targets: npt.ArrayLike, threats: npt.ArrayLike) -> None:
        """Record one step.

        `agents` (N, 4), `targets` (K, 4) and `threats` (M, 4) hold north m, east m, heading deg, speed m/s, in the
        order of the ids. They are copied.

        Raises:
            ValueError: a shape does not fit the ids, or a value is not finite.

        """
        if self._count == len(self._t_s):
            self._t_s = np.concatenate((self._t_s, np.empty_like(self._t_s)))
            self._values = np.concatenate((self._values, np.full_like(self._values, np.nan)))
        self._t_s[self._count] = t_s
        for ids, columns, rows in zip(self._present, self._columns, (agents, targets, threats), strict=True):
            table = np.asarray(rows, dtype=float)
            if ids and table.shape != (len(ids), 4):
                raise ValueError(f"rows of shape {table.shape}; ({len(ids)}, 4) is allowed")
            if ids and not np.isfinite(table).all():
                raise ValueError("a recorded value is not finite")
            if ids:
                self._values[self._count, [columns[identity] for identity in ids]] = table
        self._count += 1

    def build(self, begin: int = 0, end: int | None = None) -> Trajectory:
        """Return the trajectory of the steps from `begin` to before `end`, rounded to the decimals of the file.

        Raises:
            ValueError: no such step was recorded, a time is not finite, or the rounded times do not increase.

        """
        end = self._count if end is None else min(end, self._count)
        if end <= begin:
            raise ValueError("no step was recorded")
        t_s = self._t_s[begin:end]
        if not np.isfinite(t_s).all():
            raise ValueError("a recorded time is not finite")
        agents, targets, threats = self._columns
        values = self._values[begin:end, [*agents.values(), *targets.values(), *threats.values()]]
        trajectory = _trajectory(t_s, (tuple(agents), tuple(targets), tuple(threats)), values)
        if (np.diff(trajectory.t_s) <= 0).any():
            raise ValueError("recorded times do not increase")
        return trajectory


class TrajectoryFile:
    """A `trajectory.csv` that grows with the flight: whatever ends the program, the file holds whole steps."""

    def __init__(self, path: Path, builder: TrajectoryBuilder) -> None:
        """Begin the file with its header; `builder` collects the steps.

        Raises:
            OSError: the file cannot be written.

        """
        self._builder = builder
        # Without a buffer of ours: what is written is the operating system's, and stays if this process is killed.
        self._file = path.open("wb", buffering=0)
        self._bytes = 0
        self.steps = 0
        """Number of steps in the file."""
        self._append(f"{HEADER}\n".encode("ascii"), np.zeros(0, dtype=int))

    def catch_up(self) -> None:
        """Write the steps that the builder has collected since the last call.

        Raises:
            OSError: the file cannot be written; it then ends with the last step that fitted whole.

        """
        while self.steps < len(self._builder):
            for text, rows in self._builder.build(self.steps, self.steps + _WRITE_BATCH).csv_text():
                self._append(text.encode("ascii"), rows)

    def close(self) -> None:
        """Write the rest and close the file.

        Raises:
            OSError: the file cannot be written; it is closed all the same.

        """
        if self._file.closed:
            return
        with self._file:
            self.catch_up()

    def _append(self, data: bytes, rows: np.ndarray) -> None:
        """Write whole steps of so many rows each (C,), or the header, which is none."""
        written = 0
        try:
            while written < len(data):
                written += self._file.write(data[written:])
        except OSError:
            whole = int(np.searchsorted(rows.cumsum(), data[:written].count(b"\n"), side="right"))
            lines = data.splitlines(keepends=True)[: int(rows[:whole].sum())]
            self._count(b"".join(lines), whole)
            self._file.truncate(self._bytes)
            self._file.seek(self._bytes)
            raise
        self._count(data, len(rows))

    def _count(self, data: bytes, steps: int) -> None:
        self.steps += steps
        self._bytes += len(data)


def rounded_rows(rows: np.ndarray) -> np.ndarray:  # (N, 4) -> (N, 3)
    """Return north m, east m and heading deg of rows with the decimals that they have in a trajectory."""
    rounded: np.ndarray = np.empty((len(rows), 3))
    rounded[:, :2] = _rounded(rows[:, :2], POSITION_DECIMALS)
    rounded[:, 2] = _headings_deg(rows[:, 2])
    return rounded


def read_csv(path: Path, *, things_change: bool = False) -> Trajectory:
    """Read a `trajectory.csv`; with `things_change` targets and threats may be added and retired between its steps.

    Raises:
        InputError: the file is missing or damaged (named with its line): another header, a row of the wrong length, a
            value that is not a finite number, a row missing or out of order within a step, times that do not increase.

    """
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a trajectory: {one_line(str(error))}") from error
    if not lines or lines[0] != HEADER:
        found = lines[0][:80] if lines else ""
        raise InputError(f"{path}: line 1: header is {found!r}; {HEADER!r} is allowed")
    rows = [line.split(",") for line in lines[1:]]
    for number, row in enumerate(rows, start=2):
        if len(row) != 7:
            raise InputError(f"{path}: line {number}: {len(row)} columns; 7 are allowed")
    if not rows:
        raise InputError(f"{path}: no rows after the header; one per object and step is needed")

    if things_change:
        return _read_changing(path, rows)
    per_step = 1
    while per_step < len(rows) and rows[per_step][0] == rows[0][0]:
        per_step += 1
    ids = _ids_of_step(path, rows[:per_step])
    labels = [(kind, str(identity)) for kind, of_kind in zip(KINDS, ids, strict=True) for identity in of_kind]
    for index, row in enumerate(rows):
        kind, identity = labels[index % per_step]
        step_t_s = rows[index - index % per_step][0]
        if row[1] != kind or row[2] != identity or row[0] != step_t_s:
            raise InputError(
                f"{path}: line {index + 2}: {row[1]} {row[2]} at t_s {row[0]}; "
                f"{kind} {identity} at t_s {step_t_s} is allowed: every step lists the same objects in the same order"
            )
    if len(rows) % per_step:
        raise InputError(f"{path}: the last step has {len(rows) % per_step} rows; {per_step} are needed")

    numbers = _numbers(path, rows).reshape(-1, per_step, 5)
    t_s = numbers[:, 0, 0]
    backwards = np.flatnonzero(np.diff(t_s) <= 0)
    if backwards.size:
        line = (int(backwards[0]) + 1) * per_step + 2
        raise InputError(f"{path}: line {line}: t_s {rows[line - 2][0]} does not come after {rows[line - 3][0]}")
    return _trajectory(t_s, ids, numbers[..., 1:])


def _read_changing(path: Path, rows: Sequence[Sequence[str]]) -> Trajectory:
    """Read the rows of a file whose targets and threats are not the same at every step; the agents are."""
    numbers = _numbers(path, rows)
    begins = [index for index, row in enumerate(rows) if index == 0 or row[0] != rows[index - 1][0]]
    agents: tuple[int, ...] | None = None
    built: TrajectoryBuilder | None = None
    last_t_s = -np.inf
    for begin, end in zip(begins, [*begins[1:], len(rows)], strict=True):
        ids = _ids_of_step(path, rows[begin:end], begin + 2)
        t_s = float(numbers[begin, 0])
        if agents is None or built is None:
            agents, built = ids[0], TrajectoryBuilder(*ids)
        if ids[0] != agents:
            raise InputError(f"{path}: line {begin + 2}: agents {ids[0]}; {agents}, as at every step, are allowed")
        if t_s <= last_t_s:
            raise InputError(f"{path}: line {begin + 2}: t_s {rows[begin][0]} does not come after {rows[begin - 1][0]}")
        last_t_s = t_s
        built.follow(*ids[1:])
        tables = np.split(numbers[begin:end, 1:], np.cumsum([len(of_kind) for of_kind in ids[:2]]))
        built.append(t_s, *tables)
    assert built is not None
    return built.build()


def _ids_of_step(
    path: Path, rows: Sequence[Sequence[str]], line: int = 2
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    """Return the ids of a step's rows, the first on a line, by kind; raise InputError for a bad kind, order or id."""
    ids: tuple[list[int], list[int], list[int]] = ([], [], [])
    last = 0
    for number, row in enumerate(rows, start=line):
        if row[1] not in KINDS:
            raise InputError(f"{path}: line {number}: kind is {row[1]!r}; agent, target or threat is allowed")
        kind = KINDS.index(row[1])
        if kind < last:
            raise InputError(
                f"{path}: line {number}: {row[1]} after {KINDS[last]}; agents, targets, threats is the order"
            )
        last = kind
        if not row[2].isdecimal():
            raise InputError(f"{path}: line {number}: id is {row[2]!r}; a whole number is allowed")
        if int(row[2]) in ids[kind]:
            raise InputError(f"{path}: line {number}: {row[1]} {row[2]} twice in one step; once is allowed")
        ids[kind].append(int(row[2]))
    return tuple(ids[0]), tuple(ids[1]), tuple(ids[2])


def _numbers(path: Path, rows: Sequence[Sequence[str]]) -> np.ndarray:
    """Return (R, 5) numbers of R rows: time, north, east, heading, speed; raise InputError if one is not finite."""
    try:
        numbers = np.array([[float(row[0]), *map(float, row[3:])] for row in rows])
    except ValueError:
        numbers = np.full((1, 5), np.nan)
    if np.isfinite(numbers).all():
        return numbers
    names = HEADER.split(",")
    for number, row in enumerate(rows, start=2):
        for column in (0, 3, 4, 5, 6):
            if not _is_finite_number(row[column]):
                raise InputError(
                    f"{path}: line {number}: {names[column]} is {row[column]!r}; a finite number is allowed"
                )
    raise AssertionError("a value was not finite, yet every field is a finite number")


def _step_text(formats: Sequence[str], values: np.ndarray, there: np.ndarray) -> str:
    """Return the rows of the objects that are there at a step: values (5 each) and whether they are, in one order."""
    kept = "".join([one for one, is_there in zip(formats, there, strict=True) if is_there])
    return kept % tuple(values.reshape(-1, 5)[there].ravel().tolist())


def _is_finite_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _trajectory(
    t_s: np.ndarray, ids: tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]], values: np.ndarray
) -> Trajectory:
    """Return the rounded Trajectory of times (S,) s and values (S, N + K + M, 4): north, east, heading, speed."""
    ned_m = _rounded(values[..., :2], POSITION_DECIMALS)
    heading_deg = _headings_deg(values[..., 2])
    speed_m_s = _rounded(values[..., 3], SPEED_DECIMALS)
    first_target = len(ids[0])
    first_threat = first_target + len(ids[1])
    agents, targets, threats = (
        slice(0, first_target),
        slice(first_target, first_threat),
        slice(first_threat, None),
    )
    return Trajectory(
        t_s=_rounded(t_s, TIME_DECIMALS),
        agent_ids=ids[0],
        target_ids=ids[1],
        threat_ids=ids[2],
        agents_ned_m=ned_m[:, agents],
        agents_heading_deg=heading_deg[:, agents],
        agents_speed_m_s=speed_m_s[:, agents],
        targets_ned_m=ned_m[:, targets],
        targets_heading_deg=heading_deg[:, targets],
        targets_speed_m_s=speed_m_s[:, targets],
        threats_ned_m=ned_m[:, threats],
        threats_heading_deg=heading_deg[:, threats],
        threats_speed_m_s=speed_m_s[:, threats],
    )


def _headings_deg(heading_deg: np.ndarray) -> np.ndarray:
    """Return rounded headings in [0, 360)."""
    # Rounding can give 360 degrees again, which is north, 0.
    headings_deg: np.ndarray = _rounded(heading_deg % FULL_TURN_DEG, HEADING_DECIMALS) % FULL_TURN_DEG
    return headings_deg


def _rounded(values: np.ndarray, decimals: int) -> np.ndarray:
    """Return rounded values; adding zero turns -0.0 into 0.0, so that the file never shows "-0.000"."""
    rounded: np.ndarray = np.round(values, decimals) + 0.0
    return rounded
