"""The ground station's shell: real sockets on this computer, real files, and what survives a restart."""

from __future__ import annotations

import asyncio
import importlib
import os
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.errors import InputError
from companion.files.tlog import read_tlog
from companion.mission.model import Mission, parse_mission
from companion.protocol.authenticator import REPEATED, Authenticator, Trust
from companion.protocol.frame import raw_frame
from companion.protocol.keys import keygen, load_mavlink_key, load_public
from companion.protocol.mavlink_signing import timestamp_of
from companion.protocol.messages import REVISIONS, Directive, MotionFrame, Stamp, StateFrame
from companion.runtime.clock import SteadyClock
from companion.transport.endpoints import parse_link
from groundstation import service
from groundstation.choices import Authentication
from groundstation.clock import MOST_AHEAD_S, GroundClock, Sources
from groundstation.directives import directive_from
from groundstation.log_files import log_place
from groundstation.options import Options
from groundstation.page import Page
from groundstation.radio import parse_radio
from groundstation.rivals import RunLock
from groundstation.saved_state import (
    SavedState,
    began_at_s,
    epoch_after,
    saved_state_from,
    signing_after,
    state_in,
    text_of,
    threats_digest,
)
from groundstation.service import load_frame_signer, run_groundstation
from groundstation.store.database import Database
from groundstation.store.recordings import records_in
from groundstation.web.address import Address
from groundstation.web.site import Site

# Loaded before any test, as the first assignment would load it: the tests of clocks must not count that second.
importlib.import_module("scipy.optimize")

NOW_S = 1_790_000_000.0
KEPT = SavedState(1, 0, "", 0.0, Directive.NORMAL, 1)
SMALL = """
name: small
broadcast_period_s: 0.1
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 5000}]
targets: [{id: 1, north_m: 20000, east_m: 0}]
threats: [{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000, speed_bound_m_s: 10}]
"""


def mission() -> Mission:
    return parse_mission(SMALL, "small")


class Ear:
    """A UDP port of this computer, and what came in."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.link = parse_link(f"udpout:127.0.0.1:{self._socket.getsockname()[1]}")
        self._heard: list[bytes] = []

    def heard(self) -> list[bytes]:
        while True:
            try:
                self._heard.append(self._socket.recv(2048))
            except BlockingIOError:
                return self._heard

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def ear() -> Iterator[Ear]:
    one = Ear()
    yield one
    one.close()


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    folder = tmp_path / "keys"
    keygen(folder)
    return folder


def broadcast_until(options: Options, done: Callable[[], bool]) -> None:
    """Run a ground station until something holds, for 20 s at most."""

    async def run() -> None:
        stop = asyncio.Event()
        running = asyncio.create_task(run_groundstation(mission(), options, stop))
        for _ in range(2_000):
            if done() or running.done():
                break
            await asyncio.sleep(0.01)
        stop.set()
        await running

    asyncio.run(run())
    assert done()


def admitted(heard: list[bytes], trust: Trust) -> list[StateFrame]:
    authenticator = Authenticator(trust)
    now_s = admission_time_s(heard)
    frames = [one.frame for data in heard for one in authenticator.admit(data, now_s)]
    return [frame for frame in frames if isinstance(frame, StateFrame)]


def admission_time_s(heard: list[bytes]) -> float:
    """Return the time of the last frame, in its epoch and milliseconds."""
    payload = heard[-1][10:]
    return int.from_bytes(payload[:4], "little") + int.from_bytes(payload[4:8], "little") / 1000.0


@pytest.mark.parametrize("authentication", ["unsigned", "mavlink", "ed25519", "both"])
def test_what_is_broadcast_is_believed_by_who_demands_just_that(
    ear: Ear, keys: Path, authentication: Authentication
) -> None:
    folder = None if authentication == "unsigned" else keys
    broadcast_until(Options(ear.link, authentication, folder), lambda: len(ear.heard()) >= 3)
    trust = Trust(
        mavlink_key=load_mavlink_key(keys / "broadcast.mavlink") if authentication in ("mavlink", "both") else None,
        public_key=load_public(keys / "broadcast.public") if authentication in ("ed25519", "both") else None,
    )
    assert admitted(ear.heard(), trust)


def test_who_demands_a_signature_believes_nothing_unsigned(ear: Ear, keys: Path) -> None:
    broadcast_until(Options(ear.link, "unsigned"), lambda: len(ear.heard()) >= 3)
    assert admitted(ear.heard(), Trust(public_key=load_public(keys / "broadcast.public"))) == []


def test_every_status_says_that_it_is_unsigned(ear: Ear, capsys: pytest.CaptureFixture[str]) -> None:
    broadcast_until(Options(ear.link, "unsigned"), lambda: len(ear.heard()) >= 1)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) >= 2
    assert all("(unsigned)" in line for line in lines)


def test_the_log_has_every_frame_sent_and_no_mavlink_signature(ear: Ear, keys: Path, tmp_path: Path) -> None:
    path = tmp_path / "sent.tlog"
    broadcast_until(Options(ear.link, "both", keys, log=path), lambda: len(ear.heard()) >= 5)
    logged = [raw for _, raw in read_tlog(path)]
    assert len(logged) == len(ear.heard())
    assert all(raw_frame(raw).is_signed for raw in ear.heard())
    assert not any(raw_frame(raw).is_signed for raw in logged)
    public_key = load_public(keys / "broadcast.public")
    assert admitted(logged, Trust(public_key=public_key))
    secret = load_mavlink_key(keys / "broadcast.mavlink")
    assert secret not in path.read_bytes()


@pytest.mark.slow
def test_a_frame_inside_a_v2_extension_is_logged_as_itself(ear: Ear, keys: Path, tmp_path: Path) -> None:
    path = tmp_path / "sent.tlog"
    options = Options(ear.link, "mavlink", keys, radio=parse_radio("20000/v2ext", 1.0), log=path)
    broadcast_until(options, lambda: len(ear.heard()) >= 5)
    assert {int.from_bytes(raw[7:10], "little") for raw in ear.heard()} == {248}
    logged = [raw for _, raw in read_tlog(path)]
    assert not any(raw_frame(raw).is_signed for raw in logged)
    assert admitted(logged, Trust())


def test_threats_are_mirrored_on_a_port_of_their_own(ear: Ear) -> None:
    display = Ear()
    options = Options(ear.link, "unsigned", mirror=display.link)
    broadcast_until(options, lambda: len(ear.heard()) >= 3 and len(display.heard()) >= 2)
    kinds = [common.MAVLink(None).parse_buffer(raw)[0].get_type() for raw in display.heard()[:2]]
    assert kinds == ["HEARTBEAT", "ADSB_VEHICLE"]
    assert all(int.from_bytes(raw[7:10], "little") >= 0xA00100 for raw in ear.heard())
    display.close()


def test_a_restart_begins_an_epoch_after_the_last(ear: Ear, tmp_path: Path) -> None:
    state = tmp_path / "ground.state"
    epochs = []
    for _ in range(2):
        ear.heard().clear()
        broadcast_until(Options(ear.link, "unsigned", state=state), lambda: len(ear.heard()) >= 1)
        epochs.append(int.from_bytes(ear.heard()[0][10:14], "little"))
        assert kept_in(state).epoch_s == epochs[-1]
    assert epochs == sorted(set(epochs))


def set_clock(monkeypatch: pytest.MonkeyPatch, by_s: float) -> Callable[[], float]:
    """Set the clock of this computer for runs that begin later, and return the function that reads it."""

    def wall_s() -> float:
        return time.time() + by_s

    monkeypatch.setattr(service, "GroundClock", lambda: GroundClock(Sources(wall_s=wall_s)))
    return wall_s


def test_after_a_small_step_back_of_the_clock_a_restart_is_heard_at_once(
    ear: Ear, keys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "ground.state"
    options = Options(ear.link, "both", keys, state=state)
    authenticator = Authenticator(
        Trust(load_mavlink_key(keys / "broadcast.mavlink"), load_public(keys / "broadcast.public"))
    )
    for run in range(2):
        wall_s = set_clock(monkeypatch, -0.3 * run)
        ear.heard().clear()
        broadcast_until(options, lambda: len(ear.heard()) >= 3)
        # The vehicle's clock stands still meanwhile, all but.
        now_s = wall_s()
        assert len(authenticator.admit(ear.heard()[0], now_s)) == 1
        for raw in ear.heard()[1:]:
            authenticator.admit(raw, now_s)
        # While the epoch is ahead of the clock its stamp stands, so that what is told again is the same frame.
        assert authenticator.rejected.keys() <= {REPEATED}


def test_stamps_follow_the_clock_though_the_last_run_was_ahead_of_it(ear: Ear, tmp_path: Path) -> None:
    state = tmp_path / "ground.state"
    began_s = SteadyClock().now_s()
    state.write_text(text_of(replace(KEPT, epoch_s=int(began_s))))
    broadcast_until(Options(ear.link, "unsigned", state=state), lambda: len(ear.heard()) >= 3)
    assert int.from_bytes(ear.heard()[0][10:14], "little") == int(began_s) + 1
    assert admission_time_s(ear.heard()) <= SteadyClock().now_s() + MOST_AHEAD_S


def test_with_the_clock_far_behind_the_last_run_it_does_not_start(
    ear: Ear, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "ground.state"
    options = Options(ear.link, "unsigned", state=state)
    broadcast_until(options, lambda: len(ear.heard()) >= 1)
    before = kept_in(state)
    ear.heard().clear()
    set_clock(monkeypatch, -3_600.0)
    with pytest.raises(
        InputError, match="the clock is 3[56]\\d\\d.\\d s behind the last run, .*: wait, set the clock or"
    ):
        broadcast_until(options, lambda: False)
    assert ear.heard() == []
    assert kept_in(state) == before


@pytest.mark.slow
def test_no_mavlink_time_is_at_or_below_one_signed_before(ear: Ear, keys: Path) -> None:
    state = keys / "ground.state"
    ahead = timestamp_of(SteadyClock().now_s() + 1.3)
    state.write_text(text_of(replace(KEPT, signing_timestamp=ahead)))
    broadcast_until(Options(ear.link, "mavlink", keys, state=state), lambda: len(ear.heard()) >= 3)
    times = [int.from_bytes(raw[-12:-6], "little") for raw in ear.heard()]
    assert times == list(range(ahead + 1, ahead + 1 + len(times)))
    assert kept_in(state).signing_timestamp >= ahead + len(times)


def test_a_signing_time_far_ahead_is_refused_where_vehicles_look_at_it_and_only_there() -> None:
    kept = replace(KEPT, signing_timestamp=timestamp_of(NOW_S + 10.0))
    with pytest.raises(InputError, match="x.state: the clock is 10.0 s behind the last run"):
        signing_after(kept, NOW_S, True, Path("x.state"))
    assert signing_after(kept, NOW_S, False, Path("x.state")) == kept.signing_timestamp


def test_a_run_without_mavlink_signing_forgets_no_signing_time(ear: Ear, tmp_path: Path) -> None:
    state = tmp_path / "ground.state"
    state.write_text(text_of(replace(KEPT, signing_timestamp=12_345)))
    broadcast_until(Options(ear.link, "unsigned", state=state), lambda: len(ear.heard()) >= 1)
    assert kept_in(state).signing_timestamp == 12_345


def kept_in(path: Path) -> SavedState:
    state = state_in(path)
    assert state is not None
    return state


def threat_radius_m(ear: Ear) -> float:
    (threat,) = admitted(ear.heard()[:1], Trust())[0].threats
    return threat.detection_radius_m


def test_after_a_restart_the_threats_are_as_old_as_the_mission(
    ear: Ear, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = tmp_path / "ground.state"
    options = Options(ear.link, "unsigned", state=state)
    broadcast_until(options, lambda: len(ear.heard()) >= 1)
    assert threat_radius_m(ear) < 3_050.0
    kept = kept_in(state)
    state.write_text(text_of(replace(kept, began_s=kept.began_s - 600.0)))  # As releases before the store wrote it.
    ear.heard().clear()
    capsys.readouterr()
    broadcast_until(options, lambda: len(ear.heard()) >= 1)
    assert threat_radius_m(ear) >= 3_000.0 + 600.0 * 10.0
    assert "threats: where the mission says 60" in capsys.readouterr().out
    assert kept_in(state).began_s == kept.began_s - 600.0


def test_only_the_same_threats_are_as_old_as_the_last_run_has_them() -> None:
    digest = threats_digest(mission())
    kept = replace(KEPT, threats=digest, began_s=NOW_S - 600.0)
    other_target = parse_mission(SMALL.replace("20000", "21000"), "small")
    other_threat = parse_mission(SMALL.replace("10000", "11000"), "small")
    assert began_at_s(kept, threats_digest(other_target), NOW_S) == NOW_S - 600.0
    assert began_at_s(kept, threats_digest(other_threat), NOW_S) == NOW_S
    assert began_at_s(kept, digest, NOW_S - 1_000.0) == NOW_S - 1_000.0
    assert began_at_s(None, digest, NOW_S) == NOW_S


def test_without_a_state_file_it_warns_that_a_restart_would_not_know_where_threats_may_be(
    ear: Ear, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broadcast_until(Options(ear.link, "unsigned"), lambda: len(ear.heard()) >= 2)
    assert capsys.readouterr().err.count("warning: without --state a restart would tell the threats smaller") == 1
    broadcast_until(Options(ear.link, "unsigned", state=tmp_path / "x"), lambda: len(ear.heard()) >= 4)
    assert "warning" not in capsys.readouterr().err


def test_a_directive_is_on_disk_at_once_and_holds_after_a_restart(
    ear: Ear, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    state = tmp_path / "ground.state"
    options = Options(ear.link, "unsigned", state=state)
    reading, writing = os.pipe()
    with os.fdopen(reading) as stdin, os.fdopen(writing, "wb", buffering=0) as orders:
        monkeypatch.setattr("sys.stdin", stdin)
        orders.write(b"hold\n")
        found: list[Directive] = []

        def held() -> bool:
            # Looked at while the program runs: it is not its end that writes this.
            heard = [frame.directive for frame in admitted(ear.heard(), Trust())] if ear.heard() else []
            if Directive.HOLD in heard:
                found.append(kept_in(state).directive)
            return bool(found)

        broadcast_until(options, held)
    assert found[0] is Directive.HOLD
    ear.heard().clear()
    capsys.readouterr()
    monkeypatch.setattr("sys.stdin", None)
    broadcast_until(options, lambda: len(ear.heard()) >= 3)
    assert {frame.directive for frame in admitted(ear.heard(), Trust())} == {Directive.HOLD}
    assert "directive: hold, kept from the last run" in capsys.readouterr().out


def test_a_frame_that_cannot_be_made_is_warned_of_once_and_ends_nothing(
    ear: Ear, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def never(*_: object) -> list[MotionFrame]:
        return [MotionFrame(Stamp(1, 1, -1), (), (), ())]

    monkeypatch.setattr("groundstation.ground_station.motion_frames", never)
    broadcast_until(Options(ear.link, "unsigned"), lambda: len(ear.heard()) >= 4)
    warning = "a frame could not be sent: sequence -1 does not fit its field; allowed: 0 to 4294967295; going on with"
    assert capsys.readouterr().err.count(warning) == 1


def test_a_mission_that_a_radio_cannot_carry_is_refused_before_anything_is_said(
    ear: Ear, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = tmp_path / "ground.state"
    options = Options(ear.link, "unsigned", radio=parse_radio("10", 0.1), state=state)
    with pytest.raises(InputError, match="radio 10: the state of this mission is") as caught:
        broadcast_until(options, lambda: False)
    assert "--auth" not in str(caught.value)
    assert capsys.readouterr() == ("", "")
    assert not state.exists()


def test_the_state_is_on_disk_before_the_first_frame_is_on_the_air(
    ear: Ear, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "ground.state"
    heard_before: list[int] = []
    replace_file = Path.replace

    def replaced(fresh: Path, target: Path) -> Path:
        time.sleep(0.2)
        heard_before.append(len(ear.heard()))
        return replace_file(fresh, target)

    monkeypatch.setattr(Path, "replace", replaced)
    broadcast_until(Options(ear.link, "unsigned", state=state), lambda: bool(ear.heard()))
    assert heard_before[0] == 0


def test_a_disk_that_takes_neither_state_nor_log_is_told_and_silences_nobody(
    ear: Ear, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = tmp_path / "ground.state"
    in_the_way = tmp_path / "ground.state.new"
    in_the_way.mkdir()

    def done() -> bool:
        if len(ear.heard()) >= 5 and in_the_way.is_dir():
            in_the_way.rmdir()
        return state.exists()

    broadcast_until(Options(ear.link, "unsigned", state=state, log=tmp_path / "nowhere" / "x.tlog"), done)
    said = capsys.readouterr()
    assert f"groundstation: warning: {state}: cannot write the store" in said.err
    assert "groundstation: warning: no logs: No such file or directory; broadcasting without them" in said.err
    assert said.err.count("warning: ") == 2
    assert f"groundstation: {state}: the store is written again" in said.out


def test_logs_of_one_name_have_a_bound_together_and_none_is_written_over(tmp_path: Path) -> None:
    path = tmp_path / "ground.tlog"
    for number in range(1, 30):
        place = log_place(path, 1_000)
        one = place(1)
        assert not one.exists()
        one.write_bytes(bytes(100))
        os.utime(one, (number, number))
    other = tmp_path / "other.tlog"
    other.write_bytes(bytes(5_000))
    logs = [one for one in tmp_path.iterdir() if one != other]
    assert sum(one.stat().st_size for one in logs) <= 1_050
    assert max(one.stat().st_mtime for one in logs) == 29
    assert other.exists()


def test_a_run_leaves_its_events_pictures_and_frames_and_a_second_one_goes_on(ear: Ear, tmp_path: Path) -> None:
    state = tmp_path / "ground.state"
    options = Options(ear.link, "unsigned", state=state)
    for _ in range(2):
        ear.heard().clear()
        broadcast_until(options, lambda: len(ear.heard()) >= 4)
    reader = Database.read_only(state)
    kinds = [row.event for row in reader.events()]
    assert kinds[:3] == ["started", "assigned", "revision-began"]
    assert kinds.count("assigned") == 1
    assert kinds.count("started") == kinds.count("stopped") == 2
    pictures = list(reader.recorded("picture"))
    assert [agent["id"] for agent in orjson.loads(pictures[0].body)["agents"]] == [1, 2]
    assert any(list(records_in(recorded.body)) for recorded in reader.recorded("frames"))
    reader.close()


def test_a_second_run_with_the_same_store_is_refused_though_its_keys_are_others(
    ear: Ear, keys: Path, tmp_path: Path
) -> None:
    state = tmp_path / "ground.state"
    first = RunLock(state.with_name("ground.state.lock"))
    with pytest.raises(
        InputError, match="ground.state.lock: another ground station runs with these keys or this state"
    ):
        broadcast_until(Options(ear.link, "both", keys, state=state), lambda: False)
    first.close()
    assert not state.exists()


def test_a_state_that_is_none_is_not_replaced(ear: Ear, tmp_path: Path) -> None:
    state = tmp_path / "ground.state"
    state.write_text("something else")
    with pytest.raises(InputError, match="no state of a ground station"):
        broadcast_until(Options(ear.link, "unsigned", state=state), lambda: False)
    assert state.read_text() == "something else"
    assert ear.heard() == []


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 4e9))
def test_an_epoch_is_later_than_the_last_and_no_more_than_seconds_ahead_of_the_clock(
    last_epoch_s: int, now_s: float
) -> None:
    try:
        epoch_s = epoch_after(replace(KEPT, epoch_s=last_epoch_s), now_s, None)
    except InputError:
        assert last_epoch_s + 1 > now_s + MOST_AHEAD_S
        return
    assert last_epoch_s < epoch_s <= now_s + MOST_AHEAD_S
    assert epoch_s in (int(now_s), last_epoch_s + 1)


def test_the_first_run_begins_now() -> None:
    assert epoch_after(None, NOW_S + 0.7, None) == NOW_S


@given(
    st.builds(
        SavedState,
        st.integers(),
        st.integers(),
        st.text(),
        st.floats(0.0, 1e12),
        st.sampled_from(Directive),
        st.integers(0, REVISIONS - 1),
    )
)
def test_what_is_written_is_what_is_read(kept: SavedState) -> None:
    assert saved_state_from(text_of(kept), Path("x.state")) == kept


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        "null",
        "{",
        "[" * 60_000,
        '{"epoch_s": "x", "signing_timestamp": 1, "threats": "", "began_s": 1, "directive": "hold"}',
        '{"epoch_s": Infinity, "signing_timestamp": 1, "threats": "", "began_s": 1, "directive": "hold"}',
        '{"epoch_s": 1, "signing_timestamp": 1, "threats": "", "began_s": Infinity, "directive": "hold"}',
        '{"epoch_s": 1, "signing_timestamp": 1, "threats": "", "began_s": NaN, "directive": "hold"}',
        '{"epoch_s": 1, "signing_timestamp": 1, "threats": "", "began_s": 1, "directive": "hld"}',
    ],
)
def test_a_state_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="x.state: no state of a ground station; allowed: "):
        saved_state_from(text, Path("x.state"))


@pytest.mark.parametrize(
    ("line", "directive"),
    [("hold", Directive.HOLD), (" Return \r", Directive.RETURN), ("NORMAL", Directive.NORMAL)],
)
def test_a_line_names_a_directive(line: str, directive: Directive) -> None:
    assert directive_from(line) is directive


def test_a_misspelt_directive_is_told_the_nearest() -> None:
    with pytest.raises(InputError, match="'retrun'; did you mean 'return'\\?; allowed: normal, hold, return"):
        directive_from("retrun")


def test_a_line_on_standard_input_changes_what_is_broadcast(
    ear: Ear, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reading, writing = os.pipe()
    with os.fdopen(reading) as stdin, os.fdopen(writing, "wb", buffering=0) as orders:
        monkeypatch.setattr("sys.stdin", stdin)
        orders.write(b"nonsense\nhol")
        orders.write(b"d\n")

        def held() -> bool:
            return (
                any(frame.directive is Directive.HOLD for frame in admitted(ear.heard(), Trust()))
                if ear.heard()
                else False
            )

        broadcast_until(Options(ear.link, "unsigned"), held)
    said = capsys.readouterr()
    assert "directive: 'nonsense'; allowed: normal, hold, return" in said.err
    assert "directive hold; agents to targets" in said.out


def test_the_end_of_standard_input_ends_nothing(ear: Ear, monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    os.close(writing)
    with os.fdopen(reading) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        broadcast_until(Options(ear.link, "unsigned"), lambda: len(ear.heard()) >= 3)


def test_standard_input_that_cannot_be_waited_for_is_left_alone(
    ear: Ear, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = tmp_path / "orders"
    path.write_text("hold\n")
    with path.open() as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        broadcast_until(Options(ear.link, "unsigned"), lambda: len(ear.heard()) >= 2)


def test_a_folder_of_keys_that_is_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match="--keys: .*nowhere.*No such file.*allowed: the folder that `groundstation keygen"
    ):
        load_frame_signer("both", tmp_path / "nowhere")


def test_a_file_is_no_folder_of_keys(keys: Path) -> None:
    with pytest.raises(InputError, match="is no folder; allowed: "):
        load_frame_signer("both", keys / "broadcast.private")


def test_a_folder_of_keys_that_others_can_read_is_refused(keys: Path) -> None:
    keys.chmod(0o750)
    with pytest.raises(InputError, match="is open to others \\(mode 750\\); allowed: its owner only; chmod 700"):
        load_frame_signer("both", keys)


def test_only_the_keys_that_are_used_need_be_there(keys: Path) -> None:
    (keys / "broadcast.mavlink").unlink()
    assert load_frame_signer("ed25519", keys).overhead_bytes == 64
    with pytest.raises(InputError, match="broadcast.mavlink: cannot read the key"):
        load_frame_signer("both", keys)


def test_no_error_and_no_status_shows_a_key(keys: Path, ear: Ear, capsys: pytest.CaptureFixture[str]) -> None:
    options = Options(ear.link, "both", keys)
    broadcast_until(options, lambda: len(ear.heard()) >= 2)
    said = "".join(capsys.readouterr())
    secret = load_mavlink_key(keys / "broadcast.mavlink")
    assert secret.hex() not in said + repr(options) + repr(load_frame_signer("both", keys))


@pytest.mark.parametrize("radio", [None, "sik-57600"])
def test_a_ground_station_that_is_stopped_says_so_in_its_last_broadcast(ear: Ear, radio: str | None) -> None:
    options = Options(ear.link, "unsigned", radio=None if radio is None else parse_radio(radio, 1.0))
    broadcast_until(options, lambda: len(ear.heard()) > 2)
    states = admitted(ear.heard(), Trust())
    assert [state.is_last for state in states[:1]] == [False]
    assert states[-1].is_last
    assert states[-1].directive is Directive.NORMAL


def test_a_fault_in_what_is_only_shown_ends_nothing_and_is_told_once(
    ear: Ear, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object) -> None:
        raise KeyError("agents")

    monkeypatch.setattr(Page, "tick", broken)
    site = Site(Address("127.0.0.1", 0))
    broadcast_until(Options(ear.link, "unsigned", site=site), lambda: len(ear.heard()) > 5)
    assert capsys.readouterr().err.count("page: cannot be shown: KeyError: 'agents'; the broadcast goes on") == 1
