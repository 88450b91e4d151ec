"""The check: what every design rule of a chip says of a network, the compiler included."""

from dataclasses import dataclass

from runtime.artifact import Artifact
from runtime.chip import Chip
from runtime.compile import compile
from runtime.design import design
from runtime.errors import SpikedeployError
from runtime.limits import Limits
from runtime.mapping import Mapping
from runtime.rules import judged
from runtime.ruling import Ruling

COMPILE = "compile"
NONE = Limits(primitives=(), sources={})


@dataclass(frozen=True, eq=False)
class Check:
    """A network on one chip.

    chip: its datasheet.
    rulings: of every rule on every node, then on the network, and the compiler's last.
    mapping: onto its cores.
    """

    chip: Chip
    rulings: tuple[Ruling, ...]
    mapping: Mapping

    @property
    def passed(self) -> bool:
        """Whether no rule is broken; what is unknown breaks none."""
        return not any(ruling.failed for ruling in self.rulings)

    def of(self, rule: str) -> list[Ruling]:
        """The rulings of one rule."""
        return [ruling for ruling in self.rulings if ruling.rule == rule]


def check(artifact: Artifact, on: Chip) -> Check:
    """Judge the artifact by every rule of the chip."""
    plan = design(artifact, on, on.limits or NONE)
    rulings = judged(plan) if on.limits is not None else []
    broken = any(ruling.failed for ruling in rulings)
    return Check(on, (*rulings, _compiled(artifact, on, not broken)), plan.mapping)


def _compiled(artifact: Artifact, on: Chip, limits: bool) -> Ruling:
    """What the compiler says; without limits where rules have said already what breaks them."""
    try:
        compile(artifact, on, limits=limits)
    except SpikedeployError as error:
        return Ruling(COMPILE, None, "fail", str(error))
    return Ruling(COMPILE, None, "pass", "a program")
