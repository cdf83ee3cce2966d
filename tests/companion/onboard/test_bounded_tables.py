"""Whatever an authentic sender tells, what is remembered of it stays within bounds, and nobody flies into the rest."""

from __future__ import annotations

import random

import pytest

from companion.onboard.world_model import WorldModel
from companion.protocol.authenticator import Authenticator
from companion.protocol.codec import (
    AgentEntry,
    AgentMotion,
    BandEntry,
    BandsFrame,
    Directive,
    FleetFrame,
    Grid,
    MissionFrame,
    MotionFrame,
    PointMotion,
    RadiiEntry,
    RadiiFrame,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
    ThreatPlace,
)
from companion.protocol.link_quality import LinkMonitor
from companion.protocol.mavlink_signing import MAX_STREAMS, MavlinkSigner
from tests.companion.protocol.hostile import START_S, Ground

EPOCH_S = 1_790_000_000
MOST = 20
ME = 5


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.onboard.beliefs.MOST_KNOWN", MOST)


def state(number: int, *, epoch_s: int = EPOCH_S, threats: tuple[int, ...] = (), told: int | None = None) -> StateFrame:
    """Return a state frame with ids of its own for agents and targets."""
    return StateFrame(
        Stamp(epoch_s, 1000 * number, number, number % 200, 255),
        47.0,
        8.0,
        Directive.NORMAL,
        1,
        len(threats) if told is None else told,
        0,
        100,
        tuple(AgentEntry(1000 + 10 * number + k, 0.0, 0.0, None) for k in range(9)) + (AgentEntry(ME, 0.0, 0.0, 1),),
        tuple(TargetEntry(1000 + 5 * number + k, 0.0, 0.0) for k in range(4)) + (TargetEntry(1, 9.0, 9.0),),
        tuple(ThreatEntry(identity, 0.0, 1e4, 100.0, 50.0, 1.0) for identity in threats),
    )


def sizes(world: WorldModel) -> dict[str, int]:
    """Return the sizes of all tables of a world model."""
    found: dict[str, int] = {}
    for name, part in (("beliefs", world._beliefs), ("assembly", world._assembly), ("picture", world._picture)):
        found |= {f"{name}.{key}": len(value) for key, value in vars(part).items() if isinstance(value, dict | set)}
    return found | {"order.parts": len(world.order._parts)}


def test_agents_and_targets_without_end_push_out_the_ones_told_longest_ago() -> None:
    world = WorldModel(ME)
    for number in range(1, 200):
        assert world.take(state(number), EPOCH_S + number)
        assert max(sizes(world).values()) <= 256
        assert len(world._beliefs.agents) <= MOST and len(world._beliefs.targets) <= MOST
    assert world.target_id == 1
    assert world.view(EPOCH_S + 200).target_ned_m == (9.0, 9.0)


def test_with_more_threats_than_can_be_known_nobody_goes_anywhere() -> None:
    world = WorldModel(ME)
    for number in range(1, 20):
        ids = tuple(range(4 * number, 4 * number + 4))
        assert world.take(state(number, threats=ids, told=MOST), EPOCH_S + number)
        assert len(world._beliefs.threats) <= MOST
    assert world.missing == "more than 2000 threats"
    assert not world.view(EPOCH_S + 20).whole
    assert world.view(EPOCH_S + 20).target_ned_m is None


def test_threats_of_earlier_runs_make_room_for_those_of_the_newest() -> None:
    world = WorldModel(ME)
    for run in range(1, 30):
        ids = tuple(range(4 * run, 4 * run + 4))
        assert world.take(state(1, epoch_s=EPOCH_S + run, threats=ids, told=5), EPOCH_S + run)
        assert len(world._beliefs.threats) <= MOST
        assert set(ids) <= set(world._beliefs.threats)
    assert world.missing == "4 of 5 threats heard"


def test_frames_of_every_kind_with_any_ids_keep_every_table_within_bounds() -> None:
    world, quality = WorldModel(ME), LinkMonitor()
    rng = random.Random(4)
    grid = Grid(100, 0, 0)
    for number in range(1, 400):
        stamp = Stamp(EPOCH_S, 1000 * number, number, 0, 1)
        ids = rng.sample(range(1, 65_000), 4)
        frames = (
            FleetFrame(stamp, Directive.NORMAL, 1, grid, (), (), tuple(ThreatPlace(k, 0.0, 0.0, 0.0) for k in ids)),
            MotionFrame(
                stamp,
                tuple(AgentMotion(k, 0.0, 5.0, 0.0) for k in ids),
                (),
                tuple(PointMotion(k, 1.0, 0.0, 0.0) for k in ids),
            ),
            BandsFrame(stamp, tuple(BandEntry(k, 0.0, 10.0) for k in ids)),
            RadiiFrame(stamp, 1, 10, tuple(RadiiEntry(k, 10.0, 5.0, 1.0, None, 9.0) for k in ids)),
            MissionFrame(stamp, 1, 47.0, 8.0, 0.0, 1.0, 1.0, bytes(8), 3, 1, 0, "x", bytes((number % 4,)) * 8),
            state(number),
        )
        for frame in frames:
            quality.note(frame, EPOCH_S + number)
            world.take(frame, EPOCH_S + number)
        assert max(sizes(world).values()) <= 256
    assert len(quality._arrivals_s) < 1000


def test_streams_of_a_holder_of_the_shared_key_are_bounded() -> None:
    ground = Ground("mavlink", random.Random(3))
    vehicle = Authenticator(ground.trust)
    for link_id in range(200):
        raw = MavlinkSigner(ground.mavlink_key, link_id).sign(ground.unsealed(START_S + 1), START_S + 1)
        vehicle.admit(raw, START_S + 1)
    assert len(vehicle.state.streams) <= MAX_STREAMS
