"""A network file against the design rules of chips: whether it fits, and if not, why not."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from spikedeploy import zoo
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import CHIPS, chip, split_names
from spikedeploy.runtime.compiler.compile import COMPILE, DesignCheck
from spikedeploy.runtime.compiler.compile import check as check_on
from spikedeploy.runtime.compiler.mapping import mapping_utilisation, placement_utilisation
from spikedeploy.runtime.compiler.rules import RULES, RuleResult, Status
from spikedeploy.runtime.errors import ConfigError, ConventionError

ALL = "all"
# statuses of a rule on several nodes: the first of these that occurs counts
_ORDER: tuple[Status, ...] = ("fail", "pass", "unknown", "not applicable")


@dataclass(frozen=True)
class DesignReport:
    """A network on several chips.

    file      as the user named it
    artifact  the network and its convention
    checks    one for each chip
    any_does  whether one chip that passes is enough, as for "all"
    resets    chip that lacks its reset, and nothing else -> the reset with which it passes
    """

    file: str
    artifact: Artifact
    checks: Sequence[DesignCheck]
    any_does: bool
    resets: Mapping[str, str] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """True if all named chips pass; of "all", at least one that has limits."""
        if self.any_does:
            return any(each.passed for each in self.checks if each.chip.limits is not None)
        return all(each.passed for each in self.checks)

    def as_json(self) -> dict[str, Any]:
        """Every rule result and mapping, as plain data."""
        return {
            "file": self.file,
            "convention": self.artifact.convention.to_record(),
            "passed": self.passed,
            "chips": [
                {**_chip(each), "fits_with_reset": self.resets.get(each.chip.name)}
                for each in self.checks
            ],
        }


def design_report(reference: str, chips: Sequence[str], **convention: Any) -> DesignReport:  # noqa: ANN401
    """The design rules of chips on a file.

    reference   a .nir file, or the name of a shipped policy that spikes
    chips       names, each also several with commas between them, or "all"
    convention  options of artifact.load; they take precedence over the file
    """
    return report_of(reference, load(network_path(reference), **convention), chips)


def report_of(reference: str, artifact: Artifact, chips: Sequence[str]) -> DesignReport:
    """The design rules of chips on a network that was read from a file."""
    named = [name for text in chips for name in split_names(text)]
    if not named:
        raise ConfigError("--chip names none. Name a chip, or all.")
    names = tuple(CHIPS) if ALL in named else tuple(dict.fromkeys(named))
    # with its options, in which two chips of a report may differ
    checks = [check_on(artifact, replace(chip(name), name=name)) for name in names]
    resets = {each.chip.name: _fitting_reset(artifact, each) for each in checks}
    found = {name: reset for name, reset in resets.items() if reset is not None}
    return DesignReport(reference, artifact, checks, ALL in named, found)


def _fitting_reset(artifact: Artifact, found: DesignCheck) -> str | None:
    """The reset with which the network would pass, where it lacks no more than that.

    None for a policy that was trained in the integers of a chip: with another reset it is another.
    """
    broken = {ruling.rule for ruling in found.rulings if ruling.failed}
    if artifact.trained_for or "reset" not in broken or broken - {"reset", COMPILE}:
        return None
    for reset in found.chip.resets:
        with suppress(ConventionError):  # several spikes of a timestep, which are subtracted
            convention = artifact.convention.with_options({"reset": reset})
            if check_on(replace(artifact, convention=convention), found.chip).passed:
                return reset
    return None


def statuses(found: DesignCheck) -> dict[str, Status]:
    """Rule -> its worst status; rules without a result on this chip are not applicable."""
    return {rule: worst(found.of(rule)).status for rule in (*RULES, COMPILE)}


def worst(rulings: Sequence[RuleResult]) -> RuleResult:
    """The first failure, else the pass with the largest count, else unknown, or not applicable."""

    def rank(ruling: RuleResult) -> tuple[int, float]:
        found = ruling.found if isinstance(ruling.found, int | float) else 0.0
        return _ORDER.index(ruling.status), 0.0 if ruling.failed else -found

    return min(rulings, key=rank, default=RuleResult("", None, "not applicable"))


def network_path(reference: str) -> Path:
    """The .nir file at a path, or of a shipped policy."""
    path = zoo.resolve(reference)
    if path is None:
        raise ConfigError(
            f"no network at {reference!r}: no such file or shipped policy; `spikedeploy policies` "
            "lists what is shipped"
        )
    if path.suffix == ".onnx":
        raise ConfigError(f"{reference} does not spike, so no chip runs it: name a .nir file")
    return path


def _chip(found: DesignCheck) -> dict[str, Any]:
    limits, program = found.chip.limits, found.program
    placements = [
        {
            **asdict(placement),
            "utilisation": limits and asdict(placement_utilisation(placement, limits)),
        }
        for placement in found.mapping.placements
    ]
    return {
        "chip": found.chip.name,
        "passed": found.passed,
        "membrane_output": found.chip.membrane_output,
        "clock": program and program.clock,
        "clock_assumed": program and program.assumed_clock,
        "timesteps_more": program and program.fill,
        "timesteps_late": program and program.trailing,
        "rules": statuses(found),
        "rulings": [ruling.as_json() for ruling in found.rulings],
        "mapping": {
            "cores": found.mapping.cores,
            "chips": found.mapping.chips,
            "utilisation": limits and asdict(mapping_utilisation(found.mapping, limits)),
            "layers": placements,
        },
        "limits": limits and asdict(limits),
    }
