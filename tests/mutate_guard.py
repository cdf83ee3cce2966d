"""Mutation test of the guard: what wrong lines of it the tests in test_guard.py do not notice.

`python tests/mutate_guard.py [--sample 800] [--seed 1] [NAME...]` from the root; without --sample all. NAME is a
function or a mutant of it: `Guard._ray`, `Guard._ray#3`.

mutmut makes the mutants: of every function, and of the numbers at the top. Left out by this rule are type aliases, the
wording of reasons, and defaults of fields, which are in force before a mutant can be. Each is put in place in a process
of its own, and the tests that call the function run until one fails, those that take the least time first. A test that
takes far too long fails. Random tests are seeded and shrink nothing. A mutant may survive only if
mutate_guard_equivalent.txt lists it, with the reason. Exit status 1 if any other does, or if an entry there is no
survivor any more. Leave the tests alone while it runs: with edits in between it called some killed that live.

Of all 2963 mutants 2829 are killed and 134 are equivalent, 34 of them but for a value at a tolerance or an edge to the
last bit; none is alive. Before the tests were extended for it, at least 107 of those killed lived. About half an hour
on two cores.
"""

import argparse
import difflib
import os
import random
import re
import resource
import signal
import sys
import time
from pathlib import Path
from types import CodeType, FrameType
from typing import NamedTuple, NoReturn

import libcst as cst
import pytest
from hypothesis import HealthCheck, Phase, settings
from mutmut.mutation.file_mutation import ChildReplacementTransformer, create_mutations

from companion.guard import guard

TESTS = "tests/companion/guard/test_guard.py"
EQUIVALENT = Path(__file__).with_name("mutate_guard_equivalent.txt")
CPU_SHARE = 3.0
CPU_S = 2.0
"""A mutant one of whose tests takes so many times what it takes on the guard, and so much more, hangs."""
MEMORY_BYTES = 4 << 30


class Mutant(NamedTuple):
    """A function, or the constants, with one thing changed."""

    name: str
    removed: str
    added: str
    code: CodeType

    @property
    def function(self) -> str:
        return self.name.partition("#")[0]

    @property
    def change(self) -> tuple[str, ...]:
        return self.function, self.removed, self.added


def all_mutants() -> list[Mutant]:
    """Return the mutants, each numbered within its function."""
    path = Path(guard.__file__)
    module, mutations, _, _ = create_mutations(str(path), path.read_text(encoding="utf-8"))
    owners = {
        method: f"{place.name.value}."
        for place in module.body
        if isinstance(place, cst.ClassDef)
        for method in place.body.body
    }
    constants = [line for line in module.body if is_number(line)]
    made: dict[tuple[str, str], Mutant] = {}
    counts: dict[str, int] = {}
    for mutation in mutations:
        function = mutation.contained_by_top_level_function
        whole, name = constants, "constants"
        if isinstance(function, cst.FunctionDef):
            whole, name = [function], owners.get(function, "") + function.name.value
        changed = cst.Module(whole).visit(ChildReplacementTransformer(mutation.original_node, mutation.mutated_node))
        before, after = cst.Module(whole).code, changed.code
        if before == after or (name, after) in made:
            continue
        counts[name] = counts.get(name, 0) + 1
        lines = list(difflib.ndiff(before.splitlines(), after.splitlines()))
        removed, added = (" ".join(line[2:].strip() for line in lines if line[0] == sign) for sign in "-+")
        code = compile("from __future__ import annotations\n" + after, name, "exec")
        made[name, after] = Mutant(f"{name}#{counts[name]}", removed, added, code)
    return list(made.values())


def is_number(line: cst.CSTNode) -> bool:
    """Return whether a line at the top of the guard names a number."""
    if not (isinstance(line, cst.SimpleStatementLine) and isinstance(line.body[0], cst.Assign)):
        return False
    target = line.body[0].targets[0].target
    return isinstance(target, cst.Name) and isinstance(getattr(guard, target.value), float | int)


def put_in_place(mutant: Mutant) -> None:
    made: dict[str, object] = {}
    exec(mutant.code, guard.__dict__, made)
    del made["annotations"]
    owner, dot, _ = mutant.function.partition(".")
    for name, value in made.items():
        setattr(getattr(guard, owner) if dot else guard, name, value)


class Judge:
    """Plugin of pytest that runs the tests once as they are, and then tries each mutant."""

    def __init__(self, mutants: list[Mutant], jobs: int) -> None:
        self._mutants, self._jobs = mutants, jobs
        self._trying = False
        self._running: dict[int, Mutant] = {}
        self.survivors: list[Mutant] = []
        self.hung = 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and self._trying:
            os._exit(1)
        if report.failed:
            pytest.exit(f"{report.nodeid} fails on the guard as it is", 2)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        runs = sorted((measured(item) for item in session.items), key=lambda run: run[1])
        for mutant in self._mutants:
            if len(self._running) == self._jobs:
                self._wait()
            chosen = [(item, cpu_s) for item, cpu_s, ran in runs if mutant.function in ran | {"constants"}]
            pid = os.fork()
            if pid == 0:
                self._try(mutant, chosen)
            self._running[pid] = mutant
        while self._running:
            self._wait()
        return True

    def _try(self, mutant: Mutant, tests: list[tuple[pytest.Item, float]]) -> NoReturn:
        self._trying = True
        sink = os.open(os.devnull, os.O_WRONLY)
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        try:
            put_in_place(mutant)
            for item, cpu_s in tests:
                signal.setitimer(signal.ITIMER_PROF, CPU_SHARE * cpu_s + CPU_S)
                item.ihook.pytest_runtest_protocol(item=item, nextitem=None)
        except BaseException:
            os._exit(1)
        os._exit(0)

    def _wait(self) -> None:
        pid, status = os.wait()
        mutant = self._running.pop(pid)
        self.hung += os.WIFSIGNALED(status)
        if status == 0:
            self.survivors.append(mutant)


def measured(item: pytest.Item) -> tuple[pytest.Item, float, set[str]]:
    """Run a test; return it, its processor time and the functions of the guard that it calls."""
    ran: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename == guard.__file__:
            ran.add(frame.f_code.co_qualname)

    start_s = time.process_time()
    sys.setprofile(note)
    item.ihook.pytest_runtest_protocol(item=item, nextitem=None)
    sys.setprofile(None)
    return item, time.process_time() - start_s, ran


def listed() -> set[tuple[str, ...]]:
    """Return function, line and mutated line of each mutant that is said to be equivalent."""
    return set(re.findall(r"^(\S+)\n  - (.*)\n  \+ (.*)$", EQUIVALENT.read_text(encoding="utf-8"), re.MULTILINE))


def main() -> int:
    """Try the mutants asked for, judge the survivors, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--sample", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    everything = all_mutants()
    tried = [one for one in everything if not asked.names or {one.name, one.function} & set(asked.names)]
    if asked.sample is not None:
        random.Random(asked.seed).shuffle(tried)
        tried = tried[: asked.sample]
    # That a test fails is enough. How long it takes depends on what else the machine does.
    settings.register_profile(
        "mutants",
        database=None,
        deadline=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=[HealthCheck.too_slow],
    )
    judge = Judge(tried, asked.jobs)
    options = ["-n0", "--capture=no", "--tb=no", "--assert=plain", "--hypothesis-profile=mutants"]
    status = pytest.main([TESTS, *options], plugins=[judge])
    if status != pytest.ExitCode.OK:
        return 1
    expected, survived = listed(), {one.change for one in judge.survivors}
    alive = [one for one in judge.survivors if one.change not in expected]
    killed = {one.change for one in tried} - survived
    unknown = expected - {one.change for one in everything}
    for one in alive:
        print(f"survived: {one.name}\n  - {one.removed}\n  + {one.added}")
    for function, removed, added in sorted(expected & killed | unknown):
        print(f"listed as equivalent, but no survivor: {function}\n  - {removed}\n  + {added}")
    equivalent = len(judge.survivors) - len(alive)
    print(
        f"{len(everything)} mutants, {len(tried)} tried: {len(tried) - len(judge.survivors)} killed "
        f"({judge.hung} of them hung), {equivalent} equivalent, {len(alive)} alive"
    )
    return 1 if alive or expected & killed | unknown else 0


if __name__ == "__main__":
    sys.exit(main())
