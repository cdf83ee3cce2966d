"""The shell of `companion identify` on real sockets, with an autopilot that the test plays."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from companion.autopilot.offboard import SETPOINT_IDS
from companion.files.tlog import read_tlog
from companion.onboard.authority import MODE_LEFT
from companion.onboard.config import Config
from companion.onboard.identification.identifier import End
from companion.onboard.identification.service import NOT_FLOWN, fly_pattern, table_of
from companion.onboard.identification.table import Row
from tests.companion.onboard.test_service_flight import Scene

pytestmark = pytest.mark.slow


def taken_over(scene: Scene, config: Config) -> tuple[End, list[Row]]:
    """Fly the pattern until a person takes over; return what it says."""

    async def play() -> tuple[End, list[Row]]:
        stop = asyncio.Event()
        task = asyncio.create_task(fly_pattern(config, stop))
        while not task.done():
            scene.vehicle.speak()
            if scene.vehicle.count(*SETPOINT_IDS) >= 10:
                scene.vehicle.mode = 9
            await asyncio.sleep(0.02)
        return task.result()

    return asyncio.run(asyncio.wait_for(play(), 20.0))


def test_a_person_who_takes_over_ends_it_and_its_log_gives_the_same_table(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    scene = Scene(tmp_path)
    end, table = taken_over(scene, scene.config)
    assert end == End(MODE_LEFT, complete=False)
    log = scene.logs / "identify-1.tlog"
    assert f"log: {log}" in capfd.readouterr().out
    assert table == table_of(read_tlog(log), scene.config)
    scene.vehicle.close()


def test_without_a_folder_for_logs_none_is_kept(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    end, table = taken_over(scene, scene.config.model_copy(update={"log_dir": None}))
    assert end.words == MODE_LEFT and table
    assert not (tmp_path / "logs").exists()
    scene.vehicle.close()


def test_stopped_before_the_hand_over_it_says_so(tmp_path: Path) -> None:
    async def play() -> tuple[End, list[Row]]:
        stop = asyncio.Event()
        asyncio.get_running_loop().call_later(0.5, stop.set)
        return await fly_pattern(Scene(tmp_path).config, stop)

    assert asyncio.run(play())[0] is NOT_FLOWN
