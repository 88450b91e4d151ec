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
from spikedeploy.runtime.compiler.lowering import lower
from spikedeploy.runtime.compiler.mapping import mapping_utilisation, placement_utilisation
from spikedeploy.runtime.errors import ConfigError, ConventionError, SpikedeployError
from spikedeploy.runtime.files import suffix

ALL = "all"


@dataclass(frozen=True)
class DesignReport:
    """A network on several chips.

    file: as the user named it.
    artifact: the network and its convention.
    checks: one for each chip.
    any_does: whether one chip that passes is enough, as for "all".
    resets: chip that lacks the network's reset, and nothing else -> the reset with which it passes,
        and the options that read the file so, as they are typed. It is another network then.
    """

    file: str
    artifact: Artifact
    checks: Sequence[DesignCheck]
    any_does: bool
    resets: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """True if all named chips pass; of "all", at least one that has limits."""
        if self.any_does:
            return any(each.passed for each in self.checks if each.chip.limits is not None)
        return all(each.passed for each in self.checks)

    def __str__(self) -> str:
        """The verdicts, a line for each chip, and the rules that are broken."""
        lines = [f"{self.file}: {self.artifact.convention.describe()}"]
        for each in self.checks:
            broken = [result for result in each.results if result.failed]
            lines.append(f"{'✗' if broken else '✓'} {each.chip.name}")
            lines += [f"  {result.describe(each.chip.name)}" for result in broken]
        return "\n".join(lines)

    def as_json(self) -> dict[str, Any]:
        """Every rule result and mapping, as plain data."""
        return {
            "file": self.file,
            "convention": self.artifact.convention.to_record(),
            "passed": self.passed,
            "chips": [
                {**_chip(each), "fits_with_reset": self.resets.get(each.chip.name, (None,))[0]}
                for each in self.checks
            ],
        }


def report_of(
    reference: str,
    artifact: Artifact,
    chips: Sequence[str],
    path: Path,
    reading: Mapping[str, Any],
) -> DesignReport:
    """The design rules of chips on a network that was read from a file.

    chips: names, each also several with commas between them, or "all".
    path, reading: from which and by which options of `load` it was read.
    """
    named = [name for text in chips for name in split_names(text)]
    if not named:
        raise ConfigError("--chip names none. Name a chip, or all.")
    names = tuple(CHIPS) if ALL in named else tuple(dict.fromkeys(named))
    lowered = lower(artifact)
    # with its options, in which two chips of a report may differ
    checks = [check_on(artifact, replace(chip(name), name=name), lowered) for name in names]
    resets = {each.chip.name: _fitting_reset(artifact, each) for each in checks}
    typed = {reset: _typed(reset, path, reading) for reset in {*resets.values()} if reset}
    others = {name: (reset, typed[reset]) for name, reset in resets.items() if reset}
    return DesignReport(reference, artifact, checks, ALL in named, others)


def _fitting_reset(artifact: Artifact, found: DesignCheck) -> str | None:
    """The reset with which the network would pass, where it lacks no more than that.

    None for a policy that was trained in the integers of a chip: with another reset it is another.
    """
    broken = {result.rule for result in found.results if result.failed}
    if artifact.trained_for or "reset" not in broken or broken - {"reset", COMPILE}:
        return None
    for reset in found.chip.resets:
        with suppress(ConventionError):  # several spikes of a timestep, which are subtracted
            convention = artifact.convention.with_options({"reset": reset})
            if check_on(replace(artifact, convention=convention), found.chip).passed:
                return reset
    return None


def _typed(reset: str, path: Path, reading: Mapping[str, Any]) -> str:
    """The options by which a file is read with this reset, as they are typed.

    A tool may call another reset so, as snnTorch's `subtract`; then the file is read without it.
    """
    given = {name: value for name, value in reading.items() if value is not None}
    alone = {name: value for name, value in given.items() if name != "reset"}
    for words, options in ((f"--reset {reset}", {**given, "reset": reset}), ("no --reset", alone)):
        with suppress(SpikedeployError):
            if load(path, **options).convention.reset == reset:
                return words
    return f"--dt {load(path, **given).convention.dt:g} --reset {reset}, without --from"


def network_path(reference: str) -> Path:
    """The .nir file at a path, or of a shipped policy."""
    path = zoo.resolve(reference)
    if path is None:
        raise ConfigError(
            f"no network at {reference!r}: no such file or shipped policy; `spikedeploy policies` "
            "lists what is shipped"
        )
    if suffix(path) == ".onnx":
        raise ConfigError(f"{reference} does not spike, so no chip runs it: name a .nir file")
    return path


def _chip(found: DesignCheck) -> dict[str, Any]:
    limits, program = found.chip.limits, found.program
    placements = found.mapping.placements
    layers = [
        {**asdict(each), "utilisation": limits and placement_utilisation(each, limits)}
        for each in placements
    ]
    return {
        "chip": found.chip.name,
        "passed": found.passed,
        "membrane_output": found.chip.membrane_output,
        "clock": program and program.clock,
        "clock_assumed": program and program.assumed_clock,
        "timesteps_more": program and program.fill,
        "timesteps_late": program and program.trailing,
        "rules": {rule: result.status for rule, result in found.worst.items()},
        "rulings": [result.as_json() for result in found.results],
        "mapping": {
            "cores": found.mapping.cores,
            "chips": found.mapping.chips,
            "utilisation": limits and mapping_utilisation(placements, limits),
            "layers": layers,
        },
        "limits": limits and asdict(limits),
    }
