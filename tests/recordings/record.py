"""Records flights and compares the digests of what they write, byte for byte, with those of earlier flights.

A change that should change nothing must leave every digest equal. `python -m tests.recordings.record` flies every row
of the table and compares it with `digests.json` beside this file; `--write` replaces that file, `--quick` flies the
small missions on one seed only, `--only TEXT` the rows whose names hold it, `--keep DIR` leaves the recordings.

The rows are flown by `sim fly` and `sim arena` as a user calls them, so that they outlive any change of modules.
Floating point differs between processors and numpy builds: compare on the machine that wrote the digests.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from companion.autopilot.kinds import CRUISE_M_S

ROOT = Path(__file__).parents[2]
DIGESTS = Path(__file__).with_name("digests.json")
OWN_MISSIONS = Path(__file__).with_name("missions")
AUTOPILOTS = ("kinematic", "arducopter", "arduplane", "px4-copter", "px4-plane")
SEEDS = (1, 2, 3)
MISSIONS: dict[str, tuple[str, ...]] = {
    "paper-dynamic": ("paper-dynamic",),
    "paper-static": ("paper-static", "--law", "seed"),
    "poor-link": (str(OWN_MISSIONS / "poor-link.yaml"),),
    "one-radio": (str(OWN_MISSIONS / "one-radio.yaml"), "--radio", "sik-57600/v2ext", "--one-radio"),
}
"""Arguments of `sim fly`, by the mission's name."""
QUICK = ("poor-link", "one-radio")
"""Missions that `--quick` flies."""
ARENA = "arena"
TIMES = frozenset({"decision_us", "speedup"})
"""Keys of result.json whose values depend on the machine."""
ARENA_TIMES = frozenset({"decision_median_us", "decision_p99_us", "decision_max_us", "seconds", "wall_s"})
"""Keys of arena.json whose values depend on the machine."""


@dataclass(frozen=True)
class Row:
    """One flight to record."""

    mission: str
    autopilot: str
    seed: int

    @property
    def name(self) -> str:
        """Key of the row in digests.json, and name of its folder."""
        return f"{self.mission}-{self.autopilot}-{self.seed}"


def rows(quick: bool) -> list[Row]:
    """Return the table: four missions, five autopilots, three seeds; or the part of it that `--quick` flies."""
    missions, seeds = (QUICK, SEEDS[:1]) if quick else (tuple(MISSIONS), SEEDS)
    return [Row(mission, autopilot, seed) for mission in missions for autopilot in AUTOPILOTS for seed in seeds]


def without(value: object, keys: frozenset[str]) -> object:
    """Return JSON data without some keys, at any depth."""
    if isinstance(value, dict):
        return {key: without(part, keys) for key, part in value.items() if key not in keys}
    return [without(part, keys) for part in value] if isinstance(value, list) else value


def digests(folder: Path, keys: frozenset[str]) -> dict[str, str]:
    """Return the SHA-256 of each recording in a folder, by file name; JSON is digested without the given keys."""
    found = {}
    for path in sorted(folder.glob("*")):
        if path.suffix in (".csv", ".tlog"):
            found[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
        elif path.suffix == ".json":
            text = json.dumps(without(json.loads(path.read_text()), keys), sort_keys=True)
            found[path.name] = hashlib.sha256(text.encode()).hexdigest()
    return found


def record(row: Row, folder: Path) -> dict[str, str]:
    """Fly a row into a folder; return the digests of the files that it wrote."""
    folder.mkdir(parents=True)
    scale = ["--scale"] if row.autopilot in CRUISE_M_S else []
    options = ["--seed", str(row.seed), "--autopilot", row.autopilot, *scale, "--out", str(folder)]
    subprocess.run(
        [sys.executable, "-m", "sim", "fly", *MISSIONS[row.mission], *options],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    found = digests(folder, TIMES)
    if "result.json" not in found:
        raise RuntimeError(f"{row.name}: the flight left no result.json")
    return found


def record_arena(folder: Path) -> dict[str, str]:
    """Fly the arena's missions with our law; return the digest of its figures."""
    folder.mkdir(parents=True)
    options = ["--runs", "4", "--seed", "1", "--law", "routed", "--out", str(folder)]
    subprocess.run([sys.executable, "-m", "sim", "arena", *options], cwd=ROOT, capture_output=True, check=False)
    return digests(folder, ARENA_TIMES)


def main() -> int:
    """Fly the rows, and compare or write their digests; exit status 1 where a digest differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="replace digests.json")
    parser.add_argument("--quick", action="store_true", help="the small missions on one seed only")
    parser.add_argument("--only", default="", help="the rows whose names hold this text")
    parser.add_argument("--keep", type=Path, help="leave the recordings in this folder")
    parser.add_argument("--jobs", type=int, default=2, help="flights at a time")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(options.jobs) as pool:
        folder = options.keep or Path(temporary)
        table = [row for row in rows(options.quick) if options.only in row.name]
        recorded = dict(
            zip((row.name for row in table), pool.map(lambda row: record(row, folder / row.name), table), strict=True)
        )
        if not options.quick and options.only in ARENA:
            recorded[ARENA] = record_arena(folder / ARENA)
    if options.write:
        DIGESTS.write_text(json.dumps(recorded, indent=1, sort_keys=True) + "\n")
        return 0
    expected = json.loads(DIGESTS.read_text())
    differing = [
        f"{name}/{file}"
        for name, files in recorded.items()
        for file in sorted(files.keys() | expected[name].keys())
        if files.get(file) != expected[name].get(file)
    ]
    print("\n".join(differing) or f"{len(recorded)} recordings, all equal")
    return int(bool(differing))


if __name__ == "__main__":
    sys.exit(main())
