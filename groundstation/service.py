"""Shell of `groundstation run`: the broadcast socket, the sensor's socket and the clock around the core."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack

import click

from companion.config import DEFAULT_LAW
from companion.mission import Mission
from companion.process import SteadyClock, wait
from companion.transport import Link, open_receiver, open_sender
from groundstation.core import GroundStation

TICK_S = 0.05
"""How often the core is asked what is due: fine against any broadcast period in use."""


async def run_groundstation(
    mission: Mission, link: Link, sensor: Link | None, uplink: Link | None, can_stop: bool, stop: asyncio.Event
) -> None:
    """Broadcast a resolved mission until `stop` is set.

    Without a sensor the ground station knows no more than the mission file: threats that may move grow with age, and in
    Case I nobody can be known to be lost or to have arrived. In Case II agents that `can_stop`, or not, are reckoned,
    and what they report on the `uplink` is heard.

    Raises:
        InputError: a link cannot be opened, or the mission asks for something the ground station cannot do.

    """
    clock = SteadyClock()
    # The epoch is this run's whole second, and what is broadcast counts from it.
    station = GroundStation(mission, clock.now_s(), sensed=sensor is not None, law=DEFAULT_LAW, can_stop=can_stop)
    with ExitStack() as stack:
        sender = await open_sender(link)
        stack.callback(sender.close)
        if sensor is not None:
            receiver = await open_receiver(sensor, lambda datagram: station.sense(datagram, clock.now_s()))
            stack.callback(receiver.close)
        if uplink is not None:
            reports = await open_receiver(uplink, lambda datagram: station.hear_report(datagram, clock.now_s()))
            stack.callback(reports.close)
        click.echo(
            f"groundstation: {mission.name} on {link} (unsigned), case {mission.case}, sensor {sensor or 'none'}, "
            f"uplink {uplink or 'none'}"
        )
        said = ""
        while not stop.is_set():
            for datagram in station.tick(clock.now_s()):
                sender.send(datagram)
            line = _line(station)
            if line != said:
                click.echo(f"groundstation: {line}")
                said = line
            await wait(stop, TICK_S)


def _line(station: GroundStation) -> str:
    pairs = ", ".join(f"{agent} to {target}" for agent, target in sorted(station.assignment.items()))
    picture = station.picture
    return (
        f"agents to targets: {pairs or 'none'}; reached {sorted(picture.completed)}, "
        f"arrived {sorted(picture.arrived)}, lost {sorted(picture.lost)}, uncovered {list(station.uncovered)}"
    )
