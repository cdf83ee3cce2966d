"""A process that forwards datagrams from one link to another and loses, delays, repeats and reorders some of them.

It puts a lossy radio link between real programs.

Run as `python -m sim.relay --listen udpbcast:10.0.0.255:14600 --to udpout:127.0.0.1:14601 --loss 0.3`.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

import click
import numpy as np

from companion.errors import EXIT_DONE, InputError, run_program
from companion.files.yaml import validated
from companion.mission.model import LinkSpec
from companion.runtime.clock import run_until_signal, wait
from companion.transport.endpoints import Link, open_receiver, open_sender, parse_link
from sim.air_link import LINK_STREAM, LossyLink

TICK_S = 0.005
"""Time between two deliveries of what has arrived, short compared with the delays of radio links."""
MAX_SEED = 2**63 - 1


@dataclass(frozen=True, slots=True)
class RelayOptions:
    """The options of `sim.relay`."""

    listen: Link
    to: Link
    spec: LinkSpec
    hold_back_s: float
    seed: int


async def run_relay(options: RelayOptions, stop: asyncio.Event) -> None:
    """Forward datagrams as the lossy link lets them through, until `stop` is set.

    Raises:
        InputError: a link cannot be opened, or `listen` is a stream, which has no datagrams to lose.

    """
    loop = asyncio.get_running_loop()
    air = LossyLink(options.spec, np.random.default_rng([options.seed, LINK_STREAM]), options.hold_back_s)
    taken = 0

    def take(datagram: bytes) -> None:
        nonlocal taken
        taken += 1
        air.send(datagram, loop.time())

    sender = await open_sender(options.to)
    try:
        receiver = await open_receiver(options.listen, take)
        try:
            if receiver.is_stream:
                raise InputError(f"--listen: '{options.listen}' is a stream; allowed: a link of datagrams")
            click.echo(f"relay: {options.listen} to {options.to}")
            while not stop.is_set():
                for _, datagram in air.deliver(loop.time()):
                    sender.send(datagram)
                await wait(stop, TICK_S)
        finally:
            receiver.close()
    finally:
        sender.close()
    click.echo(f"relay: taken {taken}, lost {air.lost}, sent {sender.counts.sent}")


def _burst(_context: click.Context, _parameter: click.Parameter, text: str | None) -> dict[str, float] | None:
    if text is None:
        return None
    try:
        enter, leave, loss = map(float, text.split(","))
    except ValueError:
        raise click.BadParameter(f"'{text}'; allowed: three probabilities, ENTER,LEAVE,LOSS") from None
    return {"enter": enter, "leave": leave, "loss": loss}


@click.command(
    epilog="Example: python -m sim.relay --listen udpin:127.0.0.1:14600 --to udpout:127.0.0.1:14601 --loss 0.3"
)
@click.option("--listen", required=True, metavar="URL", help="Where datagrams come in.")
@click.option("--to", required=True, metavar="URL", help="Where what gets through goes.")
@click.option("--loss", type=float, default=0.0, show_default=True, help="Share of datagrams lost, each on its own.")
@click.option(
    "--burst",
    callback=_burst,
    metavar="ENTER,LEAVE,LOSS",
    help="Probabilities at each datagram: bad times begin, end; a datagram is lost in them.",
)
@click.option("--delay", "delay_s", type=float, default=0.0, show_default=True, help="Of each datagram, s.")
@click.option("--jitter", "jitter_s", type=float, default=0.0, show_default=True, help="Further delay at most, s.")
@click.option("--duplicate", type=float, default=0.0, show_default=True, help="Share of datagrams that come twice.")
@click.option("--reorder", type=float, default=0.0, show_default=True, help="Share of datagrams that are held back.")
@click.option(
    "--hold-back",
    "hold_back_s",
    type=click.FloatRange(0.0, 60.0),
    default=0.5,
    show_default=True,
    help="How long at most, s.",
)
@click.option("--seed", type=click.IntRange(0, MAX_SEED), default=1, show_default=True, help="Which are lost.")
def relay(listen: str, to: str, hold_back_s: float, seed: int, **air: object) -> int:
    """Pass the datagrams of one link on to another through a lossy, late, repeating, reordering air.

    Exit status 0 when it is interrupted, 2 for unusable input.
    """
    spec = validated(LinkSpec, air, "relay")
    options = RelayOptions(parse_link(listen), parse_link(to), spec, hold_back_s, seed)
    run_until_signal(lambda stop: run_relay(options, stop))
    return EXIT_DONE


if __name__ == "__main__":
    run_program(relay, "relay")
