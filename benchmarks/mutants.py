"""Mutation testing: does a test fail for every small fault in arithmetic, quantisers, compiler?

    python benchmarks/mutants.py [--sample 600] [--seed 0] [--only runtime/compiler]
        [--page docs/mutation-testing.md] [--folder build/mutants]

What is mutated and which tests run stands in benchmarks/mutants.toml. First every test is run once
and its lines recorded; then each fault is put into its file, in a process's memory, and the tests
that reach its line run until one fails. Results are kept in the folder: a second run tries only
what is new, what survived and what has changed. Without --sample all faults are tried.
"""

import prepare  # isort: skip  # noqa: F401 - before all others

import argparse
import json
import os
import random
import subprocess
import sys
import time
from hashlib import sha256
from pathlib import Path
from typing import Any

from benchmarks.mutant_operators import ROOT, Mutant, mutants
from benchmarks.mutant_page import summary, write_page
from benchmarks.mutant_trials import Fate, import_large, try_mutant

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Tests = dict[str, dict[str, Any]]


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
    options.folder.mkdir(parents=True, exist_ok=True)
    everything = [m for file in files(config) for m in mutants(file)]
    drawn = draw(everything, options.sample, options.seed)
    drawn = [m for m in drawn if m.path.startswith(options.only)]
    fates = try_all(drawn, reach(config, options.folder), config, options.folder)
    print(summary(fates, len(everything), config["equivalent"]))
    if options.page:
        write_page(options.page, fates, everything, config["equivalent"], options.seed)


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


def reach(config: dict[str, Any], folder: Path) -> Tests:
    """The tests with their seconds and lines; recorded again for test files that have changed."""
    code = digest([ROOT / file for file in files(config)])
    tests: Tests = {}
    for file in sorted(p for place in config["tests"] for p in (ROOT / place).rglob("test_*.py")):
        name = file.relative_to(ROOT).as_posix()
        kept = folder / "reach" / f"{name.replace('/', '.')}-{code}-{digest([file])}.json"
        if not kept.exists():
            print(f"recording {name}", file=sys.stderr, flush=True)
            record(name, kept, config)
        tests |= json.loads(kept.read_text("utf-8"))
    return {
        name: test
        for name, test in tests.items()
        if "unfit" not in test and test["seconds"] <= config["longest"]
    }


def record(file: str, kept: Path, config: dict[str, Any]) -> None:
    """Run a file's tests and write the lines that they reach."""
    kept.parent.mkdir(parents=True, exist_ok=True)
    known = {"MUTANT_FILES": json.dumps(files(config)), "MUTANT_REACH": str(kept)}
    deselected = [f"--deselect={test}" for test in config["not_tests"]]
    plugins = ["-p", "no:cacheprovider", "-p", "benchmarks.mutant_reach"]
    words = [sys.executable, "-m", "pytest", "-q", *plugins, *deselected, file]
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, **known, "PYTHONPATH": path}
    subprocess.run(words, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, check=False)


def try_all(
    drawn: list[Mutant], tests: Tests, config: dict[str, Any], folder: Path
) -> dict[Mutant, Fate]:
    """The fate of every one, from the folder where it is known."""
    book = folder / "fates.jsonl"
    lines = book.read_text("utf-8").splitlines() if book.exists() else []
    known: dict[str, list[str]] = {line[0]: line for line in map(json.loads, lines)}
    code = {file: digest([ROOT / file]) for file in {m.path for m in drawn}}
    against = sha256(json.dumps(sorted(tests)).encode()).hexdigest()[:16]
    import_large()
    os.chdir(ROOT)
    fates: dict[Mutant, Fate] = {}
    with book.open("a", encoding="utf-8") as out:
        for number, mutant in enumerate(drawn, 1):
            key, fate, of, by = (*known.get(mutant.key, ()), "", "", "", "")[:4]
            if of != code[mutant.path] or (fate in ("survived", "unreached") and by != against):
                start = time.monotonic()
                fate = try_mutant(mutant, chosen(mutant, tests, config["seconds"]))
                print(json.dumps([mutant.key, fate, code[mutant.path], against]), file=out)
                out.flush()
                took = f"{time.monotonic() - start:.1f} s"
                print(f"{number}/{len(drawn)} {took} {fate} {mutant.line} {mutant.key}", flush=True)
            fates[mutant] = fate
    return fates


def chosen(mutant: Mutant, tests: Tests, budget: float) -> list[dict[str, float]]:
    """The tests that reach it, a few files at a time, those first that cost least.

    A line outside of functions is reached by importing: tests that enter the file come first, then
    all others.
    """
    near = {n: t for n, t in tests.items() if _reaches(t["reached"].get(mutant.path, ()), mutant)}
    groups = _groups(near, budget)
    if mutant.inside:
        return groups
    spent = sum(sum(group.values()) for group in groups)
    others = {name: test for name, test in tests.items() if name not in near}
    return groups + _groups(others, budget - spent)


def _reaches(lines: list[int], mutant: Mutant) -> bool:
    if not mutant.inside:
        return bool(lines)
    return any(mutant.line <= line <= mutant.last for line in lines)


def _groups(tests: Tests, budget: float, files_each: int = 5) -> list[dict[str, float]]:
    """Within the budget, cheap tests first; then by file, those of a file together."""
    by_file: dict[str, dict[str, float]] = {}
    for name in sorted(tests, key=lambda name: tests[name]["seconds"]):
        if (budget := budget - tests[name]["seconds"]) < 0:
            break
        by_file.setdefault(name.split("::")[0], {})[name] = tests[name]["seconds"]
    order = sorted(by_file.values(), key=lambda group: sum(group.values()) / len(group))
    parts = [order[at : at + files_each] for at in range(0, len(order), files_each)]
    return [{n: s for group in part for n, s in group.items()} for part in parts]


if __name__ == "__main__":
    main()
