"""The line-up of a comparison: which policies, on which chips, against which references."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from spikedeploy import envs, zoo
from spikedeploy.policies.registry import FLOAT, Candidate, find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.setup import DEFAULT, Setup

# of the shipped policies, in table order: the more a control sees and can compute, the later
_CONTROLS = ("phase", "bilinear", "fourier", "linear", "mlp-8", "mlp-16", "mlp-32", "mlp-64",
             "pruned", "small")  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """One row of a comparison, before it is played.

    candidate: the policy
    chip: a chip, "float" for the float twin of a spiking policy, None for what does not spike
    reference: the entry it is measured against: the float ANN; on a chip its float twin
    setup: setup of the evaluation, which all entries of a comparison share
    """

    candidate: Candidate
    chip: str | None = None
    reference: "Entry | None" = None
    setup: Setup = DEFAULT

    @property
    def label(self) -> str:
        """The name in tables: `popsan · loihi1`."""
        if self.chip is None:
            return self.candidate.name
        remarks = "" if self.limits else ", limits off"
        faulty = ", faulty" if self.on_chip and self.setup.faults else ""
        return f"{self.candidate.name} · {self.chip}{remarks}{faulty}"

    @property
    def on_chip(self) -> bool:
        """True where a chip is emulated."""
        return self.chip not in (None, FLOAT)

    @property
    def limits(self) -> bool:
        """True if the design rules of its chip were enforced."""
        return self.setup.limits == "on" or not self.on_chip

    @property
    def references(self) -> list["Entry"]:
        """Its reference, that one's reference, and so on up to the float ANN."""
        return [] if self.reference is None else [self.reference, *self.reference.references]

    @property
    def rank(self) -> int:
        """The number of entries that must be played before it."""
        return len(self.references)


def line_up(
    env: str,
    files: Sequence[str],
    chips: Sequence[str] | None,
    teacher: Candidate | None = None,
    setup: Setup = DEFAULT,
) -> list[Entry]:
    """Float ANNs, float SNNs, each SNN on each chip, built-in players and the shipped controls.

    env: short name or id of the environment
    files: policies to compare; none stands for the shipped ones of the environment
    chips: for those that spike; None stands for that which each was trained for, or the default
    teacher: a row beside the files; one that is a network is the float ANN
    setup: setup of all entries
    """
    spec = envs.spec(env)
    short = spec.short
    shipped = [find(str(path)) for path in zoo.policies(short)]
    chosen = [find(file) for file in files] or shipped
    if teacher is not None:
        chosen = [teacher, *(candidate for candidate in chosen if candidate != teacher)]
    if not chosen:
        how = f"train {short} --recipe ppo-snn" if spec.foreign else "train"
        raise ConfigError(
            f"no policies are shipped for {short} yet: name files or run folders, or train one "
            f"with `spikedeploy {how}`"
        )
    chosen = _distinct(chosen)
    networks = _of_kind("ann", chosen) or _of_kind("ann", shipped)
    ann = Entry(networks[0], setup=setup) if networks else None
    entries = [ann] if ann else []
    entries += [Entry(candidate, None, ann, setup) for candidate in networks[1:]]
    for candidate in _of_kind("snn", chosen):
        exported = candidate.format == ".nir"  # a run folder is torch, which no chip runs
        on = ([candidate.default_chip] if chips is None else chips) if exported else ()
        entries += _on_chips(candidate, on, ann, setup)
    controls = [find(name) for name in spec.controls]
    order = {name: place for place, name in enumerate(_CONTROLS)}
    others = dict.fromkeys(_of_kind("control", [*chosen, *shipped]))
    ranked = sorted(others, key=lambda control: order.get(control.name, len(order)))
    controls += [each for each in ranked if each not in controls]
    # what looks at no observation has no actions for those of others
    return entries + [
        Entry(each, None, None if each.format == "expert" else ann, setup) for each in controls
    ]


def make_entries(candidate: Candidate, chip: str | None, setup: Setup = DEFAULT) -> list[Entry]:
    """A policy without baselines: one that spikes as its float twin and on the chip."""
    if candidate.kind != "snn":
        return [Entry(candidate, setup=setup)]
    return _on_chips(candidate, (chip,), None, setup)


def _on_chips(
    candidate: Candidate, chips: Sequence[str | None], ann: Entry | None, setup: Setup
) -> list[Entry]:
    """A spiking policy in float and on chips.

    One that was trained in a chip's integers has no float twin: its file read in float is another
    network.
    """
    twin = None if candidate.chip else Entry(candidate, FLOAT, ann, setup)
    rows = [Entry(candidate, chip, twin or ann, setup) for chip in chips]
    return rows if twin is None else [twin, *rows]


def _of_kind(kind: str, candidates: Sequence[Candidate]) -> list[Candidate]:
    return [candidate for candidate in candidates if candidate.kind == kind]


def _distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, with the folder in the name where names would be equal."""
    names = [candidate.name for candidate in candidates]
    return [
        replace(candidate, name=f"{Path(candidate.path).parent.name}/{candidate.name}")
        if names.count(candidate.name) > 1
        else candidate
        for candidate in candidates
    ]


def remark_on_chip(entry: Entry) -> str:
    """The remark on a policy on another chip than it was trained for; empty on its own."""
    trained = entry.candidate.chip
    if trained is None or entry.chip in (None, trained) or trained == entry.chip.split(":")[0]:
        return ""
    return f"{entry.candidate.name} was trained for {trained}, and runs on {entry.chip} here"
