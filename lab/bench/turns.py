"""Candidates that take turns, so that what else the machine does meets all of them alike."""

import argparse
import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

Act = Callable[[], object]


def interleave(candidates: Mapping[str, Iterable[Act]], rounds: int) -> dict[str, list[float]]:
    """Seconds of each candidate's calls, round by round; the first round is not kept."""
    calls = {name: list(acts) for name, acts in candidates.items()}
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(rounds + 1):
        for name, acts in calls.items():
            for act in acts:
                start = time.perf_counter()
                act()
                if turn:
                    taken[name].append(time.perf_counter() - start)
    return taken


def medians(candidates: Mapping[str, Iterable[Act]], rounds: int) -> dict[str, float]:
    """Median time [us] of each candidate's calls, which take turns."""
    taken = interleave(candidates, rounds)
    return {name: 1e6 * float(np.median(values)) for name, values in taken.items()}


def parser_of(doc: str | None, rounds: int = 15) -> argparse.ArgumentParser:
    """The options that benchmarks have."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=rounds, help="in which candidates take turns")
    parser.add_argument("--json", action="store_true")
    return parser


def report(result: Mapping[str, Any], options: argparse.Namespace) -> None:
    """Print nested results as JSON, or for people."""
    print(json.dumps(result, indent=2) if options.json else "\n".join(lines(result)))


def lines(result: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Yield names, and behind or below them their numbers, to three digits."""
    for name, value in result.items():
        if not isinstance(value, Mapping):
            yield f"{indent}{name}: {_short(value)}"
        elif any(isinstance(each, Mapping) for each in value.values()):
            yield f"{indent}{name}"
            yield from lines(value, f"{indent}  ")
        else:
            numbers = ", ".join(f"{key} {_short(each)}" for key, each in value.items())
            yield f"{indent}{name}: {numbers}"


def _short(value: object) -> str:
    if isinstance(value, list | tuple):
        return " ".join(map(_short, value))
    if not isinstance(value, float):
        return str(value)
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
