"""The picture of fleet, targets and threats on board: the newest entry heard of each, with its age.

State frames are self-contained and idempotent, and the newest wins. An agent or target is forgotten only when it is
missing in a broadcast of which every frame was heard, a threat only when a picture without it is whole
(companion/onboard/picture.py); one that is merely not heard of again stays, and its disc only grows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from companion.guidance.view import Traffic, View
from companion.onboard.beliefs import Beliefs, Heard, put
from companion.onboard.directives import Directives
from companion.onboard.fleet_assembly import FleetAssembly, PlacedThreat
from companion.onboard.frame_order import Acceptance, FrameOrder
from companion.onboard.picture import Picture
from companion.onboard.world_view import (
    PeerTable,
    ThreatTable,
    checked_identities,
    peer_table,
    reaching,
    threat_table,
    view_of,
    with_traffic,
)
from companion.protocol.codec import (
    BandsFrame,
    FleetFrame,
    Frame,
    MissionFrame,
    MotionFrame,
    RadiiFrame,
    StateFrame,
    TargetEntry,
    ThreatEntry,
)
from companion.protocol.freshness import SenderClock
from companion.protocol.messages import REVISIONS


class WorldModel:
    """Merges the broadcast's frames for one agent; the caller gives all times, in seconds by this vehicle's clock."""

    def __init__(self, agent_id: int, peer_memory_s: float = 30.0, *, clocks_agree: bool = True) -> None:
        """Begin without a picture; `clocks_agree`: the sender's clock shows the same time as this vehicle's."""
        self.agent_id = agent_id
        self.peer_memory_s = peer_memory_s
        """Age above which a peer's position is left out of views: it is somewhere else by now."""
        self.origin_deg: tuple[float, float] | None = None
        self.directives = Directives()
        self.order = FrameOrder()
        self._sender_clock = SenderClock(agrees=clocks_agree)
        self._state_true_at_s: float | None = None
        self._beliefs = Beliefs()
        self._assembly = FleetAssembly()
        self._picture = Picture()
        self._agents_told: tuple[int, ...] | None = None
        """Ids of the agents in the last broadcast of which every frame was heard."""
        self._tables: tuple[ThreatTable, PeerTable] | None = None
        """Tables of the entries heard, kept until an entry changes."""

    @property
    def target_id(self) -> int | None:
        """Id of the target that is assigned to the vehicle; None if there is none."""
        return self._beliefs.target_of(self.agent_id)

    @property
    def agents_told(self) -> tuple[int, ...] | None:
        """Ids of the agents in the last broadcast of which every frame was heard; None before one."""
        return self._agents_told

    @property
    def target_ned_m(self) -> tuple[float, float] | None:
        """The place (north, east) of the vehicle's target as last told; None if there is none or it is unheard."""
        heard = None if self.target_id is None else self._beliefs.targets.get(self.target_id)
        return None if heard is None else (heard[0].north_m, heard[0].east_m)

    @property
    def agent_ids(self) -> tuple[int, ...]:
        """The ids of the agents of which the broadcast tells, in order."""
        return tuple(sorted(self._beliefs.agents))

    @property
    def others_told(self) -> tuple[int, int]:
        """Of how many other agents the broadcast tells, and of how many the place."""
        others = [agent for identity, (agent, _) in self._beliefs.agents.items() if identity != self.agent_id]
        return len(others), sum(agent.position_ned_m is not None for agent in others)

    @property
    def missing(self) -> str | None:
        """What the vehicle waits for, in words: threats of the picture in force, then the place of its own target.

        None if both were heard, or nothing at all.
        """
        target_id = self.target_id
        if self._picture.missing is None and target_id is not None and target_id not in self._beliefs.targets:
            return f"target {target_id} not heard"
        return self._picture.missing

    def age_s(self, now_s: float) -> float | None:
        """Return the age of the newest state or fleet frame that was merged; None before the first."""
        return None if self._state_true_at_s is None else max(0.0, now_s - self._state_true_at_s)

    def take(self, frame: Frame, now_s: float) -> bool:
        """Merge a frame received at `now_s`; return whether it was new and of a kind that the broadcast consists of."""
        if isinstance(frame, StateFrame):
            return self.take_state(frame, now_s)
        if isinstance(frame, FleetFrame):
            return self.take_fleet(frame, now_s)
        if isinstance(frame, RadiiFrame):
            return self.take_radii(frame, now_s)
        if isinstance(frame, MissionFrame):
            return self.take_mission(frame, now_s)
        if isinstance(frame, MotionFrame):
            return self.take_motion(frame, now_s)
        return isinstance(frame, BandsFrame) and self.take_bands(frame)

    def take_state(self, frame: StateFrame, now_s: float) -> bool:
        """Merge a state frame received at `now_s`; return whether it was new.

        Of a frame whose picture was overtaken only the directives count.
        """
        acceptance = self.order.take_part(frame.stamp, now_s)
        if acceptance is not Acceptance.REFUSED:
            self.directives = self.directives.after(frame, self.agent_id)
        if not self._follow(acceptance, frame):
            return False
        self._take_origin((frame.origin_lat_deg, frame.origin_lon_deg))
        self._picture.count(frame.picture_threats)
        heard = self._merge(frame, now_s)
        for threat in frame.threats:
            self._take_threat(threat, heard)
            self._assembly.placed.pop(threat.id, None)
        if self.order.is_whole(frame.stamp):
            self._forget_absent()
        self._forget_retired()
        return True

    def take_fleet(self, frame: FleetFrame, now_s: float) -> bool:
        """Merge a fleet frame received at `now_s`; return whether it was new.

        A threat enters the picture once its radii are known as well. Until the epoch's origin is known, only the
        frame's directives count and the frame waits; what the picture of the epoch before told stays. Of a frame whose
        picture was overtaken only the directives count.
        """
        acceptance = self.order.take_part(frame.stamp, now_s)
        if acceptance is not Acceptance.REFUSED:
            self.directives = self.directives.after(frame, self.agent_id)
        if not self._follow(acceptance, frame):
            return False
        if self._assembly.origin_told:
            self._merge_fleet([(frame, now_s)])
            self._forget_retired()
        else:
            self._assembly.wait(frame, now_s)
        return True

    def take_radii(self, frame: RadiiFrame, now_s: float) -> bool:
        """Merge the radii of some threats; return whether the frame was of the newest epoch and revision."""
        if not self._follow(self.order.take_constant(frame.stamp, now_s), frame):
            return False
        for entry in frame.threats:
            self._assembly.size(entry)
            self._join(entry.id)
        self._tables = None
        self._forget_retired()
        return True

    def take_mission(self, frame: MissionFrame, now_s: float) -> bool:
        """Take origin, number of threats and mission; return whether the frame was of the newest epoch and revision."""
        if not self._follow(self.order.take_constant(frame.stamp, now_s), frame):
            return False
        self._take_origin((frame.origin_lat_deg, frame.origin_lon_deg))
        if self._picture.name(frame.mission_digest):
            self._beliefs.forget(lambda heard: heard.broadcast[0] != frame.stamp.epoch_s)
            self._tables = None
        self._picture.count(frame.threats)
        self._merge_fleet(self._assembly.take_waiting())
        self._forget_retired()
        return True

    def take_motion(self, frame: MotionFrame, now_s: float) -> bool:
        """Merge a motion frame received at `now_s`; return whether it was of this epoch and not older than the last."""
        if not self.order.take_motion(frame.stamp):
            return False
        self._beliefs.take_motion(frame, self._sender_clock.true_at_s(frame.stamp, now_s))
        self._tables = None
        return True

    def take_bands(self, frame: BandsFrame) -> bool:
        """Merge threats' floors and ceilings; return whether the frame was of this epoch and not older than the last.

        A threat keeps its band until a newer frame gives it another, or the threat leaves the picture.
        """
        if not self.order.take_bands(frame.stamp):
            return False
        self._beliefs.take_bands(frame)
        self._tables = None
        return True

    def view(self, now_s: float, band_m: tuple[float, float] | None = None) -> View:
        """Return the picture at `now_s`, with discs grown and peers moved on by their age.

        `band_m`: least and greatest altitude above sea level that the vehicle may be at. Threats that are known to
        reach no altitude of it are left out; a threat whose floor and ceiling were never heard is not.
        """
        if self._tables is None:
            self._tables = (threat_table(self._beliefs), peer_table(self._beliefs, self.agent_id))
        threats, peers = self._tables
        if band_m is not None:
            threats = reaching(threats, *band_m)
        view = view_of(threats, peers, self._assigned(), self.peer_memory_s, now_s)
        return view if self._picture.whole else replace(view, whole=False)

    def with_traffic(
        self, view: View, seen: Sequence[Traffic], elsewhere: Sequence[Traffic] = (), fastest_m_s: float = math.inf
    ) -> View:
        """Return the view with the traffic that the vehicle's own detector shows; see `world_view.with_traffic`.

        `fastest_m_s`: greatest speed over ground of an agent; without a bound any place that a detector shows is taken
        for that of the agent that it names.
        """
        shown = checked_identities(view.others, seen, elsewhere, fastest_m_s)
        return with_traffic(view, shown, self._beliefs, self.agent_id)

    def _assigned(self) -> tuple[TargetEntry, Heard] | None:
        """Return the assigned target; None if there is none, its place was not heard or the picture is not whole."""
        # A vehicle that does not know all threats cannot keep clear of them, so it goes nowhere.
        target_id = self.target_id
        if target_id is None or not self._picture.whole:
            return None
        return self._beliefs.targets.get(target_id)

    def _follow(self, acceptance: Acceptance, frame: StateFrame | FleetFrame | RadiiFrame | MissionFrame) -> bool:
        """Return whether a frame is new; if its picture is, drop bands, radii and places of the one before."""
        if acceptance is Acceptance.REFUSED:
            return False
        begins = acceptance is Acceptance.ANEW
        if begins:
            self._picture.begin_epoch()
        elif self._picture.is_old(frame.revision, frame.stamp.sequence):
            return False
        if self._picture.follow(frame.revision, frame.stamp.sequence):
            self._beliefs.bands.clear()
            self._assembly = FleetAssembly(self._assembly.origin_told and not begins)
            self._tables = None
        return True

    def _take_origin(self, origin_deg: tuple[float, float]) -> None:
        self._assembly.origin_told = True
        if self.origin_deg != origin_deg:
            self._beliefs = Beliefs()
            self._picture.forget()
            self._assembly.placed.clear()
            self._tables = None
            self.origin_deg = origin_deg

    def _merge(self, frame: StateFrame | FleetFrame, received_s: float) -> Heard:
        """Take agents and targets of a state or fleet frame; return when they were true."""
        true_at_s = self._sender_clock.true_at_s(frame.stamp, received_s)
        heard = Heard(true_at_s, (frame.stamp.epoch_s, frame.stamp.sequence))
        self._state_true_at_s = true_at_s
        self._beliefs.take(frame, heard)
        self._tables = None
        return heard

    def _merge_fleet(self, frames: Sequence[tuple[FleetFrame, float]]) -> None:
        """Merge fleet frames, each with the time when it came, the oldest first."""
        for frame, received_s in frames:
            heard = self._merge(frame, received_s)
            for place in frame.threats:
                self._assembly.place(PlacedThreat(place, frame.rounding_m, heard))
                self._join(place.id)
        if frames and self.order.is_whole(frames[-1][0].stamp):
            self._forget_absent()

    def _join(self, identity: int) -> None:
        """Put a threat into the picture if its place and radii are both known."""
        joined = self._assembly.joined(identity)
        if joined is None:
            return
        self._take_threat(joined.threat, joined.heard)
        if joined.band is not None:
            put(self._beliefs.bands, identity, joined.band)

    def _take_threat(self, threat: ThreatEntry, heard: Heard) -> None:
        if threat.id not in self._beliefs.threats and not self._beliefs.make_room(self._picture.has_heard):
            # Nothing that counts may be forgotten for it, and nobody may fly among threats that are not known.
            self._picture.overflow()
            return
        self._beliefs.take_threat(threat, heard, self._picture.has_heard(threat.id))
        self._beliefs.threat_pictures[threat.id] = heard.broadcast[0] * REVISIONS + (self._picture.revision or 0)
        self._picture.hear((threat.id,))

    def _forget_absent(self) -> None:
        """Forget agents and targets that are not in the newest broadcast, of which every frame was heard."""
        newest = (self.order.epoch_s, self.order.sequence)
        self._beliefs.forget(lambda heard: heard.broadcast != newest)
        self._agents_told = tuple(sorted(self._beliefs.agents))
        if self.agent_id not in self._beliefs.agents:
            self.directives = self.directives.unnamed()

    def _forget_retired(self) -> None:
        """Forget the threats that the picture lacks, once it is whole: until then one may only be unheard."""
        if self._picture.whole:
            self._beliefs.forget_threats(self._picture.has_heard)
            self._tables = None
