"""The relay between real programs: everything passes a clear air, and a lossy one loses the same every time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from click.testing import CliRunner

from companion.errors import InputError
from companion.mission.model import LinkSpec
from companion.transport.endpoints import open_receiver, open_sender, parse_link
from sim.relay import RelayOptions, relay, run_relay
from tests.ports import free_port

LOCALHOST = "127.0.0.1"
DATAGRAMS = [bytes([index]) * 50 for index in range(200)]


async def relayed(spec: LinkSpec, seed: int, enough: Callable[[list[bytes]], bool]) -> list[bytes]:
    """Return what a listener behind a relay has heard once that is enough."""
    heard: list[bytes] = []
    before, behind = (f"{LOCALHOST}:{free_port()}" for _ in range(2))
    stop = asyncio.Event()
    receiver = await open_receiver(parse_link(f"udpin:{behind}"), heard.append)
    options = RelayOptions(parse_link(f"udpin:{before}"), parse_link(f"udpout:{behind}"), spec, 0.05, seed)
    running = asyncio.create_task(run_relay(options, stop))
    await asyncio.sleep(0.05)
    sender = await open_sender(parse_link(f"udpout:{before}"))
    for datagram in DATAGRAMS:
        sender.send(datagram)
    for _ in range(500):
        if enough(heard):
            break
        await asyncio.sleep(0.01)
    # Whatever should not come would come by now.
    await asyncio.sleep(0.1)
    stop.set()
    await running
    for end_point in (sender, receiver):
        end_point.close()
    return heard


def run(body: Awaitable[list[bytes]]) -> list[bytes]:
    async def within_time() -> list[bytes]:
        return await asyncio.wait_for(body, 10.0)

    return asyncio.run(within_time())


def test_a_clear_air_passes_everything_on_once_and_in_order() -> None:
    assert run(relayed(LinkSpec(delay_s=0.0), 1, lambda heard: len(heard) >= 200)) == DATAGRAMS


@pytest.mark.slow
def test_a_lossy_air_loses_the_same_datagrams_every_time() -> None:
    spec = LinkSpec(loss=0.5, delay_s=0.0)
    first, second = (run(relayed(spec, 7, lambda heard: len(heard) >= 80)) for _ in range(2))
    other = run(relayed(spec, 8, lambda heard: len(heard) >= 80))
    assert first == second != other
    assert 70 < len(first) < 130


def test_an_air_that_repeats_and_reorders_hands_on_every_datagram_twice_out_of_order() -> None:
    heard = run(relayed(LinkSpec(delay_s=0.0, duplicate=1.0, reorder=0.5), 1, lambda heard: len(heard) >= 400))
    assert sorted(heard) == sorted(DATAGRAMS * 2)
    assert heard != sorted(heard)


@pytest.mark.slow
def test_an_air_with_a_delay_is_late() -> None:
    async def body() -> list[bytes]:
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        heard = await relayed(LinkSpec(delay_s=0.4), 1, bool)
        assert loop.time() - began_s >= 0.4
        return heard

    assert run(body()) == DATAGRAMS


@pytest.mark.parametrize(
    ("option", "complaint"),
    [("--loss=1.5", "loss: 1.5"), ("--loss=nan", "loss"), ("--delay=-1", "delay_s"), ("--burst=0.1,0.2", "--burst")],
)
def test_an_impossible_air_is_refused_in_one_line(option: str, complaint: str) -> None:
    links = ["--listen", f"udpin:{LOCALHOST}:14600", "--to", f"udpout:{LOCALHOST}:14601"]
    result = CliRunner().invoke(relay, [*links, option])
    message = str(result.exception) if isinstance(result.exception, InputError) else result.output
    assert result.exit_code != 0
    assert complaint in message
