"""A recorded flight is decided again, to the bit; a flight that was decided otherwise is found out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from companion.cli import cli
from companion.errors import InputError
from companion.files.tlog import read_tlog
from companion.mission.model import Burst, LinkSpec, load_mission
from companion.mission.resolve import resolve
from companion.onboard.config import Config, parse_config
from companion.onboard.replay import Replayed, replay
from companion.protocol.codec import FrameWriter, StateFrame, decode_frame
from companion.protocol.dialect import oneway
from companion.protocol.frame import raw_frame
from sim.lockstep import FlightOptions, fly

pytestmark = pytest.mark.slow

RADIO = LinkSpec(loss=0.2, burst=Burst(enter=0.05, leave=0.2), delay_s=0.3, jitter_s=0.4, duplicate=0.2, reorder=0.2)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Flown over a bad radio, with a reaction time, so that all that is told counts."""
    folder = tmp_path_factory.mktemp("flight")
    mission = resolve(load_mission("paper-dynamic"), 18).model_copy(update={"link": RADIO, "max_time_s": 300.0})
    fly(mission, 18, FlightOptions(law="routed", out=folder))
    return folder


def config_of(folder: Path, agent: int) -> Config:
    path = folder / f"companion-{agent}.yaml"
    return parse_config(path.read_text(), str(path))


def replayed(folder: Path, agent: int) -> list[Replayed]:
    return list(replay(read_tlog(folder / f"vehicle-{agent}.tlog"), config_of(folder, agent)))


@pytest.mark.parametrize("agent", [1, 2, 10])
def test_a_flight_over_a_bad_radio_is_decided_again_to_the_bit(recorded: Path, agent: int) -> None:
    again = replayed(recorded, agent)
    assert len(again) == 600
    assert all(one.same for one in again)


def test_other_settings_decide_otherwise_and_that_is_seen(recorded: Path) -> None:
    config = config_of(recorded, 1)
    slower = config.model_copy(update={"limits": config.limits.model_copy(update={"n_max": 0.5 * config.limits.n_max})})
    again = list(replay(read_tlog(recorded / "vehicle-1.tlog"), slower))
    assert not all(one.same for one in again)


def test_a_threat_moved_in_the_recording_is_seen_in_the_decisions(recorded: Path) -> None:
    def moved(raw: bytes) -> bytes:
        if raw_frame(raw).message_id != oneway.MAVLINK_MSG_ID_ONEWAY_STATE:
            return raw
        frame = decode_frame(raw_frame(raw))
        assert isinstance(frame, StateFrame)
        # Onto the vehicle's target, where they are in its way.
        own = next(agent.target_id for agent in frame.agents if agent.id == 1)
        there = next((target for target in frame.targets if target.id == own), frame.targets[0])
        threats = tuple(replace(threat, north_m=there.north_m, east_m=there.east_m) for threat in frame.threats)
        return FrameWriter().encode(replace(frame, threats=threats))

    records = [(t_s, moved(raw)) for t_s, raw in read_tlog(recorded / "vehicle-1.tlog")]
    assert not all(one.same for one in replay(records, config_of(recorded, 1)))


def test_the_program_says_that_all_decisions_are_the_same(recorded: Path) -> None:
    result = CliRunner().invoke(cli, ["replay", str(recorded / "vehicle-1.tlog")], standalone_mode=False)
    assert result.return_value == 0
    assert result.output.splitlines()[-1] == "600 decisions, none different from those in flight"


def test_the_program_fails_where_a_decision_differs(recorded: Path, tmp_path: Path) -> None:
    text = (recorded / "companion-1.yaml").read_text().replace("law: routed", "law: seed")
    (tmp_path / "other.yaml").write_text(text)
    arguments = ["replay", str(recorded / "vehicle-1.tlog"), "--config", str(tmp_path / "other.yaml")]
    result = CliRunner().invoke(cli, arguments, standalone_mode=False)
    assert result.return_value == 1
    assert "differs from the flight" in result.output


def test_a_log_without_decisions_is_refused(recorded: Path) -> None:
    arguments = ["replay", str(recorded / "broadcast.tlog"), "--config", str(recorded / "companion-1.yaml")]
    with pytest.raises(InputError, match="no decisions in it"):
        CliRunner().invoke(cli, arguments, standalone_mode=False, catch_exceptions=False)


def test_a_log_of_another_name_needs_its_settings(recorded: Path) -> None:
    with pytest.raises(InputError, match="--config is needed"):
        CliRunner().invoke(
            cli, ["replay", str(recorded / "broadcast.tlog")], standalone_mode=False, catch_exceptions=False
        )
