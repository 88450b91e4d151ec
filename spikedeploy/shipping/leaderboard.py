"""Rows of the public table of closed-loop spiking policies: their schema, made and checked.

A row is one JSON file. It is made of a report of `compare`, whose numbers it repeats, or written by
hand from a publication. What is not known is null: nothing is filled in.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from spikedeploy import envs, zoo
from spikedeploy.comparison.comparison import static
from spikedeploy.comparison.statistics import nested_ratio
from spikedeploy.comparison.summary import smallest_baseline
from spikedeploy.reports.headline import ann_row, main_row
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.runtime.files import read_json, suffix, write_json
from spikedeploy.runtime.metrics.energy import TABLES, chip_terms
from spikedeploy.runtime.schema import validate

Data = Mapping[str, Any]
FORMAT = 1
FEWEST_FOR_RISK = 20  # episodes below which NeuroBench's RewardScore has no risk
_EQUAL = 1e-6  # relative: numbers of a row that follow from one another
# of a row, what a report does not decide: whoever sends it may write it
_OF_THE_SENDER = (
    "source", "link", "read", "note", "over_trainings", "without_hidden", "evidence.reproduce",
)  # fmt: skip

Count = Annotated[FiniteFloat, Field(ge=0)]
Whole = Annotated[int, Field(ge=0, lt=2**63)]
Some = Annotated[int, Field(ge=1, lt=2**63)]
Share = Annotated[FiniteFloat, Field(ge=0, le=1)]
Interval = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Text = Annotated[str, Field(max_length=2000)]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Energy(_Entry):
    """Energy of a control step by one price table, or as it was measured."""

    prices: Name = Field(description="price table of `spikedeploy energy`, or how it was measured")
    dynamic_j: Count | None = Field(
        None, description="all terms that have a price, without static power [J]"
    )
    with_static_j: Count | None = Field(None, description="the same with static power [J]")
    static_power: Name | None = Field(None, description="measurement of the static power")
    terms_j: dict[str, FiniteFloat] = Field({}, description="term of `dynamic_j` -> energy [J]")
    unpriced: list[str] = Field([], description="terms that happen and have no price")


class PolicyEntry(_Entry):
    """One policy: what it earns, and what a control step of it takes."""

    name: Name = Field(description="as its authors call it")
    return_mean: FiniteFloat | None = Field(None, description="mean return of the episodes")
    return_ci95: Interval | None = Field(None, description="its 95 % interval, over episodes")
    share: FiniteFloat | None = Field(None, description="return_mean over that of the reference")
    share_ci95: Interval | None = Field(None, description="its 95 % interval")
    success_rate: Share | None = Field(None, description="share of the episodes that succeed")
    failure_rate: Share | None = Field(
        None, description="share that a terminal state other than success ended: a fall, a crash"
    )
    risk: FiniteFloat | None = Field(
        None, description="mean return of the worst 5 %; null for fewer than 20 episodes"
    )
    training_seeds: Some | None = Field(None, description="trainings that the numbers are of")
    sops: Count | None = Field(None, description="synaptic operations of a control step")
    effective_acs: Count | None = Field(None, description="accumulates, input not 0")
    effective_macs: Count | None = Field(None, description="multiply-accumulates, input not 0")
    macs_dense: Count | None = Field(None, description="multiply-accumulates, zeros included")
    neuron_updates: Count | None = Field(None, description="neuron updates of a control step")
    encoder: Name | None = Field(None, description="observation to spikes: how, and where")
    energy: list[Energy] = Field([], description="one for each price table")


class OverTrainings(_Entry):
    """The same recipe, trained several times."""

    training_seeds: Some = Field(description="trainings")
    episodes: Some = Field(description="episodes of each")
    first_seed: Whole = Field(description="seed of the first episode")
    share: FiniteFloat = Field(description="mean return over that of the reference")
    share_ci95: Interval = Field(description="its 95 % interval, over trainings and episodes")
    share_t95: Interval | None = Field(
        None, description="that of Student's t over the trainings; null of one training"
    )
    success_rate: Share | None = Field(None, description="share of all episodes that succeed")
    failure_rate: Share | None = Field(None, description="share of all episodes that ended early")
    worst_share: FiniteFloat | None = Field(
        None, description="mean return of the worst 5 % of all, over the reference's mean"
    )
    reference_success_rate: Share | None = Field(
        None, description="that of the reference in the same episodes"
    )
    source: Name = Field(description="file and row")


class SynapticOperations(_Entry):
    """NeuroBench's SynapticOperations, of an inference."""

    effective_macs: Count | None = Field(None, alias="Effective_MACs", description="as above")
    effective_acs: Count | None = Field(None, alias="Effective_ACs", description="as above")
    dense: Count | None = Field(None, alias="Dense", description="zeros included")


class RewardScore(_Entry):
    """NeuroBench's RewardScore (branch 2025_GC)."""

    avg: FiniteFloat = Field(description="mean return")
    std: Count = Field(description="standard deviation of the returns, divided by n")
    risk: FiniteFloat | None = Field(
        description="mean of the lowest 5 %; null for fewer than 20 episodes"
    )


class NeuroBenchEntry(_Entry):
    """The same numbers by NeuroBench's names (docs/metrics.md has the formulas)."""

    footprint: Count | None = Field(None, alias="Footprint", description="memory [bytes]")
    connection_sparsity: Share | None = Field(
        None, alias="ConnectionSparsity", description="weights that are 0"
    )
    activation_sparsity: Share | None = Field(
        None, alias="ActivationSparsity", description="neurons and timesteps without a spike"
    )
    synaptic_operations: SynapticOperations | None = Field(
        None, alias="SynapticOperations", description="three counts"
    )
    reward_score: RewardScore | None = Field(None, alias="RewardScore", description="of returns")


class Evidence(_Entry):
    """Where the numbers of a row can be made again from."""

    command: Text = Field(description="command that gives these numbers")
    reproduce: Text = Field(description="command that plays it again and compares every number")
    first_seed: Whole = Field(description="seed of the first evaluation episode")
    sha256: dict[str, Sha256] = Field(description="policy file -> hash")
    versions: dict[str, str | None] = Field(description="package -> version of the evaluation")
    created: str | None = Field(None, description="when")


class LeaderboardRow(_Entry):
    """A row of the table, a file of results/leaderboard/."""

    format: Literal[1] = Field(description="of this schema")
    task: Name = Field(description="id of the environment")
    chip: Name | None = Field(None, description="chip, emulated if the row has evidence")
    reference: Name | None = Field(None, description="float policy whose return is 100 %")
    reference_success_rate: Share | None = Field(
        None, description="share of the reference's episodes that succeed"
    )
    episodes: Some | None = Field(None, description="evaluation episodes")
    spiking: PolicyEntry = Field(description="the spiking policy")
    rival: PolicyEntry | None = Field(None, description="the float policy beside it")
    over_trainings: OverTrainings | None = Field(None, description="the recipe, trained again")
    neurobench: NeuroBenchEntry | None = Field(None, description="of the spiking policy")
    without_hidden: FiniteFloat | None = Field(
        None, description="share of its return with all hidden neurons dead; null: not tried"
    )
    source: Name = Field(description="paper and table, or whose row it is")
    link: Name | None = Field(None, description="URL, arXiv number or DOI")
    read: Literal["paper", "abstract", "notes"] | None = Field(
        None, description="how much of a publication was read; notes: of a third party"
    )
    evidence: Evidence | None = Field(None, description="null of a publication")
    note: Text = Field("", description="what a reader has to know besides")


class _ComparedRow(BaseModel):
    """What a row is made of, in a row of a report."""

    policy: str
    kind: str
    chip: str | None
    file: str
    episodes: Some
    training_seeds: int | None
    return_mean: FiniteFloat
    return_std: FiniteFloat
    return_ci95: list[FiniteFloat]
    risk: FiniteFloat
    returns: Annotated[list[FiniteFloat], Field(min_length=1)]
    successes: list[bool]
    success_rate: FiniteFloat | None
    failure_rate: FiniteFloat | None = None
    sparsity: FiniteFloat | None
    sops_per_inference: FiniteFloat | None
    effective_acs: FiniteFloat | None
    effective_macs: FiniteFloat | None
    macs_dense: FiniteFloat | None
    neuron_updates_per_inference: FiniteFloat | None
    footprint: FiniteFloat | None
    connection_sparsity: FiniteFloat | None
    energy_terms_j: dict[str, dict[str, FiniteFloat]]
    energy_unknown: dict[str, list[str]]
    static_energy_j: dict[str, FiniteFloat]


def read_row(path: Path) -> LeaderboardRow:
    """The row in a file; ConfigError where it breaks the schema."""
    return validate(LeaderboardRow, read_json(path), path, "; docs/leaderboard.md has the schema")


def plain(row: LeaderboardRow) -> dict[str, Any]:
    """The row as plain data, NeuroBench's fields by their names."""
    return row.model_dump(by_alias=True)


def write_row(row: LeaderboardRow, path: Path) -> Path:
    """Write a row; return the path."""
    return write_json(path, plain(row))


# A row from a report.


def row_of_report(
    document: Data,
    report: str,
    policy: str | None = None,
    chip: str | None = None,
    rival: str | None = None,
    source: str = "not named",
) -> LeaderboardRow:
    """The row that a report of `compare` gives.

    report  folder or file of it, for the command that plays it again
    policy  spiking policy, by default the one that the report is about
    chip    on which, where it is there on several
    rival   float policy beside it, by default the smallest one that is not shown to be worse, and
            where all are, the best
    """
    rows: Sequence[Data] = document["rows"]
    remedy = "; `spikedeploy compare` of this version writes all that is needed"
    validate(list[_ComparedRow], rows, f"rows of {report}", remedy)
    spiking = _chosen(rows, policy, chip)
    beside = _named(rows, rival) if rival else _smallest(rows, spiking)
    files = {each["file"] for each in (spiking, beside, ann_row(rows)) if each}
    evidence = {
        "command": document["command"],
        "reproduce": f"spikedeploy reproduce {report}",
        "first_seed": document["seeds"]["first"],
        "sha256": {f: digest for f, digest in document.get("sha256", {}).items() if f in files},
        "versions": document.get("versions", {}),
        "created": document.get("created"),
    }
    disturbed = ", ".join(each["text"] for each in document.get("disturbances", ()))
    return row_of_rows(
        document.get("env_id", document["env"]), spiking, ann_row(rows), beside, evidence,
        {"source": source, "note": f"disturbed by {disturbed}" if disturbed else ""},
    )  # fmt: skip


def row_of_rows(
    task: str,
    spiking: Data,
    reference: Data | None,
    rival: Data | None,
    evidence: Data | None,
    more: Data,
) -> LeaderboardRow:
    """The row of rows of `Comparison.as_json`.

    reference  whose return is 100 %
    more       fields as they stand
    """
    row = {
        "format": FORMAT,
        "task": task,
        "chip": spiking["chip"],
        "reference": reference["policy"] if reference else None,
        "reference_success_rate": reference["success_rate"] if reference else None,
        "episodes": spiking["episodes"],
        "spiking": _policy(spiking, reference),
        "rival": _policy(rival, reference) if rival else None,
        "neurobench": _neurobench(spiking),
        "evidence": evidence,
        **more,
    }
    return validate(LeaderboardRow, row, "the row")


def _chosen(rows: Sequence[Data], policy: str | None, chip: str | None) -> Data:
    """The spiking row on a chip that is meant."""
    found = [
        row
        for row in rows
        if row["kind"] == "snn"
        and row["chip"] not in (None, "float")
        and policy in (None, row["policy"])
        and chip in (None, row["chip"])
    ]
    if not found:
        there = ", ".join(f"{row['policy']} on {row['chip']}" for row in rows if row["chip"])
        raise ConfigError(
            f"the report has no row of {policy or 'a spiking policy'} on {chip or 'a chip'}, which "
            f"the table is of; it has {there or 'none that spikes'}"
        )
    return found[0] if policy else main_row([*found, *(r for r in rows if r["kind"] != "snn")])


def _smallest(rows: Sequence[Data], spiking: Data) -> Data | None:
    trained = [row for row in rows if row["kind"] != "snn" and row["training_seeds"]]
    best = max(trained, key=lambda row: float(row["return_mean"]), default=None)
    return smallest_baseline(spiking, rows) or best


def _named(rows: Sequence[Data], name: str) -> Data:
    """The float row of a name."""
    floats = {row["policy"]: row for row in rows if row["kind"] != "snn"}
    if name not in floats:
        raise ConfigError(f"the report has no float policy {name!r}: {', '.join(floats) or 'none'}")
    return floats[name]


def _policy(row: Data, reference: Data | None) -> dict[str, Any]:
    """A policy's part; of several measurements of static power the least."""
    spikes, powers = row["kind"] == "snn", row["static_energy_j"]
    power = min(powers, key=powers.__getitem__, default=None)
    return {
        "name": row["policy"],
        "return_mean": row["return_mean"],
        "return_ci95": list(row["return_ci95"]),
        **_share(row, reference),
        "success_rate": row["success_rate"],
        "failure_rate": row.get("failure_rate"),
        "risk": _risk(row),
        "training_seeds": row["training_seeds"],
        "sops": row["sops_per_inference"],
        "effective_acs": row["effective_acs"] if spikes else None,
        "effective_macs": row["effective_macs"],
        "macs_dense": row["macs_dense"],
        "neuron_updates": row["neuron_updates_per_inference"],
        "encoder": _encoder(row["file"]) if spikes else None,
        "energy": [
            {
                "prices": table,
                "dynamic_j": sum(terms.values()),
                "with_static_j": sum(terms.values()) + powers[power] if power else None,
                "static_power": power,
                "terms_j": terms,
                "unpriced": list(row["energy_unknown"].get(table, ())),
            }
            for table, terms in row["energy_terms_j"].items()
        ],
    }


def _risk(row: Data) -> float | None:
    """The mean return of the worst 5 %; None of too few episodes."""
    return row["risk"] if len(row["returns"]) >= FEWEST_FOR_RISK else None


def _share(row: Data, reference: Data | None) -> dict[str, Any]:
    """The share of the reference's return in the same episodes; of one above 0 alone."""
    if reference is None or reference["return_mean"] <= 0:
        return {"share": None, "share_ci95": None}
    found = nested_ratio([row["returns"]], reference["returns"])
    return {"share": found.mean, "share_ci95": list(found.ci95)}


def _is_ours(task: str) -> bool:
    try:
        return not envs.spec(task).foreign
    except SpikedeployError:  # no environment of this name is here
        return False


def _encoder(file: str) -> str | None:
    """Kind of a file's encoder; it runs on the host."""
    place = zoo.resolve(file)
    if place is None or suffix(place) != ".nir":
        return None
    codec = load(place).codec
    return f"{codec.encoder.kind}, on the host" if codec else None


def _neurobench(row: Data) -> dict[str, Any]:
    return {
        "Footprint": row["footprint"],
        "ConnectionSparsity": row["connection_sparsity"],
        "ActivationSparsity": row["sparsity"],
        "SynapticOperations": {
            "Effective_MACs": row["effective_macs"],
            "Effective_ACs": row["effective_acs"],
            "Dense": row["macs_dense"],
        },
        "RewardScore": {
            "avg": row["return_mean"],
            "std": row["return_std"],
            "risk": _risk(row),
        },
    }


# Checks of a row.


def faults(row: LeaderboardRow) -> Iterator[str]:
    """Sentences on what is wrong with a row that keeps the schema."""
    for whose, policy in (("spiking", row.spiking), ("rival", row.rival)):
        if policy is not None:
            yield from _of_policy(whose, policy)
            for energy in policy.energy:
                yield from _of_energy(f"{whose}.energy of {energy.prices}", energy, policy, row)
    if row.over_trainings:
        of = row.over_trainings
        yield from _outside("over_trainings.share", of.share, of.share_ci95)
        yield from _outcomes("over_trainings", of)
    yield from _of_neurobench(row)
    if row.evidence is None and row.read is None:
        yield "evidence is null and read too: a row is of a report, or of a publication"
    if row.evidence and row.rival is None:
        yield "rival is null: compare the policy with a float one, on the same seeds"
    for file, digest in (row.evidence.sha256 if row.evidence else {}).items():
        place = zoo.resolve(file)
        if place and place.is_file() and (found := zoo.sha256(place)) != digest:
            yield f"evidence.sha256: {file} has {found[:12]}…, and the row says {digest[:12]}…"


def not_checked(row: LeaderboardRow) -> Iterator[str]:
    """Words on what of a row could not be checked here."""
    if row.evidence is None:
        yield "numbers of a publication, beside their source"
        return
    missing = [file for file in row.evidence.sha256 if not zoo.resolve(file)]
    if missing:
        yield f"hashes of files that are not here: {', '.join(missing)}"
    if row.over_trainings:
        yield f"over_trainings, which no report has: {row.over_trainings.source}"
    yield f"whether the episodes give these numbers: `{row.evidence.reproduce}` plays them again"


def differences(row: LeaderboardRow, document: Data, report: str) -> Iterator[str]:
    """Sentences on where a row is not what its report gives."""
    made = row_of_report(
        document, report, row.spiking.name, row.chip, row.rival.name if row.rival else None
    )
    then, now = dict(_leaves(plain(row))), dict(_leaves(plain(made)))
    for path in dict.fromkeys([*now, *then]):
        if not path.startswith(_OF_THE_SENDER) and not _same(then.get(path), now.get(path)):
            yield f"{path}: {then.get(path)} in the row, {now.get(path)} from the report"


def _of_policy(whose: str, policy: PolicyEntry) -> Iterator[str]:
    yield from _outside(f"{whose}.return_mean", policy.return_mean, policy.return_ci95)
    yield from _outside(f"{whose}.share", policy.share, policy.share_ci95)
    yield from _outcomes(whose, policy)
    yield from _above(f"{whose}.risk", policy.risk, policy.return_mean)
    for name in ("effective_macs", "effective_acs"):
        count = getattr(policy, name)
        dense = policy.macs_dense
        if count is not None and dense is not None and count > dense * (1 + _EQUAL):
            yield f"{whose}.{name} is {count:g}, more than all weights have: {dense:g}"


def _outcomes(whose: str, of: PolicyEntry | OverTrainings) -> Iterator[str]:
    """No episode both succeeds and ends early without success."""
    if (of.success_rate or 0) + (of.failure_rate or 0) > 1 + _EQUAL:
        yield (
            f"{whose}: {of.success_rate:g} of the episodes succeed and {of.failure_rate:g} end "
            "early without success, more than all"
        )


def _above(name: str, risk: float | None, mean: float | None) -> Iterator[str]:
    """The worst episodes earn no more than all."""
    if risk is not None and mean is not None and risk > mean + abs(mean) * _EQUAL:
        yield f"{name} is {risk:g}, above the mean {mean:g}"


def _outside(name: str, value: float | None, interval: Sequence[float] | None) -> Iterator[str]:
    if value is not None and interval is not None and not interval[0] <= value <= interval[1]:
        yield f"{name} is {value:g}, outside of its interval {interval[0]:g} to {interval[1]:g}"


def _of_energy(
    name: str, energy: Energy, policy: PolicyEntry, row: LeaderboardRow
) -> Iterator[str]:
    dynamic, total = energy.dynamic_j, energy.with_static_j
    if energy.terms_j and not _same(sum(energy.terms_j.values()), dynamic):
        yield f"{name}: its terms add up to {sum(energy.terms_j.values()):g} J, not to {dynamic} J"
    if dynamic is not None and total is not None and total < dynamic:
        yield f"{name}: {total:g} J with static power is less than {dynamic:g} J without"
    if energy.prices in TABLES:
        yield from _of_prices(name, energy, policy)
    powers = static(row.chip, row.task) if row.chip and row.evidence and _is_ours(row.task) else {}
    if energy.static_power in powers and dynamic is not None:
        expected = dynamic + powers[energy.static_power]
        if not _same(total, expected):
            yield f"{name}: with {energy.static_power} it is {expected:g} J, not {total} J"


def _of_prices(name: str, energy: Energy, policy: PolicyEntry) -> Iterator[str]:
    """Operations and updates by the prices that the table has today."""
    table = TABLES[energy.prices]
    if policy.sops is None or {"graded_sop", "one_state_update"} & set(table.joules):
        return  # MACs executed or not, and graded spikes, are not told apart in a row
    counts = {"sop": policy.sops, "neuron_update": policy.neuron_updates or 0.0}
    expected = chip_terms(counts, table)
    for term in ("operations", "updates"):
        found = energy.terms_j.get(term)
        if found is not None and not _same(found, expected[term]):
            yield (
                f"{name}: {term} are {found:g} J, and {expected[term]:g} J by the counts of the "
                "row and the table's prices"
            )
    least = expected["operations"] + expected["updates"]
    if energy.dynamic_j is not None and energy.dynamic_j < least * (1 - _EQUAL):
        yield (
            f"{name}: {energy.dynamic_j:g} J is less than its operations and updates take, "
            f"{least:g} J"
        )


def _of_neurobench(row: LeaderboardRow) -> Iterator[str]:
    score = row.neurobench.reward_score if row.neurobench else None
    if score is None:
        return
    if not _same(score.avg, row.spiking.return_mean):
        yield f"RewardScore.avg is {score.avg:g}, and return_mean {row.spiking.return_mean}"
    yield from _above("RewardScore.risk", score.risk, score.avg)
    if score.risk is not None and row.episodes and row.episodes < FEWEST_FOR_RISK:
        yield f"RewardScore.risk of {row.episodes} episodes: NeuroBench has none below 20"


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:  # noqa: ANN401
    """(a.b, value) of all that is neither table nor list."""
    if isinstance(value, Mapping | list):
        pairs = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, each in pairs:
            yield from _leaves(each, f"{path}.{key}" if path else str(key))
    else:
        yield path, value


def _same(left: Any, right: Any) -> bool:  # noqa: ANN401
    if isinstance(left, float | int) and isinstance(right, float | int):
        return math.isclose(left, right, rel_tol=_EQUAL)
    return bool(left == right)
