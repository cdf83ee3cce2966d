"""`companion check --param`: the file that it writes, and that a vehicle that loads it passes."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.autopilot.firmware import FAMILIES, versions
from companion.errors import InputError
from companion.onboard.finding import Finding
from companion.onboard.param_file import check_new, write_param_file
from companion.onboard.preflight import findings
from sim.vehicles import CRAFTS
from sim.vehicles.parameters import set_parameters
from tests.field.rig import Rig, config_of

BAD = {
    "Copter": {"GUID_TIMEOUT": 3.0, "FS_GCS_ENABLE": 1.0, "FS_EKF_ACTION": 2.0, "FENCE_ENABLE": 0.0},
    "Plane": {"FS_GCS_ENABL": 1.0, "WP_LOITER_RAD": -500.0, "BATT_FS_LOW_ACT": 3.0},
    "PX4": {"COM_OF_LOSS_T": 5.0, "COM_OBL_RC_ACT": 0.0, "NAV_DLL_ACT": 2.0, "NAV_TRAFF_AVOID": 3.0},
}
"""Parameters, of all versions, with values that are not allowed."""
FENCE = ", fence: [[-30000, -30000], [-30000, 30000], [30000, 30000], [30000, -30000]]"


def checked(rig: Rig) -> list[Finding]:
    adapter = rig.companion.adapter
    return findings(
        rig.companion.config,
        adapter,  # type: ignore[arg-type]
        link_heard=True,
        broadcast_heard=True,
        now_s=rig.now_s,
    )


def asked(kind: str, version: tuple[int, int], loaded: dict[str, float]) -> Rig:
    """Return a rig whose companion has asked for everything, after a stand-in loaded these parameters."""
    rig: Rig = type("Versioned", (Rig,), {"firmware": version})(kind, config_of(kind, limits=FENCE))
    set_parameters(rig.vehicle, loaded.items())
    rig.companion.adapter.ask_further()  # type: ignore[attr-defined]
    rig.run(9.0)
    return rig


def read(path: Path) -> dict[str, float]:
    """Return a parameter file as ground-control programs read it."""
    rows = [line.replace(",", "\t").split("\t") for line in path.read_text().splitlines() if not line.startswith("#")]
    return {row[-3 if len(row) == 5 else 0]: float(row[-2 if len(row) == 5 else 1]) for row in rows}


# The oldest and the newest names of each kind.
VERSIONS = [
    (kind, version) for kind in CRAFTS for version in (versions(FAMILIES[kind])[0], versions(FAMILIES[kind])[-1])
]


@pytest.mark.parametrize(("kind", "version"), VERSIONS)
def test_what_is_written_makes_the_check_pass_when_it_is_loaded(
    kind: str, version: tuple[int, int], tmp_path: Path
) -> None:
    bad = asked(kind, version, BAD[FAMILIES[kind]])
    found = checked(bad)
    assert sum(not one.passed for one in found) >= 3
    path = tmp_path / "demanded.param"
    write_param_file(path, kind, 1, dict(pair for one in found for pair in one.sets))
    loaded = read(path)
    assert loaded.keys() <= bad.vehicle.named.keys()
    after = checked(asked(kind, version, BAD[FAMILIES[kind]] | loaded))
    assert [one.text for one in after if not one.passed] == []


def test_ardupilots_form_is_a_name_and_a_value(tmp_path: Path) -> None:
    path = tmp_path / "a.param"
    write_param_file(path, "arducopter", 1, {"GUID_TIMEOUT": 1.0, "WP_ACC": 2.5})
    assert path.read_text() == "GUID_TIMEOUT,1\nWP_ACC,2.5\n"


def test_px4s_form_has_five_columns_and_the_type(tmp_path: Path) -> None:
    path = tmp_path / "a.params"
    write_param_file(path, "px4-copter", 3, {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0})
    assert path.read_text().splitlines()[3:] == [
        "3\t1\tCOM_OF_LOSS_T\t1.000000000\t9",
        "3\t1\tCOM_OBL_RC_ACT\t5\t6",
    ]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.param"
    path.write_text("mine")
    with pytest.raises(InputError, match="--param: .* exists"):
        check_new(path)
    with pytest.raises(InputError, match="--param: "):
        write_param_file(path, "arducopter", 1, {"A": 1.0})
    assert path.read_text() == "mine"
    with pytest.raises(InputError, match="no folder"):
        check_new(tmp_path / "none" / "a.param")
