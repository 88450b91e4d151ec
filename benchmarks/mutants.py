"""Mutation testing of arithmetic, quantisers and compiler: which small faults no test finds.

    python benchmarks/mutants.py [--sample 600] [--seed 0] [--only runtime/compiler]
        [--page docs/mutation-testing.md] [--folder build/mutants]

What is mutated and which tests run stands in benchmarks/mutants.toml. First every test runs once
and its lines are recorded; then each fault is put into its function, in a process's memory, and the
tests that reach its line run until one fails. Results are kept in the folder: a second run tries
only what is new, what survived and what has changed. Without --sample all faults are tried.
"""

import prepare  # isort: skip  # noqa: F401 - before all others

import argparse
import gc
import json
import os
import random
import sys
import time
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from benchmarks.mutant_operators import ROOT, Mutant, mutants
from benchmarks.mutant_page import summary, write_page
from benchmarks.mutant_reach import record
from benchmarks.mutant_trials import Fate, in_copy, try_mutant

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_LONGEST = 1800  # [CPU s] of the tests of a file, traced


def main() -> None:
    """Try the faults and print what survived."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", type=int, help="faults drawn at random; all without it")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="files that begin with this")
    parser.add_argument("--page", type=Path, help="Markdown file whose block is written")
    parser.add_argument("--folder", type=Path, default=ROOT / "build/mutants")
    options = parser.parse_args()
    config = tomllib.loads((ROOT / "benchmarks/mutants.toml").read_text("utf-8"))
    everything = [m for file in files(config) for m in mutants(file)]
    drawn = draw(everything, options.sample, options.seed)
    drawn = [m for m in drawn if m.path.startswith(options.only)]
    os.chdir(ROOT)
    trials = Trials(drawn, config, options.folder)
    deselected = [f"--deselect={test}" for test in config["not_tests"]]
    words = ["-q", "-p", "no:cacheprovider", *deselected, *config["tests"]]
    if code := pytest.main(words, [trials]):
        sys.exit(code)
    print(summary(trials.fates, len(everything), config["equivalent"]))
    if options.page:
        write_page(options.page, trials.fates, everything, config["equivalent"], options.seed)


def files(config: dict[str, Any]) -> list[str]:
    """The files under mutation."""
    found = sorted({path for glob in config["files"] for path in ROOT.glob(glob)})
    names = [path.relative_to(ROOT).as_posix() for path in found]
    return [name for name in names if name not in config["not_files"]]


def draw(everything: list[Mutant], sample: int | None, seed: int) -> list[Mutant]:
    """So many of them at random; a larger sample holds the smaller one."""
    drawn = list(everything)
    if sample is not None:
        random.Random(seed).shuffle(drawn)
    return drawn[:sample]


def digest(paths: list[Path]) -> str:
    """Of the contents of files."""
    return sha256(b"".join(path.read_bytes() for path in sorted(paths))).hexdigest()[:16]


class Trials:
    """A plugin of pytest that, instead of running the tests, tries the faults with them."""

    def __init__(self, drawn: list[Mutant], config: dict[str, Any], folder: Path) -> None:
        self._drawn, self._config, self._folder = drawn, config, folder
        self._failed = False
        self.fates: dict[Mutant, Fate] = {}

    def pytest_configure(self) -> None:
        """The same examples for each fault; a smaller example of a failure is of no use here."""
        from hypothesis import Phase, settings  # not before pytest

        phases = (Phase.explicit, Phase.generate)
        settings.register_profile("mutants", derandomize=True, database=None, phases=phases)
        settings.load_profile("mutants")

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Record what is not known yet, then try every fault."""
        gc.collect()
        gc.freeze()  # the copies share this memory
        tests = self._reach(session.items)
        self._try_all({item: tests[item.nodeid] for item in session.items if item.nodeid in tests})
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a test that fails."""
        self._failed |= report.failed

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:  # noqa: ANN401
        """Say nothing of tests."""
        terminalreporter.stats.clear()

    def _run(self, item: pytest.Item) -> bool:
        """Run a test with fixtures of its own; whether it passed or was skipped."""
        self._failed = False
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
        return not self._failed

    def _reach(self, items: Sequence[pytest.Item]) -> dict[str, dict[str, Any]]:
        """Test -> its seconds and lines; recorded again for test files that have changed."""
        watched = files(self._config)
        code = digest([ROOT / file for file in watched])
        by_file: dict[Path, list[pytest.Item]] = {}
        for item in items:
            by_file.setdefault(item.path, []).append(item)
        tests: dict[str, dict[str, Any]] = {}
        (self._folder / "reach").mkdir(parents=True, exist_ok=True)
        for file, own in by_file.items():
            kept = self._folder / "reach" / f"{file.stem}-{code}-{digest([file])}.json"
            if not kept.exists():
                print(f"recording {file.relative_to(ROOT)}", flush=True)
                in_copy(lambda own=own, kept=kept: _zero(record(own, self._run, kept, watched)),  # type: ignore[misc]
                        _LONGEST)  # fmt: skip
            tests |= json.loads(kept.read_text("utf-8"))
        longest = self._config["longest"]
        return {name: test for name, test in tests.items() if test["seconds"] <= longest}

    def _try_all(self, tests: dict[pytest.Item, dict[str, Any]]) -> None:
        """The fate of every one, from the folder where it is known."""
        book = self._folder / "fates.jsonl"
        lines = book.read_text("utf-8").splitlines() if book.exists() else []
        known: dict[str, list[str]] = {line[0]: line for line in map(json.loads, lines)}
        code = {file: digest([ROOT / file]) for file in {m.path for m in self._drawn}}
        against = digest([item.path for item in tests])
        with book.open("a", encoding="utf-8") as out:
            for number, mutant in enumerate(self._drawn, 1):
                _, fate, of, by = known.get(mutant.key, ("", "", "", ""))
                lives = fate in ("survived", "unreached") and by != against
                if of != code[mutant.path] or lives:
                    start = time.monotonic()
                    fate = try_mutant(mutant, self._chosen(mutant, tests), self._run)
                    print(json.dumps([mutant.key, fate, code[mutant.path], against]), file=out)
                    out.flush()
                    took = f"{time.monotonic() - start:.1f} s"
                    line = f"{number}/{len(self._drawn)} {took} {fate} {mutant.line} {mutant.key}"
                    print(line, flush=True)
                self.fates[mutant] = fate  # type: ignore[assignment]

    def _chosen(
        self, mutant: Mutant, tests: dict[pytest.Item, dict[str, Any]]
    ) -> dict[pytest.Item, float]:
        """The tests that reach it, those first that take least, within the time for one."""
        near = [item for item, test in tests.items() if _reaches(test, mutant)]
        chosen, left = {}, self._config["seconds"]
        for item in sorted(near, key=lambda item: float(tests[item]["seconds"])):
            if (left := left - tests[item]["seconds"]) < 0:
                break
            chosen[item] = tests[item]["seconds"]
        return chosen


def _zero(_: None) -> int:
    return 0


def _reaches(test: dict[str, Any], mutant: Mutant) -> bool:
    lines = test["reached"].get(mutant.path, ())
    return any(mutant.line <= line <= mutant.last for line in lines)


if __name__ == "__main__":
    main()
