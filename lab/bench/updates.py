"""How long a training update through each chip takes, against snnTorch's own of the same module.

    python -m lab updates [--rounds 7] [--chips loihi1,odin] [--networks 64-96-10] [--json]

One process, one thread. An update is the forward pass, cross-entropy of the summed spikes, the
backward pass and a step of Adam. Both train the same torch module: snnTorch by its own loop over
timesteps, in float; ours through `on_chip`, whose forward pass is the chip's integers. They take
turns, and the medians are compared. Neurons and resets are the nearest that snnTorch has to those
of each chip; design rules are off, but convolutions run only where a chip has some.

Weights are those that torch draws times GAIN, or LESS for chips whose membranes forget inhibition,
for which hidden neurons spike in about a tenth of timesteps; inputs are independent spikes, in a
fifth of timesteps.
"""

import sys
import warnings
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from lab.bench.turns import medians, parser_of, report
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.backend import backend_class
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.trainers.through_chip import on_chip

CHIPS = (
    "loihi1", "loihi2", "spinnaker2", "spiker", "speck2f", "truenorth", "xylo-a2", "odin",
    "tinyodin", "ideal",
)  # fmt: skip
RATE, GAIN, CLASSES = 0.2, 3.0, 10
LESS = {"odin": 1.0, "tinyodin": 2.0}


class Size(NamedTuple):
    """A network and what it is trained with: fully connected, or convolutions in front."""

    takes: tuple[int, ...]
    hidden: tuple[int, ...]
    timesteps: int
    batch: int


NETWORKS = {
    "64-96-10": Size((64,), (96,), 12, 64),
    "2x34x34": Size((2, 34, 34), (), 20, 16),
    "128-256-256-10": Size((128,), (256, 256), 50, 64),
}


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = parser_of(__doc__, 7)
    parser.add_argument("--chips", default=",".join(CHIPS), help="names between commas")
    parser.add_argument("--networks", default=",".join(NETWORKS), help="likewise")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    # where the chip has another reset than snnTorch, on_chip says so
    warnings.simplefilter("ignore")
    result: dict[str, Any] = {}
    for size in arguments.networks.split(","):
        result[size] = {}
        for name in arguments.chips.split(","):
            if not holds(size, name):
                continue
            result[size][name] = compare(size, name, arguments.rounds)
            print(f"  {size} {name}: {result[size][name]['time']:.2f}", file=sys.stderr, flush=True)
    report(result, arguments)


def holds(size: str, chip_name: str) -> bool:
    """Return whether the chip has convolutions, where the network has."""
    limits = chip(chip_name).limits
    return len(NETWORKS[size].takes) == 1 or limits is None or "Conv2d" in limits.primitives


def compare(size: str, chip_name: str, rounds: int) -> dict[str, Any]:
    """Medians [ms] of both, and which backend ran."""
    candidates, _ = updates(size, chip_name), torch.manual_seed(0)
    taken = medians({name: [update] for name, update in candidates.items()}, rounds)
    through = on_chip(module(size, chip_name), chip_name, NETWORKS[size].takes, limits=False)
    return {
        "median_ms": {name: us / 1e3 for name, us in taken.items()},
        "time": taken["chip"] / taken["snntorch"],
        "backend": backend_class(through.program(), "auto").__name__,
    }


def updates(size: str, chip_name: str, batch: int | None = None) -> dict[str, Callable[[], object]]:
    """An update through the chip and snnTorch's own, of modules with the same numbers."""
    from snntorch import utils

    of, found = NETWORKS[size], {}
    torch.manual_seed(0)
    batch = batch or of.batch
    raster = (torch.rand(of.timesteps, batch, *of.takes) < RATE).float()
    labels = torch.randint(0, CLASSES, (batch,))
    own, to_chip = module(size, chip_name), module(size, chip_name)

    def by_timesteps(rows: Tensor) -> Tensor:
        utils.reset(own)
        return torch.stack([own(row) for row in rows.unbind()])

    through = on_chip(to_chip, chip_name, of.takes, limits=False)
    runs = {"snntorch": (own, by_timesteps), "chip": (to_chip, through)}
    for name, (trained, run) in runs.items():
        optimiser = torch.optim.Adam(trained.parameters(), 1e-3)
        found[name] = partial(_update, run, optimiser, raster, labels)
    return found


def _update(
    run: Callable[[Tensor], Tensor],
    optimiser: torch.optim.Optimizer,
    raster: Tensor,
    labels: Tensor,
) -> None:
    optimiser.zero_grad()
    nn.functional.cross_entropy(run(raster).sum(dim=0), labels).backward()
    optimiser.step()


def module(size: str, chip_name: str) -> nn.Sequential:
    """The torch module, with the same numbers each time, in front of a chip's neurons."""
    torch.manual_seed(1)
    of, neurons = NETWORKS[size], neurons_on(chip_name)
    layers: list[nn.Module] = []
    if len(of.takes) == 3:
        layers += [nn.Conv2d(2, 8, 5, 2, bias=False), neurons()]
        layers += [nn.Conv2d(8, 16, 3, 2, bias=False), neurons()]
        layers += [nn.Flatten(), nn.Linear(16 * 7 * 7, CLASSES, bias=False), neurons()]
    else:
        for inputs, outputs in pairwise((*of.takes, *of.hidden, CLASSES)):
            layers += [nn.Linear(inputs, outputs, bias=False), neurons()]
    made = nn.Sequential(*layers)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.mul_(LESS.get(chip_name, GAIN))
    return made


def neurons_on(chip_name: str) -> Callable[[], nn.Module]:
    """A maker of the neurons of snnTorch that are nearest to the chip's."""
    import snntorch

    target = chip(chip_name)
    leaks = target.limits is None or target.limits.membrane_loss != (0.0, 0.0)
    settings: dict[str, Any] = {
        "beta": 0.9 if leaks else 1.0,
        "reset_mechanism": "zero" if "zero" in target.resets else "subtract",
        "reset_delay": False,
        "init_hidden": True,
    }
    if isinstance(target.arithmetic, XyloArithmetic):
        return partial(snntorch.Synaptic, alpha=0.5, **settings)
    return partial(snntorch.Leaky, **settings)
