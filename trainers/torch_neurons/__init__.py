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
from typing import Any, NamedTuple

from torch import nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.trainers.torch_neurons.adapter import TorchNeurons
from spikedeploy.trainers.torch_neurons.norse import NorseNeurons
from spikedeploy.trainers.torch_neurons.sinabs import SinabsNeurons
from spikedeploy.trainers.torch_neurons.snntorch import SnnTorchNeurons
from spikedeploy.trainers.torch_neurons.spikingjelly import SpikingJellyNeurons


class _Library(NamedTuple):
    """A library: the adapter of its neurons, the known classes, and the bases of all neurons."""

    adapter: Callable[[Any, Shape], TorchNeurons]
    known: list[str]
    bases: list[str]


_NORSE = (
    "LIFCell LIF LIFRecurrentCell LIFRecurrent LIFBoxCell IAFCell IAF LICell LI LIBoxCell "
    "LILinearCell"
)
_LIBRARIES = {
    name: _Library(adapter, known.split(), bases.split())
    for name, adapter, known, bases in (
        ("snntorch", SnnTorchNeurons, "Leaky RLeaky Synaptic RSynaptic Lapicque", "SpikingNeuron"),
        ("norse", NorseNeurons, _NORSE, "SNNCell SNN SNNRecurrentCell SNNRecurrent"),
        (
            "sinabs",
            SinabsNeurons,
            "IAF IAFSqueeze LIF LIFSqueeze ExpLeak ExpLeakSqueeze",
            "StatefulLayer",
        ),
        (
            "spikingjelly",
            SpikingJellyNeurons,
            "IFNode LIFNode ParametricLIFNode",
            "BaseNode SimpleBaseNode",
        ),
    )
}
KNOWN = "; ".join(f"{name}: {', '.join(each.known)}" for name, each in _LIBRARIES.items())


def is_neurons(module: nn.Module) -> bool:
    """Return True for neurons of a library, also where they have no form on a chip."""
    return any(
        kind.__name__ in (*_LIBRARIES[name].known, *_LIBRARIES[name].bases)
        for name, kind in _classes(module)
    )


def neurons_of(name: str, module: nn.Module, takes: Shape) -> TorchNeurons | None:
    """Return the neurons of a module; None where it is none.

    name: for messages
    takes: shape of its input without batch and time

    Raises ConfigError for neurons that have no form on a chip.
    """
    if not is_neurons(module):
        return None
    classes = list(_classes(module))
    known = [(lib, kind) for lib, kind in classes if kind.__name__ in _LIBRARIES[lib].known]
    if not known:
        library = classes[0][0]
        raise ConfigError(
            f"{name}: {library}'s {type(module).__name__} has no form on a chip. Of {library} "
            f"these have: {', '.join(_LIBRARIES[library].known)}."
        )
    library, original = known[0]
    order = type(module).__mro__
    own = {
        each
        for kind in order[: order.index(original)]
        for each, value in vars(kind).items()
        if callable(value) and not each.startswith("__") and each != "extra_repr"
    }
    if changed := sorted(each for each in own if hasattr(original, each)):
        raise ConfigError(
            f"{name}: {type(module).__name__} is a {original.__name__} of {library} that has its "
            f"own {', '.join(changed)}, and may compute something else. Take {original.__name__} "
            "as it is; trained through a chip, it resets as the chip does."
        )
    try:
        return _LIBRARIES[library].adapter(module, takes)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from None


def _classes(module: nn.Module) -> Iterator[tuple[str, type]]:
    """Return the classes of known libraries that a module is of, with the library."""
    for kind in type(module).__mro__:
        library = kind.__module__.partition(".")[0]
        if library in _LIBRARIES:
            yield library, kind
