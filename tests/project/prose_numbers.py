"""Where the numbers in sentences of README and docs come from: one rule for each claim.

A rule is a piece of a sentence with a `{}` for each number, and a function that computes those
numbers from results/. Links, backticks, asterisks and line breaks of the page are left out. Where a
sentence is rewritten, rewrite the rule; where it goes, delete the rule.
"""

import csv
import json
import math
import re
from collections import defaultdict
from statistics import mean, median

import numpy as np

from lab.experiments.kart.design import GREEDY
from lab.experiments.lineup import records, tables
from lab.experiments.pareto.tables import NEAR, NEARLY
from spikedeploy.comparison.statistics import nested_ratio, ratio_of_medians
from spikedeploy.envs.hexapod.command import FOLLOWED, SPEED
from spikedeploy.runtime.metrics.energy import energy_table
from spikedeploy.trainers.distill.config import DistillConfig
from spikedeploy.trainers.ppo.config import PpoConfig
from spikedeploy.trainers.resolve import resolve
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.phases import phases
from tests.paths import ROOT

RESULTS = ROOT / "results"
KARTS = ("kart-grid", "kart-gazebo", "kart-steer")
WALKS = ("hexapod", "hexapod-command")


def clocked(task, clock="pipelined", more=""):
    """The numbers of a row of results/clocks.csv."""
    kind = f"trained {clock}{more}" if clock == "pipelined" else "shipped, trained gated"
    (found,) = [
        r for r in lines("clocks.csv") if (r["task"], r["kind"], r["clock"]) == (task, kind, clock)
    ]
    numbers = "trainings", "share", "share_low", "share_high", "succeeded", "sops"
    return {name: float(found[name]) for name in numbers}


def row(env, policy, chip="loihi1:clock=gated"):
    """A row of results/<env>/report.json; `chip` is passed over where the policy does not spike."""
    rows = json.loads((RESULTS / env / "report.json").read_text("utf-8"))["rows"]
    return next(r for r in rows if r["policy"] == policy and r["chip"] in (chip, None))


def sops(env, policy="sparse"):
    """Synaptic operations of an inference on loihi1."""
    return row(env, policy)["sops_per_inference"]


def joules(env, policy, table="horowitz45-int8"):
    """Energy of an inference [J]; on loihi1 where the policy spikes."""
    return row(env, policy)["energy_per_inference_j"][table]


def fewer(envs, dense, table=None):
    """How many times fewer operations, or less energy by a table, `sparse` needs: of each env."""
    if table:
        return [joules(env, dense, table) / joules(env, "sparse", table) for env in envs]
    return [sops(env, dense) / sops(env) for env in envs]


def skipping(env):
    """Energy of the float network of a task without the zeros [J]."""
    return row(env, "sac")["effective_macs"] * mac()


def mac():
    """Price of a multiply-accumulate with 8-bit weights [J]."""
    return energy_table("horowitz45-int8").joules["mac"]


def lines(file):
    """Rows of a CSV file of results/."""
    with (RESULTS / file).open(encoding="utf-8") as opened:
        return list(csv.DictReader(opened))


def medians(file, column, **wanted):
    """Median of a column over the rows that have the wanted cells."""
    rows = [r for r in lines(file) if all(r[name] == text for name, text in wanted.items())]
    return median(float(r[column]) for r in rows if r[column])


def returns(env, *policies):
    """Mean returns, on loihi1 of policies that spike."""
    return [row(env, policy)["return_mean"] for policy in policies]


def low(found, name):
    """The lower end of a row's 95 % interval."""
    return found[f"{name}_ci95"][0]


def high(found, name):
    """The upper end of a row's 95 % interval."""
    return found[f"{name}_ci95"][1]


def learned(preset, field):
    """(world, policy) -> steps of its trainings (n,) to what the field says; inf where never."""
    found = defaultdict(list)
    for r in lines("kart/learning.csv"):
        if r["preset"] == preset:
            found[r["world"], r["policy"]].append(float(r[field]))
    return found


def steps_of_ann():
    """The ANN's median steps to 300 finishes over the SNN's [%], of each kart."""
    steps = learned("default", "finish_300")
    return [100 * median(steps[kart, "ann"]) / median(steps[kart, "snn"]) for kart in KARTS]


def ratio_interval(kart, field):
    """The interval of the ANN's median steps over the SNN's, over training seeds."""
    steps = learned("default", field)
    rng = np.random.default_rng(0)
    return ratio_of_medians(steps[kart, "ann"], steps[kart, "snn"], rng).ci95


def reached(policy):
    """How many classic trainings came to 300 finishes, and of how many; over all karts."""
    steps = trainings("classic", "finish_300", policy)
    return sum(map(math.isfinite, steps)), len(steps)


def trainings(preset, field, *policies):
    """Steps of all trainings of these policies to what the field says, over all karts."""
    found = learned(preset, field)
    return [steps for kart in KARTS for policy in policies for steps in found[kart, policy]]


def learning_rate(recipe):
    """With which the policy of a recipe begins to learn."""
    return resolve(PpoConfig, recipe).actor_rate.start


def small_operations():
    """Operations of `small` over those of the SNN on loihi1, of each kart."""
    driving, asked = "kart/driving.csv", {"preset": "default"}
    return [
        medians(driving, "effective_macs", world=kart, policy="small", **asked)
        / medians(driving, "sops_per_inference", world=kart, policy="snn", chip="loihi1", **asked)
        for kart in KARTS
    ]


def lost_on_chip():
    """Points of the finish rate that our preset's SNNs lose on the chip.

    How many lose most, how much that is, and the most that another one loses.
    """
    rows = [r for r in lines("kart/driving.csv") if r["preset"] == "default"]
    lost = [round(-100 * float(r["success_difference_mean"] or 0), 6) for r in rows]
    return lost.count(max(lost)), max(lost), max(p for p in lost if p < max(lost))


def longer_laps():
    """By how much the script's laps are longer than those of our preset's SNNs [%]."""
    laps = {
        (kart, policy): medians("kart/driving.csv", "lap_time", world=kart, policy=policy,
                                preset="default", chip=chip)
        for kart in KARTS for policy, chip in (("gap", ""), ("snn", "loihi1"))
    }  # fmt: skip
    return [100 * (laps[kart, "gap"] / laps[kart, "snn"] - 1) for kart in KARTS]


def elsewhere(policy, preset="default"):
    """Share of starts that finish on tracks that nothing was trained on [%], of each kart."""
    rows = [r for r in lines("kart/tracks.csv") if r["unseen"] == "True"]
    wanted = [r for r in rows if (r["policy"], r["preset"]) == (policy, preset)]
    return [
        100 * mean(mean(map(int, r["finished"])) for r in wanted if r["world"] == kart)
        for kart in KARTS
    ]


def lined_up(env, policy):
    """The row of a policy in results/lineup.md."""
    section = (RESULTS / "lineup.md").read_text("utf-8").split(f"## {env}\n")[1].split("\n## ")[0]
    (found,) = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in section.splitlines() if line.startswith(f"| {policy} |")
    ]  # fmt: skip
    return found


def of_sac(env, policy, trainings=5):
    """Share of the return of sac [%], and its interval, over that many trainings."""
    found = lined_up(env, policy)
    assert int(found[2]) == trainings
    return [float(n) for n in re.findall(r"[\d.]+", found[4])]


def best_of_five(env, policy):
    """Return of the shipped training, which is the highest of five, and their mean."""
    found = lined_up(env, policy)
    assert found[5] == found[7]
    return [float(found[5].replace(",", "")), float(found[3].split()[0].replace(",", ""))]


def narrow(env):
    """Return, share of sac's [%] and SOPs of the PopSAN of 256 neurons in a layer."""
    operations, returns = lined_up(env, "popsan-256")[1], lined_up(env, "popsan-256")[3]
    numbers = [float(text.split()[0].replace(",", "")) for text in (returns, operations)]
    return numbers[0], *of_sac(env, "popsan-256", 1), numbers[1]


def of_sparse(env, policy):
    """Share of the return of sparse [%], and its interval, over five trainings of both."""
    rows = records.read(RESULTS / "lineup.csv")
    own = [r["returns"] for r in rows if (r["env"], r["policy"]) == (env, policy)]
    beside = [r["returns"] for r in tables.sparse_rows(env, RESULTS / f"pareto/{env}.csv", 100)]
    assert len(own) == len(beside) == 5
    found = nested_ratio(own, beside, np.random.default_rng(0))
    return [100 * n for n in (found.mean, *found.ci95)]


def successes_of_sac(policy):
    """Share of the successes of sac on the command task [%], and its interval."""
    rows = records.read(RESULTS / "lineup.csv")
    own, beside = (
        [r["successes"] for r in rows if (r["env"], r["policy"]) == ("hexapod-command", each)]
        for each in (policy, "sac")
    )
    found = nested_ratio(own, beside, np.random.default_rng(0))
    return [100 * n for n in (found.mean, *found.ci95)]


def cornered(policy, kart):
    """Share of the ANN's steps to 300 finishes in corridors [%], and its interval."""
    text = (RESULTS / "kart.md").read_text("utf-8").split("### corridor preset\n")[1]
    line = next(each for each in text.splitlines() if each.startswith(f"| {kart} | {policy} |"))
    found = re.findall(r"[\d.]+", line.split("|")[6])
    return [float(n) for n in found]


def table(file, *heads):
    """Rows (a dict each) of every table of a page of results/ that has the heads."""
    for block in re.split(r"\n\s*\n", (RESULTS / file).read_text("utf-8")):
        found = [[c.strip() for c in line.strip("|").split("|")] for line in block.splitlines()]
        if len(found) > 2 and set(heads) <= set(found[0]):
            yield from (dict(zip(found[0], cells, strict=True)) for cells in found[2:])


def column(file, head, *near, **wanted):
    """Every number in a column of the tables that have it and the columns `near`."""
    rows = [r for r in table(file, head, *near, *wanted) if wanted.items() <= r.items()]
    return [float(n.replace(",", "")) for r in rows for n in re.findall(r"[-+]?[\d,.]*\d", r[head])]


def drift(head, bits):
    """A factor of the first table of results/drift.md, over all policies."""
    return column("drift.md", head, bits=str(bits))[0]


def imitates(env, *students):
    """Gradient updates of imitation of pruned students of a recipe, pruning and polish included."""
    return [phases(resolve(SparseConfig, f"{env}-{s}"))[-1].end for s in students]


def fresh_walks(env, student):
    """Walks that a pruned student adds to its pool after a round."""
    return resolve(SparseConfig, f"{env}-{student}").walks


def same_spikes(tool, variant):
    """How many shipped files a tool computes every spike of, by results/interop.json."""
    rows = json.loads((RESULTS / "interop.json").read_text("utf-8"))
    return sum(
        (each["peer"], each["variant"]) == (tool, variant)
        and not each["file"].startswith("examples/")
        and each["opens"]
        and not each["meant"]["differ"]
        for each in rows
    )


def spread(numbers):
    """The least and the most."""
    return min(numbers), max(numbers)


def cheapest(total, karts=False):
    """Energy over that of the cheapest float network as good, in pareto.md: walkers or karts."""
    text = (RESULTS / "pareto.md").read_text("utf-8").partition("\n## kart-")[2 if karts else 0]
    lines = re.findall(rf"^- . {total}: .*", text, re.M)
    return [float(n) for line in lines for n in re.findall(r" pJ: ([\d.]+) times", line)]


def trained(task, policy):
    """Mean return of five trainings [% of the teacher's], in the first table of pareto.md."""
    (found,) = [r for r in table("pareto.md", "task") if (r["task"], r["policy"]) == (task, policy)]
    assert found["seeds"] == "5"
    return float(found["% of teacher"].partition("%")[0])


def rounding_share(bits):
    """What rounding of thresholds, decays and states changes the distance by, at most [%]."""
    head = f"distance, {bits} bits"
    weights = column("drift.md", head, rounding="weights rounded")
    chip = column("drift.md", head, rounding="+ states, overflow: the chip")
    return max(100 * abs(each / other - 1) for each, other in zip(chip, weights, strict=True))


def truncated(rounding):
    """hexapod/popsan with 4 bits and a scale a layer: return less the float twin's, interval."""
    head = "return − float's [95 %]"
    return column("drift.md", head, "distance lif3", bits="4", scale="layer", rounding=rounding,
                  tuned="")  # fmt: skip


def tuned_interval_on_karts():
    """The largest bound of a return's difference at 2 bits, scales per neuron, tuned."""
    rows = [
        r
        for r in table("drift.md", "return − float's [95 %]", "output error")
        if (r["bits"], r["scale"], r["tuned"]) == ("2", "channel", "yes")
        and "distance lif3" not in r
    ]
    bounds = [n for r in rows for n in re.findall(r"\d+\.\d+", r["return − float's [95 %]"])]
    return max(map(float, bounds))


def macs(env, *policies):
    """Multiply-accumulates with an input that is not 0, of an inference."""
    return [row(env, policy)["effective_macs"] for policy in policies]


def phase_table():
    """What `python -m lab phase-table` found."""
    return json.loads((RESULTS / "phase-table.json").read_text("utf-8"))


def spiking_over_float(task, sums, of="own", where="chip", clock="gated"):
    """A ratio of results/energy.csv."""
    wanted = {"task": task, "accumulator_bits": sums, "update_price_of": of, "encoder": where,
              "clock": clock}  # fmt: skip
    (found,) = [r for r in lines("energy.csv") if wanted.items() <= r.items()]
    return float(found["ratio"])


def walker_operations(sums, mac):
    """Energy of the sparse walker's operations over that of the MLP's, a MAC of so many pJ."""
    pair = next(r for r in lines("energy.csv") if r["task"] == "hexapod")
    price = energy_table(f"horowitz45-int8{sums}").joules["sop"]
    return float(pair["sops"]) * price / (float(pair["macs"]) * mac * 1e-12)


def operations_an_update():
    """Of the sparse walkers of results/energy.csv."""
    found = [next(r for r in lines("energy.csv") if r["task"] == task) for task in WALKS]
    return spread([float(r["sops"]) / float(r["updates"]) for r in found])


def in_memory(total, bits, karts=False):
    """The least and the most of `cheapest` with sums in memory."""
    return spread(cheapest(f"{total}, sums of {bits} bits in memory", karts))


def update_over_sop(*tables):
    """How many times as much an update costs as a synaptic operation, by each table."""
    prices = [energy_table(name).joules for name in tables]
    return [each["neuron_update"] / each["sop"] for each in prices]


def walker_picojoules():
    """Of the sparse walkers with reward [pJ]: operations alone, and all, in the overview."""
    wanted = {"task": "hexapod", "policy": "LIF, with reward"}
    return [column("pareto.md", head, **wanted)[0] for head in
            ("operations alone [pJ]", "+ the rest")]  # fmt: skip


RULES = [
    # docs/architecture.md
    ("of the {} shipped files Norse computes every spike of {} as they are", lambda: (
        len(list((ROOT / "spikedeploy/zoo").glob("*/*.nir"))), same_spikes("norse", "as it is"))),
    ("Norse, snnTorch and SpikingJelly of {}, the dense ones. The {} sparse files", lambda: (
        *{same_spikes(tool, "--for") for tool in ("norse", "snntorch", "spikingjelly")},
        len(list((ROOT / "spikedeploy/zoo").glob("*/sparse.nir"))))),
    # docs/training.md
    ("On hexapod the LIF network imitates for {} updates, the MLP for {} and the linear policy "
     "for {}", lambda: imitates("hexapod", "sparse", "small-mlp", "small-linear")),
    ("on hexapod-command for {}, {} and {}. On both the float ones", lambda:
        imitates("hexapod-command", "sparse", "small-mlp", "small-linear")),
    ("On both the float ones get {} fresh walks after a round, and the LIF network {}", lambda: (
        *{fresh_walks(env, s) for env in WALKS for s in ("small-mlp", "small-linear")},
        *{fresh_walks(env, "sparse") for env in WALKS})),
    ("On the karts the LIF network takes {} updates, the float ones {}, and all {} walks", lambda: (
        *{n for env in KARTS for n in imitates(env, "sparse")},
        *{n for env in KARTS for n in imitates(env, "small-mlp", "small-linear")},
        *{fresh_walks(env, s) for env in KARTS for s in ("sparse", "small-mlp", "small-linear")})),
    ("imitate for {} updates on hexapod and {} on hexapod-command, as the dense popsan does",
     lambda: [n for env in WALKS for n in {
        resolve(DistillConfig, f"{env}-{s}").updates
        for s in ("mlp-8", "linear", "fourier", "distill")}]),
    # README
    ("linear policy ({} MACs) and mlp-8, eight hidden units ({}), earn what sac does", lambda:
        macs("hexapod", "linear", "mlp-8")),
    ("On the command task mlp-32 ({}) earns more than any spiking policy", lambda:
        macs("hexapod-command", "mlp-32")),
    ("As a Loihi runs it (free), sparse earns {} % of sac; {} trainings through the pipeline earn "
     "{} % [{}, {}] with {} SOPs, one on the command task {} % with {}; pipelined karts finish {}, "
     "{} and {} % of their laps", lambda: [
        clocked("hexapod", "free")["share"] * 100, clocked("hexapod")["trainings"],
        *(100 * clocked("hexapod")[n] for n in ("share", "share_low", "share_high")),
        clocked("hexapod")["sops"], *(
            clocked("hexapod-command", "pipelined", ", then with reward")[n] * unit
            for n, unit in (("share", 100), ("sops", 1))),
        *(100 * clocked(kart)["succeeded"] for kart in KARTS)]),
    ("Spiking costs more in total: {} to {} times as much as the cheapest float MLP of the same "
     "share with sums in registers, {} to {} times with sums of 16 bits in memory, {} to {} times "
     "with 32", lambda: (
        *spread(cheapest("With updates, encoder and constants")),
        *in_memory("With updates, encoder and constants", 16),
        *in_memory("With updates, encoder and constants", 32))),
    ("a table of the gait's {} phases with {} MACs earns {} % of it", lambda: (
        40, phase_table()["macs"], 100 * phase_table()["of_sac"]["mean"])),
    # docs/results.md
    ("among policies with {} % of the teacher's return, and among those with {} %, the cheapest "
     "sparse walker's cost {} to {} times those of the cheapest MLP with sums in registers, "
     "{} to {} times with sums of 16 bits in memory, and {} to {} times with sums of 32", lambda: (
        100 * NEARLY, 100 * NEAR, *spread(cheapest("Operations alone")),
        *in_memory("Operations alone", 16), *in_memory("Operations alone", 32))),
    ("the sparse walkers cost more in all three: {} to {}, {} to {} and {} to {} times as much, "
     "sparse kart drivers {} to {}, {} to {} and {} to {} times as much as linear ones", lambda: [
        n for karts in (False, True)
        for n in (*spread(cheapest("With updates, encoder and constants", karts)),
                  *in_memory("With updates, encoder and constants", 16, karts),
                  *in_memory("With updates, encoder and constants", 32, karts))]),
    ("a table of {} actions for each of them and {} multiplications beside it", lambda: (
        18, phase_table()["macs"])),
    ("pruned greedily, earn {} % [{}, {}] of sac on the {} seeds", lambda: [
        100 * n for n in (
            phase_table()["of_sac"]["mean"], *phase_table()["of_sac"]["ci95"], 1)]),
    ("that is {} pJ for the operations and {} pJ with the constants and all reads, against {} and "
     "{} of the sparse walkers", lambda: (
        1e12 * phase_table()["joules"]["operations"], 1e12 * phase_table()["joules"]["all"],
        *walker_picojoules())),
    ("On the command task fourier earns {} % [{}, {}] of what sac does, mlp-16 {} % [{}, {}], "
     "mlp-32 {} % [{}, {}] and mlp-8 {} % [{}, {}], sparse {} % [{}, {}]", lambda: [
        n for each in ("fourier", "mlp-16", "mlp-32", "mlp-8", "sparse")
        for n in of_sac("hexapod-command", each)]),
    ("On the walking task linear earns {} % [{}, {}], mlp-8 {} % [{}, {}], sparse {} % [{}, {}]",
     lambda: [n for each in ("linear", "mlp-8", "sparse") for n in of_sac("hexapod", each)]),
    ("The shipped mlp-16, at {}, has the highest return of its five trainings, whose mean is {}",
     lambda: best_of_five("hexapod-command", "mlp-16")),
    ("instead of 512 earns {}, {} % [{}, {}] of sac, with {} SOPs, and {} on the command task, "
     "{} % [{}, {}], with {}", lambda: [n for env in WALKS for n in narrow(env)]),
    ("down to mlp-8 with {} MACs", lambda: macs("hexapod", "mlp-8")),
    ("mlp-16 ({} MACs) and fourier ({}), which has no hidden layer, earn more than sac, and mlp-32 "
     "({}) earns more than every spiking policy", lambda:
        macs("hexapod-command", "mlp-16", "fourier", "mlp-32")),
    ("an inference on the command task takes {} nJ for sparse on the chip, at least {} for "
     "fourier, {} for mlp-16 and {} for mlp-32", lambda: [
        1e9 * joules("hexapod-command", p) for p in ("sparse", "fourier", "mlp-16", "mlp-32")]),
    ("it is {} for sparse and at least {} for mlp-16 and {} for mlp-32", lambda: [
        1e9 * row("hexapod-command", p)["energy_total_j"]["horowitz45-int8"]
        for p in ("sparse", "mlp-16", "mlp-32")]),
    ("no fall, and RMSE within {} of the largest command", lambda: (FOLLOWED[0] / SPEED[1],)),
    ("it succeeds in {} % of the episodes, sac in {} %", lambda: [
        100 * row("hexapod-command", p)["success_rate"] for p in ("sparse", "sac")]),
    ("the spiking walker costs {} µJ per inference ({} µJ on the command task)", lambda:
        [1e6 * joules(env, "popsan") for env in WALKS]),
    ("The float network costs at least {} µJ when all its {} MACs are executed", lambda: (
        1e6 * joules("hexapod", "sac"), row("hexapod", "sac")["macs_dense"])),
    ("at {} pJ for a MAC with its weight fetch", lambda: (1e12 * mac(),)),
    ("{} on the walking task, {} µJ, and {} on the command task, {} µJ", lambda:
        [n for env in WALKS for n in (row(env, "sac")["effective_macs"], 1e6 * skipping(env))]),
    ("costs {} times the dense float network and {} times the one that skips zeros "
     "({} and {} times on the command task)", lambda:
        [joules(env, "popsan") / other
         for env in WALKS for other in (joules(env, "sac"), skipping(env))]),
    ("about {} times fewer synaptic operations than popsan on the walking task, {} times fewer on "
     "the command task, and {} to {} times fewer than snn on the karts", lambda:
        (*fewer(WALKS, "popsan"), *spread(fewer(KARTS, "snn")))),
    ("an inference costs about {} times less on the walking task, {} on the command task and {} to "
     "{} on the karts", lambda: (
        *fewer(WALKS, "popsan", "davies2018"), *spread(fewer(KARTS, "snn", "davies2018")))),
    ("the ANN needs {}, {} and {} % of the SNN's steps (grid, gazebo, steer)", steps_of_ann),
    ("The {} % intervals over seeds in results/kart.md contain {} % in all three worlds", lambda: (
        95, 100 if all(low <= 1 <= high for low, high in (
            ratio_interval(kart, "finish_300") for kart in KARTS)) else 0)),
    ("drives as well with {} to {} of the operations", lambda: spread(small_operations())[::-1]),
    ("each the best of five earlier trainings by validation, finish {}, {} and {} % in float and "
     "{}, {} and {} % on loihi1", lambda:
        [100 * row(kart, "snn", chip)["success_rate"]
         for chip in ("float", "loihi1:clock=gated") for kart in KARTS]),
    ("Until {} % of greedy validation episodes finish, trainings of either take {} to {} thousand "
     "steps with our preset", lambda: (
        100 * GREEDY,
        *(n / 1000 for n in spread(trainings("default", "greedy_95", "ann", "snn"))))),
    ("the ANN came to 300 finishes in {} of {} trainings, the SNN in {} of {}", lambda: (
        *reached("ann"), *reached("snn"))),
    ("kart-simulator's learning rate for it is {} times the ANN's", lambda: (
        learning_rate("kart-gazebo-classic-snn") / learning_rate("kart-gazebo-classic-ann"),)),
    ("the ANN finishes {}, {} and {} % of the starts, the SNN {}, {} and {} %, small {}, {} and {} "
     "%, linear {}, {} and {} %; the script finishes {}, {} and {} %", lambda:
        [n for each in ("ann", "snn", "small", "linear", "gap") for n in elsewhere(each)]),
    ("on the same six tracks the ANN finishes {}, {} and {} % of the starts, the SNN {}, {} and {} "
     "%, small {}, {} and {} %, linear {}, {} and {} %", lambda: [
        n for each in ("ann", "snn", "small", "linear") for n in elsewhere(each, "corridor")]),
    ("ANN, SNN, small and linear finish {}, {}, {} and {} % of them, the script {} %", lambda: [
        100 * mean(mean(map(int, r["finished"])) for r in lines("kart/tracks.csv")
                   if (r["world"], r["preset"], r["policy"], r["track"])
                   == ("kart-grid", preset, policy, "corridor-8"))
        for policy, preset in [(p, "corridor") for p in ("ann", "snn", "small", "linear")]
        + [("gap", "default")]]),
    ("the ANN needs {} % [{}, {}] of the SNN's steps on gazebo and {} % [{}, {}] on steer, {} "
     "and {} % of those of linear, {} and {} % of those of small", lambda: [
        *cornered("snn", "kart-gazebo"), *cornered("snn", "kart-steer"),
        *(cornered(p, kart)[0] for p in ("linear", "small") for kart in KARTS[1:])]),
    ("mlp-16 earns {} % [{}, {}], fourier {} % [{}, {}] and mlp-32 {} % [{}, {}]; on the walking "
     "task mlp-8 {} % [{}, {}], fourier {} % [{}, {}] and linear {} % [{}, {}]", lambda: [
        n for env, policy in (
            ("hexapod-command", "mlp-16"), ("hexapod-command", "fourier"),
            ("hexapod-command", "mlp-32"), ("hexapod", "mlp-8"), ("hexapod", "fourier"),
            ("hexapod", "linear"))
        for n in of_sparse(env, policy)]),
    ("paired by episode, {} % [{}, {}], {} % [{}, {}] and {} % [{}, {}] of its successes", lambda: [
        n for each in ("mlp-16", "fourier", "mlp-32") for n in successes_of_sac(each)]),
    ("sac, which succeeds in {} % of the episodes: mlp-16 in {} %, fourier in {}, mlp-32 in {}",
     lambda: [float(lined_up("hexapod-command", p)[10].split("%")[0])
              for p in ("sac", "mlp-16", "fourier", "mlp-32")]),
    ("The script's laps take {} to {} % longer than the SNN's", lambda:
        spread(longer_laps())),
    ("among the fifteen SNNs of that preset, {} lost {} points on the chip, the others {} at most",
     lost_on_chip),
    ("stopped by hand at {}, {} and {} of 120,000 steps", lambda:
        [float(lines(f"hexapod-popsan/seed{seed}.csv")[-1]["env_steps"]) for seed in range(3)]),
    # docs/quantisation.md, of results/drift.md
    ("together change the distance by about {} % at most, and by less than {} % from 6 bits down",
     lambda: (rounding_share(8), 1 if max(map(rounding_share, (6, 4, 2))) < 1 else 99)),
    ("distances are {} to {} of those with a scale for each layer, at every number of bits", lambda:
        spread(column("drift.md", "channel / layer"))),
    ("It needs {} to {} distinct thresholds in a layer", lambda:
        spread(column("drift.md", "distinct thresholds", scale="channel"))),
    ("with 16 of them distances grow by {} to {} %", lambda:
        [100 * (n - 1) for n in spread(column("drift.md", "16 thresholds / any"))]),
    ("Truncation costs {} times the distance at 8 bits and {} times at 2", lambda: [
        drift("truncate / nearest", bits) for bits in (8, 2)]),
    ("(nearest: {}, interval {} to {})", lambda: truncated("nearest")),
    ("(truncated: {} of 3,295)", lambda: truncated("truncate")[:1]),
    ("{} of the distance at 8 bits, {} at 2", lambda: [
        drift("tuned / as it is", bits) for bits in (8, 2)]),
    ("differs measurably from the float twin's by more than {} on the karts", lambda: (
        tuned_interval_on_karts(),)),
    ("the worst one's steps become {} to {} times coarser", lambda: spread(
        column("drift.md", "proven: steps coarser, at most", policy="hexapod/popsan",
               scale="channel"))),
    # docs/energy.md
    ("An update costs {} times as much as a synaptic operation by sanafe and {} times by "
     "davies2018, {} times by horowitz45-int8, and {} and {} times with sums of 16 and 32 bits",
     lambda: update_over_sop("sanafe", "davies2018", *(
        f"horowitz45-int8{sums}" for sums in ("", "-acc16", "-acc32")))),
    ("({} to {} operations an update on the walkers)", operations_an_update),
    ("Operations alone of the walker cost {} times those of the MLP with sums in registers, {} "
     "times with sums of 16 bits in memory and {} times with 32, {} and {} times beside an MLP "
     "with its inputs in registers", lambda: (
        walker_operations("", 1.55), walker_operations("-acc16", 4.05),
        walker_operations("-acc32", 4.05), walker_operations("-acc16", 2.8),
        walker_operations("-acc32", 2.8))),
    ("With updates, encoder and constants it is {}, {} and {} times, of the kart-grid driver {}, "
     "{} and {} times beside a linear policy", lambda: [
        spiking_over_float(task, sums)
        for task in ("hexapod", "kart-grid") for sums in ("none", "16", "32")]),
    ("the ratio of sanafe ({} times on the walking task, {} times on the command task) or, on the "
     "walking task, of davies2018 ({} times)", lambda: [
        spiking_over_float(task, "none", of, "host") for task, of in (
            ("hexapod", "sanafe"), ("hexapod-command", "sanafe"), ("hexapod", "davies2018"))]),
]  # fmt: skip

# sentences without numbers that compare, and whether results/ says so
COMPARISONS = [
    ("and snnTorch, SpikingJelly and Rockpool of none", lambda:
        not any(same_spikes(t, "as it is") for t in ("snntorch", "spikingjelly", "rockpool"))),
    ("the sparse walkers cost more in all three", lambda: min(
        *cheapest("With updates, encoder and constants"),
        *in_memory("With updates, encoder and constants", 16),
        *in_memory("With updates, encoder and constants", 32)) > 1),
    ("All terms counted, spiking costs more in every table", lambda: all(
        spiking_over_float(task, sums) > 1
        for task in {r["task"] for r in lines("energy.csv")} for sums in ("none", "16", "32"))),
    ("The sign flips on the walkers alone at published prices of updates", lambda: all(
        (r["task"] in WALKS and (r["accumulator_bits"], r["encoder"]) == ("none", "host"))
        for r in lines("energy.csv")
        if r["update_price_of"] in ("sanafe", "davies2018") and float(r["ratio"]) < 1)),
    ("earn what sac does, and", lambda:
        all(high(row("hexapod", p), "return") >= low(row("hexapod", "sac"), "return")
            for p in ("linear", "mlp-8"))),
    ("mlp-32 (2,853) earns more than any spiking policy", lambda:
        low(row("hexapod-command", "mlp-32"), "return")
        > max(high(row("hexapod-command", p), "return") for p in ("popsan", "sparse"))),
    ("every control that observes more than the gait's phase earns what sac does", lambda:
        all(high(row("hexapod", p), "return") >= low(row("hexapod", "sac"), "return")
            for p in ("fourier", "linear", "mlp-8", "mlp-32", "mlp-64"))),
    ("which has no hidden layer, earn more than sac", lambda:
        min(returns("hexapod-command", "mlp-16", "fourier"))
        > returns("hexapod-command", "sac")[0]),
    ("the products in the encoder of fourier have none", lambda:
        "encoder" in row("hexapod-command", "fourier")["energy_unknown"]["horowitz45-int8"]),
    ("so has the shipped mlp-32, and on both tasks sparse", lambda: all(
        best_of_five(*which) for which in (
            ("hexapod-command", "mlp-32"), *((env, "sparse") for env in WALKS)))),
    ("mlp-8 falls behind", lambda:
        high(row("hexapod-command", "mlp-8"), "return")
        < low(row("hexapod-command", "sac"), "return")),
    ("sparse earns more than sac and tracks less well", lambda:
        low(row("hexapod-command", "sparse"), "return")
        > high(row("hexapod-command", "sac"), "return")
        and row("hexapod-command", "sparse")["success_rate"]
        < row("hexapod-command", "sac")["success_rate"]),
    ("smooth, which earns more than sac", lambda:
        returns("hexapod-command", "smooth") > returns("hexapod-command", "sac")),
    ("on grid and steer in all ten, and in one of five on gazebo", lambda: [
        sum(math.isfinite(n) for n in learned("classic", "finish_300")[kart, "snn"])
        for kart in KARTS
     ] == [5, 1, 5]),
    ("in about as many environment steps as float networks, small and linear included", lambda:
        all(0.8 < median(steps[kart, "snn"]) / median(steps[kart, p]) < 1.25
            for steps in [learned("default", "finish_300")] for kart in KARTS
            for p in ("ann", "small", "linear"))),
    ("no interval over five seeds tells the two apart", lambda:
        all(low <= 1 <= high for low, high in (
            ratio_interval(kart, "greedy_95") for kart in KARTS))),
    ("On big_S the scripted driver finishes as often", lambda:
        all(high(row(kart, "gap"), "success_difference") >= 0 for kart in KARTS)),
]  # fmt: skip
