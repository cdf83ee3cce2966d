"""The ground station's shell: real sockets on this computer, real files, and what survives a restart."""

from __future__ import annotations

import asyncio
import json
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.admission import Admission, Trust
from companion.errors import InputError
from companion.frames import Directive, StateFrame
from companion.framing import is_signed
from companion.keys import keygen, load_mavlink_key, load_public
from companion.mission import Mission, parse_mission
from companion.signing import timestamp_of
from companion.tlog import read_tlog
from companion.transport import parse_link
from groundstation import service
from groundstation.plan import Authentication
from groundstation.radio import parse_radio
from groundstation.service import (
    STATE_PERIOD_S,
    Kept,
    Options,
    directive_from,
    kept_from,
    load_sealer,
    run_groundstation,
    start_after,
)

NOW_S = 1_790_000_000.0
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
    admission = Admission(trust)
    now_s = admission_time_s(heard)
    frames = [one.frame for data in heard for one in admission.admit(data, now_s)]
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
    assert all(is_signed(raw) for raw in ear.heard())
    assert not any(is_signed(raw) for raw in logged)
    public_key = load_public(keys / "broadcast.public")
    assert admitted(logged, Trust(public_key=public_key))
    secret = load_mavlink_key(keys / "broadcast.mavlink")
    assert secret not in path.read_bytes()


def test_a_frame_inside_a_v2_extension_is_logged_as_itself(ear: Ear, keys: Path, tmp_path: Path) -> None:
    path = tmp_path / "sent.tlog"
    options = Options(ear.link, "mavlink", keys, radio=parse_radio("20000/v2ext", 1.0), log=path)
    broadcast_until(options, lambda: len(ear.heard()) >= 5)
    assert {int.from_bytes(raw[7:10], "little") for raw in ear.heard()} == {248}
    logged = [raw for _, raw in read_tlog(path)]
    assert not any(is_signed(raw) for raw in logged)
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
    for _ in range(3):
        ear.heard().clear()
        broadcast_until(Options(ear.link, "unsigned", state=state), lambda: len(ear.heard()) >= 1)
        epochs.append(int.from_bytes(ear.heard()[0][10:14], "little"))
        assert json.loads(state.read_text())["epoch_s"] == epochs[-1]
    assert epochs == sorted(set(epochs))


def test_with_the_clock_set_back_it_goes_on_from_the_last_run(
    ear: Ear, keys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    state = tmp_path / "ground.state"
    options = Options(ear.link, "both", keys, state=state)
    broadcast_until(options, lambda: len(ear.heard()) >= 3)
    before = list(ear.heard())
    kept = kept_from(state.read_text(), state)
    ear.heard().clear()

    class Earlier(service.SteadyClock):
        def now_s(self) -> float:
            return super().now_s() - 3_600.0

    monkeypatch.setattr(service, "SteadyClock", Earlier)
    capsys.readouterr()
    broadcast_until(options, lambda: len(ear.heard()) >= 3)
    assert "the system clock is 3" in capsys.readouterr().err
    assert kept_from(state.read_text(), state).epoch_s > kept.epoch_s
    trust = Trust(load_mavlink_key(keys / "broadcast.mavlink"), load_public(keys / "broadcast.public"))
    admission = Admission(trust)
    assert sum(len(admission.admit(raw, admission_time_s(before))) for raw in before) == len(before)
    heard = [one for raw in ear.heard() for one in admission.admit(raw, admission_time_s(ear.heard()))]
    assert len(heard) == len(ear.heard())


def test_no_mavlink_time_is_at_or_below_one_signed_before(ear: Ear, keys: Path) -> None:
    state = keys / "ground.state"
    far = timestamp_of(4e9)
    state.write_text(json.dumps({"epoch_s": 1, "time_s": 1.0, "signing_timestamp": far}))
    broadcast_until(Options(ear.link, "mavlink", keys, state=state), lambda: len(ear.heard()) >= 3)
    times = [int.from_bytes(raw[-12:-6], "little") for raw in ear.heard()]
    assert times == list(range(far + 1, far + 1 + len(times)))
    assert kept_from(state.read_text(), state).signing_timestamp >= far + len(times)


def test_the_state_is_on_disk_before_the_first_frame_is_on_the_air(ear: Ear, tmp_path: Path) -> None:
    state = tmp_path / "ground.state"
    (tmp_path / "ground.state.new").mkdir()
    with pytest.raises(InputError, match="cannot write the state"):
        broadcast_until(Options(ear.link, "unsigned", state=state), lambda: False)
    assert ear.heard() == []


def test_a_state_that_is_none_is_not_replaced(ear: Ear, tmp_path: Path) -> None:
    state = tmp_path / "ground.state"
    state.write_text("something else")
    with pytest.raises(InputError, match="no state of a ground station"):
        broadcast_until(Options(ear.link, "unsigned", state=state), lambda: False)
    assert state.read_text() == "something else"
    assert ear.heard() == []


@given(st.floats(0.0, 4e9), st.floats(0.0, 1e5), st.floats(-1e9, 1e9))
def test_a_run_begins_in_a_later_second_than_the_last_and_after_all_that_it_sent(
    epoch_s: float, lasted_s: float, clock_stepped_s: float
) -> None:
    kept = Kept(int(epoch_s), int(epoch_s) + lasted_s, 0)
    now_s = kept.time_s + clock_stepped_s
    start_s = start_after(kept, now_s)
    assert int(start_s) > kept.epoch_s
    assert start_s >= now_s
    # The last run may have gone on for so long after it wrote.
    assert start_s >= kept.time_s + STATE_PERIOD_S or now_s >= kept.time_s


def test_the_first_run_begins_now() -> None:
    assert start_after(None, NOW_S) == NOW_S


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", '{"epoch_s": "x", "time_s": 1, "signing_timestamp": 1}', "{"])
def test_a_state_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="x.state: no state of a ground station; allowed: "):
        kept_from(text, Path("x.state"))


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
        load_sealer("both", tmp_path / "nowhere")


def test_a_file_is_no_folder_of_keys(keys: Path) -> None:
    with pytest.raises(InputError, match="is no folder; allowed: "):
        load_sealer("both", keys / "broadcast.private")


def test_a_folder_of_keys_that_others_can_read_is_refused(keys: Path) -> None:
    keys.chmod(0o750)
    with pytest.raises(InputError, match="is open to others \\(mode 750\\); allowed: its owner only; chmod 700"):
        load_sealer("both", keys)


def test_only_the_keys_that_are_used_need_be_there(keys: Path) -> None:
    (keys / "broadcast.mavlink").unlink()
    assert load_sealer("ed25519", keys).overhead_bytes == 64
    with pytest.raises(InputError, match="broadcast.mavlink: cannot read the key"):
        load_sealer("both", keys)


def test_no_error_and_no_status_shows_a_key(keys: Path, ear: Ear, capsys: pytest.CaptureFixture[str]) -> None:
    options = Options(ear.link, "both", keys)
    broadcast_until(options, lambda: len(ear.heard()) >= 2)
    said = "".join(capsys.readouterr())
    secret = load_mavlink_key(keys / "broadcast.mavlink")
    assert secret.hex() not in said + repr(options) + repr(load_sealer("both", keys))
