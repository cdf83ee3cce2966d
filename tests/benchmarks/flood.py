"""A flood on a real socket: `python -m tests.benchmarks.flood [--seconds 10] [--rate 10000]` from the root.

A sender process floods a receiver process on 127.0.0.1, with genuine frames at GENUINE_PER_S among the forged ones. The
receiver has what a companion has: transport, authenticator, loop. In the first flood the forger has no key and sends
newer, CRC-correct frames with a wrong MAVLink hash, the costliest kind that it can make. In the second it holds the
shared MAVLink key and can make everything but the Ed25519 signature. Printed are the share of one core that the
receiver used, what was accepted, and for the second flood how long a vehicle waits for a genuine frame. The exit status
is 1 if a forged frame was accepted or, in the first flood, a genuine one was not.
"""

from __future__ import annotations

import argparse
import asyncio
import bisect
import multiprocessing
import random
import socket
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection

from companion.protocol.authenticator import BURST_CHECKS, WRONG_ED25519, Authenticator, Trust
from companion.protocol.codec import MotionFrame, StateFrame
from companion.protocol.frame import ED25519_BYTES
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.runtime.fair_share import FairShare
from companion.transport.endpoints import open_receiver, parse_link
from tests.companion.protocol.hostile import Ground, forged_seal

GENUINE_PER_S = 5.0
PORT = 19_550
TEMPLATES = 4096
"""Number of forged frames made beforehand, so that making them costs the sender no time while it floods."""
SETTLING_S = 5.0
"""Virtual time at the beginning that is left out, in which the checks saved up are used up."""
CROWD_S = 0.02
"""Time about a genuine frame within which a forger that knows when it comes can send all its own frames."""
SPARE_S = 1.0
"""Time that the forged stamps are ahead of the clock when they are made, and that the receiver goes on after the
flood."""


def main() -> int:
    """Run both floods; return the exit status."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--seconds", type=float, default=10.0)
    arguments.add_argument("--rate", type=float, default=10_000.0, help="forged frames per second")
    arguments.add_argument("--checks", type=float, default=Trust().checks_per_s, help="Ed25519 checks per second")
    arguments.add_argument("--virtual", type=float, default=600.0, help="seconds of virtual time for the waits")
    options = arguments.parse_args()
    is_good = True
    for has_key in (False, True):
        found = flood(options.seconds, options.rate, options.checks, has_key=has_key)
        is_good &= found["forged"] == 0 and (has_key or found["genuine"] == found["genuine_sent"])
        print(("with" if has_key else "without") + " the shared key: " + _line(found), flush=True)
    for checks_per_s in (options.checks / 5, options.checks):
        for crowd_s, how in ((1.0 / GENUINE_PER_S, "spread evenly"), (CROWD_S, "crowded about each genuine frame")):
            waits = sorted(waits_s(options.rate, checks_per_s, options.virtual, crowd_s))
            found_text = (
                f"after {sum(waits) / len(waits):.1f} s in the mean, 99 % within {waits[int(0.99 * len(waits))]:.1f} s"
                if waits
                else "never"
            )
            print(
                f"{options.rate:.0f} frames/s with the shared key, {how}, {checks_per_s:.0f} checks/s: a genuine frame "
                f"{found_text} (virtual time, {GENUINE_PER_S:.0f} genuine frames/s)",
                flush=True,
            )
    return 0 if is_good else 1


def flood(seconds: float, rate: float, checks_per_s: float, *, has_key: bool) -> dict[str, float]:
    """Run one flood; return the counts and times of both processes."""
    ground = Ground("both", random.Random(1), epoch_s=int(time.time()))
    trust = Trust(ground.trust.mavlink_key, ground.trust.public_key, checks_per_s=checks_per_s)
    ours, theirs = multiprocessing.Pipe()
    # Forked, so that the keys need no way into the other process.
    receiver = multiprocessing.get_context("fork").Process(target=_receive, args=(trust, theirs), daemon=True)
    receiver.start()
    ours.recv()
    sent = _send(ground, seconds, rate, has_key=has_key)
    time.sleep(SPARE_S)
    ours.send("stop")
    found: dict[str, float] = ours.recv()
    receiver.join()
    return found | sent


def _line(found: dict[str, float]) -> str:
    flooded_s = found["ended_s"] - found["began_s"]
    return (
        f"{found['sent'] / flooded_s:.0f} forged frames/s sent for {flooded_s:.1f} s, {found['heard'] / flooded_s:.0f} "
        f"datagrams/s heard; the receiver used {100 * found['cpu_s'] / flooded_s:.1f} % of a core; "
        f"{found['checked'] / flooded_s:.0f} Ed25519 checks/s; {found['forged']} forged accepted; "
        f"{found['genuine']} of {found['genuine_sent']} genuine accepted"
    )


def _send(ground: Ground, seconds: float, rate: float, *, has_key: bool) -> dict[str, float]:
    """Flood the receiver, with genuine frames in between; return the counts and the times of begin and end."""
    rng = random.Random(2)
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    address = ("127.0.0.1", PORT)
    forge = _forger(ground, rng, has_key=has_key)
    templates = [forge(time.time() + SPARE_S) for _ in range(TEMPLATES)]
    began_s = time.monotonic()
    sent = genuine = 0
    while (passed_s := time.monotonic() - began_s) < seconds:
        if genuine < passed_s * GENUINE_PER_S:
            sock.sendto(ground.frame(time.time()), address)
            genuine += 1
        # What is due goes out in small bursts, as from any sender that sleeps between.
        for _ in range(int(passed_s * rate) - sent):
            sock.sendto(templates[sent % TEMPLATES], address)
            sent += 1
        time.sleep(0.0005)
    ended_s = time.monotonic()
    return {"sent": sent, "genuine_sent": genuine, "began_s": began_s, "ended_s": ended_s}


def _forger(ground: Ground, rng: random.Random, *, has_key: bool) -> Callable[[float], bytes]:
    signer = MavlinkSigner(ground.mavlink_key if has_key else rng.randbytes(32), 0)

    def forge(now_s: float) -> bytes:
        raw = ground.unsealed(now_s, rng.randrange(1 << 31, 1 << 32))
        return signer.sign(forged_seal(raw, rng.randbytes(ED25519_BYTES)), now_s)

    return forge


def _receive(trust: Trust, pipe: Connection) -> None:
    """Receive as a vehicle does, in a process of its own."""
    asyncio.run(_listen(trust, pipe))


async def _listen(trust: Trust, pipe: Connection) -> None:
    authenticator = Authenticator(trust)
    counts = {"heard": 0, "forged": 0, "genuine": 0}

    def hear(datagram: bytes) -> None:
        counts["heard"] += 1
        for _, frame in authenticator.admit(datagram, time.time()):
            if not isinstance(frame, StateFrame | MotionFrame):
                raise AssertionError(f"{type(frame).__name__} was neither sent nor forged")
            # A genuine one counts from 1; a forged one begins far above.
            is_forged = frame.stamp.sequence >= 1 << 31
            counts["forged" if is_forged else "genuine"] += 1

    receiver = await open_receiver(parse_link(f"udpin:127.0.0.1:{PORT}"), hear)
    pipe.send("ready")
    began_cpu_s = time.process_time()
    while not pipe.poll():
        await asyncio.sleep(0.05)
        authenticator.due(time.time())
    cpu_s = time.process_time() - began_cpu_s
    receiver.close()
    checked = authenticator.rejected[WRONG_ED25519] + counts["forged"] + counts["genuine"]
    pipe.send(counts | {"cpu_s": cpu_s, "checked": checked})


def waits_s(rate: float, checks_per_s: float, seconds: float, crowd_s: float) -> list[float]:
    """Return how long vehicles that begin to listen at any moment wait for a genuine frame, by the check limiter alone.

    The time is virtual; the forger sends all its frames within `crowd_s` about each genuine one.
    """
    gate: FairShare[bytes] = FairShare(checks_per_s, BURST_CHECKS, random.Random(3))
    each = round(rate / GENUINE_PER_S)
    begins_s = [turn / GENUINE_PER_S for turn in range(round(seconds * GENUINE_PER_S))]
    rng = random.Random(4)
    accepted_s = []
    for begin_s in begins_s:
        genuine_at = rng.randrange(each + 1)
        for place in range(each + 1):
            now_s = begin_s + crowd_s * place / each
            raws = [b"genuine" if place == genuine_at else b"forged"]
            drawn = gate.due(now_s)
            if gate.offer(raws[0], now_s):
                drawn += raws
            if b"genuine" in drawn:
                accepted_s.append(now_s)
    # The quiet time before the gate fills up, in which all are checked, is left out.
    settled_s = [moment for moment in accepted_s if moment > SETTLING_S]
    starts_s = [SETTLING_S + 0.1 * index for index in range(int(10 * ((settled_s or [0.0])[-1] - SETTLING_S)))]
    return [settled_s[bisect.bisect_left(settled_s, start_s)] - start_s for start_s in starts_s]


if __name__ == "__main__":
    sys.exit(main())
