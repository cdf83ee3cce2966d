"""Mutation test of the guard: `python tests/mutate_guard.py` from the root: hours on two cores.

mutmut (configured in pyproject.toml) makes the mutants and runs tests/companion/test_guard.py against each. This script
adds the judgement: a mutant may survive only if it is listed here as equivalent, with the reason. Exit status 1 if any
other does, or if an entry of the list no longer fits the guard.
"""

import re
import subprocess
import sys

EQUIVALENT = {
    (
        "if off_m > self._tolerance_m() + (change_m_s + 2.0 * limits.wind_m_s) * elapsed_s:",
        "if off_m >= self._tolerance_m() + (change_m_s + 2.0 * limits.wind_m_s) * elapsed_s:",
    ): "they differ for a report that is off by the tolerance to the last bit, which is chosen and not measured",
    (
        "lost = math.hypot(ahead_m, beside_m) > self._tolerance_m() + self._tracking_m() or self._left_s <= 0.0",
        "lost = math.hypot(ahead_m, beside_m) >= self._tolerance_m() + self._tracking_m() or self._left_s <= 0.0",
    ): "likewise",
    (
        "if max((np.hypot(north_m, east_m) + discs.radii_m - grown_m).tolist(), default=0.0) <= ROUNDING_M:",
        "if max((np.hypot(north_m, east_m) + discs.radii_m - grown_m).tolist(), default=0.0) < ROUNDING_M:",
    ): "the shortcut may end at the allowance for rounding or just before: what is beyond it is looked at one by one",
    (
        "self._dt_s = 0.0",
        "self._dt_s = 1.0",
    ): "both ways in set it before anything reads it",
    (
        "self._heard_s = 0.0",
        "self._heard_s = 1.0",
    ): "nothing has been heard yet at a reset, so there is nothing to grow by it",
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
