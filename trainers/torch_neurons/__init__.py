"""Neurons of other libraries as difference equations: what each class means by its settings.

adapter.py       what an adapter is
snntorch.py      Leaky, Synaptic and Lapicque, with and without recurrence
norse.py         LIF, LIFBox, IAF, LI and LIBox; cells and over time
sinabs.py        IAF, LIF and ExpLeak
spikingjelly.py  IFNode, LIFNode and ParametricLIFNode

`neurons_of` finds the adapter of a module by the names of its class and library. No library is
imported, but Norse where a module is of it.
"""

from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

from torch import nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_neurons.adapter import TorchNeurons
from spikedeploy.trainers.torch_neurons.norse import NorseNeurons
from spikedeploy.trainers.torch_neurons.sinabs import SinabsNeurons
from spikedeploy.trainers.torch_neurons.snntorch import SnnTorchNeurons
from spikedeploy.trainers.torch_neurons.spikingjelly import SpikingJellyNeurons

_Kind: TypeAlias = Callable[[Any, Shape], TorchNeurons]
_NORSE = "LIFCell LIF LIFRecurrentCell LIFRecurrent LIFBoxCell IAFCell IAF LICell LI LIBoxCell"
_LIBRARIES: dict[str, tuple[_Kind, tuple[str, ...]]] = {
    "snntorch": (SnnTorchNeurons, ("Leaky", "RLeaky", "Synaptic", "RSynaptic", "Lapicque")),
    "norse": (NorseNeurons, (*_NORSE.split(), "LILinearCell")),
    "sinabs": (
        SinabsNeurons,
        ("IAF", "IAFSqueeze", "LIF", "LIFSqueeze", "ExpLeak", "ExpLeakSqueeze"),
    ),
    "spikingjelly": (SpikingJellyNeurons, ("IFNode", "LIFNode", "ParametricLIFNode")),
}
# what all neurons of a library are
_BASES = {
    "snntorch": ("SpikingNeuron",),
    "norse": ("SNNCell", "SNN", "SNNRecurrentCell", "SNNRecurrent"),
    "sinabs": ("StatefulLayer",),
    "spikingjelly": ("BaseNode", "SimpleBaseNode"),
}
KNOWN = "; ".join(f"{library}: {', '.join(kinds)}" for library, (_, kinds) in _LIBRARIES.items())


def is_neurons(module: nn.Module) -> bool:
    """Return True for neurons of a library, also where they have no form on a chip."""
    return any(
        kind.__name__ in (*_LIBRARIES[library][1], *_BASES[library])
        for library, kind in _classes(module)
        if library in _LIBRARIES
    )


def neurons_of(name: str, module: nn.Module, takes: Shape) -> TorchNeurons | None:
    """Return the neurons of a module; None where it is none.

    name: for messages
    takes: shape of its input without batch and time

    Raises ConfigError for neurons that have no form on a chip.
    """
    if not is_neurons(module):
        return None
    changed: set[str] = set()
    for library, kind in _classes(module):
        make, kinds = _LIBRARIES.get(library, (None, ()))
        if make is not None and kind.__name__ in kinds:
            break
        changed |= {each for each in vars(kind) if callable(vars(kind)[each])}
    else:
        library = next(library for library, _ in _classes(module) if library in _LIBRARIES)
        raise ConfigError(
            f"{name}: {library}'s {type(module).__name__} has no form on a chip. Of {library} "
            f"these have: {', '.join(_LIBRARIES[library][1])}."
        )
    plain = {each for each in changed if each.startswith("__") or each == "extra_repr"}
    ours = {each for each in changed - plain if hasattr(kind, each)}
    if ours:
        raise ConfigError(
            f"{name}: {type(module).__name__} is a {kind.__name__} of {library} that has its own "
            f"{', '.join(sorted(ours))}, and may compute something else. Take {kind.__name__} as "
            "it is; trained through a chip, it resets as the chip does."
        )
    try:
        return make(module, takes)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from None


def _classes(module: nn.Module) -> Iterator[tuple[str, type]]:
    """Return the classes that a module is of, with their libraries."""
    for kind in type(module).__mro__:
        yield kind.__module__.partition(".")[0], kind
