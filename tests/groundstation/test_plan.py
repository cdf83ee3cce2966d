"""The plan of a broadcast: bytes, intervals, how soon everybody knows, and how long an outage may last."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from companion.errors import InputError
from companion.mission.model import Mission, load_mission, parse_mission
from companion.mission.resolve import resolve
from companion.protocol.messages import (
    AgentEntry,
    Directive,
    FleetFrame,
    Grid,
    MissionFrame,
    MotionFrame,
    RadiiEntry,
    RadiiFrame,
    Stamp,
    TargetEntry,
    ThreatPlace,
)
from groundstation.choices import Authentication
from groundstation.plan import Air, Bursts, Item, Part, Plan, outage_limit, plan
from groundstation.radio import parse_radio
from groundstation.schedule import Sent

FLEET = Path(__file__).parents[2] / "docs" / "examples" / "fleet-500.yaml"
SMALL = """
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 5000}]
targets: [{id: 1, north_m: 20000, east_m: 0}]
threats: [{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000, speed_bound_m_s: 10}]
"""
A: Part = ("ONEWAY_FLEET", 0)
B: Part = ("ONEWAY_FLEET", 1)


@cache
def fleet() -> Mission:
    return resolve(load_mission(str(FLEET)), 1)


@cache
def planned(radio: str, authentication: Authentication, share: float = 1.0) -> Plan:
    return plan(fleet(), parse_radio(radio, share), authentication)


def item(found: Plan, name: str) -> Item:
    return next(one for one in found.items if one.name == name)


def air(sendings: list[tuple[float, Part]], needs: dict[frozenset[Part], float]) -> Air:
    return Air(tuple(sendings), needs, np.arange(0.5, 20.5, 0.25), 400.0)


def each_second(*parts: Part) -> list[tuple[float, Part]]:
    return [(second + 0.1 * place, part) for second in range(400) for place, part in enumerate(parts)]


def fleet_frame(
    index: int, agents: tuple[AgentEntry, ...] = (), targets: tuple[int, ...] = (), threat: int = 0
) -> Sent:
    threats = (ThreatPlace(threat, 0.0, 0.0, 0.0),) if threat else ()
    places = tuple(TargetEntry(target, 0.0, 0.0) for target in targets)
    return Sent(
        b"", FleetFrame(Stamp(1, 0, 1, index, 5), Directive.NORMAL, 1, Grid(1, 0, 0), agents, places, threats), 0
    )


def test_an_agent_needs_its_own_entry_its_targets_all_threats_and_what_they_are_read_with() -> None:
    ones = [
        fleet_frame(0, (AgentEntry(1, 0.0, 0.0, 7), AgentEntry(2, 0.0, 0.0, None))),
        fleet_frame(1, (AgentEntry(3, 0.0, 0.0, 8), AgentEntry(4, 0.0, 0.0, 7))),
        fleet_frame(2, targets=(7,)),
        fleet_frame(3, targets=(8,)),
        fleet_frame(4, threat=1),
        Sent(b"", RadiiFrame(Stamp(1, 0, 1), 1, 1, (RadiiEntry(1, 2.0, 1.0, 0.0),)), 0),
        Sent(b"", MissionFrame(Stamp(1, 0, 1), 1, 47.0, 8.0, 0.0, 1.0, 1.0, bytes(8), 4, 2, 1, "four", bytes(8)), 0),
        Sent(b"", MotionFrame(Stamp(1, 0, 1), (), (), ()), 0),
        Sent(b"", None, 0),
    ]
    found = Air.of([(0.1 * k, one) for k, one in enumerate(3 * ones)], 400.0)

    def fleet_parts(*indices: int) -> set[Part]:
        return {("ONEWAY_FLEET", index) for index in indices}

    everybody: set[Part] = {("ONEWAY_RADII", 0), ("ONEWAY_MISSION", 0), ("ONEWAY_FLEET", 4)}
    assert found.needs == {
        frozenset(everybody | fleet_parts(0, 2)): 0.25,
        frozenset(everybody | fleet_parts(0)): 0.25,
        frozenset(everybody | fleet_parts(1, 3)): 0.25,
        frozenset(everybody | fleet_parts(1, 2)): 0.25,
    }
    assert {part for _, part in found.sendings} == everybody | fleet_parts(0, 1, 2, 3)


@pytest.mark.parametrize("loss", [0.1, 0.3, 0.5])
def test_independent_loss_of_one_frame_a_second_takes_as_many_as_its_power_says(loss: float) -> None:
    after_s = air(each_second(A), {frozenset([A]): 1.0}).current_after_s(loss)
    sendings = math.ceil(math.log(0.001) / math.log(loss))
    assert after_s is not None
    # Switched on 0.0, 0.25, 0.5 or 0.75 s after a sending, so that the last is between one and zero seconds away.
    assert sendings - 1 <= after_s <= sendings


def test_without_loss_everybody_is_current_when_all_was_said_once() -> None:
    after_s = air(each_second(A, B), {frozenset([A, B]): 1.0}).current_after_s(0.0)
    assert after_s == pytest.approx(1.0, abs=0.02)


def test_who_needs_two_frames_waits_for_both() -> None:
    p, shares = 0.3, {}
    for name, needs in (("one", [A]), ("two", [A, B])):
        shares[name] = air(each_second(A, B), {frozenset(needs): 1.0}).current_after_s(p)
    n = next(n for n in range(1, 50) if (1.0 - p**n) ** 2 >= 0.999)
    assert shares["one"] is not None
    assert shares["two"] is not None
    assert shares["two"] > shares["one"]
    assert n - 1 <= shares["two"] <= n


def test_what_only_few_need_and_hardly_ever_comes_may_come_late() -> None:
    seldom = sorted([*each_second(A), *((50.0 * k, B) for k in range(8))])
    few = air(seldom, {frozenset([A]): 0.9995, frozenset([A, B]): 0.0005}).current_after_s(0.0)
    many = air(seldom, {frozenset([A]): 0.99, frozenset([A, B]): 0.01}).current_after_s(0.0)
    assert few is not None
    assert many is not None
    assert few <= 1.0
    assert many > 20.0


def test_what_does_not_happen_before_the_end_is_not_told() -> None:
    once = Air(((1.0, A),), {frozenset([A]): 1.0}, np.array([0.0, 0.5]), 30.0)
    assert once.current_after_s(0.5) is None
    assert once.current_after_bursts_s(Bursts(10.0, 2.0, 0.5, 1.0)) is None


@pytest.mark.parametrize("loss", [0.3, 0.5])
def test_bursts_that_are_none_agree_with_the_exact_reckoning(loss: float) -> None:
    one = air(each_second(A, B), {frozenset([A, B]): 0.7, frozenset([B]): 0.3})
    exact_s = one.current_after_s(loss)
    drawn_s = one.current_after_bursts_s(Bursts(10.0, 2.0, loss, loss))
    assert exact_s is not None
    assert drawn_s == pytest.approx(exact_s, abs=1.5)


def test_bursts_take_longer_than_the_same_loss_spread_evenly() -> None:
    one = air(each_second(A), {frozenset([A]): 1.0})
    evenly_s, bursts_s = one.current_after_s(0.2), one.current_after_bursts_s(Bursts(40.0, 10.0, 0.0, 1.0))
    assert evenly_s is not None
    assert bursts_s is not None
    assert bursts_s > 3.0 * evenly_s


@pytest.mark.slow
def test_a_bad_spell_is_outlasted_as_its_length_says() -> None:
    # All is lost in bad spells only: whoever is still waiting has been in the one it began in.
    one = air([(0.02 * k, A) for k in range(20_000)], {frozenset([A]): 1.0})
    drawn_s = one.current_after_bursts_s(Bursts(10.0, 2.0, 0.0, 1.0))
    assert drawn_s == pytest.approx(2.0 * math.log((2.0 / 12.0) / 0.001), rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("radio", "authentication"), [("3900", "mavlink"), ("5300", "ed25519")])
def test_500_agents_are_told_once_a_second_within_the_bytes_promised(
    radio: str, authentication: Authentication
) -> None:
    found = planned(radio, authentication)
    assert item(found, "ONEWAY_FLEET").interval_s == pytest.approx(1.0, abs=0.005)
    assert found.bytes_per_s <= float(radio) * 1.001
    assert found.largest_frame_bytes <= 252
    radii_s = item(found, "ONEWAY_RADII").interval_s
    assert radii_s is not None
    assert radii_s < 10.0


@pytest.mark.slow
def test_on_half_a_radio_the_plan_says_which_refresh_fits() -> None:
    found = planned("sik-57600", "both", 0.5)
    state = item(found, "ONEWAY_FLEET")
    assert state.interval_s is not None
    assert 1.9 < state.interval_s < 2.4
    assert found.refresh_s == state.interval_s
    assert found.left_out[0] == f"the state once a second: it fits every {state.interval_s:.1f} s"
    assert 0.98 <= found.utilisation <= 1.005
    assert found.bytes_per_s == pytest.approx(sum(one.bytes_per_s for one in found.items))


@pytest.mark.slow
def test_the_more_is_lost_the_longer_it_takes() -> None:
    times = list(planned("sik-57600", "both", 0.5).current_after_s.items())
    assert [name for name, _ in times] == ["0%", "10%", "30%", "50%", "bursts"]
    without_loss_s, *others_s = (after_s for _, after_s in times[:4])
    assert without_loss_s is not None
    assert 2.0 < without_loss_s < 3.0
    assert others_s == sorted(others_s, key=lambda after_s: after_s or math.inf)
    assert None not in dict(times).values()


@pytest.mark.slow
def test_a_plan_can_be_written_as_json() -> None:
    found = planned("sik-57600", "both", 0.5)
    again = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert again["refresh_s"] == found.refresh_s
    assert again["items"][0]["name"] == "ONEWAY_FLEET"


def test_a_small_mission_travels_in_one_state_frame_with_copies() -> None:
    found = plan(parse_mission(SMALL, "small"), parse_radio("sik-57600", 1.0), "both")
    assert {one.name for one in found.items} == {"ONEWAY_STATE", "ONEWAY_MOTION", "HEARTBEAT"}
    assert item(found, "ONEWAY_STATE").copies == pytest.approx(3.0, abs=0.05)
    assert found.left_out == ()
    assert found.current_after_s["0%"] == pytest.approx(0.25, abs=0.06)


def test_in_a_signed_v2_extension_a_small_mission_travels_packed() -> None:
    found = plan(parse_mission(SMALL, "small"), parse_radio("sik-57600/v2ext-signed", 1.0), "both")
    assert found.largest_frame_bytes <= 252 - 13
    assert {"ONEWAY_FLEET", "ONEWAY_RADII", "ONEWAY_MISSION"} <= {one.name for one in found.items}


def test_a_small_mission_fits_a_twentieth_of_lora() -> None:
    found = plan(parse_mission(SMALL, "small"), parse_radio("lora", 0.05), "both")
    assert 5.0 < found.refresh_s < 12.0
    assert found.utilisation == pytest.approx(1.0, abs=0.02)


def test_a_mission_that_a_radio_cannot_carry_is_refused_with_the_remedies() -> None:
    with pytest.raises(InputError, match="radio lora.*bytes.*allowed: at most 20 s"):
        plan(fleet(), parse_radio("lora", 0.1), "both")


def test_an_outage_may_last_as_long_as_the_nearest_threat_takes_to_come() -> None:
    outage = outage_limit(parse_mission(SMALL, "small"))
    assert outage.limit_s == pytest.approx(700.0)
    assert outage.clearance_m == pytest.approx(7_000.0)
    assert outage.why == "the start of agent 1 is 7000 m clear of threat 1, at most 10 m/s"


def test_targets_count_like_starts() -> None:
    near = SMALL.replace("north_m: 20000, east_m: 0", "north_m: 14000, east_m: 0")
    outage = outage_limit(parse_mission(near, "near"))
    assert outage.limit_s == pytest.approx(100.0)
    assert outage.why.startswith("target 1 is 1000 m clear of threat 1")


def test_a_faster_threat_farther_off_may_be_the_nearest_in_time() -> None:
    far = ", {id: 2, north_m: -30000, east_m: 0, detection_radius_m: 1000, attack_radius_m: 500, speed_bound_m_s: 50}]"
    outage = outage_limit(parse_mission(SMALL.rstrip().removesuffix("]") + far, "far"))
    assert outage.limit_s == pytest.approx(29_000.0 / 50.0)


def test_who_starts_inside_a_disc_may_miss_nothing() -> None:
    inside = SMALL.replace("{id: 1, north_m: 0, east_m: 0}", "{id: 1, north_m: 8000, east_m: 0}")
    assert outage_limit(parse_mission(inside, "inside")).limit_s == 0.0


def test_threats_that_stand_still_set_no_limit() -> None:
    still = SMALL.replace("speed_bound_m_s: 10", "speed_bound_m_s: 0")
    outage = outage_limit(parse_mission(still, "still"))
    assert (outage.limit_s, outage.why) == (None, "threats stand still")


def test_threats_above_everybody_set_no_limit() -> None:
    above = SMALL.replace("speed_bound_m_s: 10", "speed_bound_m_s: 10, floor_m: 5000")
    assert outage_limit(parse_mission(above, "above")).limit_s is None


def test_progress_is_told_up_to_the_end() -> None:
    told: list[float] = []
    plan(parse_mission(SMALL, "small"), parse_radio("lora", 0.05), "mavlink", told.append)
    assert told == sorted(told)
    assert 0.0 < told[0] < told[-1] <= 1.0
