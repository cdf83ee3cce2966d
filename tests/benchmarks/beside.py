"""Runs a benchmark of another checkout and of this one in turns, and prints what both said.

    python -m tests.benchmarks.beside TREE flood --seconds 10
    python -m tests.benchmarks.beside TREE --turns 3 hostile 300000

Each checkout runs its own version of the benchmark. `namespaces` runs the tests of that name, which print how soon
companions are current again after a kill. The exit status is that of the worst run of this checkout.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
NAMESPACES = ("-m", "pytest", "-n", "0", "-q", "-s", "-p", "no:cacheprovider", "tests/sim/test_namespaces.py")


def run(tree: Path, name: str, arguments: list[str]) -> tuple[int, str]:
    """Run a benchmark of a checkout; return its exit status and what it said."""
    call = list(NAMESPACES) if name == "namespaces" else ["-m", f"tests.benchmarks.{name}"]
    process = subprocess.run(
        [sys.executable, *call, *arguments],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return process.returncode, process.stdout


def main() -> int:
    """Run both in turns; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tree", type=Path, help="the other checkout")
    parser.add_argument("--turns", type=int, default=1)
    parser.add_argument("name", help="a module of tests/benchmarks, or namespaces")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="of the benchmark")
    options = parser.parse_args()
    worst = 0
    for turn in range(options.turns):
        for which, tree in (("before", options.tree.resolve()), ("now", ROOT)):
            began_s = time.monotonic()
            status, said = run(tree, options.name, options.arguments)
            took_s = time.monotonic() - began_s
            load = os.getloadavg()[0]
            print(f"== {options.name}, {which}, turn {turn + 1}: status {status} after {took_s:.0f} s, load {load:.1f}")
            print(said, flush=True)
            if which == "now":
                worst = max(worst, status)
    return worst


if __name__ == "__main__":
    sys.exit(main())
