"""The truth's log: what is written is what is read, and damage is told in one line."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.errors import InputError
from sim.trajectory import HEADER, Trajectory, TrajectoryBuilder, TrajectoryFile, read_csv

WRITE_LIMIT_S = 1.5
"""For 5000 steps of 19 objects."""


def built(steps: int = 3, seed: int = 1, agents: int = 2, targets: int = 1, threats: int = 1) -> Trajectory:
    generator = np.random.default_rng(seed)
    builder = TrajectoryBuilder(range(1, agents + 1), range(1, targets + 1), range(7, threats + 7))
    for step in range(steps):
        tables = [generator.uniform(-1e5, 1e5, (count, 4)) for count in (agents, targets, threats)]
        builder.append(step * 0.5, *tables)
    return builder.build()


def same(first: Trajectory, second: Trajectory) -> bool:
    return all(
        np.array_equal(getattr(first, field.name), getattr(second, field.name))
        for field in dataclasses.fields(Trajectory)
    )


def lines_of(trajectory: Trajectory, path: Path) -> list[str]:
    trajectory.write_csv(path)
    return path.read_text().splitlines()


def fault(path: Path, lines: list[str]) -> str:
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as caught:
        read_csv(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


@pytest.mark.slow
@settings(max_examples=50)
@given(
    counts=st.tuples(st.integers(1, 3), st.integers(0, 2), st.integers(0, 2)),
    steps=st.integers(1, 6),
    data=st.data(),
)
def test_what_is_read_equals_what_was_in_memory_bit_for_bit(
    counts: tuple[int, int, int], steps: int, data: st.DataObject
) -> None:
    builder = TrajectoryBuilder(*(range(1, count + 1) for count in counts))
    for step in range(steps):
        tables = [data.draw(arrays(float, (count, 4), elements=st.floats(-1e6, 1e6))) for count in counts]
        builder.append(0.1 * step, *tables)
    trajectory = builder.build()
    with tempfile.TemporaryDirectory() as folder:
        trajectory.write_csv(Path(folder) / "trajectory.csv")
        assert same(read_csv(Path(folder) / "trajectory.csv"), trajectory)


def test_rows_are_agents_then_targets_then_threats_at_every_step(tmp_path: Path) -> None:
    builder = TrajectoryBuilder([4, 2], [9], [1])
    for t_s in (0.0, 0.5):
        agents = [[1.0, 2.0, 90.0, 60.0], [3.0, 4.0, 0.00004, 60.0]]
        builder.append(t_s, agents, [[-5.0004, 6.0, 0.0, 0.0]], [[7.0, 8.9996, 359.99999, 1.5]])
    lines = lines_of(builder.build(), tmp_path / "trajectory.csv")
    assert lines == [
        "t_s,kind,id,north_m,east_m,heading_deg,speed_m_s",
        "0.000,agent,4,1.000,2.000,90.0000,60.000",
        "0.000,agent,2,3.000,4.000,0.0000,60.000",
        "0.000,target,9,-5.000,6.000,0.0000,0.000",
        "0.000,threat,1,7.000,9.000,0.0000,1.500",
        "0.500,agent,4,1.000,2.000,90.0000,60.000",
        "0.500,agent,2,3.000,4.000,0.0000,60.000",
        "0.500,target,9,-5.000,6.000,0.0000,0.000",
        "0.500,threat,1,7.000,9.000,0.0000,1.500",
    ]


def test_a_negative_zero_is_never_written(tmp_path: Path) -> None:
    builder = TrajectoryBuilder([1], [], [])
    builder.append(0.0, [[-0.0, -0.0001, -0.0, -0.0]], [], [])
    assert lines_of(builder.build(), tmp_path / "trajectory.csv")[1] == "0.000,agent,1,0.000,0.000,0.0000,0.000"


def test_a_heading_west_of_north_is_written_between_0_and_360(tmp_path: Path) -> None:
    builder = TrajectoryBuilder([1], [], [])
    builder.append(0.0, [[0, 0, -90, 1]], [], [])
    assert builder.build().agents_heading_deg[0, 0] == 270


def test_the_same_data_give_the_same_bytes(tmp_path: Path) -> None:
    built(seed=3).write_csv(tmp_path / "first.csv")
    built(seed=3).write_csv(tmp_path / "second.csv")
    assert (tmp_path / "first.csv").read_bytes() == (tmp_path / "second.csv").read_bytes()


def test_the_recorder_copies_what_it_is_given() -> None:
    table = np.array([[1.0, 2.0, 3.0, 4.0]])
    builder = TrajectoryBuilder([1], [], [])
    builder.append(0.0, table, [], [])
    table[:] = 99.0
    assert builder.build().agents_ned_m[0, 0].tolist() == [1.0, 2.0]


def test_a_run_longer_than_the_first_buffer_keeps_every_step() -> None:
    builder = TrajectoryBuilder([1], [], [])
    for step in range(3_000):
        builder.append(step, [[step, 0, 0, 0]], [], [])
    assert len(builder) == 3_000
    assert builder.build().agents_ned_m[:, 0, 0].tolist() == list(range(3_000))


def test_a_row_of_the_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="allowed"):
        TrajectoryBuilder([1, 2], [], []).append(0.0, [[1, 2, 3, 4]], [], [])


def test_nothing_recorded_is_no_trajectory() -> None:
    with pytest.raises(ValueError, match="no step"):
        TrajectoryBuilder([1], [], []).build()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_refused(value: float) -> None:
    builder = TrajectoryBuilder([1], [], [])
    with pytest.raises(ValueError, match="finite"):
        builder.append(0.0, [[value, 0, 0, 0]], [], [])


def test_times_that_round_to_the_same_are_refused_on_build() -> None:
    builder = TrajectoryBuilder([1], [], [])
    for t_s in (0.0, 0.0001):
        builder.append(t_s, [[0, 0, 0, 0]], [], [])
    with pytest.raises(ValueError, match="increase"):
        builder.build()


def test_five_thousand_steps_of_nineteen_objects_are_written_in_time(tmp_path: Path) -> None:
    trajectory = built(steps=5_000, agents=10, targets=5, threats=4)
    begin_s = time.perf_counter()
    trajectory.write_csv(tmp_path / "trajectory.csv")
    assert time.perf_counter() - begin_s < WRITE_LIMIT_S


def test_a_missing_file_is_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_csv(tmp_path / "nowhere.csv")


def test_a_file_that_is_not_text_is_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "trajectory.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        read_csv(tmp_path / "trajectory.csv")


def test_an_empty_file_is_told_in_one_line(tmp_path: Path) -> None:
    assert "header" in fault(tmp_path / "trajectory.csv", [""])


def test_another_header_is_told_in_one_line(tmp_path: Path) -> None:
    lines = lines_of(built(), tmp_path / "trajectory.csv")
    assert "header" in fault(tmp_path / "trajectory.csv", [lines[0].replace("north_m", "x"), *lines[1:]])


def test_a_header_without_rows_is_told_in_one_line(tmp_path: Path) -> None:
    assert "no rows" in fault(tmp_path / "trajectory.csv", [HEADER])


@pytest.mark.parametrize("word", ["abc", "", "nan", "inf", "1.0.0"])
@pytest.mark.parametrize("column", [3, 4, 5, 6])
def test_what_is_not_a_finite_number_is_told_with_line_and_column(tmp_path: Path, word: str, column: int) -> None:
    lines = lines_of(built(), tmp_path / "trajectory.csv")
    row = lines[6].split(",")
    row[column] = word
    message = fault(tmp_path / "trajectory.csv", [*lines[:6], ",".join(row), *lines[7:]])
    assert "line 7" in message
    assert HEADER.split(",")[column] in message


@pytest.mark.parametrize("removed", [2, 4, 5, 8, 12])
def test_a_row_missing_anywhere_is_told_in_one_line(tmp_path: Path, removed: int) -> None:
    lines = lines_of(built(), tmp_path / "trajectory.csv")
    fault(tmp_path / "trajectory.csv", lines[:removed] + lines[removed + 1 :])


def test_a_row_twice_in_the_first_step_is_told_in_one_line(tmp_path: Path) -> None:
    lines = lines_of(built(), tmp_path / "trajectory.csv")
    assert "twice" in fault(tmp_path / "trajectory.csv", [*lines[:2], lines[1], *lines[2:]])


def test_an_unknown_kind_is_told_in_one_line(tmp_path: Path) -> None:
    lines = lines_of(built(), tmp_path / "trajectory.csv")
    assert "bird" in fault(tmp_path / "trajectory.csv", [lines[0], lines[1].replace("agent", "bird"), *lines[2:]])


def test_an_id_that_is_no_number_is_told_in_one_line(tmp_path: Path) -> None:
    lines = lines_of(built(), tmp_path / "trajectory.csv")
    assert "id" in fault(tmp_path / "trajectory.csv", [lines[0], lines[1].replace("agent,1", "agent,x"), *lines[2:]])


def test_kinds_out_of_order_are_told_in_one_line(tmp_path: Path) -> None:
    lines = lines_of(built(), tmp_path / "trajectory.csv")
    assert "agents, targets, threats is the order" in fault(
        tmp_path / "trajectory.csv", [lines[0], lines[4], *lines[1:4], *lines[5:]]
    )


def test_a_row_with_a_column_too_few_is_told_in_one_line(tmp_path: Path) -> None:
    lines = lines_of(built(), tmp_path / "trajectory.csv")
    assert "columns" in fault(tmp_path / "trajectory.csv", [*lines[:3], "0.000,agent,3,1.0", *lines[3:]])


def test_times_that_go_back_are_told_in_one_line(tmp_path: Path) -> None:
    lines = lines_of(built(), tmp_path / "trajectory.csv")
    assert "come after" in fault(tmp_path / "trajectory.csv", [lines[0], *lines[5:9], *lines[1:5]])


def changing() -> TrajectoryBuilder:
    """Return a flight in which target 9 and threat 8 are added, threat 7 is retired, and threat 8 comes back."""
    builder = TrajectoryBuilder([1], [3], [7])
    for step, (targets, threats) in enumerate([([3], [7]), ([3, 9], [7, 8]), ([3, 9], []), ([3, 9], [8])]):
        builder.follow(targets, threats)
        rows = [[[10.0 * identity, step, 0.0, 1.0] for identity in ids] for ids in ([1], targets, threats)]
        builder.append(float(step), *rows)
    return builder


def test_a_thing_has_rows_only_while_it_is_there_and_what_is_read_is_what_was_recorded(tmp_path: Path) -> None:
    trajectory = changing().build()
    lines = lines_of(trajectory, tmp_path / "trajectory.csv")
    rows = [line.split(",")[:3] for line in lines[1:]]
    assert [(kind, name) for t_s, kind, name in rows if t_s == "2.000"] == [
        ("agent", "1"), ("target", "3"), ("target", "9"),
    ]  # fmt: skip
    assert [t_s for t_s, kind, name in rows if (kind, name) == ("threat", "8")] == ["1.000", "3.000"]
    read = read_csv(tmp_path / "trajectory.csv", things_change=True)
    assert (read.target_ids, read.threat_ids) == ((3, 9), (7, 8))
    assert np.array_equal(read.threats_ned_m, trajectory.threats_ned_m, equal_nan=True)
    assert np.isnan(read.threats_ned_m[2]).all()
    assert "same objects" in fault(tmp_path / "trajectory.csv", lines)


def test_a_growing_file_of_things_that_change_holds_every_step(tmp_path: Path) -> None:
    builder = changing()
    file = TrajectoryFile(tmp_path / "grown.csv", builder)
    file.close()
    builder.build().write_csv(tmp_path / "whole.csv")
    assert file.steps == 4
    assert (tmp_path / "grown.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
