"""Status messages of `groundstation run`: the assignment, the frames sent, and warnings."""

from __future__ import annotations

from companion.protocol.messages import Directive
from groundstation.broadcast import Unsendable
from groundstation.choices import Authentication
from groundstation.ground_station import GroundStation
from groundstation.options import Options
from groundstation.schedule import Broadcaster

STATUS_PERIOD_S = 60.0
"""Period of the message about the frames sent."""
MOST_PAIRS = 20
"""Greatest number of assigned agents for which the status names each with its target."""

_WORDS: dict[Authentication, str] = {
    "unsigned": "unsigned",
    "mavlink": "MAVLink signed",
    "ed25519": "Ed25519 signed",
    "both": "Ed25519 and MAVLink signed",
}


class Status:
    """Makes the status messages of a run."""

    def __init__(self, station: GroundStation, broadcaster: Broadcaster, options: Options) -> None:
        self._station = station
        self._broadcaster = broadcaster
        self._warned = False
        self._options = options
        self.sent_bytes = 0
        self._said = ""
        self._revision = station.revision
        self._told_at_s: float | None = None
        self._told_bytes = 0

    def opening(self) -> str:
        """Return the first message of a run: its options."""
        options, mission = self._options, self._station.mission
        radio = options.radio
        over = f", radio {radio.name} at {radio.share:.0%}" if radio is not None else ""
        mirror = f", mirror {options.mirror}" if options.mirror is not None else ""
        sources = "".join(f", {spec.name} ({spec.kind})" for spec in options.sources)
        return (
            f"{mission.name} on {options.link} ({_WORDS[options.authentication]}){over}, case {mission.case}, "
            f"sensor {options.sensor or 'none'}, uplink {options.uplink or 'none'}{mirror}{sources}"
        )

    def news(self, now_s: float, frames: int) -> list[str]:
        """Return the messages that are due: of mission and picture on changes, of the link every STATUS_PERIOD_S.

        What the inputs said and is not believed is told as Refusals tells it.
        """
        lines = self._station.tracks.refusals.news(now_s)
        line = f"{self._mission_line()} ({_WORDS[self._options.authentication]})"
        if line != self._said:
            lines.append(line)
            self._said = line
        if self._station.revision != self._revision:
            self._revision = self._station.revision
            lines.append(f"picture: revision {self._revision}, {len(self._station.mission.threats)} threats")
        if self._told_at_s is None:
            self._told_at_s = now_s
        elif now_s - self._told_at_s >= STATUS_PERIOD_S:
            rate_bytes_per_s = (self.sent_bytes - self._told_bytes) / (now_s - self._told_at_s)
            pace = self._broadcaster.pace
            slowed = f", slowed to {pace:.0%} by the radio's buffer" if pace < 1.0 else ""
            doubted, unsendable = self._station.tracks.refusals.total, sum(one.count for one in self._unsendable())
            refused = f", {doubted} inputs not believed" if doubted else ""
            unsent = f", {unsendable} frames not sent" if unsendable else ""
            lines.append(
                f"{frames} frames sent, {rate_bytes_per_s:.0f} B/s{slowed}{refused}{unsent} "
                f"({_WORDS[self._options.authentication]})"
            )
            self._told_at_s, self._told_bytes = now_s, self.sent_bytes
        return lines

    def warnings(self) -> list[str]:
        """Return a warning about frames that could not be sent, once in a run."""
        wrong = [one.first for one in self._unsendable() if one.count]
        if self._warned or not wrong:
            return []
        self._warned = True
        return [f"a frame could not be sent: {wrong[0]}; going on with the others"]

    def _unsendable(self) -> tuple[Unsendable, Unsendable]:
        return self._station.unsendable, self._broadcaster.unsendable

    def _mission_line(self) -> str:
        station = self._station
        picture = station.tracks
        pairs = ", ".join(f"{agent} to {target}" for agent, target in sorted(station.sent.items()))
        if len(station.sent) > MOST_PAIRS:
            pairs = f"{len(station.sent)} of {len(picture.present_agents)} sent"
        directive = "" if station.directive is Directive.NORMAL else f"directive {station.directive.name.lower()}; "
        progress = picture.progress
        return (
            f"{directive}agents to targets: {pairs or 'none'}; reached {sorted(progress.completed)}, "
            f"arrived {sorted(progress.arrived)}, lost {sorted(progress.lost)}, uncovered {list(station.uncovered)}"
        )
