"""The table of docs/nir.md: which chips have which primitives, by what the compiler says."""

import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import RuleError
from tests.networks import chain
from tests.paths import ROOT

DT = 1e-3


def neurons(kind, *shape):
    """A threshold of half the weights; dt = 1 ms: membranes keep 7/8, currents 3/4."""
    zero, gain, threshold = (np.full(shape, float(v)) for v in (0, 8, 0.5))
    current, membrane = np.full(shape, 4e-3), np.full(shape, 8e-3)
    if kind == "IF":
        return nir.IF(np.full(shape, 1000.0), threshold, zero)
    if kind == "LIF":
        return nir.LIF(membrane, gain, zero, threshold, zero)
    return nir.CubaLIF(current, membrane, gain, zero, threshold, zero, gain / 2)


def readout(kind):
    """Neurons without a threshold; their membranes keep 7/8."""
    zero, gain, leak = (np.full(4, float(v)) for v in (0, 8, 8e-3))
    if kind == "I":
        return nir.I(np.full(4, 1000.0))
    if kind == "LI":
        return nir.LI(leak, gain, zero)
    return nir.CubaLI(leak / 2, leak, gain, zero, gain / 2)


def convolved(kind):
    kernel = nir.Conv2d((4, 4), np.ones((1, 1, 3, 3)), 1, 1, 1, 1, np.zeros(1))
    flat = nir.Flatten({"input": np.array([1, 4, 4])}, 0, -1)
    return [kernel, neurons(kind, 1, 4, 4), flat, nir.Linear(np.ones((4, 16)))]


FORMER = {
    "Conv1d, Conv2d": convolved,
    "Scale": lambda kind: [nir.Scale(np.ones(4))],
    "Delay": lambda kind: [nir.Delay(np.full(4, DT)), nir.Linear(np.eye(4))],
}


def network(primitive, kind):
    """Neurons of that kind behind what the primitive is part of, and before others of them."""
    former = FORMER.get(primitive, lambda kind: [nir.Linear(np.eye(4))])(kind)
    width = [1, 4, 4] if primitive.startswith("Conv") else 4
    last = [neurons(kind, 4), nir.Linear(np.eye(4)), neurons(kind, 4)]
    return chain(*former, *last, width=width, act=4)


READOUTS = ("LI", "CubaLI", "I")


def table():
    """Chip -> primitive -> the cell of the page."""
    page = (ROOT / "docs" / "nir.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("|")]
    (heads,) = [row[1:] for row in rows if row[0] == "chip"]
    return {
        name.strip("`"): dict(zip(heads, row[1:], strict=True))
        for row in rows
        if len(row) == len(heads) + 1 and row[0].startswith("`")
        for name in row[0].split(", ")
    }


def test_every_chip_is_in_the_table():
    assert set(table()) == set(CHIPS)


@pytest.mark.parametrize("name", CHIPS)
@pytest.mark.parametrize("primitive", ["IF", "LIF", "CubaLIF", *FORMER])
def test_a_chip_has_what_the_page_says(name, primitive):
    cells, on = table()[name], chip(name)
    # what is no neuron is tried with neurons that the chip has
    kind = primitive if primitive in ("IF", "LIF") else "IF" if cells["IF"] == "yes" else "LIF"
    kind = "CubaLIF" if primitive == "CubaLIF" else kind
    artifact = Artifact(network(primitive, kind), None, Convention(DT, on.resets[0]))
    if cells[primitive] == "yes":
        assert compile_program(artifact, on).layers
    else:
        with pytest.raises(RuleError, match=f"^rule {cells[primitive]}: "):
            compile_program(artifact, on)


@pytest.mark.parametrize("name", CHIPS)
@pytest.mark.parametrize("primitive", READOUTS)
def test_a_chip_reads_what_the_page_says(name, primitive):
    cell, on = table()[name][primitive], chip(name)
    kind = "IF" if table()[name]["IF"] == "yes" else "LIF"
    nodes = [nir.Linear(np.eye(4)), neurons(kind, 4), nir.Linear(np.eye(4)), readout(primitive)]
    artifact = Artifact(chain(*nodes, width=4, act=4), None, Convention(DT, on.resets[0]))
    if cell in ("yes", "host"):
        program = compile_program(artifact, on)
        assert [layer.name for layer in program.host] == (["n4"] if cell == "host" else [])
        assert check(artifact, on).passed
    else:
        with pytest.raises(RuleError, match=f"^rule {cell}: "):
            compile_program(artifact, on)


@pytest.mark.parametrize("name", ["loihi1", "loihi1:membrane_output=none"])
def test_readouts_take_cores_where_they_are_on_the_chip(name):
    nodes = [nir.Linear(np.eye(4)), neurons("LIF", 4), nir.Linear(np.eye(4)), readout("LI")]
    artifact = Artifact(chain(*nodes, width=4, act=4), None, Convention(DT, "zero"))
    found = check(artifact, chip(name))
    here = "none" not in name
    assert [p.name for p in found.mapping.placements] == ["input", "n2", "n4"][: 2 + here]
    assert {r.node for r in found.results_of("fan-in") if r.found} == (
        {"n2", "n4"} if here else {"n2"}
    )
    (compiled,) = found.results_of("compile")
    assert ("the host integrates it" in compiled.note) != here
