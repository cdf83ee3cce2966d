"""The web process' end of the pipe: whoever waits for an answer gets one, also when the ground station ends."""

from __future__ import annotations

import asyncio
import socket
from contextlib import suppress

import pytest

from groundstation.web.feed import Refused
from groundstation.web.hub import Hub
from groundstation.web.live_feed import LiveFeed
from groundstation.web.pipe import Message, Who

ANNA = Who("anna", "operator")


def test_a_command_that_the_ground_station_ends_with_unread_is_answered_that_it_may_have_obeyed() -> None:
    async def asked() -> list[Refused]:
        ours, theirs = socket.socketpair()
        feed = await LiveFeed.open(theirs)
        running = asyncio.ensure_future(feed.run(Hub()))
        command = asyncio.ensure_future(feed.command(ANNA, {"do": "pause"}))
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        ours.close()  # With the command unread, which resets the pipe.
        with suppress(ConnectionError):
            await running
        return [await _refusal(command), await _refusal(asyncio.ensure_future(feed.command(ANNA, {"do": "pause"})))]

    during, after = asyncio.run(asked())
    assert (during.status, after.status) == (503, 503)
    assert str(during).startswith("the ground station does not answer")
    assert str(after) == "the ground station has ended"


def test_a_command_whose_answer_is_cancelled_by_a_server_that_stops_is_answered_too() -> None:
    async def asked() -> Refused:
        ours, theirs = socket.socketpair()
        feed = await LiveFeed.open(theirs)
        command = asyncio.ensure_future(feed.command(ANNA, {"do": "pause"}))
        await asyncio.sleep(0)
        command.cancel()
        refused = await _refusal(command)
        ours.close()
        return refused

    assert asyncio.run(asked()).status == 503


def test_a_command_that_the_pipe_cannot_hold_is_refused() -> None:
    async def asked() -> Refused:
        ours, theirs = socket.socketpair()
        feed = await LiveFeed.open(theirs)
        refused = await _refusal(asyncio.ensure_future(feed.command(ANNA, {"do": "undo", "number": 2**64})))
        ours.close()
        return refused

    assert asyncio.run(asked()).status == 422


async def _refusal(command: asyncio.Future[Message]) -> Refused:
    with pytest.raises(Refused) as refused:
        await command
    return refused.value
