"""The check: what every design rule of a chip says of a network, the compiler included."""

from dataclasses import dataclass

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.limits import Limits
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.design_rules.mapping import CoreMapping
from spikedeploy.runtime.design_rules.rule import RuleResult, design
from spikedeploy.runtime.design_rules.table import judged
from spikedeploy.runtime.errors import SpikedeployError

COMPILE = "compile"
NONE = Limits(primitives=(), sources={})


@dataclass(frozen=True, eq=False)
class DesignCheck:
    """A network on one chip.

    chip: its datasheet.
    rulings: of every rule on every node, then on the network, and the compiler's last.
    mapping: onto its cores.
    """

    chip: Chip
    rulings: tuple[RuleResult, ...]
    mapping: CoreMapping

    @property
    def passed(self) -> bool:
        """Whether no rule is broken; what is unknown breaks none."""
        return not any(ruling.failed for ruling in self.rulings)

    def of(self, rule: str) -> list[RuleResult]:
        """The rulings of one rule."""
        return [ruling for ruling in self.rulings if ruling.rule == rule]


def check(artifact: Artifact, on: Chip) -> DesignCheck:
    """Judge the artifact by every rule of the chip."""
    plan = design(artifact, on, on.limits or NONE)
    rulings = judged(plan) if on.limits is not None else []
    broken = any(ruling.failed for ruling in rulings)
    return DesignCheck(on, (*rulings, _compiled(artifact, on, not broken)), plan.mapping)


def _compiled(artifact: Artifact, on: Chip, limits: bool) -> RuleResult:
    """What the compiler says; without limits where rules have said already what breaks them."""
    try:
        compile_program(artifact, on, limits=limits)
    except SpikedeployError as error:
        return RuleResult(COMPILE, None, "fail", str(error))
    return RuleResult(COMPILE, None, "pass", "a program")
