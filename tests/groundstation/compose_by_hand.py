"""Runs the services of groundstation/deploy/compose.yaml as processes, where no Docker is: by hand, for half a minute.

`python -m tests.groundstation.compose_by_hand [SECONDS]` starts the very commands of the file, with its folders in a
scratch folder, prints what the page's API says of the three agents, stops everything and prints the ground station's
messages. It exits with 1 unless all three agents were seen flying to their targets.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

import yaml

DEPLOY = Path(__file__).parents[2] / "groundstation" / "deploy"
PAGE = "http://127.0.0.1:8750"
OLDEST_S = 3.0
"""Age of an agent's place up to which it counts as seen."""


def commands(scratch: Path) -> dict[str, list[str]]:
    """Return the command of each service, by its name, with folders of this computer in place of the containers'."""
    services = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]
    places = {"/demo/": f"{DEPLOY / 'demo'}/", "/fleet/": f"{scratch}/"}
    found = {}
    for name, service in services.items():
        words = service["command"]
        for there, here in places.items():
            words = words.replace(there, here)
        program, *rest = shlex.split(words)
        found[name] = [sys.executable, "-m", program, *rest]
    return found


def _agents() -> list[dict[str, Any]]:
    with urllib.request.urlopen(f"{PAGE}/api/v1/picture", timeout=5) as answer:
        agents: list[dict[str, Any]] = json.load(answer)["agents"]
    return agents


def main() -> int:
    """Run all services for so many seconds; return the exit status."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 30.0
    with tempfile.TemporaryDirectory() as folder:
        wanted = commands(Path(folder))
        subprocess.run(wanted.pop("fleet"), check=True)
        output = Path(folder) / "groundstation.txt"
        running = []
        for name, command in wanted.items():
            with (output if name == "groundstation" else Path(os.devnull)).open("w") as file:
                running.append(subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=file, stderr=file))
        try:
            time.sleep(seconds)
            agents = _agents()
        finally:
            for process in running:
                process.terminate()
            for process in running:
                process.wait(20)
        for agent in agents:
            keys = ("id", "state", "target", "age_s", "north_m", "east_m", "speed_m_s", "heading_deg")
            print({key: agent[key] for key in keys})
        print(output.read_text())
    seen = [agent for agent in agents if agent["age_s"] < OLDEST_S and agent["north_m"] > 50.0]
    return 0 if len(seen) == len(agents) == 3 else 1


if __name__ == "__main__":
    sys.exit(main())
