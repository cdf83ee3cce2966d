"""The web process' end of the worker: one job at a time, with the newest picture, and questions before routes.

The companion's code is the worker's: the web process starts without it.
"""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import Iterable
from typing import Any

from companion.errors import InputError
from companion.runtime.console import program_logger
from groundstation.web.feed import Refused
from groundstation.web.hub import Hub
from groundstation.web.pipe import READ_BYTES, Message, Unpacker, frames_message, packed

LOGGER = program_logger("groundstation")
PERIOD_S = 1.0
"""Time between two jobs for routes."""
JOB_S = 20.0
"""Time after which a worker that has not answered is ended."""
BACK_OFF_S = 5.0
"""Time after which a worker that ended is started again."""
ASK_S = 15.0
"""Longest wait for a decision."""
HEARD_S = 60.0
"""Time for which frames are played to a copy: the state of the slowest radio, which takes 20 s, and its carousel."""
MOST_ASKED = 50
"""Greatest number of agents that are asked about at a time."""


class Reckoning:
    """Keeps a worker busy with what a hub shows."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._asked: dict[int, asyncio.Future[dict[str, Any] | None]] = {}
        self._wake = asyncio.Event()
        self._known: object = None
        """The mission that the worker knows."""

    async def why(self, agent_id: int) -> dict[str, Any]:
        """Return the decision of the copy of an agent's companion; raises Refused."""
        picture = self._hub.picture
        if picture is None or self._hub.mission is None:
            raise Refused("no picture yet; allowed: a second after the start", 503)
        if agent_id not in {agent["id"] for agent in picture["agents"]}:
            raise Refused(f"no agent {agent_id}; allowed: one of the picture's", 404)
        if agent_id not in self._asked:
            if len(self._asked) >= MOST_ASKED:
                raise Refused(f"{MOST_ASKED} agents are asked about; ask again later", 503)
            self._asked[agent_id] = asyncio.get_running_loop().create_future()
            self._wake.set()
        try:
            async with asyncio.timeout(ASK_S):
                decision = await asyncio.shield(self._asked[agent_id])
        except TimeoutError as error:
            raise Refused("it takes too long to reckon; ask again later", 503) from error
        if decision is None:
            raise Refused("it cannot be reckoned from this picture; ask again later", 503)
        return decision

    async def run(self) -> None:
        """Keep a worker running until cancelled."""
        while True:
            try:
                await self._work()
            except (OSError, InputError, TimeoutError) as error:
                LOGGER.warning("page: routes: %s; begun again in %g s", error or "no answer", BACK_OFF_S)
            await asyncio.sleep(BACK_OFF_S)

    async def _work(self) -> None:
        """Start a worker and give it jobs until it ends; raises OSError, InputError or TimeoutError then."""
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        command = [sys.executable, "-m", "groundstation.web.worker", str(theirs.fileno())]
        try:
            # A process group of its own: Ctrl-C at the terminal does not reach it, not even while it starts.
            process = subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, process_group=0)
        finally:
            theirs.close()
        self._known = None
        try:
            unpacker = Unpacker()
            while True:
                await self._await_something()
                await self._job(ours, unpacker)
        finally:
            ours.close()
            process.kill()
            process.wait()

    async def _await_something(self) -> None:
        """Wait until somebody asks, or routes are due."""
        try:
            async with asyncio.timeout(PERIOD_S):
                await self._wake.wait()
        except TimeoutError:
            return
        self._wake.clear()

    async def _job(self, pipe: socket.socket, unpacker: Unpacker) -> None:
        hub, loop = self._hub, asyncio.get_running_loop()
        if hub.picture is None or hub.mission is None:
            return
        asked = dict(self._asked)
        job: dict[str, Any] = {"type": "job", "picture": hub.picture, "why": list(asked), "heard": []}
        if asked:
            job["heard"] = [frames_message(*frame) for frame in _to_be_played(hub.heard, float(hub.picture["t_s"]))]
        if hub.mission is not self._known:
            job |= {"mission": hub.mission, "can_stop": hub.can_stop}
        async with asyncio.timeout(JOB_S):
            await loop.sock_sendall(pipe, packed(job))
            self._known = hub.mission
            answers: list[Message] = []
            while not answers:
                data = await loop.sock_recv(pipe, READ_BYTES)
                if not data:
                    raise InputError("the worker has ended")
                answers = unpacker.feed(data)
        answer = answers[0]
        if "error" in answer:
            LOGGER.warning("page: routes: %s", answer["error"])
        for agent_id, future in asked.items():
            self._asked.pop(agent_id, None)
            future.set_result(answer["why"].get(str(agent_id)))
        if not asked:
            hub.message({"type": "routes", "routes": answer["routes"]})


def _to_be_played(heard: Iterable[tuple[float, bytes]], now_s: float) -> list[tuple[float, list[bytes]]]:
    """Return the frames of the last HEARD_S, each once, with the time at which it was first broadcast."""
    first: dict[bytes, float] = {}
    for heard_s, datagram in heard:
        if now_s - HEARD_S <= heard_s <= now_s:
            first.setdefault(datagram, heard_s)
    return [(heard_s, [datagram]) for datagram, heard_s in first.items()]
