"""The table of what was measured, its remedies, and writing them into a configuration."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from pymavlink.dialects.v20 import common

from companion.cli import cli
from companion.errors import InputError
from companion.files.tlog import TlogWriter
from companion.onboard.config import LimitsSection, load_config
from companion.onboard.identification.estimators import Identified
from companion.onboard.identification.follower import Estimate
from companion.onboard.identification.identifier import End
from companion.onboard.identification.service import check_writable, report, write_limits
from companion.onboard.identification.table import Row, remedies, rows

LIMITS = LimitsSection(speed_m_s=8.0, reaction_s=0.2, braking_m_s2=2.0, wind_m_s=3.0)
SLUGGISH = Identified(
    reaction_s=Estimate(0.62, 0.58, 0.66),
    speed_reaction_s=Estimate(0.8, 0.7, 0.92),
    rate_share=Estimate(0.4, 0.37, 0.43),
    braking_m_s2=Estimate(2.4, 2.2, 2.6),
    top_speed_m_s=Estimate(8.0, 7.9, math.inf),
    asked_m_s=8.0,
)
CONFIG = """# mine
agent_id: 1
autopilot: {kind: arducopter, link: "udpin:127.0.0.1:14540"}
broadcast: {link: "udpin:127.0.0.1:14600", trust: unsigned}
limits: {speed_m_s: 8, rate_share: 1}  # guessed
"""


def table(found: Identified = SLUGGISH) -> list[Row]:
    return rows(found, LIMITS, True, 10.0)


def test_what_is_worse_gets_the_cautious_end_of_its_interval() -> None:
    assert remedies(table()) == {"reaction_s": 0.95, "rate_share": 0.35}


def test_a_remedy_stands_in_its_line() -> None:
    assert any(row.text.endswith("worse: set limits.rate_share to 0.35") for row in table())


def test_a_better_value_changes_nothing() -> None:
    better = Identified(reaction_s=Estimate(0.1, 0.05, 0.15), rate_share=Estimate(1.0, 0.98, math.inf))
    assert remedies(table(better)) == {}
    assert all(not row.worse for row in table(better))


def test_an_interval_that_reaches_what_is_reckoned_with_is_not_worse() -> None:
    assert remedies(table(Identified(braking_m_s2=Estimate(1.8, 1.5, 2.1)))) == {}


def test_reaction_and_turn_rate_are_judged_together_where_neither_interval_tells() -> None:
    creeps = Identified(reaction_s=Estimate(0.1, 0.0, 0.9), rate_share=Estimate(0.8, 0.7, math.inf))
    assert remedies(table(creeps)) == {}
    assert remedies(table(creeps._replace(turns_denied=True))) == {"rate_share": 0.7}


def test_what_a_flight_does_not_show_is_said() -> None:
    assert all("not shown by this flight" in row.text or row.name == "" for row in table(Identified()))


def test_a_wind_stronger_than_configured_is_told_with_where_it_comes_from() -> None:
    wind = Identified(wind_m_s=Estimate(5.0, 4.8, 5.2), wind_ned_m_s=(0.0, 5.0))
    text = next(row.text for row in table(wind) if row.name == "wind")
    assert "from 270 deg" in text and text.endswith("worse: set limits.wind_m_s to 5.2")


def test_the_status_tells_whether_something_is_worse() -> None:
    assert report(None, table()) == 1
    assert report(None, table(SLUGGISH._replace(reaction_s=None, speed_reaction_s=None, rate_share=None))) == 0


def test_what_is_written_is_read_back_and_all_else_stays(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(CONFIG)
    write_limits(str(path), None, table())
    assert path.read_text() == CONFIG.replace(
        "{speed_m_s: 8, rate_share: 1}", "{reaction_s: 0.95, speed_m_s: 8, rate_share: 0.35}"
    )
    assert load_config(str(path)).limits == LimitsSection(speed_m_s=8.0, reaction_s=0.95, rate_share=0.35)


def test_what_half_a_pattern_shows_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(CONFIG)
    write_limits(str(path), End("battery low", complete=False), table())
    assert path.read_text() == CONFIG


def test_a_value_that_no_rule_allows_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(CONFIG)
    with pytest.raises(InputError, match="wind_m_s: 9; allowed: less than speed_m_s 8"):
        write_limits(str(path), None, [Row("wind", "", "", True, ("wind_m_s", 9.0))])
    assert path.read_text() == CONFIG


def test_a_packaged_configuration_is_not_written() -> None:
    with pytest.raises(InputError, match="--write: 'copter-demo-1' is a packaged configuration"):
        check_writable("copter-demo-1")


def test_a_log_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["identify", "copter-demo-1", "--log", str(tmp_path / "none.tlog")])
    assert isinstance(result.exception, InputError)


def read(tmp_path: Path, frames: list[bytes], config: str = CONFIG) -> Result:
    """Return what `companion identify --log` makes of a log of these frames."""
    log, path = tmp_path / "vehicle-1.tlog", tmp_path / "c.yaml"
    path.write_text(config)
    with TlogWriter(log) as writer:
        for index, frame in enumerate(frames):
            writer.write(float(index), frame)
    return CliRunner().invoke(cli, ["identify", str(path), "--log", str(log)], standalone_mode=False)


def heartbeat(mav_type: int, system_id: int = 1) -> bytes:
    message = common.MAVLink_heartbeat_message(mav_type, common.MAV_AUTOPILOT_ARDUPILOTMEGA, 0x81, 4, 4, 3)
    return bytes(message.pack(common.MAVLink(None, srcSystem=system_id, srcComponent=1)))


def test_a_log_without_a_flight_is_no_clean_one(tmp_path: Path) -> None:
    result = read(tmp_path, [])
    assert result.return_value == 1
    assert result.output.count("not shown by this flight") == 8
    assert result.output.endswith("the log shows nothing of how the vehicle obeys\n")


def test_the_wind_alone_says_nothing_of_the_vehicle() -> None:
    assert report(None, table(Identified(wind_m_s=Estimate(1.0, 0.9, 1.1), wind_ned_m_s=(1.0, 0.0)))) == 1


def test_a_log_of_another_kind_is_refused_naming_both(tmp_path: Path) -> None:
    result = read(tmp_path, [heartbeat(common.MAV_TYPE_FIXED_WING)])
    assert isinstance(result.exception, InputError)
    assert "vehicle-1.tlog: heard ArduPilot of MAV_TYPE 1, configured autopilot.kind arducopter" in str(
        result.exception
    )


def test_a_log_of_another_system_is_refused_naming_both(tmp_path: Path) -> None:
    configured = CONFIG.replace("kind: arducopter", "kind: arducopter, system_id: 4")
    result = read(tmp_path, [heartbeat(common.MAV_TYPE_QUADROTOR, system_id=7)], configured)
    assert isinstance(result.exception, InputError)
    assert "heard system 7, configured autopilot.system_id 4" in str(result.exception)


def test_a_log_is_read_without_the_link_of_the_broadcast(tmp_path: Path) -> None:
    without = "".join(line for line in CONFIG.splitlines(keepends=True) if "broadcast" not in line)
    assert read(tmp_path, [heartbeat(common.MAV_TYPE_QUADROTOR)], without).return_value == 1


def test_a_log_is_not_read_without_the_kind_of_the_autopilot(tmp_path: Path) -> None:
    result = read(tmp_path, [], "agent_id: 1\n")
    assert isinstance(result.exception, InputError) and "c.yaml: autopilot: missing" in str(result.exception)
