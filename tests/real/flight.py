"""One flight of real programs: autopilots, ground station and companions as processes, in real time."""

from __future__ import annotations

import contextlib
import json
import math
import os
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission, ThreatSpec, dump_mission
from companion.mission.places import Origin
from companion.protocol.codec import Detection
from companion.protocol.codec import Kind as DetectionKind
from companion.protocol.keys import keygen
from sim.sensor import LOOK_PERIOD_S, detection_of_row, mission_sensor, world_detections
from sim.world import World
from tests.real.config import BROADCAST_PORT, write_config
from tests.real.kinds import KINDS, Kind
from tests.real.pilot import Vehicle
from tests.real.programs import Place, Program, first_instance, module
from tests.real.scenarios import (
    DRAWN_FOR_M_S,
    Action,
    Ask,
    ChooseMode,
    Event,
    Flood,
    Have,
    LowerRates,
    MoveHome,
    MoveOrigin,
    Scenario,
    SetParameters,
    Signal,
    StartAgain,
)
from tests.real.truth import trajectory_of
from tests.real.wire import Wire

SEED = 1
PROJECT = Path(__file__).parents[2]
POLL_S = 0.02
RELAY_PERIOD_S = 0.5
"""Time between two ADSB_VEHICLE of each other vehicle."""
SENSOR_PORT, PAGE_PORT = 14500, 14501
UP_PATIENCE_S = 150.0
"""A simulator's estimator needs some 40 s before it lets anybody arm."""
READY_PATIENCE_S = 40.0
ASK_PATIENCE_S = 5.0
HAND_OVER_AFTER_S = 2.0
"""Time after which the vehicles are handed over once targets and threats have set out, as in `sim fly`."""
NO_WIND = "SIH_WIND_N not found"
READY = "picture fresh"


class GroundFailure(Exception):
    """The flight did not come about: something before the hand-over failed."""


class Flight:
    """One scenario with one kind of vehicle; `fly` flies it, and everything is kept in its folder."""

    def __init__(self, scenario: Scenario, kind: Kind, folder: Path) -> None:
        """Prepare keys, mission and configurations in an empty folder."""
        self.scenario, self.kind, self._folder = scenario, kind, folder
        self.mission = scenario.mission(kind)
        self._frame = LocalFrame(self.mission.origin.lat_deg, self.mission.origin.lon_deg)
        self.vehicles: dict[int, Vehicle] = {}
        self._programs: dict[str, Program] = {}
        self._wires: dict[int, Wire] = {}
        self.notes: list[tuple[float, str]] = []
        """What happened, with its Unix time: the hand-over and each event."""
        self._load: list[float] = []
        self._relay_due_s = 0.0
        self._turned_s = math.inf
        self._pause_s = 0.0
        self._first_instance = first_instance() if kind.firmware == "PX4" else 0
        keygen(folder / "keys")
        (folder / "mission.yaml").write_text(dump_mission(self.mission), encoding="utf-8")
        for agent in self.mission.agents:
            ids = agent.id, self._instance(agent.id)
            more = scenario.config_of(kind, agent.id)
            write_config(folder / f"companion-{agent.id}.yaml", kind, self.mission, ids, more)

    def fly(self) -> float:
        """Fly it; return the Unix time at which targets and threats set out.

        Raises:
            GroundFailure: the vehicles did not get to their height, or no companion was ready.

        """
        with contextlib.ExitStack() as stack:
            for agent in self.mission.agents:
                self._start_vehicle(agent.id)
                stack.callback(self.vehicles[agent.id].close)
            self._until(self._climb, UP_PATIENCE_S, "at their height")
            # Before the companions: with GUIDED still chosen they would steer a copter that is climbing.
            stack.callback(self._end_programs)
            for agent in self.mission.agents if self.scenario.wired else ():
                self._wires[agent.id] = Wire(self.kind, self._instance(agent.id), agent.id, self.scenario.troubles)
                stack.callback(self._wires[agent.id].close)
            sensor = stack.enter_context(contextlib.closing(_Sensor(self.mission, self.vehicles)))
            self._start_programs()
            ready = self._all_ready if not self.scenario.refused else self._all_speak
            self._until(ready, READY_PATIENCE_S, "ready", sensor.look)
            self._note("ready")
            begin_s = sensor.set_out()
            self._follow(begin_s, sensor)
        return begin_s

    def _with_asked(self) -> Mission:
        """Return the mission with the discs that operators add: all of them are far from everybody until they do."""
        scale = self.kind.speed_m_s / DRAWN_FOR_M_S
        asked = [event.action.scaled(scale) for event in self.scenario.events if isinstance(event.action, Ask)]
        added = [
            ThreatSpec.model_validate({key: value for key, value in command.items() if key != "do"})
            for command in asked
            if command["do"] == "add-threat"
        ]
        return self.mission.model_copy(update={"threats": (*self.mission.threats, *added)})

    def _instance(self, agent_id: int) -> int:
        return self._first_instance + agent_id - 1

    def _climb(self) -> bool:
        return all([vehicle.climb() for vehicle in self.vehicles.values()])

    def _hand_over(self) -> bool:
        return all([vehicle.hand_over() for vehicle in self.vehicles.values()])

    def _start_vehicle(self, agent_id: int) -> None:
        spec = next(agent for agent in self.mission.agents if agent.id == agent_id)
        lat_deg, lon_deg = self._frame.to_global(*spec.position_ned_m)
        origin = Origin(lat_deg=lat_deg, lon_deg=lon_deg, alt_m=self.mission.origin.alt_m)
        wind = wind_parameters(self.kind, self.scenario.wind_m_s, self.scenario.wind_from_deg)
        more = self.scenario.parameters if self.kind.firmware == "ArduPilot" else {}
        parameters = {**self.kind.parameters, **wind, **more}
        place = Place(agent_id, origin, spec.heading_deg or 0.0, parameters, self._instance(agent_id))
        self.vehicles[agent_id] = Vehicle(self.kind, place, self._folder / f"autopilot-{agent_id}", self._frame)

    def _start_programs(self) -> None:
        ports = ",".join(f"127.0.0.1:{BROADCAST_PORT + agent.id}" for agent in self.mission.agents)
        self._programs["groundstation"] = Program(
            module(
                "groundstation", "run", "mission.yaml", "--link", f"udpout:{ports}", "--keys", "keys",
                "--sensor", f"udpin:127.0.0.1:{SENSOR_PORT}", "--seed", str(SEED), "--log", "broadcast.tlog",
                *(("--ui", f"127.0.0.1:{PAGE_PORT}") if self._is_asked else ()),
            ),
            self._folder,
            "groundstation",
        )  # fmt: skip
        for agent in self.mission.agents:
            command = module("companion", "run", f"companion-{agent.id}.yaml")
            self._programs[f"companion-{agent.id}"] = Program(command, self._folder, f"companion-{agent.id}")

    @property
    def _is_asked(self) -> bool:
        """Whether an operator asks something of the ground station, which then has its page."""
        return any(isinstance(event.action, Ask) for event in self.scenario.events)

    def _companions(self) -> list[Program]:
        return [program for name, program in self._programs.items() if name.startswith("companion")]

    def _all_ready(self) -> bool:
        return all(companion.has_said(READY) for companion in self._companions())

    def _all_speak(self) -> bool:
        return all(len(companion.said) > 1 for companion in self._companions())

    def _follow(self, begin_s: float, sensor: _Sensor) -> None:
        """Hand over, do what the scenario says, and watch until its end."""
        hand_over_s = begin_s + HAND_OVER_AFTER_S
        self._until(lambda: time.time() >= hand_over_s, READY_PATIENCE_S, "waiting", sensor.look)
        # ArduCopter waits in a mode of its own until now; PX4 takes OFFBOARD once setpoints stream.
        self._until(self._hand_over, READY_PATIENCE_S, "guided", sensor.look)
        self._note("handed over")
        self._pause_s = 0.0
        due = [(self.notes[-1][0] + event.after_s, event) for event in self.scenario.events]
        watch = _Watch(self.mission, self.scenario, self.kind, self.notes[-1][0])
        while not watch.over(self.vehicles):
            while due and time.time() >= due[0][0]:
                self._do(due.pop(0)[1])
            self._turn(sensor.look)
        self._note("over")

    def _do(self, event: Event) -> None:
        self._note(_named(event.action))
        action, vehicle = event.action, self.vehicles[1]
        if isinstance(action, ChooseMode):
            vehicle.choose(getattr(self.kind.modes, action.mode))
        elif isinstance(action, Signal):
            name = "companion-1" if action.program == "companion" else action.program
            self._programs[name].signal(action.number)
        elif isinstance(action, StartAgain):
            self._programs["companion-1"].start()
        elif isinstance(action, SetParameters):
            vehicle.set_parameters(action.of[self.kind.firmware])
        elif isinstance(action, MoveHome):
            vehicle.move(action)
        elif isinstance(action, LowerRates):
            self._wires[1].lower_rates()
        elif isinstance(action, Have):
            self._wires[1].troubles.add(action.trouble)
        elif isinstance(action, Flood):
            command = module("tests.real.flood", str(BROADCAST_PORT + 1), str(action.rate_hz))
            self._programs["flood"] = Program(command, self._folder, "flood", {"PYTHONPATH": str(PROJECT)})
        elif isinstance(action, Ask):
            ask(action.scaled(self.kind.speed_m_s / DRAWN_FOR_M_S))
        else:
            vehicle.drain()

    def _turn(self, look: Callable[[], None] = lambda: None) -> None:
        self._pause_s = max(self._pause_s, time.monotonic() - self._turned_s)
        for vehicle in self.vehicles.values():
            vehicle.poll()
            if not vehicle.program.runs:
                raise GroundFailure(f"the autopilot of agent {vehicle.place.agent_id} ended: see autopilot.log")
            if vehicle.program.has_said(NO_WIND):
                raise GroundFailure("this PX4's simulator has no wind: SIH_WIND_N is unknown to it")
        look()
        self._relay()
        self._turned_s = time.monotonic()
        time.sleep(POLL_S)

    def _relay(self) -> None:
        """Tell each vehicle by ADSB_VEHICLE of the others, where the scenario has that."""
        if not self.scenario.adsb or time.monotonic() < self._relay_due_s:
            return
        self._relay_due_s = time.monotonic() + RELAY_PERIOD_S
        flying = [vehicle for vehicle in self.vehicles.values() if vehicle.samples]
        for vehicle in flying:
            for other in flying:
                if other is not vehicle:
                    vehicle.tell_of(other)

    def _until(
        self, condition: Callable[[], bool], patience_s: float, what: str, look: Callable[[], None] = lambda: None
    ) -> None:
        ends_s = time.monotonic() + patience_s
        while not condition():
            if time.monotonic() > ends_s:
                raise GroundFailure(f"not {what} within {patience_s:g} s: modes {self._modes()}")
            self._turn(look)

    def _modes(self) -> str:
        return ", ".join(f"{v.mode} at {v.height_m:.1f} m" for v in self.vehicles.values())

    def _note(self, what: str) -> None:
        self.notes.append((time.time(), what))
        self._load.append(os.getloadavg()[0])

    def _end_programs(self) -> None:
        for program in self._programs.values():
            program.end()

    def write(self, begin_s: float) -> None:
        """Write what scoring needs: the trajectory, the mission as it began, notes, modes and heights."""
        samples = {agent_id: vehicle.samples for agent_id, vehicle in self.vehicles.items()}
        mission = self._with_asked()
        (self._folder / "mission.yaml").write_text(dump_mission(mission), encoding="utf-8")
        trajectory = trajectory_of(samples, mission, SEED, begin_s)
        trajectory.write_csv(self._folder / "trajectory.csv")
        began = [
            agent.model_copy(
                update={
                    "north_m": round(float(trajectory.agents_ned_m[0, index, 0]), 1),
                    "east_m": round(float(trajectory.agents_ned_m[0, index, 1]), 1),
                    "heading_deg": round(float(trajectory.agents_heading_deg[0, index]), 1) % 360.0,
                }
            )
            for index, agent in enumerate(self.mission.agents)
        ]
        begun = mission.model_copy(update={"agents": tuple(began)})
        (self._folder / "mission-begun.yaml").write_text(dump_mission(begun), encoding="utf-8")
        record = {
            "scenario": self.scenario.name,
            "kind": next(name for name, kind in KINDS.items() if kind is self.kind),
            "begin_unix_s": begin_s,
            "notes": self.notes,
            "load": max(self._load),
            "pause_s": round(self._pause_s, 3),
            "modes": {agent_id: vehicle.modes for agent_id, vehicle in self.vehicles.items()},
            "heights_m": {
                agent_id: [
                    (round(sample.t_unix_s, 2), round(sample.altitude_m - self.mission.origin.alt_m, 2))
                    for sample in seen
                    if sample.t_unix_s >= begin_s
                ]
                for agent_id, seen in samples.items()
            },
            "delivered_s": {agent_id: wire.delivered_s for agent_id, wire in self._wires.items()},
            "told_s": {agent_id: wire.told_s for agent_id, wire in self._wires.items()},
        }
        (self._folder / "flight.json").write_text(json.dumps(record), encoding="utf-8")


def ask(command: Mapping[str, Any]) -> None:
    """Ask something of the ground station over its API.

    Raises:
        GroundFailure: it refuses, or does not answer.

    """
    body = json.dumps(command).encode()
    request = urllib.request.Request(
        f"http://127.0.0.1:{PAGE_PORT}/api/v1/commands", body, {"Content-Type": "application/json"}
    )
    try:
        urllib.request.urlopen(request, timeout=ASK_PATIENCE_S).close()
    except urllib.error.HTTPError as error:
        raise GroundFailure(f"the ground station refuses {command}: {error.read().decode()}") from error
    except OSError as error:
        raise GroundFailure(f"the ground station does not answer {command}: {error}") from error


def _named(action: Action) -> str:
    """Return what is noted of an event."""
    if isinstance(action, ChooseMode):
        return f"mode {action.mode}"
    if isinstance(action, Signal):
        return f"{action.number.name} {action.program}"
    if isinstance(action, SetParameters):
        return action.what
    if isinstance(action, MoveHome):
        what = "origin" if isinstance(action, MoveOrigin) else "home"
        return f"{what} moved by {action.north_m:g}, {action.east_m:g}, {action.up_m:g} m up"
    if isinstance(action, Have):
        return action.trouble
    if isinstance(action, Ask):
        return f"asked: {action.command['do']} {action.command.get('directive', '')}".strip()
    if isinstance(action, Flood):
        return f"{action.rate_hz:g} junk frames a second"
    return {StartAgain: "started again", LowerRates: "rates lowered"}.get(type(action), "battery nearly empty")


def wind_parameters(kind: Kind, speed_m_s: float, from_deg: float) -> dict[str, float]:
    """Return the parameters with which a kind's simulator has a steady wind."""
    if speed_m_s == 0.0:
        return {}
    if kind.firmware == "PX4":
        towards_rad = math.radians(from_deg + 180.0)
        return {
            "SIH_WIND_N": round(speed_m_s * math.cos(towards_rad), 3),
            "SIH_WIND_E": round(speed_m_s * math.sin(towards_rad), 3),
        }
    return {"SIM_WIND_SPD": speed_m_s, "SIM_WIND_DIR": from_deg}


class _Sensor:
    """The centre's sensor: it sees every vehicle where its simulator has it, and targets and threats where they are."""

    def __init__(self, mission: Mission, vehicles: dict[int, Vehicle]) -> None:
        self._mission, self._vehicles = mission, vehicles
        self._epoch_s = int(time.time())
        self._sensor = mission_sensor(mission, self._epoch_s)
        self._world = World(mission, SEED)
        self._begin_s = math.inf
        self._due_s = 0.0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def set_out(self) -> float:
        """Let targets and threats set out; return the Unix time."""
        self._begin_s = time.time()
        return self._begin_s

    def look(self) -> None:
        """Send a look's detections if one is due."""
        now_s = time.time()
        if now_s < self._due_s:
            return
        self._due_s = now_s + LOOK_PERIOD_S
        targets, threats = self._world.rows()
        if now_s < self._begin_s:
            targets, threats = targets * (1, 1, 1, 0), threats * (1, 1, 1, 0)
        else:
            self._world.advance(now_s - self._begin_s)
            targets, threats = self._world.rows()
        seen: list[Detection] = world_detections(self._mission, targets, threats)
        for agent_id, vehicle in self._vehicles.items():
            seen.append(detection_of_row(DetectionKind.AGENT, agent_id, np.array(vehicle.samples[-1].row)))
        for datagram in self._sensor.look(seen, now_s):
            self._socket.sendto(datagram, ("127.0.0.1", SENSOR_PORT))

    def close(self) -> None:
        self._socket.close()


class _Watch:
    """Says when a flight is over: some time after all have arrived, or when its time is up."""

    def __init__(self, mission: Mission, scenario: Scenario, kind: Kind, hand_over_s: float) -> None:
        self._places = {target.id: target.position_ned_m for target in mission.targets}
        self._radius_m = mission.arrival_radius_m
        self._stays_s = scenario.stays_after_s(kind)
        self._ends_s = hand_over_s + scenario.most_s

    def over(self, vehicles: dict[int, Vehicle]) -> bool:
        """Return whether the flight is over, once the vehicles' last samples are taken in."""
        for agent_id, vehicle in vehicles.items():
            sample = vehicle.samples[-1]
            place = self._places.get(agent_id)
            if place is not None and math.dist(place, (sample.north_m, sample.east_m)) <= self._radius_m:
                del self._places[agent_id]
                self._ends_s = self._ends_s if self._places else time.time() + self._stays_s
        return time.time() >= self._ends_s
