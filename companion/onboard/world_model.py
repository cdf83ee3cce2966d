"""What the vehicle believes: the newest of each thing heard, with ages.

State frames are self-contained, idempotent and newest-wins. A thing is forgotten only when a broadcast that was heard
whole no longer holds it; a threat not heard of again is never dropped, its disc only grows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from companion.guidance.view import Traffic, View
from companion.onboard.beliefs import Beliefs, Heard
from companion.onboard.fleet_assembly import FleetAssembly, PlacedThreat
from companion.onboard.frame_order import Acceptance, FrameOrder
from companion.onboard.world_view import (
    PeerTable,
    ThreatTable,
    peer_table,
    reaching,
    threat_table,
    view_of,
    with_traffic,
)
from companion.protocol.codec import (
    BandsFrame,
    Directive,
    FleetFrame,
    Frame,
    MissionFrame,
    MotionFrame,
    RadiiFrame,
    StateFrame,
    TargetEntry,
)
from companion.protocol.freshness import SenderClock


@dataclass(frozen=True)
class _MissionTold:
    """What mission frames told, of any epoch."""

    digest: bytes | None = None
    """Of the last mission frame."""
    epochs: frozenset[int] = frozenset()
    """Epochs that told this digest: what was heard in them, and in no others, is of that mission."""
    threats: int = 0
    """How many threats that mission has, 0 once a state frame told of what may be another."""


class WorldModel:
    """Merges frames for one agent; all times are this vehicle's clock in seconds, given by the caller."""

    def __init__(self, agent_id: int, peer_memory_s: float = 30.0, *, clocks_agree: bool = True) -> None:
        """`clocks_agree`: the sender's clock shows the same time as this vehicle's."""
        self.agent_id = agent_id
        self.peer_memory_s = peer_memory_s
        """A peer heard of longer ago than this is somewhere else by now and is left out."""
        self.origin_deg: tuple[float, float] | None = None
        self.directive = Directive.NORMAL
        self.order = FrameOrder()
        self._sender_clock = SenderClock(agrees=clocks_agree)
        self._state_true_at_s: float | None = None
        self._beliefs = Beliefs()
        self._assembly = FleetAssembly()
        self._mission = _MissionTold()
        self._tables: tuple[ThreatTable, PeerTable] | None = None
        """Of the beliefs, until they change."""

    @property
    def target_id(self) -> int | None:
        """The target that the vehicle was sent to."""
        return self._beliefs.target_of(self.agent_id)

    def age_s(self, now_s: float) -> float | None:
        """Return the age of the newest state heard, None if none ever was."""
        return None if self._state_true_at_s is None else max(0.0, now_s - self._state_true_at_s)

    def take(self, frame: Frame, now_s: float) -> bool:
        """Merge a frame received at `now_s`; return whether it was one of a broadcast's, and new."""
        if isinstance(frame, StateFrame):
            return self.take_state(frame, now_s)
        if isinstance(frame, FleetFrame):
            return self.take_fleet(frame, now_s)
        if isinstance(frame, RadiiFrame):
            return self.take_radii(frame, now_s)
        if isinstance(frame, MissionFrame):
            return self.take_mission(frame, now_s)
        if isinstance(frame, MotionFrame):
            return self.take_motion(frame)
        return isinstance(frame, BandsFrame) and self.take_bands(frame)

    def take_state(self, frame: StateFrame, now_s: float) -> bool:
        """Merge a state frame received at `now_s`; return whether it was new."""
        if not self._follow(self.order.take_part(frame.stamp, now_s)):
            return False
        self.directive = frame.directive
        self._take_origin((frame.origin_lat_deg, frame.origin_lon_deg))
        if self._mission.threats and frame.stamp.epoch_s not in self._mission.epochs:
            self._mission = _MissionTold(self._mission.digest, self._mission.epochs)
        heard = self._merge(frame, now_s)
        for threat in frame.threats:
            self._beliefs.threats[threat.id] = (threat, heard)
            self._assembly.placed.pop(threat.id, None)
        if self.order.is_whole(frame.stamp):
            self._forget_absent()
        return True

    def take_fleet(self, frame: FleetFrame, now_s: float) -> bool:
        """Merge a fleet frame received at `now_s`; return whether it was new.

        A threat is believed once its radii are known as well. Until the epoch's origin is known only the directive is
        obeyed and the frame waits: what was believed of an epoch before stands.
        """
        if not self._follow(self.order.take_part(frame.stamp, now_s)):
            return False
        self.directive = frame.directive
        if self._assembly.origin_told:
            self._merge_fleet([(frame, now_s)])
        else:
            self._assembly.wait(frame, now_s)
        return True

    def take_radii(self, frame: RadiiFrame, now_s: float) -> bool:
        """Merge the radii of some threats; return whether the frame was of the newest epoch."""
        if not self._follow(self.order.take_constant(frame.stamp, now_s)):
            return False
        for entry in frame.threats:
            self._assembly.radii[entry.id] = entry
            self._join(entry.id)
        self._tables = None
        return True

    def take_mission(self, frame: MissionFrame, now_s: float) -> bool:
        """Take what holds for this epoch; return whether the frame was of the newest epoch."""
        if not self._follow(self.order.take_constant(frame.stamp, now_s)):
            return False
        self._take_origin((frame.origin_lat_deg, frame.origin_lon_deg))
        epochs = self._mission.epochs
        if frame.mission_digest != self._mission.digest:
            self._forget_epochs(epochs)
            epochs = frozenset()
        self._mission = _MissionTold(frame.mission_digest, epochs | {frame.stamp.epoch_s}, frame.threats)
        self._merge_fleet(self._assembly.take_waiting())
        return True

    def take_motion(self, frame: MotionFrame) -> bool:
        """Merge a motion frame; return whether it belonged to the broadcasts of this epoch and was not overtaken."""
        if not self.order.take_motion(frame.stamp):
            return False
        self._beliefs.take_motion(frame)
        self._tables = None
        return True

    def take_bands(self, frame: BandsFrame) -> bool:
        """Merge the heights that threats reach; return whether the frame belonged to this epoch and was not overtaken.

        A threat keeps its band until a newer frame names it anew, or it leaves the picture.
        """
        if not self.order.take_bands(frame.stamp):
            return False
        self._beliefs.take_bands(frame)
        self._tables = None
        return True

    def view(self, now_s: float, band_m: tuple[float, float] | None = None) -> View:
        """Return the picture as it must be believed at `now_s`.

        With a band, least and greatest height above sea level that the vehicle may be at, threats known to reach no
        height of it are left out; one whose floor and ceiling were never heard of is not.
        """
        if self._tables is None:
            self._tables = (threat_table(self._beliefs), peer_table(self._beliefs, self.agent_id))
        threats, peers = self._tables
        if band_m is not None:
            threats = reaching(threats, *band_m)
        return view_of(threats, peers, self._assigned(), self.peer_memory_s, now_s)

    def with_traffic(self, view: View, seen: Sequence[Traffic]) -> View:
        """Return the view with what the vehicle's own detector sees."""
        return with_traffic(view, seen, self._beliefs, self.agent_id)

    def _assigned(self) -> tuple[TargetEntry, Heard] | None:
        """Return the target that the vehicle is to go to, if it was sent to one that is known."""
        # Who does not know of all threats yet cannot go past them: it has nowhere to go.
        known = sum(heard.broadcast[0] in self._mission.epochs for _, heard in self._beliefs.threats.values())
        target_id = self.target_id
        if target_id is None or known < self._mission.threats:
            return None
        return self._beliefs.targets.get(target_id)

    def _follow(self, acceptance: Acceptance) -> bool:
        """Return whether a frame is new; where it begins an epoch, what was told of the last one is over."""
        if acceptance is Acceptance.ANEW:
            self._beliefs.bands.clear()
            self._assembly = FleetAssembly()
        return acceptance is not Acceptance.REFUSED

    def _take_origin(self, origin_deg: tuple[float, float]) -> None:
        self._assembly.origin_told = True
        if self.origin_deg != origin_deg:
            self._beliefs = Beliefs()
            self._assembly.placed.clear()
            self._tables = None
            self.origin_deg = origin_deg

    def _merge(self, frame: StateFrame | FleetFrame, received_s: float) -> Heard:
        """Take what state and fleet frames tell alike; return when it was true."""
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
                self._assembly.placed[place.id] = PlacedThreat(place, frame.rounding_m, heard)
                self._join(place.id)
        if frames and self.order.is_whole(frames[-1][0].stamp):
            self._forget_absent()

    def _join(self, identity: int) -> None:
        """Believe in a threat whose place and radii are both known."""
        joined = self._assembly.joined(identity)
        if joined is None:
            return
        self._beliefs.threats[identity] = (joined.threat, joined.heard)
        if joined.band is not None:
            self._beliefs.bands[identity] = joined.band

    def _forget_absent(self) -> None:
        """Forget what the newest broadcast, heard whole, no longer holds."""
        newest = (self.order.epoch_s, self.order.sequence)

        def is_absent(heard: Heard) -> bool:
            return heard.broadcast != newest

        self._assembly.forget_placed(is_absent)
        # A threat whose new radii are still to come is believed where and as large as it was before.
        self._beliefs.forget(is_absent, kept_threats=self._assembly.placed)

    def _forget_epochs(self, epochs: frozenset[int]) -> None:
        """Forget what was heard in some epochs."""

        def is_gone(heard: Heard) -> bool:
            return heard.broadcast[0] in epochs

        self._assembly.forget_placed(is_gone)
        self._beliefs.forget(is_gone)
        self._tables = None
