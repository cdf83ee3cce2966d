"""The `groundstation` command line: one line for what it cannot do, and plans and keys for what it can."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.errors import EXIT_DONE, EXIT_UNUSABLE
from groundstation import cli
from groundstation.options import Options

LINK = ("--link", "udpout:127.0.0.1:9")
Program = Callable[..., tuple[int, str, str]]


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Program:
    """Return a caller of the program by its arguments: exit status, stdout, stderr."""

    def call(*arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["groundstation", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        out, err = capsys.readouterr()
        assert isinstance(caught.value.code, int)
        return caught.value.code, out, err

    return call


def assert_refused(result: tuple[int, str, str], *parts: str) -> None:
    status, out, err = result
    assert (status, out) == (EXIT_UNUSABLE, "")
    assert err.startswith("groundstation: ")
    assert err.count("\n") == 1
    for part in parts:
        assert part in err


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ((), ("neither --keys nor --unsigned", "--keys DIR to sign, or --unsigned to sign nothing")),
        (("--keys", "k", "--unsigned"), ("--unsigned: given together with --keys", "allowed: one of them")),
        (
            ("--keys", "nowhere"),
            ("--keys: 'nowhere'", "No such file", "allowed: the folder that `groundstation keygen"),
        ),
        (("--unsigned", "--auth", "mavlink"), ("--auth: 'mavlink' with --unsigned", "allowed: only with --keys")),
        (
            ("--keys", "k", "--auth", "mavlnk"),
            ("--auth: 'mavlnk'", "did you mean 'mavlink'?", "both, ed25519, mavlink"),
        ),
        (("--keys", "k", "--auth", "unsigned"), ("--auth: 'unsigned'", "allowed: both, ed25519, mavlink")),
        (("--unsigned", "--radio", "sik-5760"), ("radio 'sik-5760'", "did you mean 'sik-57600'?", "lora or a number")),
        (("--unsigned", "--radio", "lora", "--share", "0"), ("share: 0", "allowed: more than 0, at most 1")),
        (("--unsigned", "--radio", "lora", "--share", "1.5"), ("share: 1.5", "allowed: more than 0, at most 1")),
        (("--unsigned", "--radio", "lora", "--share", "nan"), ("share: nan", "allowed: more than 0, at most 1")),
        (("--unsigned", "--share", "0.5"), ("--share: 0.5 without --radio", "allowed: --radio NAME")),
        (
            ("--unsigned", "--mirror", "udpout:127.0.0.1:9"),
            ("--mirror", "broadcast's own link", "allowed: another port"),
        ),
        (("--unsigned", "--mirror", "udpin:127.0.0.1:9"), ("link 'udpin:127.0.0.1:9'", "only sends")),
        (("--unsigned", "--log", "x.log"), ("--log: 'x.log'", "allowed: a name that ends in .tlog")),
        (("--unsigned", "--state", "/dev/null/x"), ("/dev/null/x: cannot",)),
    ],
)
def test_run_refuses_what_it_cannot_do_in_one_line(
    program: Program,
    arguments: tuple[str, ...],
    parts: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(program("run", "copter-demo", *LINK, *arguments), *parts)


def test_a_serial_link_without_a_radio_is_refused(program: Program) -> None:
    result = program("run", "copter-demo", "--link", "serial:/dev/ttyUSB0:57600", "--unsigned")
    assert_refused(result, "--link: 'serial:/dev/ttyUSB0:57600' without --radio", "allowed: --radio NAME")


@pytest.mark.parametrize(("radio", "heartbeats"), [("900", True), ("900/v2ext", False), ("sik-57600/v2ext", False)])
def test_whatever_is_at_a_serial_port_gets_a_heartbeat_but_not_behind_an_autopilot(
    program: Program, radio: str, heartbeats: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Options] = []
    monkeypatch.setattr("groundstation.service.run_groundstation", lambda mission, options, stop: given.append(options))
    monkeypatch.setattr("companion.runtime.clock.run_until_signal", lambda start: start(None))
    program("run", "copter-demo", "--link", "serial:/dev/ttyUSB0:57600", "--unsigned", "--radio", radio)
    assert [options.radio and options.radio.heartbeats for options in given] == [heartbeats]


@pytest.mark.parametrize(
    ("more", "parts"),
    [
        (("--out", "x.csv"), ("--ui: with --out or --places", "allowed: one of them")),
        (("--from", "0"), ("--ui: with --from or --to", "allowed: without them")),
        (("--to", "2026-11-30"), ("--ui: with --from or --to", "allowed: without them")),
    ],
)
def test_a_playback_refuses_what_it_has_no_use_for(
    program: Program, more: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    assert_refused(program("log", "day.state", "--ui", "127.0.0.1:9", *more), *parts)


def test_several_addresses_behind_one_radio_are_refused(program: Program) -> None:
    link = "udpout:127.0.0.1:9,127.0.0.1:10,127.0.0.1:11"
    result = program("run", "copter-demo", "--link", link, "--unsigned", "--radio", "sik-57600")
    assert_refused(result, f"--link: '{link}' sends every frame 3 times", "allowed: one address behind a radio")


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "x\0y", *LINK, "--unsigned"),
        ("run", "copter-demo", "--link", "udpout:127.0.0.1:9\0", "--unsigned"),
        *(("run", "copter-demo", *LINK, name, "x\0y") for name in ("--keys", "--state", "--log", "--mirror")),
        ("keygen", "x\0y"),
        ("plan", "x\0y", "--link", "lora"),
    ],
)
def test_a_null_character_in_a_name_is_refused(program: Program, arguments: tuple[str, ...]) -> None:
    assert_refused(program(*arguments), "holds a null character; allowed: names without one")


@pytest.mark.parametrize("text", ["[" * 60_000, '{"epoch_s": 1, "time_s": Infinity, "signing_timestamp": 1}'])
def test_a_state_file_that_is_none_is_refused(program: Program, text: str, tmp_path: Path) -> None:
    state = tmp_path / "x.state"
    state.write_text(text)
    result = program("run", "copter-demo", *LINK, "--unsigned", "--state", state)
    assert_refused(result, "x.state: no state of a ground station")


def test_keys_that_others_can_read_are_refused_with_the_remedy(program: Program, tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    assert program("keygen", folder)[0] == EXIT_DONE
    (folder / "broadcast.private").chmod(0o644)
    assert_refused(program("run", "copter-demo", *LINK, "--keys", folder), "broadcast.private", "chmod 600")
    folder.chmod(0o755)
    assert_refused(program("run", "copter-demo", *LINK, "--keys", folder), "--keys", "chmod 700")


def test_keygen_says_which_files_go_to_the_vehicles(program: Program, tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    status, out, err = program("keygen", folder)
    assert (status, err) == (EXIT_DONE, "")
    *paths, advice = out.splitlines()
    assert sorted(Path(path).name for path in paths) == [
        "broadcast.mavlink",
        "broadcast.private",
        "broadcast.public",
        "sensor.mavlink",
        "uplink.mavlink",
    ]
    assert advice.startswith("broadcast.public goes to every vehicle")
    assert folder.stat().st_mode & 0o777 == 0o700
    for path in paths:
        assert (Path(path).stat().st_mode & 0o077 == 0) == (not path.endswith("public"))
    secret = (folder / "broadcast.mavlink").read_text().strip()
    assert secret not in out


def test_keygen_never_overwrites_a_key(program: Program, tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    program("keygen", folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert_refused(program("keygen", folder), "already")
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_plan_is_printed_with_its_figures(program: Program) -> None:
    status, out, err = program("plan", "paper-dynamic", "--link", "sik-57600", "--share", "0.5")
    assert (status, err) == (EXIT_DONE, "")
    for part in (
        "paper-dynamic over sik-57600, share 0.5: 2880 B/s, both; longest frame 252 bytes",
        "ONEWAY_STATE",
        "ONEWAY_MOTION",
        "HEARTBEAT",
        "50%",
        "bursts: 100% lost for 2 s",
        "outage without an entry: 5",
    ):
        assert part in out


def test_a_plan_without_moving_threats_has_no_limit_of_an_outage(program: Program, tmp_path: Path) -> None:
    path = tmp_path / "still.yaml"
    path.write_text(
        "agents: [{id: 1, north_m: 0, east_m: 0}]\ntargets: [{id: 1, north_m: 9000, east_m: 0}]\n"
        "threats: [{id: 1, north_m: 0, east_m: 60000, detection_radius_m: 900, attack_radius_m: 100, "
        "speed_bound_m_s: 0}]\n"
    )
    assert "outage without an entry: no limit: threats stand still" in program("plan", path, "--link", "lora")[1]


def test_a_plan_as_json_has_the_same_figures(program: Program) -> None:
    status, out, err = program("plan", "paper-static", "--link", "1200 B/s", "--auth", "ed25519", "--json")
    assert (status, err) == (EXIT_DONE, "")
    found = json.loads(out)
    assert (found["budget_bytes_per_s"], found["authentication"]) == (1_200.0, "ed25519")
    assert found["largest_frame_bytes"] == 239
    assert found["items"][0]["name"] == "ONEWAY_STATE"


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("paper-dynamic",), ("--link",)),
        (("paper-dynamic", "--link", "sik5760"), ("radio 'sik5760'", "did you mean 'sik-57600'?")),
        (("paper-dynamic", "--link", "lora", "--share", "2"), ("share: 2", "at most 1")),
        (
            ("paper-dynamic", "--link", "lora", "--auth", "ed2551"),
            ("--auth", "did you mean 'ed25519'?", "unsigned, mav"),
        ),
        (("paper-dinamic", "--link", "lora"), ("did you mean 'paper-dynamic'?",)),
        (("paper-static", "--link", "12"), ("radio 12: ", "252 bytes", "at most 20 s", "--auth mavlink instead")),
    ],
)
def test_plan_refuses_what_it_cannot_do_in_one_line(
    program: Program, arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    assert_refused(program("plan", *arguments), *parts)


@pytest.mark.parametrize("command", ["run", "plan", "keygen"])
def test_help_comes_with_an_example(program: Program, command: str) -> None:
    status, out, err = program(command, "--help")
    assert (status, err) == (EXIT_DONE, "")
    assert f"Example: groundstation {command} " in out


def test_help_is_there_without_what_only_a_broadcast_needs() -> None:
    heavy = ("numpy", "scipy", "pydantic", "pymavlink", "cryptography", "rich")
    asked = (
        "import sys\nfrom groundstation.cli import cli\n"
        "cli.main(['run', '--help'], standalone_mode=False)\n"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True).stdout
    assert "sik-57600, sik-64k-ecc, lora, or bytes per second" in " ".join(said.split())
    assert said.splitlines()[-1] == "[]"


def test_keygen_adds_the_keys_of_vehicles_and_leaves_those_that_are_there(program: Program, tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    assert program("keygen", folder, "--agents", "1-2")[0] == EXIT_DONE
    before = {path.name: path.read_text() for path in folder.iterdir()}
    status, out, _ = program("keygen", folder, "--agents", "2,7")
    assert (status, [Path(line).name for line in out.splitlines()[:-1]]) == (EXIT_DONE, ["uplink-7.mavlink"])
    assert {name: (folder / name).read_text() for name in before} == before
    assert len({before[name] for name in before if name.endswith("mavlink")}) == 5
    assert_refused(program("keygen", folder), "is there already")


@pytest.mark.parametrize("agents", ["", "x", "0", "5-", "1-99999", "70000", "3-1"])
def test_agents_that_are_none_get_no_key(program: Program, tmp_path: Path, agents: str) -> None:
    assert_refused(program("keygen", tmp_path / "keys", "--agents", agents), "--agents", "allowed: ids from 1 to")


@pytest.mark.parametrize("url", ["udpin:0.0.0.0:14601", "udpin:192.168.1.7:14601", "serial:/dev/ttyUSB0:57600"])
def test_an_input_that_others_can_send_to_needs_a_key_or_a_word(program: Program, url: str) -> None:
    refused = program("run", "copter-demo", *LINK, "--unsigned", "--sensor", url)
    assert_refused(refused, "--sensor", "hears others than this computer", "--unsigned-inputs")


def test_an_input_whose_key_is_not_there_says_how_to_make_it(program: Program, tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    program("keygen", folder)
    (folder / "sensor.mavlink").unlink()
    refused = program("run", "copter-demo", *LINK, "--keys", folder, "--sensor", "udpin:0.0.0.0:14601")
    assert_refused(refused, "sensor.mavlink", "keygen", "--agents")
