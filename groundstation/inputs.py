"""The ground station's inputs: which frames on the sensor's link and on the uplink are whole, and their senders'.

A sensor signs its detections, and a vehicle its reports, with MAVLink's signature and a key of their own
(input_keys.py). Signing times must rise in each stream of frames and be near this computer's clock, so that no
recording counts; nothing is remembered of a frame before every check has passed. Who signs nothing is believed only
where the link hears nobody but this computer, or where the ground station was told so. What is refused is counted by
its cause.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from companion.protocol.codec import DetectionsFrame, Frame, ReportFrame, WireError, decode_frame
from companion.protocol.deframer import MAX_DATAGRAM_BYTES, frames_in
from companion.protocol.frame import RawFrame
from companion.protocol.mavlink_signing import (
    FUTURE_TIME,
    PAST_TIME,
    UNSIGNED,
    MavlinkVerifier,
    signing_time_s,
)
from groundstation.refusals import Refusals
from groundstation.sightings import AHEAD_S, BEHIND_S

MOST_SENSORS = 256
"""Greatest number of streams of signed detections that are remembered: one of each sensor."""
NO_KEY = "signed, but no key is given"
NOT_MEANT = "not for this link"

FrameT = TypeVar("FrameT", DetectionsFrame, ReportFrame)


@dataclass(frozen=True)
class InputTrust:
    """Whom a link believes: the verifiers of signatures, and whether unsigned frames count."""

    one: MavlinkVerifier | None = None
    """Verifier of a link whose senders share a key."""
    by_agent: Mapping[int, MavlinkVerifier] = field(default_factory=dict)
    """Verifiers of a link on which each agent has its own key, by agent id."""
    unsigned: bool = True

    def verifier(self, frame: Frame) -> MavlinkVerifier | None:
        """Return the verifier of a frame's sender; None if there is no key of it."""
        return self.by_agent.get(frame.agent_id) if isinstance(frame, ReportFrame) else self.one


def sensor_trust(key: bytes | None, unsigned: bool) -> InputTrust:
    """Return whom the sensor's link believes: who has the key, if there is one, and who signs nothing if `unsigned`."""
    if key is None:
        return InputTrust(unsigned=unsigned)
    return InputTrust(_verifier(key, MOST_SENSORS), unsigned=unsigned)


def uplink_trust(keys: Mapping[int, bytes], unsigned: bool) -> InputTrust:
    """Return whom the uplink believes: each agent by its own key, and who signs nothing if `unsigned`."""
    return InputTrust(by_agent={agent: _verifier(key, 1) for agent, key in keys.items()}, unsigned=unsigned)


class Inputs:
    """Reads the datagrams of the sensor's link and of the uplink, and counts in `refusals` what does not count."""

    def __init__(self, refusals: Refusals) -> None:
        """Begin with links that believe everybody, as in a simulation."""
        self._refusals = refusals
        self.sensor = InputTrust()
        self.uplink = InputTrust()

    def detections(self, datagram: bytes, now_s: float) -> list[DetectionsFrame]:
        """Return the genuine frames of detections in a datagram. Never raises, whatever the bytes."""
        return self._genuine("sensor", self.sensor, DetectionsFrame, datagram, now_s)

    def reports(self, datagram: bytes, now_s: float) -> list[ReportFrame]:
        """Return the genuine reports in a datagram. Never raises, whatever the bytes."""
        return self._genuine("uplink", self.uplink, ReportFrame, datagram, now_s)

    def _genuine(
        self, channel: str, trust: InputTrust, kind: type[FrameT], datagram: bytes, now_s: float
    ) -> list[FrameT]:
        genuine: list[FrameT] = []
        skipped: Counter[str] = Counter()
        for raw in frames_in(datagram[:MAX_DATAGRAM_BYTES], skipped):
            try:
                frame = decode_frame(raw)
            except WireError as error:
                self._refuse(channel, str(error))
                continue
            if not isinstance(frame, kind):
                self._refuse(channel, NOT_MEANT)
                continue
            verifier = trust.verifier(frame)
            reason = _refused(raw, verifier, trust.unsigned, now_s)
            if reason is not None:
                self._refuse(channel, reason, raw, now_s)
                continue
            if verifier is not None and raw.is_signed:
                verifier.commit(raw)
            genuine.append(frame)
        for reason in skipped:
            self._refuse(channel, reason)
        return genuine

    def _refuse(self, channel: str, reason: str, raw: RawFrame | None = None, now_s: float = 0.0) -> None:
        why = ""
        if raw is not None and reason in (FUTURE_TIME, PAST_TIME):
            why = f": it is {signing_time_s(raw) - now_s:+.1f} s from this computer's clock"
        elif reason == UNSIGNED:
            why = "; allowed: signed with its key, or --unsigned-inputs"
        self._refusals.add((channel, reason), f"{channel}: {{}} frames refused: {reason}{why}")


def _refused(raw: RawFrame, verifier: MavlinkVerifier | None, unsigned: bool, now_s: float) -> str | None:
    """Return the reason why a frame is refused, None if it is accepted."""
    if not raw.is_signed:
        return None if unsigned else UNSIGNED
    if verifier is None:
        # Whoever may send unsigned frames there may as well send signed ones.
        return None if unsigned else NO_KEY
    return verifier.check(raw, now_s)


def _verifier(key: bytes, most_streams: int) -> MavlinkVerifier:
    return MavlinkVerifier(key, ahead_s=AHEAD_S, behind_s=BEHIND_S, most_streams=most_streams)
