"""Policies that see by events, at a place, with what they do counted for each kart of a batch.

A float network skips multiplications by zero, and saves more in one of the WAYS: as a delta network
it sends only what has changed by more than a threshold since it was sent (Neil et al. 2017,
arXiv 1612.05571), with a threshold of 0 exactly what it would else compute; and triggered by events
it runs only where so many came since it last ran, or in every so many control steps, and holds its
action and memory else. A gate leaves out control steps where the last 1/60 s brought fewer, such as
noise at rest.

At a control rate that is k times as high as in training, a float network sees the events of the
last k control steps, as many as in training, or all since it last ran where that is longer ago; its
memory moves by a k-th for each control step: h' = h + (1 - z) (n - h) / k. A spiking network takes
the events as they come; its decay factors become their k-th roots, and what comes in every
timestep, biases and currents that last, is so much smaller. Whether a policy still drives then is
measured.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d

from lab.experiments.training import Record
from spikedeploy.envs.eye.batch import EyeBatch
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.window import Window
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.policies import Policy
from spikedeploy.trainers.policies.policy import PrunedKernel, in_bits
from spikedeploy.trainers.policies.vision import (
    FloatVisionPolicy,
    SpikingVisionPolicy,
    vision_artifact,
)

FIRST_SEED = EVALUATION + 30_000  # of evaluations; kart-eye and its students were tried below

Counts = NDArray[np.uint8]
Totals = dict[str, NDArray[np.float64]]
_COUNTS_OF_FLOATS = (
    "macs", "first_macs", "changed_macs", "conv_macs", "dense_macs", "first_dense_macs",
    "behind_weights", "memory_weights", "cells", "sent", "compared", "units", "first_units",
    "gates", "runs", "events", "waits",
)  # fmt: skip
BITS = 8  # of the weights of float networks, as of those of chips
OUTCOMES = ("finish", "wrong", "crash", "forks")  # of an episode
_AT = " at "  # between a way, or a chip, and the rate at which it runs
_RECURRENT = ("gru", "back", "out")  # synapses behind the layers of units


@dataclass(frozen=True)
class Execution:
    """A way of a float network to save operations, besides those with zeros.

    delta    change of a unit above which it is sent again; None sends all that are not 0
    trigger  events that must have come since it last ran; 0 lets it run in every control step
    gate     events that the last 1/60 s must have brought; other control steps are left out
    every    control steps from one run to the next
    """

    delta: float | None = None
    trigger: int = 0
    gate: int = 0
    every: int = 1


WAYS = {
    "zero-skipping": Execution(),
    "delta 0.1": Execution(delta=0.1),
    "triggered by 16 events": Execution(trigger=16),
    "triggered by 64 events": Execution(trigger=64),
    "gated by 16 events": Execution(gate=16),
    "gated by 64 events": Execution(gate=64),
    "every 2 steps": Execution(every=2),
    "gated by 16 events every 2 steps": Execution(gate=16, every=2),
}


class CountedController(Protocol):
    """A controller of B karts, for one episode of each, that counts what it does."""

    @property
    def totals(self) -> Totals:
        """Counts (B,) by name, so far."""

    def act(self, counts: Counts) -> NDArray[np.int64]:
        """Actions (B,) for counts of events (B, obs)."""


class CountedFloatController:
    """A float network with weights of 8 bits; what it does is counted where it is computed.

    totals: by name (B,)
        macs, first_macs    multiplications of weights with what is sent; those of the first layer
        changed_macs        those of the first layer with inputs that changed since it last ran
        conv_macs           those of the convolutions, the first one included
        dense_macs          those of the convolutions, if no zero were skipped
        first_dense_macs    those of the first layer, if it is one
        behind_weights      weights of the layers behind the convolutions, each time they run
        memory_weights      those of them that read the memory of a GRU, which is never 0
        cells, sent         inputs of the first layer that are not 0; of the others what is sent
        compared            in a delta network, units some of whose inputs changed: their sum is
                            read and written, and what they send is compared with what they sent
        units, first_units  units of all layers, those of the first
        gates, runs         units of the GRU, and how often it ran
        events              of the camera
        waits               control steps that events wait for until the network runs, their own not
    """

    def __init__(
        self, policy: FloatVisionPolicy, karts: int, way: Execution, slower: int = 1, gated: int = 1
    ) -> None:
        if policy.traces:
            raise ConfigError("a policy with leaky traces has no other control rate; leave it out")
        self._policy, self._way, self._slower = in_bits(deepcopy(policy), BITS), way, slower
        self._weights = {name: w.detach() for name, w in self._policy.weights().items()}
        self._fan_out = {n: self._policy.matrix(n).fan_out for n in self._weights}
        self._biases = {name: each.detach() for name, each in self._policy.biases.items()}
        self.totals: Totals = {name: np.zeros(karts) for name in _COUNTS_OF_FLOATS}
        self._seen = np.zeros((slower, karts, policy.observations), np.uint8)  # of the last steps
        self._since = np.zeros((karts, policy.observations), np.int64)  # events since it last ran
        self._lately = np.zeros((gated, karts))  # events of the last control steps, for a gate
        self._waited, self._step = np.zeros(karts), 0
        self._of_memory = ("back", "out") if policy.gru else ()
        self._memory = torch.zeros(karts, policy.gru)
        # what was sent last; of the first layer what it last saw
        self._sent = {name: torch.zeros(karts, len(f)) for name, f in self._fan_out.items()}
        self._actions = np.full(karts, policy.actions // 2)

    @torch.no_grad()
    def act(self, counts: Counts) -> NDArray[np.int64]:
        """Actions (B,) for counts of events (B, obs)."""
        self._seen[self._step % self._slower] = counts
        self._lately[self._step % len(self._lately)] = counts.sum(1)
        self._step += 1
        self._since += counts
        self._waited += 1
        self.totals["events"] += counts.sum(1)
        is_due = (self._step - 1) % self._way.every == 0
        is_open = self._lately.sum(0) >= self._way.gate
        rows = np.flatnonzero(is_due & is_open & (self._since.sum(1) >= self._way.trigger))
        if len(rows):
            holds = self._way.trigger > 0 or self._way.every > self._slower
            is_long = (self._waited[rows] > self._slower) & holds
            lately = self._seen[:, rows].sum(0, dtype=np.int64)
            seen = np.where(is_long[:, None], self._since[rows], lately)
            self._actions[rows] = self._run(torch.from_numpy(seen).float(), rows)
            self._since[rows], self._waited[rows] = 0, 0
        self.totals["waits"] += self._since.sum(1)
        found: NDArray[np.int64] = self._actions.copy()
        return found

    def _run(self, x: Tensor, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """Actions (n,) of some karts, whose network runs once."""
        policy = self._policy
        self.totals["runs"][rows] += 1
        x = policy.normalizer(x)
        if policy.pool != (1, 1):
            x = avg_pool2d(x.view(-1, *policy.shape), policy.pool, divisor_override=1).flatten(1)
        for name in self._weights:
            if name not in _RECURRENT:
                x = torch.relu(self._drive(name, x, rows))
        if policy.gru:
            x = self._remember(x, rows)
        actions: NDArray[np.int64] = self._drive("out", x, rows).argmax(1).numpy()
        return actions

    def _remember(self, x: Tensor, rows: NDArray[np.int64]) -> Tensor:
        """The memory (n, H) after inputs (n, M)."""
        h = self._memory[rows]
        inputs, past = (
            self._drive(name, each, rows).chunk(3, 1) for name, each in (("gru", x), ("back", h))
        )
        # r = sigmoid(.) ; z = sigmoid(.) ; n = tanh(Wn x + r Un h) ; h' = h + (1 - z) (n - h) / k
        r, z = (torch.sigmoid(inputs[k] + past[k]) for k in (0, 1))
        n = torch.tanh(inputs[2] + r * past[2])
        holds = self._way.trigger > 0 or self._way.every > 1
        waited = self._waited[rows] if holds else np.ones(len(rows))
        share = torch.from_numpy(np.minimum(waited / self._slower, 1)).float()[:, None]
        self._memory[rows] = h = h + share * (1 - z) * (n - h)
        self.totals["gates"][rows] += self._policy.gru
        return h

    def _drive(self, name: str, x: Tensor, rows: NDArray[np.int64]) -> Tensor:
        """Drives (n, N) of the units behind a group of synapses, from inputs (n, M)."""
        totals, is_first = self.totals, name == next(iter(self._weights))
        is_sent = x != 0
        before = self._sent[name][rows]
        if self._way.delta is not None and not is_first:
            is_sent = (x - before).abs() > self._way.delta
            self._sent[name][rows] = x = torch.where(is_sent, x, before)
        fan_out, matrix = self._fan_out[name].double(), self._policy.matrix(name)
        macs = (is_sent.double() @ fan_out).numpy()
        totals["macs"][rows] += macs
        totals["cells" if is_first else "sent"][rows] += is_sent.sum(1).numpy()
        drive = matrix.drive(x, self._weights[name])
        totals["units"][rows] += drive.shape[1]
        if self._way.delta is not None:
            changed = ((x != before) if is_first else is_sent).float()
            reached = matrix.drive(changed, self._weights[name].abs()) > 0
            totals["compared"][rows] += reached.sum(1).numpy()
        if is_first:
            totals["first_macs"][rows] += macs
            totals["first_units"][rows] += drive.shape[1]
            totals["changed_macs"][rows] += ((x != before).double() @ fan_out).numpy()
            self._sent[name][rows] = x
        if isinstance(matrix, PrunedKernel):
            totals["conv_macs"][rows] += macs
            dense = matrix.weight[0].numel() * drive.shape[1]
            totals["dense_macs"][rows] += dense
            totals["first_dense_macs"][rows] += dense if is_first else 0
        elif not is_first:
            weights = float(fan_out.sum())
            totals["behind_weights"][rows] += weights
            totals["memory_weights"][rows] += weights if name in self._of_memory else 0
        bias = self._biases[name]
        maps: Tensor = drive.view(len(drive), len(bias), -1) + bias[:, None]
        return maps.flatten(1)


class CountedChipController:
    """A spiking network on a chip, whose ledger counts.

    gate: events that the last 1/60 s must have brought; other control steps are left out.
    totals: by name (B,), besides the events of the ledger
        cells    inputs that spike
        events   of the camera
        touched  neurons at which a spike arrives, once a timestep
    """

    def __init__(
        self,
        policy: SpikingVisionPolicy,
        karts: int,
        place: str,
        slower: int = 1,
        gate: int = 0,
        gated: int = 1,
    ) -> None:
        artifact = vision_artifact(policy.slowed(slower))
        target = chip(place)
        self._controller = SpikingController(
            artifact, target, ledger="copies", backend="auto", trace=True
        )
        self._own: Totals = {name: np.zeros(karts) for name in ("cells", "events", "touched")}
        self._gate, self._step = gate, 0
        self._lately = np.zeros((gated, karts))  # events of the last control steps, for the gate
        self._shut = np.zeros(karts)  # control steps without input
        # where nothing leaks, nothing changes in them
        self._may_rest = policy.neuron == "if"
        self._reached = [
            [(s.source, s.window, (s.weight != 0).astype(np.float64)) for s in layer.synapses]
            for layer in self.program.layers
        ]

    @property
    def program(self) -> Program:
        """The program that runs."""
        return self._controller.program

    def act(self, counts: Counts) -> NDArray[np.int64]:
        """Actions (B,) for counts of events (B, obs)."""
        self._own["events"] += counts.sum(1)
        self._lately[self._step % len(self._lately)] = counts.sum(1)
        self._step += 1
        is_shut = self._lately.sum(0) < self._gate
        self._shut += is_shut
        seen = np.where(is_shut[:, None], 0.0, counts)
        actions: NDArray[np.int64] = self._controller.act_batch(seen)
        encoded, machine = self._controller.encoded, self._controller.network
        assert isinstance(machine, Machine)
        spikes = {name: each.spikes[:, 0] for name, each in machine.recordings.items()}
        spikes[self.program.input] = encoded[:, 0]
        self._own["cells"] += np.count_nonzero(encoded[:, 0], axis=1)
        self._own["touched"] += touched(self._reached, spikes)
        return actions

    @property
    def totals(self) -> Totals:
        """Counts (B,) by name; `one_state_update` counts some of `neuron_update`."""
        ledger = self._controller.ledger
        found = {name: ledger.counts[:, :, k].sum(1) for k, name in enumerate(EVENTS)}
        alone = [name in ledger.one_state for name in ledger.layers]
        found["one_state_update"] = ledger.counts[:, alone, EVENTS.index("neuron_update")].sum(1)
        if self._may_rest and self._step:
            running = 1 - self._shut / self._step
            for name in ("neuron_update", "one_state_update"):
                found[name] = found[name] * running
        return {name: each.astype(np.float64) for name, each in found.items()} | self._own


Reach = Sequence[Sequence[tuple[str, Window | None, NDArray[np.float64]]]]


def touched(reach: Reach, spikes: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """How many neurons (B,) of all layers spikes of a timestep reach, by any synapse.

    reach: of each layer its synapses: source, window, and 1 for each weight that is not 0.
    spikes: (B, N) of the input and of each layer.
    """
    found = np.zeros(len(next(iter(spikes.values()))))
    for layer in reach:
        arriving: Any = 0
        for source, window, ones in layer:
            sent = (spikes[source] != 0).astype(np.float64)
            arriving = arriving + (sent @ ones if window is None else window.sums(ones, sent))
        found += np.count_nonzero(arriving, axis=1)
    return found


def held_at(rate: int) -> str:
    """What follows the way of a policy, or its chip, that runs at the rate of its training.

    rate: of its training [Hz]
    """
    return f"{_AT}{rate} Hz"


def own_way(way: str) -> str:
    """The way, or the chip, of a policy at whatever rate it runs."""
    return way.partition(_AT)[0]


def chip_of(way: str) -> str:
    """The chip in the way of a spiking policy, such as `speck2f gated by 16 events`."""
    return way.partition(" ")[0]


def make_controller(
    policy: Policy, karts: int, way: str, slower: int = 1, gated: int = 1
) -> CountedController:
    """A policy as a controller: a float one by one of the WAYS, a spiking one on a chip.

    way: of a spiking policy `speck2f`, or with a gate of the WAYS `speck2f gated by 16 events`
    slower: control steps in one of its training
    gated: control steps in 1/60 s, whose events a gate adds up
    """
    if isinstance(policy, FloatVisionPolicy):
        return CountedFloatController(policy, karts, WAYS[way], slower, gated)
    if isinstance(policy, SpikingVisionPolicy):
        place, _, name = way.partition(" ")
        gate = WAYS[name].gate if name else 0
        return CountedChipController(policy, karts, place, slower, gate, gated)
    raise ConfigError(f"a policy of kind {policy.kind!r} does not see by events; leave it out")


def drive(
    options: Mapping[str, Any],
    controller: CountedController,
    episodes: int,
    limit: int | None = None,
) -> tuple[Record, list[Record]]:
    """What evaluation episodes of kart-eye brought, and how each of them ended.

    Counts are means of a control step; `still` has those of steps in which nothing moved, neither
    kart nor gate, and how many these were, and how many at gates; `wait` is that of an event which
    came in the others until a float network ran [control steps], its own not counted; `finishes`
    says of each episode whether it was finished.

    options: of the environment
    limit: control steps of an episode, those at gates included; None for all
    """
    env = EyeBatch(episodes, **options)
    counts = env.reset(range(FIRST_SEED, FIRST_SEED + episodes)).reshape(episodes, -1)
    ended = np.zeros(episodes, np.bool_)
    ends: list[Record] = [{} for _ in range(episodes)]
    totals, still = dict.fromkeys(controller.totals, 0.0), dict.fromkeys(controller.totals, 0.0)
    steps = number = resting = waiting = 0
    rested = ~env.moving()
    while not ended.all():
        before = (
            {name: each.copy() for name, each in controller.totals.items()} if rested.any() else {}
        )
        actions = controller.act(counts)
        for name, each in before.items():
            still[name] += float((controller.totals[name] - each)[rested].sum())
        resting += int(rested.sum())
        rested = ~env.moving()
        counts, _, terminated, truncated, info = env.step(actions)
        counts = counts.reshape(episodes, -1)
        number += 1
        now = (terminated | truncated | (number == limit)) & ~ended
        if now.any():
            for name, each in controller.totals.items():
                totals[name] += float(each[now].sum())
            for k in np.flatnonzero(now).tolist():
                ends[k] = {name: int(info[name][k]) for name in OUTCOMES}
            steps += number * int(now.sum())
        waiting += int((info["waiting"] & ~ended).sum())
        ended |= now
        rested &= ~env.moving() & ~ended
    finish, wrong, crash, forks = (sum(end[name] for end in ends) for name in OUTCOMES)
    row: Record = {
        "episodes": episodes,
        "steps": steps,
        "finished": finish / episodes,
        "finishes": [end["finish"] for end in ends],
        "right": forks / max(forks + wrong, 1),
        "crashed": crash / episodes,
        **{name: total / steps for name, total in totals.items()},
    }
    if "waits" in totals:
        came = max(totals["events"] - still["events"], 1.0)
        row["wait"] = (totals["waits"] - still["waits"]) / came
    if resting:
        each_still = {name: total / resting for name, total in still.items()}
        row["still"] = {"steps": resting, "waiting": waiting, **each_still}
    return row, ends


def wait_longer(row: Record, quiet: float) -> Record:
    """The row of a cell whose gates stay closed for longer, from one that was driven.

    As waits are the drawn ones times a factor, each episode takes as many steps more at its gates
    as follow from it; in these nothing moves, and each counts what those counted.
    """
    factor = quiet / (1 - quiet) / (row["quiet"] / (1 - row["quiet"]))
    still = row["still"]
    more = (factor - 1) * still["waiting"]
    steps = row["steps"] + more
    means = {
        n: (row["steps"] * row[n] + more * each) / steps
        for n, each in still.items()
        if n in row and n != "steps"
    }
    return {**row, **means, "quiet": quiet, "driven_quiet": row["quiet"], "steps": round(steps)}
