"""Mutation test of the guard: `python tests/mutate_guard.py` from the root, about six minutes on two cores.

mutmut (configured in pyproject.toml) makes the mutants and runs tests/companion/test_guard.py against each. This script
adds the judgement: a mutant may survive only if it is listed here as equivalent, with the reason. Exit status 1 if any
other does, or if an entry of the list no longer fits the guard.
"""

import re
import subprocess
import sys

EQUIVALENT = {
    (
        "return bool(np.all(apart_m > grown_m + reach_m))",
        "return bool(np.all(apart_m >= grown_m + reach_m))",
    ): "the shortcut never changes the verdict, so it may begin at its reach or just beyond it",
    (
        "if point[1] < start[1] + share * (end[1] - start[1]):",
        "if point[1] <= start[1] + share * (end[1] - start[1]):",
    ): "they differ for a point on the edge itself, whose depth is zero with either sign",
    (
        "share = 0.0",
        "share = 1.0",
    ): "it stays only where the segment has no length, and multiplies that length",
}
"""(line of the guard, mutated line): why no test can tell them apart."""


def mutmut(*arguments: str) -> str:
    done = subprocess.run([sys.executable, "-m", "mutmut", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"mutmut {' '.join(arguments)} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def change_of(name: str) -> tuple[str, str]:
    """Return the line of the guard that a mutant changes, and what it makes of it."""
    lines = re.findall(r"^([-+])(?![-+]{2} )(.*)$", mutmut("show", name), re.MULTILINE)
    removed, added = (" ".join(text.strip() for sign, text in lines if sign == wanted) for wanted in "-+")
    return removed, added


def main() -> int:
    """Run mutmut, judge its survivors, and return the exit status."""
    mutmut("run")
    states = re.findall(r"^\s*(\S+__mutmut_\d+): (.+)$", mutmut("results", "--all", "true"), re.MULTILINE)
    alive = {name: change_of(name) for name, state in states if state not in ("killed", "timeout")}
    unexplained = {name: change for name, change in alive.items() if change not in EQUIVALENT}
    stale = set(EQUIVALENT) - set(alive.values())
    for name, (removed, added) in unexplained.items():
        print(f"survived: {name}\n  - {removed}\n  + {added}")
    for removed, added in stale:
        print(f"listed as equivalent, but none such survives:\n  - {removed}\n  + {added}")
    equivalent = len(alive) - len(unexplained)
    print(
        f"{len(states)} mutants, {len(states) - len(alive)} killed, {equivalent} equivalent, {len(unexplained)} alive"
    )
    return 1 if unexplained or stale or not states else 0


if __name__ == "__main__":
    sys.exit(main())
