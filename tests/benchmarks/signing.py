"""What it costs to sign and to verify a frame, beside pymavlink: `python -m tests.benchmarks.signing` from the root.

The frame is the paper's state frame. The yardstick is pymavlink's own pack and parse with signing, of the same message
in the same rounds. Machines differ and are noisy, so each figure is the median of interleaved rounds, in processor time
of one core, and stands with its ratio to that yardstick.
"""

from __future__ import annotations

import argparse
import random
import time
from collections.abc import Callable
from dataclasses import replace

from companion.mission.model import load_mission
from companion.mission.resolve import resolve
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM, FrameWriter, Stamp, StateFrame
from companion.protocol.dialect import oneway
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.mavlink_signing import MavlinkSigner, timestamp_of
from groundstation.broadcast import Broadcast, state_frames
from groundstation.ground_station import GroundStation
from groundstation.revision import first_revision
from tests.companion.protocol.hostile import START_S, Ground

Batch = Callable[[], Callable[[], object]]
"""Function that prepares a round, outside the time measured, and returns the function to time, which handles all frames
once."""


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15, help="of which the median counts")
    parser.add_argument("--frames", type=int, default=300, help="in a round")
    options = parser.parse_args()
    frame = _paper_frame()
    frames = [replace(frame, stamp=replace(frame.stamp, sequence=index + 1)) for index in range(options.frames)]
    keys = Ground("both", random.Random(1))
    private_key, mavlink_key = keys.private_key, keys.mavlink_key

    def frame_signer(*, sealed: bool, signed: bool) -> FrameSigner:
        return FrameSigner(private_key if sealed else None, MavlinkSigner(mavlink_key, 0) if signed else None)

    def sending(*, sealed: bool, signed: bool) -> Batch:
        def batch() -> Callable[[], object]:
            writer, sealing = FrameWriter(), frame_signer(sealed=sealed, signed=signed)
            return lambda: [sealing.sign(writer.encode(one), START_S) for one in frames]

        return batch

    def hearing(*, sealed: bool, signed: bool) -> Batch:
        writer, sealing = FrameWriter(), frame_signer(sealed=sealed, signed=signed)
        raws = [sealing.sign(writer.encode(one), START_S) for one in frames]
        # The bound on checks is for floods; all of these are to be checked at once.
        trust = Trust(mavlink_key if signed else None, private_key.public_key() if sealed else None, checks_per_s=1e9)

        def batch() -> Callable[[], object]:
            authenticator = Authenticator(trust)

            def hear() -> None:
                accepted = 0
                for index, raw in enumerate(raws):
                    accepted += len(authenticator.admit(raw, START_S + index / len(raws)))
                if accepted != len(raws):
                    raise AssertionError(f"{accepted} of {len(raws)} accepted: {authenticator.rejected}")

            return hear

        return batch

    strengths = {
        "unsigned": (False, False),
        "MAVLink signing": (False, True),
        "Ed25519": (True, False),
        "both": (True, True),
    }
    send = {name: sending(sealed=sealed, signed=signed) for name, (sealed, signed) in strengths.items()}
    hear = {name: hearing(sealed=sealed, signed=signed) for name, (sealed, signed) in strengths.items()}
    send = {"pymavlink: pack and sign": _pymavlink_packs(frames, mavlink_key)} | send
    hear = {"pymavlink: parse and verify": _pymavlink_parses(frames, mavlink_key)} | hear
    _table("encode and sign", send, options.rounds, options.frames)
    _table("verify and decode", hear, options.rounds, options.frames)


def _paper_frame() -> StateFrame:
    mission = resolve(load_mission("paper-dynamic"), 1)
    station = GroundStation(mission, START_S)
    station.tick(START_S)
    revision = first_revision(mission, station.tracks, 1)
    broadcast = Broadcast(Stamp(int(START_S), 0, 1), station.directive, revision)
    (frame,) = state_frames(station.tracks, mission, station.assignment, broadcast)
    return frame


def _pymavlink_packs(frames: list[StateFrame], mavlink_key: bytes) -> Batch:
    """Return a batch in which pymavlink makes the same messages: its encode from the fields, and its pack."""
    fields = [_fields_of(FrameWriter().encode(frame)) for frame in frames]

    def batch() -> Callable[[], object]:
        sender = _signing(mavlink_key)
        return lambda: [sender.oneway_state_encode(**one).pack(sender) for one in fields]

    return batch


def _pymavlink_parses(frames: list[StateFrame], mavlink_key: bytes) -> Batch:
    signer, writer = MavlinkSigner(mavlink_key, 0), FrameWriter()
    raws = [signer.sign(writer.encode(frame), START_S) for frame in frames]

    def batch() -> Callable[[], object]:
        receiver = _signing(mavlink_key)

        def parse() -> None:
            for raw in raws:
                (message,) = receiver.parse_buffer(raw)
                if not message.get_signed():
                    raise AssertionError("pymavlink refused a frame")

        return parse

    return batch


def _signing(mavlink_key: bytes) -> oneway.MAVLink:
    mav = oneway.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=GROUND_COMPONENT)
    mav.robust_parsing = True
    mav.signing.secret_key = bytearray(mavlink_key)
    mav.signing.sign_outgoing = True
    mav.signing.timestamp = timestamp_of(START_S)
    return mav


def _fields_of(raw: bytes) -> dict[str, object]:
    (message,) = oneway.MAVLink(None).parse_buffer(raw)
    return {name: getattr(message, name) for name in message.get_fieldnames()}


def _table(title: str, batches: dict[str, Batch], rounds: int, frames: int) -> None:
    taken_us: dict[str, list[float]] = {name: [] for name in batches}
    for _ in range(rounds):
        for name, batch in batches.items():
            timed = batch()
            began_s = time.process_time()
            timed()
            taken_us[name].append((time.process_time() - began_s) / frames * 1e6)
    median_us = {name: sorted(values)[rounds // 2] for name, values in taken_us.items()}
    yardstick_us = next(iter(median_us.values()))
    print(f"\n{title:<28} us/frame  frames/s  of pymavlink's")
    for name, value_us in median_us.items():
        print(f"{name:<28} {value_us:8.1f} {1e6 / value_us:9.0f} {value_us / yardstick_us:12.2f}")


if __name__ == "__main__":
    main()
