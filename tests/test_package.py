"""The project as a whole: imports point one way, the companion flies on its own libraries, pages match the code."""

from __future__ import annotations

import ast
import importlib.metadata
import re
import struct
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import pytest

from companion.protocol.codec import FrameReader, StateFrame
from companion.protocol.dialect import oneway

ROOT = Path(__file__).parents[1]
FORBIDDEN = {"companion": {"groundstation", "sim"}, "groundstation": {"sim"}, "sim": set[str]()}
COMPANION_NEEDS = ("numpy", "pymavlink", "cryptography", "fastcrc", "pydantic", "pyyaml", "pyproj", "click", "mavsdk")
"""Libraries that the vehicle's computer must have: the project's base dependencies, and none of an extra's."""
DECIDE = """
import importlib.util, math
for absent in ("torch", "scipy", "matplotlib", "rich", "jinja2", "groundstation", "sim"):
    assert importlib.util.find_spec(absent) is None, absent
from pymavlink.dialects.v20 import common
from companion.autopilot.registry import ADAPTERS
from companion.onboard.config import Config
from companion.onboard.companion import Companion
from companion.onboard.decision import Purpose
from companion.protocol.codec import AgentEntry, Directive, FrameWriter, Stamp, StateFrame, TargetEntry, ThreatEntry
import companion.cli
vehicle = common.MAVLink(None, srcSystem=1, srcComponent=1)
pilot = Companion(Config(agent_id=1), ADAPTERS['kinematic'](1))
pilot.hear(FrameWriter().encode(StateFrame(Stamp(1000, 0, 1), 47.0, 8.0, Directive.NORMAL, 1, 1, 1, 100,
    (AgentEntry(1, 0.0, 0.0, 1),), (TargetEntry(1, 5000.0, 0.0),),
    (ThreatEntry(1, 2500.0, 400.0, 1000.0, 500.0, 0.0),))), 1000.0)
pilot.receive(vehicle.heartbeat_encode(1, 0, 1 | 128, 4, 4).pack(vehicle), 1000.0)
here = vehicle.global_position_int_encode(0, 470000000, 80000000, 530000, 30000, 500, 0, 0, 0)
pilot.receive(here.pack(vehicle), 1000.0)
decision, frames = pilot.tick(1000.0)
assert decision.purpose is Purpose.TARGET and len(frames) == 2, decision
assert math.isfinite(decision.setpoint.heading_rad)
print("decided")
"""


WIDTHS = {b"B": 1, b"b": 1, b"H": 2, b"h": 2, b"I": 4, b"i": 4, b"f": 4, b"Q": 8}


def format_of(message: type[oneway.MAVLink_message]) -> bytes:
    """Return the struct letter of each field of a message, in the order on the wire."""
    letters = re.findall(r"(\d*)([BbHhIifQ])", message.unpacker.format)
    runs = b"".join(letter.encode() * int(count or 1) for count, letter in letters)
    found, position = b"", 0
    for length in message.array_lengths:
        found += runs[position : position + 1]
        position += max(1, length)
    return found


def modules() -> list[Path]:
    return [path for package in FORBIDDEN for path in sorted((ROOT / package).rglob("*.py"))]


def imported(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    assert not imported(path) & FORBIDDEN[package]


@pytest.mark.slow
def test_only_training_imports_torch_and_nothing_on_the_vehicle_imports_scipy() -> None:
    companion = [path for path in modules() if path.is_relative_to(ROOT / "companion")]
    trainings = {"training.py", "training_pairwise.py", "training_monolithic.py"}
    assert {path.name for path in companion if "torch" in imported(path)} == trainings
    assert not [path.name for path in companion if "scipy" in imported(path)]


def with_their_needs(names: tuple[str, ...]) -> set[str]:
    found: set[str] = set()
    queue = list(names)
    while queue:
        name = queue.pop().lower()
        if name in found:
            continue
        try:
            requires = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            continue  # needed on another platform or Python only
        found.add(name)
        queue += [re.split(r"[ ;<>=!~\[(]", line)[0] for line in requires if "extra ==" not in line]
    return found


@pytest.mark.slow
def test_a_companion_decides_in_a_bare_environment_without_torch_and_scipy(tmp_path: Path) -> None:
    venv.create(tmp_path, with_pip=False, symlinks=True)
    site = next((tmp_path / "lib").glob("python*/site-packages"))
    for name in with_their_needs(COMPANION_NEEDS):
        distribution = importlib.metadata.distribution(name)
        for top in {file.parts[0] for file in distribution.files or () if file.parts[0] != ".."}:
            source, link = Path(str(distribution.locate_file(top))), site / top
            if source.exists() and not link.exists() and top != "__pycache__":
                link.symlink_to(source)
    (site / "companion").symlink_to(ROOT / "companion")
    process = subprocess.run(
        [str(tmp_path / "bin" / "python"), "-I", "-c", DECIDE], capture_output=True, text=True, timeout=120, check=False
    )
    assert process.stdout == "decided\n", process.stderr


def test_the_project_itself_depends_on_what_the_vehicle_needs_and_nothing_else() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {re.split(r"[<>=]", line)[0] for line in project["dependencies"]} == set(COMPANION_NEEDS)


@pytest.mark.slow
@pytest.mark.parametrize("program", ["companion", "groundstation", "sim"])
def test_every_program_runs_as_a_module_and_helps_with_an_example(program: str) -> None:
    process = subprocess.run(
        [sys.executable, "-m", program, "--help"], capture_output=True, text=True, timeout=60, check=False
    )
    assert process.returncode == 0
    assert "Example:" in process.stdout


def test_every_console_script_is_declared() -> None:
    scripts = importlib.metadata.distribution("oneway-guidance").entry_points.select(group="console_scripts")
    assert {script.name: script.value for script in scripts} == {
        name: f"{name}.cli:main" for name in ("companion", "groundstation", "sim")
    }


def test_the_wire_page_shows_every_field_at_its_offset() -> None:
    text = (ROOT / "docs" / "wire.md").read_text()
    for message in (message for number, message in oneway.mavlink_map.items() if number > 255):
        assert f"### {message.msgname} (id {message.id} " in text
        offset = 0
        for name, kind, length in zip(
            message.ordered_fieldnames, struct.iter_unpack("c", format_of(message)), message.array_lengths, strict=True
        ):
            assert f"| {offset} | {WIDTHS[kind[0]] * max(1, length)} | `{name}` |" in text
            offset += WIDTHS[kind[0]] * max(1, length)


def test_the_worked_example_of_the_wire_page_decodes_to_what_it_says() -> None:
    text = (ROOT / "docs" / "wire.md").read_text()
    block = re.findall(r"```\n((?:[0-9a-f]{2}[ \n])+)```", text)[0]
    (frame,) = FrameReader().read(bytes.fromhex(block))
    assert isinstance(frame, StateFrame)
    assert (frame.stamp.epoch_s, frame.stamp.time_ms, frame.stamp.sequence) == (1767225600, 5000, 2)
    assert frame.agents[0].north_m == pytest.approx(61283.46)
    assert [agent.target_id for agent in frame.agents] == [1, 1]


def test_every_test_that_the_safety_page_names_exists() -> None:
    named = re.findall(r"(tests/[a-z_/]+\.py)::(test_[a-z_0-9]+)", (ROOT / "docs" / "safety.md").read_text())
    assert named
    for path, name in named:
        assert f"def {name}(" in (ROOT / path).read_text(), f"{path}::{name}"
