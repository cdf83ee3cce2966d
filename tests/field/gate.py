"""Situations of the broadcast's gate: restarts, wrong clocks, forged transponders, keys, tables and bombs."""

from __future__ import annotations

import math
import os
import random
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from companion.errors import InputError
from companion.mission.model import parse_mission
from companion.onboard.config import parse_config
from companion.onboard.state_files import AuthenticatorStateFile
from companion.onboard.world_model import WorldModel
from companion.protocol.authenticator import Authenticator, AuthenticatorState, Trust
from companion.protocol.codec import AgentEntry, Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.keys import MAVLINK_NAME, PUBLIC_NAME, keygen, load_mavlink_key, load_public
from companion.runtime.io_thread import IoThread
from tests.companion.onboard.companion_flight import guided
from tests.companion.protocol.hostile import START_S, Ground
from tests.field.situation import Situation

EPOCH_S = int(START_S)
DAY_S = 86_400
CLOSE_M = (40.0, 6.0)
"""Where a fleet mate stands, just beside the way north."""
WORKS_S = 2.0
"""Processor time after which a reader is given up."""
WAITS_S = 10.0
"""Time after which one is given up that does nothing."""


def keys(word: str) -> Ground:
    """Return a ground station's keys, always the same."""
    return Ground(word, random.Random(77))


def signed(word: str, number: int, at_s: float, *, epoch_s: int = EPOCH_S, signed_s: float | None = None) -> bytes:
    """Return one broadcast, stamped and signed at a time."""
    stamp = Stamp(epoch_s, round((at_s - epoch_s) * 1000), number)
    raw = FrameWriter().encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ()))
    ground = keys(word)
    signer = ground.sealer_with(ground.private_key, ground.mavlink_key)
    return signer.sign(raw, at_s if signed_s is None else signed_s)


def trust_of(word: str, *, checked: bool = True) -> Trust:
    """Return the trust of a vehicle that has the keys."""
    return replace(keys(word).trust, clock_checked=checked)


def _restarted_cleanly() -> str:
    again = []
    for word in ("mavlink", "ed25519", "both"):
        frame = signed(word, 7, START_S)
        before = Authenticator(trust_of(word))
        assert before.admit(frame, START_S)
        after = Authenticator(before.trust, AuthenticatorState.from_json(before.state.to_json()))
        again += after.admit(frame, START_S + 1.0)
        assert after.admit(signed(word, 8, START_S + 1.2), START_S + 1.2)
    assert not again, f"{len(again)} of 3 believed again"
    return "not believed again, the next one is"


def _killed() -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "broadcast.json")
        before = Authenticator(trust_of("both"))
        files = IoThread("files")
        kept = AuthenticatorStateFile(str(path), before, files)
        kept.write_if_due(START_S)
        lost = signed("both", 7, START_S + 0.5)
        assert before.admit(lost, START_S + 0.5)
        files.close()
        state = AuthenticatorState.from_json(path.read_text()) if path.exists() else None
        after = Authenticator(before.trust, state)
        assert not after.admit(lost, START_S + 1.5), "believed again"
        waited_s = next(
            tenth / 10
            for tenth in range(1, 100)
            if after.admit(signed("both", 8 + tenth, START_S + 1.5 + tenth / 10), START_S + 1.5 + tenth / 10)
        )
    return f"not believed again; hears on after {waited_s:.1f} s"


def _day_ahead(word: str) -> str:
    vehicle = Authenticator(trust_of(word, checked=False))
    vehicle.admit(signed(word, 1, START_S), START_S)
    assert vehicle.admit(signed(word, 1, START_S + DAY_S, epoch_s=EPOCH_S + DAY_S), START_S + 1.0)
    deaf_s = next(
        (s for s in range(2, 600) if vehicle.admit(signed(word, s, START_S + s), START_S + float(s))), math.inf
    )
    assert deaf_s < 60, "deaf for good"
    wrong = signed(word, 1, START_S + DAY_S, epoch_s=EPOCH_S + DAY_S)
    assert not vehicle.admit(wrong, START_S + 700.0)
    return f"heard again after {deaf_s - 1} s"


def _mavlink_time_ahead() -> str:
    vehicle = Authenticator(trust_of("mavlink", checked=False))
    assert vehicle.admit(signed("mavlink", 1, START_S, signed_s=START_S + 30 * DAY_S), START_S)
    deaf_s = next(
        (s for s in range(1, 600) if vehicle.admit(signed("mavlink", s, START_S + s), START_S + float(s))), math.inf
    )
    assert deaf_s < 60, "deaf for good"
    return f"heard again after {deaf_s} s"


def _wanted_rad(mate_ned_m: tuple[float, float], *seen_at: tuple[float, float]) -> float:
    """Return the course of a copter to the north with a fleet mate told, and seen at places under its callsign."""
    flight = guided()
    for place in seen_at:
        flight.neighbour(*place, callsign=b"OW00012")
    flight.broadcast((5_000.0, 0.0), agents=(AgentEntry(12, *mate_ned_m, None),))
    decision, _ = flight.at(0.0, 0.0, (10.0, 0.0))
    assert decision.setpoint is not None
    return math.remainder(decision.setpoint.heading_rad, math.tau) if decision.setpoint.speed_m_s > 0.1 else math.nan


def _forged_place(*seen_at: tuple[float, float]) -> str:
    alone, told = _wanted_rad((4_000.0, 3_000.0)), _wanted_rad(CLOSE_M)
    assert told != alone
    forged = _wanted_rad(CLOSE_M, *seen_at)
    assert math.isnan(forged) == math.isnan(told) and (math.isnan(told) or abs(forged - told) < 0.2), (
        f"{forged:.2f} rad as if nobody were there ({alone:.2f}), told {told:.2f}"
    )
    return "gives way as before"


@contextmanager
def key_folder() -> Iterator[Path]:
    """Yield a folder with new keys."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "keys")
        keygen(path)
        yield path


def _refused(read: Callable[[], object]) -> str:
    found: list[str] = []

    def run() -> None:
        try:
            read()
        except InputError as error:
            found.append(str(error))

    thread = threading.Thread(target=run, daemon=True)
    began_s, cpu_s = time.monotonic(), time.process_time()
    thread.start()
    while thread.is_alive() and time.process_time() - cpu_s < WORKS_S and time.monotonic() - began_s < WAITS_S:
        thread.join(0.01)
    assert not thread.is_alive(), f"takes more than {WORKS_S:g} s of work, or waits for ever"
    assert found, "taken"
    assert "\n" not in found[0]
    return found[0]


def _writable_key() -> str:
    with key_folder() as folder:
        (folder / PUBLIC_NAME).chmod(0o666)
        assert "chmod go-w" in _refused(lambda: load_public(folder / PUBLIC_NAME))
        return "refused with the chmod that mends it"


def _writable_folder() -> str:
    with key_folder() as folder:
        folder.chmod(0o777)
        words = [_refused(partial(load, folder / name)) for name, load in _LOADERS]
        folder.chmod(0o700)
        return f"{len(words)} keys refused"


_LOADERS: tuple[tuple[str, Callable[[Path], object]], ...] = (
    (PUBLIC_NAME, load_public),
    (MAVLINK_NAME, load_mavlink_key),
)


def _linked_key() -> str:
    with key_folder() as folder, tempfile.TemporaryDirectory() as other:
        open_folder = Path(other, "open")
        open_folder.mkdir()
        (open_folder / PUBLIC_NAME).write_bytes((folder / PUBLIC_NAME).read_bytes())
        open_folder.chmod(0o777)
        (folder / "link").symlink_to(open_folder / PUBLIC_NAME)
        _refused(lambda: load_public(folder / "link"))
    return "refused"


def _piped_key() -> str:
    with key_folder() as folder:
        os.mkfifo(folder / "pipe", 0o600)
        return _refused(lambda: load_public(folder / "pipe")).rpartition(": ")[2]


def _bomb(parse: Callable[[str, str], object], text: str) -> str:
    began_s = time.process_time()
    words = _refused(lambda: parse(text, "bomb.yaml"))
    assert time.process_time() - began_s < WORKS_S
    return f"{len(text)} bytes refused: {words.split(': ', 2)[1]}"


def _mission_bomb() -> str:
    points = ", ".join(f"[{k}, {k}, 0]" for k in range(300))
    one = "north_m: 0, east_m: 0, detection_radius_m: 50, attack_radius_m: 10"
    more = "".join(f", {{id: {k}, {one}, motion: {{path: *q}}}}" for k in range(2, 700))
    first = f"{{id: 1, {one}, motion: {{path: &q [{points}]}}}}"
    return _bomb(parse_mission, f"agents: [{{id: 1}}]\ntargets: [{{id: 1}}]\nthreats: [{first}{more}]\n")


def _config_bomb() -> str:
    corners = ", ".join(f"[{k}, {k * k}]" for k in range(200))
    same = ", ".join(["*e"] * 1900)
    return _bomb(parse_config, f"agent_id: 1\nlimits: {{exclusions: [&e [{corners}], {same}]}}\n")


def _crowd() -> str:
    world = WorldModel(1)
    for number in range(1, 301):
        agents = tuple(AgentEntry(100 * number + k, 0.0, 0.0, None) for k in range(10))
        stamp = Stamp(EPOCH_S, number * 1000, number, 0, 2)
        world.take(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, agents, (), ()), EPOCH_S + number)
    count = len(world._beliefs.agents)
    assert count <= 2000, f"{count} agents remembered"
    return f"{count} remembered, those told longest ago forgotten"


SITUATIONS: tuple[Situation, ...] = (
    Situation(
        "a vehicle is restarted, and its newest broadcast comes once more",
        "it is not believed again; the next one is",
        "believed again",
        _restarted_cleanly,
    ),
    Situation(
        "the companion is killed within the second in which it believed a broadcast, and that comes once more",
        "it is not believed again, though it was not saved",
        "believed again",
        _killed,
    ),
    Situation(
        "`clock: unchecked`, Ed25519: the ground station's clock was a day ahead for one frame",
        "its frames of the right time are believed again after a stated silence, the wrong one never again",
        "deaf for good",
        lambda: _day_ahead("ed25519"),
    ),
    Situation(
        "`clock: unchecked`, MAVLink signing: one holder of the key broadcasts an epoch a day ahead",
        "the same",
        "deaf for good",
        lambda: _day_ahead("mavlink"),
    ),
    Situation(
        "`clock: unchecked`: one frame of right content has a MAVLink time a month ahead",
        "the stream is believed again after a stated silence",
        "deaf for good",
        _mavlink_time_ahead,
    ),
    Situation(
        "a forged ADSB_VEHICLE with a fleet mate's callsign says that it is 500 m off",
        "the mate is kept clear of where the broadcast says that it is",
        "flies on as if nobody were there",
        lambda: _forged_place((500.0, 500.0)),
    ),
    Situation(
        "the same says that it is 9 km away, beyond the detector's range",
        "the same",
        "flies on as if nobody were there",
        lambda: _forged_place((9_000.0, 0.0)),
    ),
    Situation(
        "others may write the ground station's public key on the vehicle",
        "refused in one line with the remedy",
        "taken",
        _writable_key,
    ),
    Situation("others may write the folder of the keys", "refused", "taken", _writable_folder),
    Situation("a key is a link into a folder that others may write", "refused", "taken", _linked_key),
    Situation("a pipe is in the place of a key", "refused at once", "waits for ever", _piped_key),
    Situation(
        "a mission's aliases stand for 210 000 points", "refused in a moment, by its key", "taken", _mission_bomb
    ),
    Situation(
        "a configuration's aliases stand for 380 000 corners",
        "refused in a moment, by its key",
        "checked for minutes",
        _config_bomb,
    ),
    Situation(
        "an authentic sender tells of 3000 agents, ten at a time",
        "no more are remembered than a mission can have",
        "all remembered",
        _crowd,
    ),
)
