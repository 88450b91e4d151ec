"""Mutation testing tests itself: the faults are small, stand where they say, and can be found."""

import ast

import pytest

from benchmarks import mutant_operators, mutant_trials
from benchmarks.mutant_operators import mutants, mutated
from benchmarks.mutant_page import interval, score, summary

SOURCE = '''
"""A module."""
LIMIT = 3


class Box:
    size: int = 2

    def fits(self, x: int = 4) -> bool:
        """Whether it fits."""
        if not x:
            raise ValueError(f"{x + 1}")
        return 0 < x <= self.size << 1


def area(a, b):
    rows = [c * b for c in a]
    return max(rows) - 1
'''


@pytest.fixture
def box(tmp_path, monkeypatch):
    """A file of its own under mutation."""
    (tmp_path / "box.py").write_text(SOURCE)
    monkeypatch.setattr(mutant_operators, "ROOT", tmp_path)
    monkeypatch.setattr(mutant_trials, "ROOT", tmp_path)
    return tmp_path / "box.py"


def changes(path="box.py"):
    return [m.key.removeprefix("box.py ") for m in mutants(path)]


def test_operators_constants_negations_choices_and_returns_change_inside_functions_alone(box):
    found = changes()
    assert "Box.fits: `not x` → `x`" in found
    assert "Box.fits: `0 < x <= self.size << 1` → `0 <= x <= self.size << 1`" in found
    assert "Box.fits: `0 < x <= self.size << 1` → `0 < x < self.size << 1`" in found
    assert "Box.fits: `self.size << 1` → `self.size >> 1`" in found
    assert "area: `max` → `min`" in found
    assert "area: `max(rows) - 1` → `max(rows) + 1`" in found
    assert "area: `return max(rows) - 1` → `return None`" in found
    assert "area: `1` → `2`" in found
    assert "area: `c * b` → `c / b`" in found
    # messages, defaults, tables and annotations are left alone
    assert not [key for key in found if "x + 1" in key or "LIMIT" in key or "`4`" in key]
    assert not [key for key in found if "`2` →" in key or "`3` →" in key]


def test_every_fault_is_one_change_of_the_file(box):
    before = ast.unparse(ast.parse(SOURCE)).splitlines()
    for mutant in mutants("box.py"):
        after = ast.unparse(mutated(mutant)).splitlines()
        assert len(after) == len(before)
        assert sum(a != b for a, b in zip(after, before, strict=True)) == 1, mutant.key


def test_keys_stay_when_lines_move(box):
    before = changes()
    box.write_text("\n\n" + SOURCE)
    assert changes() == before
    assert len(set(before)) == len(before)


def test_a_fault_is_found_by_a_test_that_reaches_it_and_by_no_other(box):
    space = {}
    exec(compile(SOURCE, str(box), "exec"), space)
    fault = next(m for m in mutants("box.py") if m.key.endswith("area: `max` → `min`"))
    runs = {"sees": lambda: space["area"]([1, 2], 3) == 5, "blind": lambda: space["Box"]().fits(1)}

    def tried(*tests):
        return mutant_trials.try_mutant(fault, dict.fromkeys(tests, 0.1), lambda t: runs[t]())

    assert tried("blind", "sees") == "killed"
    assert tried("blind") == "survived"
    assert tried() == "unreached"
    assert space["area"]([1, 2], 3) == 5  # the fault was in a copy of the process


def test_a_fault_that_never_ends_counts_as_found(box, monkeypatch):
    fault = mutants("box.py")[0]
    monkeypatch.setattr(mutant_trials, "put_in", lambda mutant: True)
    original = mutant_trials.in_copy
    monkeypatch.setattr(mutant_trials, "in_copy", lambda work, seconds: original(work, 1))

    def forever(test):
        while True:
            pass

    assert mutant_trials.try_mutant(fault, {"test": 0.1}, forever) == "too long"


def test_equivalent_faults_are_not_counted_and_survivors_are_named(box):
    first, second, third = mutants("box.py")[:3]
    fates = {first: "killed", second: "survived", third: "survived"}
    assert score(fates, {second.key: "the same"}) == (1, 2)
    text = summary(fates, 99, {second.key: "the same"})
    assert "1 of 2 found, 50.0%" in text
    assert third.key in text
    assert second.key not in text


def test_the_interval_is_wilsons():
    # Brown, Cai and DasGupta 2001: a share of 0.9 of 100
    assert interval(90, 100) == pytest.approx((0.8256, 0.9448), abs=1e-4)
    assert interval(0, 0) == (0.0, 1.0)
