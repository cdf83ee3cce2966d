"""Whatever is lost, late, twice or out of order: a picture that counts as whole holds every threat where it may be.

A ground station of its own tells threats that stand and threats that move, in frames of two, and now and then one is
added, retired, grows or is found elsewhere, with which the next revision begins. Its frames go through a channel that
loses, delays and repeats them. This is the premise of the proof in docs/wire.md: a back-up that is certified for ever
among the discs of a whole picture enters no threat of the broadcast.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass, replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.onboard.world_model import WorldModel
from companion.protocol.codec import (
    AgentEntry,
    Directive,
    FleetFrame,
    Frame,
    FrameReader,
    FrameWriter,
    Grid,
    MissionFrame,
    RadiiEntry,
    RadiiFrame,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
    ThreatPlace,
)

ME = 1
EPOCH_S = 1_790_000_000
PERIOD_S = 5.0
BROADCASTS = 12
PER_FRAME = 2
SIDE_M = 10_000.0
UNIT_CM = 37
MOST_M = 9_000.0
"""Radius beyond which nothing grows, so that it fits its field."""
RADII_CM = 20
MOST_LATE = 2
"""Greatest number of broadcasts by which a frame comes late."""
ERROR_M = 1e-6
LOSSES = (0.0, 0.3, 0.6, 0.9)
BURST = (0.2, 0.25)
"""Chances that a bad spell, in which every frame is lost, begins and ends with a frame."""


@dataclass(frozen=True)
class Threat:
    """A true disc; `changed` is the revision since which it is as it is, apart from moving within its bound."""

    north_m: float
    east_m: float
    radius_m: float
    bound_m_s: float
    changed: int


@dataclass(frozen=True)
class Told:
    """One broadcast: when it was made, its revision and the true threats then."""

    sequence: int
    revision: int
    threats: dict[int, Threat]

    @property
    def at_s(self) -> float:
        return EPOCH_S + PERIOD_S * self.sequence


def world(chance: random.Random) -> list[Told]:
    """Return broadcasts of a world in which revisions begin now and then."""

    def somewhere() -> float:
        return chance.uniform(-SIDE_M, SIDE_M)

    def anew(revision: int) -> Threat:
        bound_m_s = chance.choice([0.0, 0.0, 7.0])
        return Threat(somewhere(), somewhere(), chance.uniform(50.0, 900.0), bound_m_s, revision)

    revision = chance.choice([1, 254])
    threats = {identity: anew(revision) for identity in range(1, 1 + chance.randint(0, 6))}
    broadcasts = []
    for sequence in range(1, 1 + BROADCASTS):
        event = chance.choice(["add", "retire", "grow", "jump", *["nothing"] * 8]) if threats else "add"
        if event != "nothing":
            revision += 1
            identity = chance.choice([*threats]) if threats else 0
            if event == "add":
                threats = {**threats, max(threats, default=0) + 1: anew(revision)}
            elif event == "retire":
                threats = {key: threat for key, threat in threats.items() if key != identity}
            else:
                old = threats[identity]
                new = (
                    replace(old, radius_m=min(2.0 * old.radius_m, MOST_M))
                    if event == "grow"
                    else replace(old, north_m=somewhere())
                )
                threats = {**threats, identity: replace(new, changed=revision)}
        broadcasts.append(Told(sequence, revision, threats))
        threats = {key: moved(threat, chance) for key, threat in threats.items()}
    return broadcasts


def moved(threat: Threat, chance: random.Random) -> Threat:
    """Return the threat one period later: at its bound, in any direction."""
    length_m, heading_rad = threat.bound_m_s * PERIOD_S, chance.uniform(0.0, math.tau)
    return replace(
        threat,
        north_m=threat.north_m + length_m * math.cos(heading_rad),
        east_m=threat.east_m + length_m * math.sin(heading_rad),
    )


def stamped(told: Told, index: int, count: int) -> Stamp:
    return Stamp(EPOCH_S, round(1000 * PERIOD_S * told.sequence), told.sequence, index, count)


def cut(told: Told) -> list[list[int]]:
    ids = sorted(told.threats)
    return [ids[at : at + PER_FRAME] for at in range(0, len(ids), PER_FRAME)] or [[]]


def state_frames(told: Told) -> list[Frame]:
    parts = cut(told)
    return [
        StateFrame(
            stamped(told, index, len(parts)),
            47.0,
            8.0,
            Directive.NORMAL,
            told.revision % 256,
            len(told.threats),
            1,
            UNIT_CM,
            (AgentEntry(ME, 0.0, 0.0, 1),),
            (TargetEntry(1, 1.0, 1.0),),
            tuple(
                ThreatEntry(key, one.north_m, one.east_m, one.radius_m, one.radius_m / 2.0, one.bound_m_s)
                for key, one in ((key, told.threats[key]) for key in part)
            ),
        )
        for index, part in enumerate(parts)
    ]


def packed_frames(told: Told) -> list[Frame]:
    parts, revision = cut(told), told.revision % 256
    frames: list[Frame] = []
    for index, part in enumerate(parts):
        stamp, discs = stamped(told, index, len(parts)), [(key, told.threats[key]) for key in part]
        places = tuple(ThreatPlace(key, one.north_m, one.east_m, 0.0) for key, one in discs)
        grid = Grid(UNIT_CM, -128, -128)
        agents = (AgentEntry(ME, 0.0, 0.0, 1),) if index == 0 else ()
        targets = (TargetEntry(1, 1.0, 1.0),) if index == 0 else ()
        frames.append(FleetFrame(stamp, Directive.NORMAL, revision, grid, agents, targets, places))
        radii = tuple(RadiiEntry(key, one.radius_m, one.radius_m / 2.0, one.bound_m_s) for key, one in discs)
        frames.append(RadiiFrame(stamp, revision, RADII_CM, radii))
    digest = repr([(key, one.radius_m, one.changed) for key, one in sorted(told.threats.items())]).encode()
    counts = (1, 1, len(told.threats))
    stamp = stamped(told, 0, 1)
    frames.append(MissionFrame(stamp, revision, 47.0, 8.0, 0.0, 1.0, 1.0, bytes(8), *counts, "m", short(digest)))
    return frames


def short(text: bytes) -> bytes:
    return random.Random(text).randbytes(8)


def arrivals(
    broadcasts: list[Told], packed: bool, loss: float | None, chance: random.Random
) -> Iterator[tuple[float, Told, Frame]]:
    """Yield time, broadcast and content of each frame that arrives, in order; a loss of None is one in bursts."""
    writer, reader = FrameWriter(), FrameReader()
    heard, bad = [], False
    for told in broadcasts:
        for frame in packed_frames(told) if packed else state_frames(told):
            bad = chance.random() >= BURST[1] if bad else chance.random() < BURST[0]
            if bad if loss is None else chance.random() < loss:
                continue
            (decoded,) = reader.read(writer.encode(frame))
            for _ in range(chance.choice([1, 1, 2])):
                late_s = PERIOD_S * chance.choice([0, 0, 0, chance.uniform(0.0, MOST_LATE)])
                heard.append((told.at_s + late_s, told, decoded))
    yield from sorted(heard, key=lambda item: item[0])


@pytest.mark.slow
@pytest.mark.parametrize("packed", [False, True], ids=["state", "packed"])
@pytest.mark.parametrize("loss", [*LOSSES, None])
@settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(chance=st.randoms(use_true_random=False))
def test_a_picture_that_counts_as_whole_holds_every_threat_of_its_revision_where_it_may_be(
    packed: bool, loss: float | None, chance: random.Random
) -> None:
    broadcasts = world(chance)
    model, newest, whole = WorldModel(ME), -1, 0
    for now_s, told, frame in arrivals(broadcasts, packed, loss, chance):
        model.take(frame, now_s)
        newest = max(newest, told.revision)
        view = model.view(now_s)
        assert view.whole == (model.missing is None or model.missing.startswith("target"))
        if not view.whole:
            continue
        whole += 1
        held = {
            int(key): (centre, float(radius_m))
            for key, centre, radius_m in zip(view.threat_ids, view.threats_ned_m, view.detection_radius_m, strict=True)
        }
        assert set(held) == set(next(one for one in broadcasts if one.revision == newest).threats)
        # The truth of the last broadcast before now; a threat that has changed since the revision is another matter.
        true = [one for one in broadcasts if one.at_s <= now_s][-1]
        for key, threat in true.threats.items():
            if key in held and threat.changed <= newest:
                centre, radius_m = held[key]
                apart_m = math.dist(centre, (threat.north_m, threat.east_m))
                assert apart_m + threat.radius_m <= radius_m + ERROR_M
    assert whole > 0 or loss != 0.0


@pytest.mark.parametrize("packed", [False, True], ids=["state", "packed"])
def test_without_losses_the_picture_is_whole_after_every_broadcast(packed: bool) -> None:
    broadcasts, model = world(random.Random(7)), WorldModel(ME)
    assert len({told.revision for told in broadcasts}) > 3
    for told in broadcasts:
        for frame in packed_frames(told) if packed else state_frames(told):
            model.take(frame, told.at_s)
        assert model.missing is None
        assert model.view(told.at_s).threat_ids.tolist() == sorted(told.threats)
