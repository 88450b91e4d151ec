"""Handwritten digits on every chip: float, float weights on the chip, trained through the chip.

    pip install '.[digits]'
    python -m lab digits [--only loihi1] [--seeds 3]

The data are the 1,797 scans of 8 x 8 pixels that scikit-learn ships (Alpaydin and Kaynak 1998, test
set): 1,300 for training, 497 unseen. A pixel spikes in each of T timesteps with the probability of
its grey level; the class is the output neuron with most spikes. Networks are snnTorch modules of
64-96-10 neurons, with the reset that the chip has. Where a chip takes fewer inputs, pixels are
averaged in squares of 2 x 2; where it has fewer outputs, only as many digits are told apart; float
then has the same task. Where a source excites all neurons or inhibits all (ODIN), or a neuron has a
weight for each of four types of axons (TrueNorth), spikes of a pixel come through as many axons:
one that excites and one that inhibits, or one of each type; the float weights are parted by sign.

`float` is the network in float64 (chip `ideal`), trained from random weights. `on the chip` are its
weights as they are. `trained` goes on from them through the chip (`on_chip`), whose weights are
clipped from the start: few bits have few levels, and what the largest weight takes of them is lost
for all others. The clip, a part of a layer's largest weight, is the one of CLIPS with the best
accuracy on the training images before training. No choice is made on unseen
images, but for two that were made with them in view before: the learning rate through the chip, and
the range of CLIPS.

Design rules of the chip are on, unless they refuse the network: then the row names the rule.
"""

import copy
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import torch
from torch import Tensor, nn

from lab.experiments.runner import Experiment, Record
from spikedeploy.runtime.chips import CHIPS as EVERY_CHIP
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.trainers.through_chip import ChipModule, on_chip

FEW_BITS = ("int:weight_bits=2", "loihi1:weight_bits=1", "int:weight_bits=3")
CHIPS = (*FEW_BITS, *(name for name in EVERY_CHIP if name != "ideal"))
TRAINED_ON, HIDDEN, TIMESTEPS, BATCH = 1300, 96, 12, 64
FLOAT_EPOCHS, CHIP_EPOCHS = 25, 15
FLOAT_RATE, CHIP_RATE = 3e-3, 1e-3
CLIPS = (1.0, 0.7, 0.5, 0.35, 0.25)  # of a layer's largest weight
UNIT = 0.8  # of a weight of two bits, of the mean magnitude of a neuron's weights
OFF = 0.25  # of that unit
SHARPNESS = 10.0  # of the softmax of mean spikes


@dataclass(frozen=True, eq=False)
class Task:
    """Images (R, M) in 0 to 1 and labels (R,), those for training first."""

    images: Tensor
    labels: Tensor
    classes: int

    @property
    def split(self) -> int:
        """The number of images for training."""
        return round(len(self.labels) * TRAINED_ON / 1797)


@lru_cache
def task_of(inputs: int, classes: int) -> Task:
    """The task with 64 or 16 inputs and the first classes."""
    from sklearn.datasets import load_digits

    data = load_digits()
    images = torch.from_numpy(data.images / 16.0).to(torch.float32)
    if inputs == 16:
        images = nn.functional.avg_pool2d(images[:, None], 2)
    order = np.random.default_rng(0).permutation(len(data.target))
    labels = torch.from_numpy(data.target[order])
    kept = labels < classes
    return Task(images[order].flatten(1)[kept], labels[kept], classes)


def jobs(seeds: int) -> Iterator[tuple[str, int]]:
    """Yield chips and seeds of trainings."""
    yield from ((name, seed) for seed in range(seeds) for name in CHIPS)


def measure(job: tuple[str, int]) -> Iterator[Record]:
    """Train a seed in float, and through a chip.

    inputs, classes: of the task
    axons: through which each input comes
    limits: "on", or the rule that refuses the network
    on_float, on_chip, trained: share of unseen images that are told right
    differ: share of unseen images that float and its weights on the chip tell otherwise
    clip: of CLIPS
    """
    name, seed = job
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")  # on_chip says where resets differ from snnTorch's
    target = chip(name)
    most = target.limits
    few = most is not None and most.inputs is not None and most.inputs < 64
    outputs = None if most is None else getattr(most, "outputs", None)
    task = task_of(16 if few else 64, min(10, outputs or 10))
    network = _trained_in_float(_kind(target), task.images.shape[1], task.classes, seed)
    in_float = answers(_through(network, "ideal", False), task)
    network = parted(network, axons := _axons(target))
    limits, refused = True, "on"
    try:
        _through(network, name, True)
    except RuleError as error:
        limits, refused = False, str(error).partition(":")[0].removeprefix("rule ")
    on_the_chip = answers(_through(network, name, limits), task)
    clip = max(CLIPS, key=lambda part: _accuracy_in_training(network, name, limits, part, task))
    trained = copy.deepcopy(network)
    clamp = clipping(trained, clip)
    module = _through(trained, name, limits)
    fit(module, task, CHIP_EPOCHS, CHIP_RATE, seed, clamp)
    labels = task.labels[task.split :]
    yield {
        "chip": name,
        "seed": seed,
        "inputs": task.images.shape[1],
        "axons": axons,
        "classes": task.classes,
        "limits": refused,
        "on_float": _share(in_float == labels),
        "on_chip": _share(on_the_chip == labels),
        "differ": _share(in_float != on_the_chip),
        "trained": _share(answers(module, task) == labels),
        "clip": clip,
    }


def _share(holds: Tensor) -> float:
    return round(float(holds.to(torch.float64).mean()), 4)


def _kind(target: Chip) -> tuple[str, str, float]:
    """Neurons of snnTorch that are nearest to the chip's: class, reset and beta."""
    reset = "zero" if "zero" in target.resets else "subtract"
    leaks = target.limits is None or target.limits.membrane_loss != (0.0, 0.0)
    kind = "Synaptic" if isinstance(target.arithmetic, XyloArithmetic) else "Leaky"
    return kind, reset, (0.9375 if kind == "Synaptic" else 0.9) if leaks else 1.0


def _axons(target: Chip) -> int:
    """Axons of an input: one of each type that the chip has, or of each sign."""
    limits = target.limits
    if limits is None:
        return 1
    return limits.weight_values or (2 if limits.axon_signs else 1)


def parted(network: nn.Sequential, axons: int) -> nn.Sequential:
    """The same network with so many axons for each input, and two neurons for each hidden one.

    Sources excite and inhibit by turns. Two axons of a sign carry two bits of a weight.
    """
    found = copy.deepcopy(network)
    if axons > 1:
        first, second = (_by_sign(network[k], count) for k, count in ((0, axons), (2, 2)))
        for k, weight in ((0, first.repeat_interleave(2, dim=0)), (2, second)):
            found[k] = nn.Linear(weight.shape[1], len(weight), bias=False)
            found[k].weight = nn.Parameter(weight)
    return found


def _by_sign(layer: nn.Module, copies: int) -> Tensor:
    """Weights (N, copies M) of sources that excite and inhibit by turns."""
    assert isinstance(layer, nn.Linear)
    weight = layer.weight.detach()
    parts = [(sign * weight).relu() for sign in (1, -1)]
    if copies == 4:
        unit = UNIT * weight.abs().mean(dim=1, keepdim=True)
        levels = [(part / unit).round().clamp(max=3) for part in parts]
        # what is off has the other sign, a little
        high = [torch.where(level >= 2, 2 * unit, -OFF * unit) for level in levels]
        low = [torch.where(level % 2 == 1, unit, -OFF * unit) for level in levels]
        parts = [*high, *low]
    turns = [part * sign for part, sign in zip(parts, (1, -1) * (copies // 2), strict=True)]
    return torch.stack(turns, 2).flatten(1)


@lru_cache(maxsize=16)
def _trained_in_float(
    kind: tuple[str, str, float], inputs: int, classes: int, seed: int
) -> nn.Sequential:
    """The network of a seed, trained in float; shared by chips with the same neurons."""
    import snntorch

    name, reset, beta = kind
    current = {"alpha": 0.5} if name == "Synaptic" else {}
    neurons = partial(
        getattr(snntorch, name), beta=beta, reset_mechanism=reset, reset_delay=False, **current
    )
    torch.manual_seed(seed)
    made = nn.Sequential(
        nn.Linear(inputs, HIDDEN, bias=False),
        neurons(),
        nn.Linear(HIDDEN, classes, bias=False),
        neurons(),
    )
    ideal = _through(made, "ideal", False)
    fit(ideal, task_of(inputs, classes), FLOAT_EPOCHS, FLOAT_RATE, seed, lambda: None)
    return made


def _through(network: nn.Sequential, name: str, limits: bool) -> ChipModule:
    inputs = network[0].in_features
    assert isinstance(inputs, int)
    return on_chip(network, name, (inputs,), limits=limits)


def clipping(network: nn.Sequential, part: float) -> Callable[[], None]:
    """Clip weights at a part of each layer's largest; return what does so again."""
    bounds = [(weight, part * float(weight.abs().max())) for weight in network.parameters()]

    @torch.no_grad()
    def clamp() -> None:
        for weight, bound in bounds:
            weight.clamp_(-bound, bound)

    clamp()
    return clamp


def _accuracy_in_training(
    network: nn.Sequential, name: str, limits: bool, part: float, task: Task
) -> float:
    clipped = copy.deepcopy(network)
    clipping(clipped, part)
    found = answers(_through(clipped, name, limits), task, unseen=False)
    return _share(found == task.labels[: task.split])


def fit(
    module: nn.Module,
    task: Task,
    epochs: int,
    rate: float,
    seed: int,
    after: Callable[[], None],
) -> None:
    """Train by cross-entropy of mean spikes and Adam, whose rate falls to 0 by a cosine."""
    generator = torch.Generator().manual_seed(seed)
    optimiser = torch.optim.Adam(module.parameters(), rate)
    batches = list(_batches(task, epochs, generator))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, len(batches))
    for rows in batches:
        optimiser.zero_grad()
        mean = module(arriving(module, task.images[rows], generator)).mean(dim=0)
        loss = nn.functional.cross_entropy(SHARPNESS * mean, task.labels[rows])
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        after()


def _batches(task: Task, epochs: int, generator: torch.Generator) -> Iterator[Tensor]:
    for _ in range(epochs):
        order = torch.randperm(task.split, generator=generator)
        yield from (order[at : at + BATCH] for at in range(0, task.split, BATCH))


def encode(images: Tensor, generator: torch.Generator) -> Tensor:
    """Spikes (T, B, M) of pixels (B, M), each with the probability of its grey level."""
    return (torch.rand(TIMESTEPS, *images.shape, generator=generator) < images).to(images.dtype)


def arriving(module: nn.Module, images: Tensor, generator: torch.Generator) -> Tensor:
    """Spikes of images through all axons of the module's inputs."""
    spikes = encode(images, generator)
    if not isinstance(module, ChipModule):
        return spikes
    return spikes.repeat_interleave(module.network.takes[0] // images.shape[1], dim=2)


@torch.no_grad()
def answers(module: ChipModule, task: Task, unseen: bool = True) -> Tensor:
    """Classes (R,) of the unseen images, or of those for training; spikes as in every call."""
    part = slice(task.split, None) if unseen else slice(task.split)
    spikes = arriving(module, task.images[part], torch.Generator().manual_seed(1))
    found: Tensor = module(spikes).sum(dim=0).argmax(dim=1)
    return found


def facts(rows: Sequence[Record]) -> Record:
    """Return what the page shows."""
    by = {name: [row for row in rows if row["chip"] == name] for name in CHIPS}
    return {
        "chips": {name: of for name, of in by.items() if of},
        "few_bits": [name for name in FEW_BITS if all(r["weights_only"] for r in by[name])],
        "seeds": len({row["seed"] for row in rows}),
        "percent": _percent,
        "CHIP_EPOCHS": CHIP_EPOCHS,
    }


def _percent(rows: Sequence[Record], column: str) -> str:
    """Return the mean of the trainings, least and most."""
    values = [row[column] for row in rows]
    low, high, mean = (100 * float(each(values)) for each in (min, max, np.mean))
    return f"{mean:.1f} ({low:.1f} to {high:.1f})"


EXPERIMENT = Experiment(
    name="digits",
    columns=(
        "chip", "seed", "inputs", "axons", "classes", "limits", "on_float", "on_chip", "differ",
        "trained", "clip", "weights_only", "weights_only_on_chip",
    ),
    texts=("chip", "limits"),
    jobs=jobs,
    measure=measure,
    facts=facts,
)  # fmt: skip
main = EXPERIMENT.main
