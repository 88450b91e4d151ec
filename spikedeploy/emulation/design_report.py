"""A network file against the design rules of chips: whether it fits, and if not, why not."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy import zoo
from spikedeploy.emulation.rasters import Raster, in_batch, read_inputs
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import CHIPS, chip, split_names
from spikedeploy.runtime.compiler.compile import COMPILE, DesignCheck
from spikedeploy.runtime.compiler.compile import check as check_on
from spikedeploy.runtime.compiler.mapping import mapping_utilisation, placement_utilisation
from spikedeploy.runtime.compiler.rules import RULES, RuleResult, Status
from spikedeploy.runtime.errors import ConfigError, ConventionError, SpikedeployError
from spikedeploy.runtime.files import suffix
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import by_port, ports

ALL = "all"
# of random input, where none is given: timesteps at each of these rates
_TIMESTEPS, _RATES = 100, (0.1, 0.3, 0.5, 0.9)
_DRAWN = "random spikes, 100 timesteps at each of the rates 0.1, 0.3, 0.5 and 0.9"
_SAME = 1e-4  # of membranes that are put out, beside their largest
# statuses of a rule on several nodes: the first of these that occurs counts
_ORDER: tuple[Status, ...] = ("fail", "pass", "unknown", "not applicable")


@dataclass(frozen=True)
class OtherReset:
    """The reset with which a network would fit on a chip: as a rule, another network.

    reset    as Convention has it
    typed    options that read the file so, as they are typed
    changed  of its outputs, numbers that differ from those of the network as it was read; in float
    outputs  numbers that were compared
    source   of the input, in words; empty where nothing came out, so that nothing was compared
    """

    reset: str
    typed: str
    changed: int
    outputs: int
    source: str

    def describe(self) -> str:
        """`With --reset zero: fits. 180 of 1,200 outputs differ then, in float, on …`."""
        if not self.source:
            found = "Not measured: random input causes no output spike; give some with --input"
        elif self.changed:
            share = (
                f"{self.changed:,} of {self.outputs:,} outputs ({self.changed / self.outputs:.0%})"
            )
            found = f"Another network: {share} differ in float, on {self.source}"
        else:
            found = f"None of {self.outputs:,} outputs differs in float, on {self.source}"
        return f"With {self.typed}: fits. {found}."


@dataclass(frozen=True)
class DesignReport:
    """A network on several chips.

    file      as the user named it
    artifact  the network and its convention
    checks    one for each chip
    any_does  whether one chip that passes is enough, as for "all"
    resets    chip that lacks the network's reset, and nothing else -> one with which it passes
    """

    file: str
    artifact: Artifact
    checks: Sequence[DesignCheck]
    any_does: bool
    resets: Mapping[str, OtherReset] = field(default_factory=dict)

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
            broken = [ruling for ruling in each.rulings if ruling.failed]
            lines.append(f"{'✗' if broken else '✓'} {each.chip.name}")
            lines += [f"  {ruling.describe(each.chip.name)}" for ruling in broken]
        return "\n".join(lines)

    def as_json(self) -> dict[str, Any]:
        """Every rule result and mapping, as plain data."""
        return {
            "file": self.file,
            "convention": self.artifact.convention.to_record(),
            "passed": self.passed,
            "chips": [{**_chip(each), **self._other_reset(each)} for each in self.checks],
        }

    def _other_reset(self, check: DesignCheck) -> dict[str, Any]:
        other = self.resets.get(check.chip.name)
        return {
            "fits_with_reset": other and other.reset,
            "fits_with": other and {**asdict(other), "meaning": other.describe()},
        }


def design_report(
    reference: str,
    chips: Sequence[str],
    raster: Path | None = None,
    **convention: Any,  # noqa: ANN401
) -> DesignReport:
    """The design rules of chips on a file.

    reference   a .nir file, or the name of a shipped policy that spikes
    chips       names, each also several with commas between them, or "all"
    raster      input on which it is counted what another reset changes; None draws some
    convention  options of artifact.load; they take precedence over the file
    """
    path = network_path(reference)
    return report_of(reference, load(path, **convention), chips, path, convention, raster)


def report_of(
    reference: str,
    artifact: Artifact,
    chips: Sequence[str],
    path: Path,
    convention: Mapping[str, Any],
    raster: Path | None = None,
) -> DesignReport:
    """The design rules of chips on a network that was read from a file.

    path, convention  from which and by which options it was read
    """
    named = [name for text in chips for name in split_names(text)]
    if not named:
        raise ConfigError("--chip names none. Name a chip, or all.")
    names = tuple(CHIPS) if ALL in named else tuple(dict.fromkeys(named))
    # with its options, in which two chips of a report may differ
    checks = [check_on(artifact, replace(chip(name), name=name)) for name in names]
    resets = {each.chip.name: _fitting_reset(artifact, each) for each in checks}
    found = {
        reset: other_reset(artifact, reset, path, convention, raster)
        for reset in dict.fromkeys(resets.values())
        if reset is not None
    }
    others = {name: found[reset] for name, reset in resets.items() if reset is not None}
    return DesignReport(reference, artifact, checks, ALL in named, others)


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


def other_reset(
    artifact: Artifact,
    reset: str,
    path: Path,
    convention: Mapping[str, Any],
    raster: Path | None = None,
) -> OtherReset:
    """What another reset changes of the outputs, in float, on a raster or on random spikes."""
    other = replace(artifact, convention=artifact.convention.with_options({"reset": reset}))
    typed = _typed(reset, path, convention)
    if raster is not None:
        rows = by_port(ports(artifact.graph.inputs), in_batch(read_inputs(raster, artifact)))
        return OtherReset(reset, typed, *_changes(artifact, other, rows)[:2], str(raster))
    changed, outputs, is_silent = _changes(artifact, other, _random(artifact))
    return OtherReset(reset, typed, changed, outputs, "" if is_silent else _DRAWN)


def _typed(reset: str, path: Path, convention: Mapping[str, Any]) -> str:
    """The options by which a file is read with this reset, as they are typed.

    A tool may call another reset so, as snnTorch's `subtract`; then the file is read without it.
    """
    given = {name: value for name, value in convention.items() if value is not None}
    alone = {name: value for name, value in given.items() if name != "reset"}
    for words, options in ((f"--reset {reset}", {**given, "reset": reset}), ("no --reset", alone)):
        with suppress(SpikedeployError):
            if load(path, **options).convention.reset == reset:
                return words
    return f"--dt {load(path, **given).convention.dt:g} --reset {reset}, without --from"


def _random(artifact: Artifact) -> dict[str, Raster]:
    """Independent spikes (B, T, *shape) at each of the rates, for each Input."""
    codec, rng = artifact.codec, np.random.default_rng(0)
    timesteps = _TIMESTEPS if codec is None else min(codec.timesteps, _TIMESTEPS)
    batch = -(-_TIMESTEPS // timesteps)
    return {
        port.name: np.concatenate(
            [rng.random((batch, timesteps, *port.shape)) < rate for rate in _RATES]
        ).astype(np.uint8)
        for port in ports(artifact.graph.inputs)
    }


def _changes(one: Artifact, other: Artifact, rows: Mapping[str, Raster]) -> tuple[int, int, bool]:
    """Outputs that differ, all that were compared, and whether nothing came out of either."""
    first, second = (_outputs(each, rows) for each in (one, other))
    spiking = all(np.array_equal(each, np.rint(each)) for each in (first, second))
    tolerance = 0.0 if spiking else _SAME * float(np.abs(first).max())
    changed = int((np.abs(first - second) > tolerance).sum())
    return changed, first.size, not (first.any() or second.any())


def _outputs(artifact: Artifact, rows: Mapping[str, Raster]) -> NDArray[np.float64]:
    """Every number that the float twin puts out, in a row."""
    graph = FloatGraph(artifact)
    trace = graph.run(rows)
    names = [port.name for port in graph.outputs]
    found = [trace[name] for name in (names if len(names) > 1 else ["output"])]
    return np.concatenate([each.astype(np.float64).ravel() for each in found])


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
    if suffix(path) == ".onnx":
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
