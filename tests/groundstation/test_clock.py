"""The ground station's clock beside the computer's: sleep, steps, and vehicles that hear it again."""

from __future__ import annotations

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from companion.mission.model import parse_mission
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.frame import raw_frame
from groundstation.clock import WAITED_FOR_S, GroundClock, Sources, WallSigner, next_epoch_s
from groundstation.ground_station import GroundStation
from groundstation.schedule import Broadcaster

START_S = 1_790_000_000.0
KEY = bytes(range(32))
TEXT = """
broadcast_period_s: 5
agents: [{id: 1, north_m: 0, east_m: 0}]
targets: [{id: 1, north_m: 20000, east_m: 0}]
threats: [{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000, speed_bound_m_s: 10}]
"""


class Computer:
    """A computer that runs a ground station and can sleep, or have its clock set."""

    def __init__(self) -> None:
        self.wall_s, self.boottime_s, self.monotonic_s = START_S, 5_000.0, 4_000.0
        self.clock = GroundClock(
            Sources(lambda: self.wall_s, lambda: self.monotonic_s, lambda: self.boottime_s),
        )
        self.private = Ed25519PrivateKey.generate()
        self.signer = WallSigner(KEY, 0)
        self.station = GroundStation(parse_mission(TEXT, "clock"), self.clock.now_s())
        self._broadcaster = Broadcaster(self.station, None, FrameSigner(self.private, self.signer))
        self.words: list[str] = []

    def run(self, lasts_s: float) -> list[bytes]:
        """Run for a time, and return what was sent."""
        sent = []
        for _ in range(round(lasts_s / 0.5)):
            self.wall_s, self.boottime_s, self.monotonic_s = (
                value + 0.5 for value in (self.wall_s, self.boottime_s, self.monotonic_s)
            )
            now_s = self.clock.now_s()
            change = self.clock.watch()
            if change:
                self.station.follow_clock(self.clock.ahead_s, change.slept_s, now_s)
                self.signer.follow(self.clock.ahead_s, now_s)
                self.words += change.words()
            sent += self._broadcaster.tick(now_s)
        return sent

    def sleep(self, lasts_s: float) -> None:
        self.wall_s += lasts_s
        self.boottime_s += lasts_s


def trust(computer: Computer, word: str) -> Trust:
    return Trust(
        mavlink_key=KEY if word in ("mavlink", "both") else None,
        public_key=computer.private.public_key() if word in ("ed25519", "both") else None,
    )


@pytest.mark.parametrize("word", ["mavlink", "ed25519", "both", "unsigned"])
@pytest.mark.parametrize(
    ("event", "said"),
    [
        (lambda computer: computer.sleep(312.0), "this computer slept 312 s"),
        (lambda computer: setattr(computer, "wall_s", computer.wall_s + 312.0), "clock was set 312.0 s forward"),
        (lambda computer: setattr(computer, "wall_s", computer.wall_s - 8.0), "clock was set 8.0 s back"),
        (lambda computer: setattr(computer, "wall_s", computer.wall_s - 7_200.0), "clock was set 7200.0 s back"),
    ],
    ids=["sleep", "forward", "back", "far back"],
)
def test_after_sleep_or_a_step_a_vehicle_with_the_right_time_hears_the_station_again(
    word: str, event: object, said: str
) -> None:
    computer = Computer()
    assert callable(event)
    if "forward" in said or "back" in said:
        # The clock was wrong before, and is right now.
        computer.run(40.0)
        vehicle = Authenticator(trust(computer, word))
    else:
        vehicle = Authenticator(trust(computer, word))
        assert all(vehicle.admit(raw, computer.wall_s) for raw in computer.run(20.0)[-3:])
    event(computer)
    assert sum(len(vehicle.admit(raw, computer.wall_s)) for raw in computer.run(10.0)) >= 2
    assert [line.startswith(("this computer slept", "this computer's clock")) for line in computer.words] == [True]
    assert said in computer.words[0]


def test_a_vehicle_that_heard_the_station_hears_it_on_after_a_step_back() -> None:
    computer = Computer()
    vehicle = Authenticator(trust(computer, "ed25519"))
    assert all(vehicle.admit(raw, computer.wall_s) for raw in computer.run(40.0)[-3:])
    computer.wall_s -= 20.0
    assert all(vehicle.admit(raw, computer.wall_s) for raw in computer.run(10.0))


@given(st.floats(0.6, 1e9))
def test_whatever_the_clock_is_set_to_no_thing_is_older_for_it(step_s: float) -> None:
    computer = Computer()
    computer.run(10.0)
    before_m = computer.station._grown_radii_m(computer.clock.now_s())
    computer.wall_s += step_s
    computer.run(1.0)
    assert computer.station._grown_radii_m(computer.clock.now_s()) == pytest.approx([before_m[0] + 10.0])
    assert computer.station.epoch_s == int(computer.wall_s - 0.5) or computer.station.epoch_s == int(computer.wall_s)


def test_while_the_computer_slept_nobody_was_silent_and_every_threat_may_have_moved() -> None:
    computer = Computer()
    computer.run(10.0)
    before_m = computer.station._grown_radii_m(computer.clock.now_s())
    computer.sleep(3_600.0)
    computer.run(5.0)
    assert computer.station.tracks.progress.lost == frozenset()
    assert computer.station._grown_radii_m(computer.clock.now_s()) == pytest.approx([before_m[0] + 36_050.0])


def test_a_clock_that_is_only_slewed_is_followed_in_no_new_epoch() -> None:
    computer = Computer()
    computer.run(10.0)
    computer.wall_s += 0.4
    computer.run(10.0)
    assert (computer.words, computer.station.epoch_s) == ([], int(START_S))


@given(st.integers(0, 2**31), st.floats(0.0, 2e9))
def test_an_epoch_after_a_step_is_later_unless_no_vehicle_could_believe_that(last_s: int, wall_s: float) -> None:
    epoch_s = next_epoch_s(last_s, wall_s)
    assert epoch_s - wall_s <= WAITED_FOR_S
    assert epoch_s > last_s or last_s + 1 - wall_s > WAITED_FOR_S


def test_a_stamp_is_by_the_computers_clock() -> None:
    computer = Computer()
    computer.run(10.0)
    computer.wall_s += 100.0
    stamp = raw_frame(computer.run(10.0)[-1]).stamp
    assert stamp.epoch_s + stamp.time_ms / 1000.0 == pytest.approx(computer.wall_s, abs=5.0)
