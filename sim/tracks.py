"""Recorded tracks as a live source of a simulated flight: the ground station hears them, and they are there in truth.

The recording begins with the flight, or plays at its own Unix times, and goes by the virtual clock. With the last
sighting of a thing its truth ends; the ground station has it until it times out, as it would have a real one.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import NamedTuple

from companion.errors import InputError
from companion.geo.local_frame import LocalFrame, to_grid
from companion.mission.model import Mission
from companion.mission.sources import SourceSpec
from companion.protocol.codec import Kind
from groundstation.desk import Desk
from groundstation.ground_station import GroundStation
from groundstation.sightings import places_in
from groundstation.sources.choices import source_specs
from groundstation.sources.feed import Feed
from groundstation.sources.playback import Due, open_recording, replayed, sightings_in
from groundstation.sources.sighting import Sighting
from groundstation.sources.sources import Sources
from sim.loop import START_S
from sim.world import World

JSON_LINES = (".jsonl", ".ndjson", ".jsonl.gz", ".ndjson.gz")
"""Ends of the names of recordings with a JSON object a line; others are CSV."""


class _Known(NamedTuple):
    """Where a thing of a recording was seen last, on the mission's plane."""

    place: complex
    velocity: complex
    at_s: float


def track_specs(mission: Mission, given: Sequence[str], source: str) -> tuple[SourceSpec, ...]:
    """Return the sources that `--tracks FILE[,KEY=VALUE...]` name; `source` names the mission.

    Raises:
        InputError: one cannot be used.

    """
    typed = [f"{'jsonl' if text.partition(',')[0].endswith(JSON_LINES) else 'csv'}={text}" for text in given]
    bare = mission.model_copy(update={"sources": ()})
    return source_specs(bare, typed, source, unsigned=False)


class Tracks:
    """The recordings of one flight."""

    def __init__(self, mission: Mission, specs: Sequence[SourceSpec], stack: ExitStack) -> None:
        """Open the recordings, which `stack` closes.

        Raises:
            InputError: one cannot be read.

        """
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self.sources = Sources(mission, specs)
        self._players = [_Player(self.sources.feeds[spec.name], stack) for spec in specs]
        self._known: dict[tuple[str, str], _Known] = {}
        self._ended: set[tuple[str, str]] = set()
        """Things whose last sighting has been."""
        self._listed = frozenset(key for key, _ in places_in(mission))

    def tick(self, station: GroundStation, desk: Desk, now_s: float) -> None:
        """Let the ground station hear what is due at a Unix time, and ask for what that makes of its picture."""
        for player in self._players:
            for sighting in player.until(now_s):
                self._known[player.feed.spec.name, sighting.key] = self._known_by(sighting)
            name = player.feed.spec.name
            self._ended |= {(name, key) for key, at_s in player.ends_s.items() if at_s < now_s}
        self.sources.tick(station, desk, now_s)

    def place(self, station: GroundStation, world: World) -> None:
        """Put the things that the ground station has taken in to where they are in truth at the world's time."""
        for key, identity in station.operations.tracks.items():
            known = self._known.get(key)
            if known is not None and identity.kind is not Kind.AGENT and key not in self._ended:
                # The world moves on from there to the next tick itself.
                here = known.place + known.velocity * (START_S + world.t_s - known.at_s)
                world.place(identity.kind, identity.id, here, known.velocity)

    def truth(self, station: GroundStation) -> Mission:
        """Return the ground station's mission with what is there in truth: without what no recording has any more."""
        tracks = station.operations.tracks
        gone = {tracks[key] for key in self._ended if key in tracks} - self._listed
        if not gone:
            return station.mission
        return station.mission.model_copy(
            update={
                "targets": tuple(one for one in station.mission.targets if (Kind.TARGET, one.id) not in gone),
                "threats": tuple(one for one in station.mission.threats if (Kind.THREAT, one.id) not in gone),
            }
        )

    def _known_by(self, sighting: Sighting) -> _Known:
        to_local = self._frame.to_local_with_convergence
        north_m, east_m, convergence_rad = to_local(sighting.lat_deg, sighting.lon_deg)
        velocity = sighting.velocity or 0j
        grid = complex(*to_grid(velocity.real, velocity.imag, convergence_rad))
        return _Known(complex(north_m, east_m), grid, sighting.at_s)


class _Player:
    """Plays one recording by the virtual clock."""

    def __init__(self, feed: Feed, stack: ExitStack) -> None:
        self.feed = feed
        assert feed.spec.file is not None
        file = open_recording(feed.spec.file)
        stack.callback(file.close)
        blocks = sightings_in(file, feed.spec.kind, feed.parse)
        try:
            dues = list(itertools.chain.from_iterable(blocks))
        except (OSError, EOFError) as error:
            raise InputError(f"--tracks: '{feed.spec.file}': {error}; allowed: a file that can be read") from error
        self._waiting: Iterator[Due] = iter(dues)
        self._last_s = {due.sighting.key: due.at_s for due in dues}
        """Time of the last sighting of each thing by the clock of the recording."""
        self.ends_s: dict[str, float] = {}
        """The same of the things that were seen, by the virtual clock."""
        self._next: Due | None = None
        self._began_s: float | None = None
        """Time of the first sighting by the clock of the recording."""

    def until(self, now_s: float) -> list[Sighting]:
        """Let the feed have what is due, and return it."""
        found: list[Sighting] = []
        speed = self.feed.spec.play_speed
        while (due := self._upcoming()) is not None:
            began_s = self._began_s = due.at_s if self._began_s is None else self._began_s
            at_s = self._at_s(due.at_s, began_s)
            if at_s > now_s:
                break
            self.ends_s[due.sighting.key] = self._at_s(self._last_s[due.sighting.key], began_s)
            found.append(replayed(due, at_s - due.at_s, speed or 1.0))
            self._next = None
        self.feed.offer(found, now_s)
        return found

    def _at_s(self, at_s: float, began_s: float) -> float:
        """Return a time of the recording's clock by the virtual one."""
        speed = self.feed.spec.play_speed
        return at_s if speed is None else START_S + (at_s - began_s) / speed

    def _upcoming(self) -> Due | None:
        self._next = self._next or next(self._waiting, None)
        return self._next
