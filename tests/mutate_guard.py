"""Mutation test of the guard: finds the wrong lines in it that the tests in tests/companion/guard do not notice.

Call `python tests/mutate_guard.py [--sample 800] [--seed 1] [NAME...]` from the root; without --sample it tries all
mutants. NAME is a function or one of its mutants: `BackupSearch.ray`, `BackupSearch.ray#3`, `is_hit`; `arcs.constants`
stands for the numbers at the top of arcs.py.

mutmut makes the mutants: of every function of companion/guard, and of the numbers at the top of each file. Left out by
this rule are type aliases, the wording of reasons, and defaults of fields, which take effect before a mutant can be put
in place. Each mutant is put in place in a process of its own, where the tests that call the function run until one
fails, the fastest test first. A test that takes far too long counts as failed. Random tests are seeded, and failing
examples are not shrunk. A mutant may survive only if mutate_guard_equivalent.txt lists it, with the reason. The exit
status is 1 if any other mutant survives, or if a listed one does not survive any more; where all is well the last line
is "no new survivor". Do not edit the tests while it runs: it then counted mutants as killed that survive.

Of all 3606 mutants 149 are listed as equivalent; 46 of these differ from the guard only for a value exactly at a
tolerance or an edge. All take about half an hour on two cores.
"""

import argparse
import difflib
import importlib
import os
import random
import re
import resource
import signal
import sys
import time
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import NamedTuple, NoReturn

import libcst as cst
import pytest
from hypothesis import HealthCheck, Phase, settings
from mutmut.mutation.file_mutation import ChildReplacementTransformer, create_mutations

import companion.guard

TESTS = "tests/companion/guard"
FOLDER = Path(companion.guard.__file__).parent
MODULES: dict[str, ModuleType] = {
    path.stem: importlib.import_module(f"companion.guard.{path.stem}")
    for path in sorted(FOLDER.glob("*.py"))
    if path.stem != "__init__"
}
CONSTANTS = ".constants"
EQUIVALENT = Path(__file__).with_name("mutate_guard_equivalent.txt")
CPU_SHARE = 3.0
"""Multiple of its time on the unchanged guard that a test may take."""
CPU_S = 2.0
"""Processor time that a test may take beyond CPU_SHARE times its time on the unchanged guard; a mutant on which a test
takes longer counts as hung, and as killed."""
MEMORY_BYTES = 4 << 30
"""Memory that the process of a mutant may take."""


class Mutant(NamedTuple):
    """A function, or the constants of a module, with one thing in it changed."""

    module: str
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
    """Return the mutants of every module, each numbered within its function."""
    found = [mutant for stem in MODULES for mutant in mutants_of(stem)]
    homes: dict[str, str] = {}
    for mutant in found:
        # The list of equivalents names functions without their modules.
        assert homes.setdefault(mutant.function, mutant.module) == mutant.module, mutant.function
    return found


def mutants_of(stem: str) -> list[Mutant]:
    """Return the mutants of one module, each numbered within its function."""
    path = FOLDER / f"{stem}.py"
    module, mutations, _, _ = create_mutations(str(path), path.read_text(encoding="utf-8"))
    owners = {
        method: f"{place.name.value}."
        for place in module.body
        if isinstance(place, cst.ClassDef)
        for method in place.body.body
    }
    constants = [line for line in module.body if is_number(line, MODULES[stem])]
    made: dict[tuple[str, str], Mutant] = {}
    counts: dict[str, int] = {}
    for mutation in mutations:
        function = mutation.contained_by_top_level_function
        whole, name = constants, stem + CONSTANTS
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
        made[name, after] = Mutant(stem, f"{name}#{counts[name]}", removed, added, code)
    return list(made.values())


def is_number(line: cst.CSTNode, module: ModuleType) -> bool:
    """Return whether a line at the top of a module assigns a number to a name."""
    if not (isinstance(line, cst.SimpleStatementLine) and isinstance(line.body[0], cst.Assign)):
        return False
    target = line.body[0].targets[0].target
    return isinstance(target, cst.Name) and isinstance(getattr(module, target.value), float | int)


def put_in_place(mutant: Mutant) -> None:
    """Replace the mutated function in its class, or in its module and every module that imports it; constants alike."""
    made: dict[str, object] = {}
    exec(mutant.code, vars(MODULES[mutant.module]), made)
    del made["annotations"]
    owner, dot, _ = mutant.function.partition(".")
    if dot and not mutant.function.endswith(CONSTANTS):
        for name, value in made.items():
            setattr(getattr(MODULES[mutant.module], owner), name, value)
        return
    for name, value in made.items():
        for module in MODULES.values():
            if name in vars(module):
                setattr(module, name, value)


class Judge:
    """Plugin of pytest that runs the tests once as they are, and then tries each mutant."""

    def __init__(self, mutants: list[Mutant], jobs: int) -> None:
        self._mutants, self._jobs = mutants, jobs
        self._trying = False
        self._running: dict[int, Mutant] = {}
        self.survivors: list[Mutant] = []
        self.hung = 0

    def pytest_collection(self) -> None:
        # After conftest.py has loaded its own, before the tests are imported.
        settings.load_profile("mutants")

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
            chosen = [
                (item, cpu_s)
                for item, cpu_s, ran in runs
                if mutant.function in ran or mutant.function.endswith(CONSTANTS)
            ]
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
    files = {module.__file__ for module in MODULES.values()}

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename in files:
            ran.add(frame.f_code.co_qualname)

    start_s = time.process_time()
    sys.setprofile(note)
    item.ihook.pytest_runtest_protocol(item=item, nextitem=None)
    sys.setprofile(None)
    return item, time.process_time() - start_s, ran


def listed() -> set[tuple[str, ...]]:
    """Return function, line and mutated line of each mutant that is listed as equivalent."""
    return set(re.findall(r"^(\S+)\n  - (.*)\n  \+ (.*)$", EQUIVALENT.read_text(encoding="utf-8"), re.MULTILINE))


def main() -> int:
    """Try the mutants that the command line names, judge the survivors, and return the exit status."""
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
    # Only a failing test counts; how long one takes depends on what else the machine does.
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
    if alive or expected & killed | unknown:
        return 1
    print("no new survivor")
    return 0


if __name__ == "__main__":
    sys.exit(main())
