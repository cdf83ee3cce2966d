"""Plays a recorded run on the page: the same messages as of a live one, at any time of it and at any speed."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from groundstation.store.recordings import Json, Recording
from groundstation.web.feed import Refused, Sink
from groundstation.web.pipe import Message, Who

STEP_S = 0.2
"""Period of the messages."""
BEFORE_S = 120.0
"""Time before a jump's end from which frames are told: the slowest carousel has gone round by then."""
MOST_SPEED = 1_000.0


class Playback:
    """The feed of one recording, which it plays from its beginning."""

    def __init__(self, recording: Recording, steady_s: Callable[[], float] = time.monotonic) -> None:
        """Play a recording; `steady_s` is the clock that paces it."""
        self._recording = recording
        self._steady_s = steady_s
        self._at_s = recording.span.from_s
        self._speed = 1.0
        self._playing = True
        self._told_s: float | None = None
        """Time up to which everything was told; None: a jump, so that all is to be told anew."""
        self._picture_s: float | None = None
        """Time of the picture that was told last."""
        self._mission: Json | None = None
        self._wake = asyncio.Event()

    async def run(self, sink: Sink) -> None:
        """Tell all events once, to jump to, and then what is played until cancelled."""
        span = self._recording.span
        sink.message({"type": "timeline", "events": self._recording.events(-1.0, span.to_s)})
        before_s = self._steady_s()
        while True:
            now_s = self._steady_s()
            self.step(sink, now_s - before_s)
            before_s = now_s
            try:
                async with asyncio.timeout(STEP_S):
                    await self._wake.wait()
            except TimeoutError:
                continue
            self._wake.clear()

    def step(self, sink: Sink, passed_s: float) -> None:
        """Tell what belongs to the time that has come after `passed_s` seconds."""
        span = self._recording.span
        if self._playing:
            self._at_s = min(self._at_s + self._speed * passed_s, span.to_s)
            self._playing = self._at_s < span.to_s
        if self._told_s is None:
            sink.forget()
            self._picture_s = None
            self._mission = None
        before_s = self._at_s - BEFORE_S if self._told_s is None else self._told_s
        events = self._recording.events(-1.0 if self._told_s is None else self._told_s, self._at_s)
        if events or self._mission is None:
            self._tell_mission(sink)
        for event in events:
            sink.message({"type": "event", "event": event})
        for at_s, datagrams in self._recording.frames(before_s, self._at_s):
            sink.frames(at_s, datagrams)
        self._tell_picture(sink)
        sink.message(self._state())
        self._told_s = self._at_s

    async def command(self, who: Who, command: Message) -> Message:
        """Refuse: what was flown stays as it was."""
        raise Refused("this is a playback: what was flown stays as it was; allowed: on the page of a running one")

    async def playback(self, control: Message) -> Message:
        """Obey `at_s`, `speed` and `playing`, each if it is given; return the state."""
        span = self._recording.span
        if (at_s := control.get("at_s")) is not None:
            self._at_s = min(max(float(at_s), span.from_s), span.to_s)
            self._told_s = None
        if (speed := control.get("speed")) is not None:
            self._speed = min(float(speed), MOST_SPEED)
        if (playing := control.get("playing")) is not None:
            if playing and self._at_s >= span.to_s:
                self._at_s, self._told_s = span.from_s, None
            self._playing = bool(playing)
        self._wake.set()
        return self._state()

    def _state(self) -> Message:
        span = self._recording.span
        return {
            "type": "playback",
            "from_s": span.from_s,
            "to_s": span.to_s,
            "at_s": round(self._at_s, 3),
            "speed": self._speed,
            "playing": self._playing,
        }

    def _tell_mission(self, sink: Sink) -> None:
        mission = self._recording.mission_at(self._at_s)
        if mission is not None and mission != self._mission:
            self._mission = mission
            sink.message({"type": "mission", "mission": mission})

    def _tell_picture(self, sink: Sink) -> None:
        picture = self._recording.picture_at(self._at_s)
        if picture is not None and picture["t_s"] != self._picture_s:
            self._picture_s = picture["t_s"]
            sink.message(picture | {"mode": "playback"})
