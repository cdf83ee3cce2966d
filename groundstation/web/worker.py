"""The worker beside the web process: it reckons routes and decisions at the lowest priority, one job after the other.

`python -m groundstation.web.worker N` reads jobs from the socket with descriptor N and answers each; it ends with the
socket. A job has a picture, the frames that the copies of companions are to hear, and the agents asked about.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from typing import Any

from companion.errors import InputError
from companion.mission.model import Mission
from groundstation.web.pipe import READ_BYTES, Message, Unpacker, frames_of, packed
from groundstation.web.routes import Routes
from groundstation.web.why import Heard, why

NICENESS = 14
"""Added to the web process' own: only what nobody else wants of the processor goes into routes."""


class Worker:
    """Answers jobs; what one job brings of mission and frames is kept for the next ones."""

    def __init__(self) -> None:
        self._mission: Mission | None = None
        self._routes: Routes | None = None
        self._can_stop = False

    def answer(self, job: Message) -> dict[str, Any]:
        """Return the routes for the job's picture, and the decisions of the agents that are asked about, by id."""
        mission = job.get("mission")
        if mission is not None:
            self._mission = Mission.model_validate(mission, strict=False)
            self._can_stop = bool(job.get("can_stop", False))
            self._routes = Routes(self._mission)
        picture = job["picture"]
        if self._mission is None or self._routes is None:
            return {"type": "done", "routes": {}, "why": {}}
        heard: list[Heard] = []
        for message in job["heard"]:
            heard_s, datagrams = frames_of(message)
            heard += [(heard_s, datagram) for datagram in datagrams]
        decisions: dict[str, Any] = {}
        for agent_id in job["why"]:
            try:
                decisions[str(agent_id)] = why(self._mission, picture, agent_id, heard, can_stop=self._can_stop)
            except KeyError:
                decisions[str(agent_id)] = None
        routes = {} if job["why"] else self._routes.update(picture)
        return {"type": "done", "routes": routes, "why": decisions}


def _answer_of(answer: dict[str, Any]) -> bytes:
    try:
        return packed(answer)
    except InputError as error:
        return packed({"type": "done", "routes": {}, "why": {}, "error": str(error)})


def main() -> None:
    """Answer jobs until the socket ends."""
    os.nice(NICENESS)
    pipe = socket.socket(fileno=int(sys.argv[1]))
    unpacker, worker = Unpacker(), Worker()
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        # A web process that was killed needs no answer.
        _answer(pipe, unpacker, worker)


def _answer(pipe: socket.socket, unpacker: Unpacker, worker: Worker) -> None:
    while data := pipe.recv(READ_BYTES):
        for job in unpacker.feed(data):
            try:
                answer = worker.answer(job)
            except (InputError, ValueError, KeyError, TypeError, AssertionError, ArithmeticError) as error:
                # A picture that cannot be reckoned must not end the worker: the next one may be better.
                answer = {"type": "done", "routes": {}, "why": {}, "error": f"{type(error).__name__}: {error}"}
            pipe.sendall(_answer_of(answer))


if __name__ == "__main__":
    main()
