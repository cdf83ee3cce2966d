"""`companion check` and what `companion run` refuses, against stand-ins over UDP: what is wrong, and what to do."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from companion.errors import EXIT_DONE, EXIT_FAILED, InputError
from companion.onboard.authority import State
from companion.onboard.config import Config, parse_config
from companion.onboard.preflight_service import check_vehicle
from companion.onboard.service import run_companion
from companion.onboard.state_files import AuthorityStateFile, saved_authority
from companion.protocol.codec import AgentEntry, Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.keys import keygen
from companion.runtime.io_thread import IoThread
from companion.transport.endpoints import open_sender, parse_link
from sim.vehicle_service import VehicleOptions, run_vehicle
from tests.ports import free_ports

pytestmark = pytest.mark.slow

WAIT_S = 6.0
CONFIG = """
agent_id: 1
autopilot: {{kind: arducopter, link: "udpin:127.0.0.1:{autopilot}"{more}}}
broadcast: {broadcast}
limits: {{speed_m_s: 5, n_max: 0.17, height_min_m: 3, height_max_m: 50}}
height_m: 8
"""


def configured(ports: list[int], *, more: str = "", broadcast: str | None = None) -> Config:
    heard = broadcast or f'{{link: "udpin:127.0.0.1:{ports[1]}", trust: unsigned}}'
    return parse_config(CONFIG.format(autopilot=ports[0], broadcast=heard, more=more), "c.yaml")


async def _broadcast(port: int, stop: asyncio.Event) -> None:
    sender = await open_sender(parse_link(f"udpout:127.0.0.1:{port}"))
    writer, epoch_s = FrameWriter(), int(time.time())
    for sequence in range(1, 1_000):
        after_ms = round(1e3 * (time.time() - epoch_s))
        stamp = Stamp(epoch_s, after_ms, sequence)
        sender.send(
            writer.encode(
                StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (AgentEntry(1, 0.0, 0.0, None),), (), ())
            )
        )
        if stop.is_set():
            break
        await asyncio.sleep(0.2)
    sender.close()


def check(
    config: Config,
    ports: list[int],
    *,
    autopilot: str = "arducopter",
    wait_s: float = WAIT_S,
    parameters: tuple[tuple[str, float], ...] = (),
) -> int:
    """Check against a stand-in in the air, a ground station beside it."""

    async def body() -> int:
        stop = asyncio.Event()
        link = parse_link(f"udpout:127.0.0.1:{ports[0]}")
        others = [
            asyncio.create_task(
                run_vehicle(VehicleOptions(autopilot, (link,), in_air_m=20.0, parameters=parameters), stop=stop)
            ),
            asyncio.create_task(_broadcast(ports[1], stop)),
        ]
        status = await check_vehicle(config, wait_s, asyncio.Event())
        stop.set()
        await asyncio.gather(*others)
        return status

    return asyncio.run(body())


def test_a_vehicle_fit_to_fly_passes_in_every_point(capsys: pytest.CaptureFixture[str]) -> None:
    ports = free_ports(2)
    assert check(configured(ports), ports, wait_s=20.0, parameters=(("GUID_TIMEOUT", 1.0),)) == EXIT_DONE
    said = capsys.readouterr().out
    assert "pass  arducopter, system 1" in said
    assert "pass  GUID_TIMEOUT: 1" in said
    assert "pass  broadcast heard" in said
    assert "pass  others: no receiver (ADSB_TYPE 0); none in the broadcast" in said
    assert "FAIL" not in said
    assert "none failed" in said


def test_another_kind_than_configured_fails_with_what_to_set(capsys: pytest.CaptureFixture[str]) -> None:
    ports = free_ports(2)
    assert check(configured(ports), ports, autopilot="px4-plane", wait_s=1.5) == EXIT_FAILED
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("FAIL")]
    assert "configured autopilot.kind arducopter" in line
    assert line.endswith("-> set autopilot.kind to px4-plane")


def test_another_system_id_than_configured_fails_with_what_was_heard(capsys: pytest.CaptureFixture[str]) -> None:
    ports = free_ports(2)
    assert check(configured(ports, more=", system_id: 9"), ports, wait_s=1.5) == EXIT_FAILED
    assert "heard system 1, configured autopilot.system_id 9 -> " in capsys.readouterr().out


def test_a_silent_link_fails(capsys: pytest.CaptureFixture[str]) -> None:
    ports = free_ports(2)
    assert asyncio.run(check_vehicle(configured(ports), 0.3, asyncio.Event())) == EXIT_FAILED
    said = capsys.readouterr().out
    assert f"FAIL  nothing heard on autopilot.link udpin:127.0.0.1:{ports[0]} -> check the link" in said
    assert "FAIL  no genuine broadcast heard" in said


def signed(folder: Path) -> str:
    keys = f"mavlink_key: {folder}/keys/broadcast.mavlink, public_key: {folder}/keys/broadcast.public"
    return f'{{link: "udpin:127.0.0.1:{free_ports(1)[0]}", trust: both, {keys}, state_file: {folder}/state.json}}'


def complaint_of(config: Config) -> str:
    """Return what `companion check` and `companion run` say, which is the same."""
    said = []
    for program in (
        check_vehicle(config, 0.5, asyncio.Event()),
        run_companion(config, asyncio.Event()),
    ):
        with pytest.raises(InputError) as caught:
            asyncio.run(program)
        said.append(str(caught.value))
    assert said[0] == said[1]
    assert "\n" not in said[0]
    return said[0]


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    said = complaint_of(configured(free_ports(2), broadcast=signed(tmp_path)))
    assert said.startswith(f"{tmp_path}/keys/broadcast.mavlink: ")


def test_a_key_that_others_can_read_is_refused_with_the_remedy(tmp_path: Path) -> None:
    keygen(tmp_path / "keys")
    (tmp_path / "keys" / "broadcast.mavlink").chmod(0o644)
    assert "chmod 600" in complaint_of(configured(free_ports(2), broadcast=signed(tmp_path)))


def test_a_missing_serial_port_is_named(tmp_path: Path) -> None:
    config = configured(free_ports(2)).model_dump(mode="json")
    config["autopilot"]["link"] = "serial:/dev/no-such-port:57600"
    said = complaint_of(Config.model_validate(config))
    assert said.startswith("link 'serial:/dev/no-such-port:57600': no such device")


def test_a_port_in_use_is_named() -> None:
    ports = free_ports(1)
    config = configured([ports[0], ports[0]])
    assert "in use by another program" in complaint_of(config)


@pytest.mark.parametrize("content", [b"", b"{", b'{"engagement": 1}', b"[]", b'"x"', b"\xff", b"[" * 60_000])
def test_a_state_file_of_something_else_counts_as_locked_and_is_no_reason_not_to_start(
    tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "autopilot.json"
    path.write_bytes(content)
    section = configured(free_ports(2), more=f", state_file: {path}").autopilot
    assert section is not None
    state, (warning,) = saved_authority(section)
    assert state is State.LOCKED
    assert warning.startswith((f"{path}: not a state of the engagement", f"{path}: cannot read the state: not text"))


@pytest.mark.parametrize("state", State)
def test_a_state_file_tells_who_had_the_vehicle(tmp_path: Path, state: State) -> None:
    path = tmp_path / "autopilot.json"
    path.write_text(f'{{"engagement": "{state.value}"}}')
    section = configured(free_ports(2), more=f", state_file: {path}").autopilot
    assert section is not None
    assert saved_authority(section) == (state, ())


@pytest.mark.parametrize(("on_disk", "in_memory", "state"), [
    (None, "engaged", State.ENGAGED),
    ("waiting", "locked", State.LOCKED),
    ("locked", "waiting", State.LOCKED),
    ("waiting", "{", State.LOCKED),
    ("engaged", None, State.ENGAGED),
    (None, None, State.WAITING),
])  # fmt: skip
def test_the_worse_of_the_states_on_disk_and_in_memory_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, on_disk: str | None, in_memory: str | None, state: State
) -> None:
    path = tmp_path / "disk" / "autopilot.json"
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"{tmp_path}/memory:/nowhere")
    section = configured(free_ports(2), more=f", state_file: {path}").autopilot
    assert section is not None
    files = IoThread("files")
    AuthorityStateFile(str(path), files).write(State.WAITING)
    files.close()
    (copy,) = (tmp_path / "memory").iterdir()
    for place, word in ((path, on_disk), (copy, in_memory)):
        place.unlink()
        if word is not None:
            place.write_text(word if word == "{" else f'{{"engagement": "{word}"}}')
    assert saved_authority(section).state is state


def test_a_check_of_a_px4_fails_where_its_state_file_is_something_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "autopilot.json"
    path.write_text("{")
    given = configured(free_ports(2), more=f", state_file: {path}")
    assert given.autopilot is not None
    autopilot = given.autopilot.model_copy(update={"kind": "px4-plane"})
    config = given.model_copy(update={"autopilot": autopilot})
    assert asyncio.run(check_vehicle(config, 0.3, asyncio.Event())) == EXIT_FAILED
    assert f"FAIL  {path}: not a state of the engagement" in capsys.readouterr().out


def test_disks_that_take_neither_state_nor_logs_are_found_before_the_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    given = configured(free_ports(2), more=f", state_file: {tmp_path}/file/autopilot.json")
    assert given.autopilot is not None
    autopilot = given.autopilot.model_copy(update={"kind": "px4-plane"})
    config = given.model_copy(update={"autopilot": autopilot, "log_dir": f"{tmp_path}/file/logs"})
    assert asyncio.run(check_vehicle(config, 0.3, asyncio.Event())) == EXIT_FAILED
    said = capsys.readouterr().out
    assert f"FAIL  {tmp_path}/file/autopilot.json: cannot " in said
    assert f"FAIL  log_dir: {tmp_path}/file/logs: no logs can be written there" in said
