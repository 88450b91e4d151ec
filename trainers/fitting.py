"""The nearest weights that the axons of a chip carry; gradients pass straight through.

Some chips keep a sign for each source (ODIN), others a weight for each type of axon (TrueNorth).
`fit` makes the weights of a network so.
"""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor, nn

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.trainers.torch_network import Delay, Fixed, Neurons, TorchNetwork, Weights

_SPREAD = 0.5  # of initial types of axons: the smaller weight over the larger one
_SAME = 1e-6  # of the sum of weights, by which they may differ after they were fitted


class Fitting(nn.Module):
    """Weights as the axons of a chip carry them.

    limit: largest magnitude of a weight [of the layer's weights]; None for none
    signs: (M,) 1 or -1 of each source, where axons have signs; else None
    values: (N, K) weight of each neuron for each type of axon, where axons have K types; else None
    """

    signs: Tensor | None
    values: nn.Parameter | None

    def __init__(
        self,
        limit: float | None = None,
        signs: Tensor | None = None,
        values: nn.Parameter | None = None,
    ) -> None:
        super().__init__()
        self.limit = limit
        self.register_buffer("signs", signs)
        self.values = values  # layers onto the same neurons share it

    def forward(self, latent: Tensor) -> Tensor:
        """Return the weights (N, M, ...) that are deployed for those that are trained."""
        if self.values is not None:
            return self._crossbar(latent, self.values)
        fitting = self._clipped(latent.detach())
        if self.signs is not None:
            sign = self.signs.reshape(1, -1, *[1] * (latent.ndim - 2))
            fitting = sign * (sign * fitting).relu()
        return straight_through(fitting, latent)

    def _clipped(self, weight: Tensor) -> Tensor:
        return weight if self.limit is None else weight.clamp(-self.limit, self.limit)

    def _crossbar(self, latent: Tensor, values: Tensor) -> Tensor:
        types = values.shape[1]
        number = torch.arange(latent.shape[1])
        of_type = number % types
        # W[n, m] = g[n, type of m] at a connected crosspoint: where the latent weight has the sign
        # of the type. The first of each type reaches all neurons, so that whoever puts axons
        # together again by their weights, as design rules do, finds these types and no others
        sign = alternating(types)[of_type].to(latent.dtype)
        present = (sign * latent > 0) | (number < types)
        connected = straight_through(present.to(latent.dtype), sign * latent)
        return connected * straight_through(self._clipped(values.detach()), values)[:, of_type]

    @torch.no_grad()
    def project(self, weight: Tensor) -> None:
        """Set weights that an update gave another sign than their source's back to 0.

        Further away they would be 0 for many updates more.
        """
        if self.signs is not None:
            weight.copy_(self(weight))


def straight_through(value: Tensor, gradient_to: Tensor) -> Tensor:
    """Return the value exactly; its gradient passes straight on to another tensor."""
    # x - x is 0, so that no rounding is added
    return value.detach() + (gradient_to - gradient_to.detach())


def alternating(count: int) -> Tensor:
    """Return 1, -1, 1, ... (count,)."""
    return 1.0 - 2.0 * (torch.arange(count) % 2)


def fit(network: TorchNetwork, target: Chip, limit: float | None = None) -> str:
    """Make weights fit the axons of a chip; return what that changes, empty where nothing.

    limit: largest magnitude of a weight, too

    Sources get the sign of most of their weights; axons are of types by turns. Where layers of
    several shapes read a source, or a convolution would need types, nothing is done, and the
    design rule of the chip says so.
    """
    arithmetic = target.arithmetic
    types = 0 if arithmetic.own_weights else int(getattr(arithmetic, "axon_types", 0))
    signed = bool(target.limits and target.limits.axon_signs)
    fitted = [*_fit_types(network, types, limit)] if types else []
    fitted += _fit_signs(network, limit) if signed else []
    if limit is not None:
        for node in network.nodes.values():
            if isinstance(node, Weights) and node.fitting is None:
                node.fitting = Fitting(limit)
    return _changed_by(fitted, target.name, types)


def _fit_signs(network: TorchNetwork, limit: float | None) -> Iterator[Weights]:
    groups: dict[frozenset[str], list[Weights]] = {}
    for name, node in network.nodes.items():
        if isinstance(node, Weights):
            groups.setdefault(frozenset(_origins(network, name)), []).append(node)
    for origins, readers in groups.items():
        weights = [each.layer.weight.detach() for each in readers]
        alone = all(origins.isdisjoint(other) for other in groups if other != origins)
        ungrouped = all(getattr(each.layer, "groups", 1) == 1 for each in readers)
        if alone and ungrouped and len({(w.ndim, w.shape[1]) for w in weights}) == 1:
            total = torch.stack([w.transpose(0, 1).flatten(1).sum(1) for w in weights]).sum(0)
            for each in readers:
                each.fitting = Fitting(limit, signs=torch.where(total < 0, -1.0, 1.0))
                yield each


def _origins(network: TorchNetwork, name: str) -> set[str]:
    """Return the neurons, or the input, whose spikes reach a node without other weights."""
    found: set[str] = set()
    for source in network.sources(name):
        is_between = isinstance(network.nodes.get(source), Fixed | Delay)
        found |= _origins(network, source) if is_between else {source}
    return found


def _fit_types(network: TorchNetwork, types: int, limit: float | None) -> Iterator[Weights]:
    for name, neurons in network.nodes.items():
        before = [network.nodes.get(source) for source in network.sources(name)]
        layers = [each for each in before if isinstance(each, Weights)]
        if isinstance(neurons, Neurons) and all(w.layer.weight.ndim == 2 for w in layers):
            weights = [each.layer.weight.detach() for each in layers]
            values = nn.Parameter(typed_values(weights, types, limit)) if weights else None
            for each in layers:
                each.fitting = Fitting(limit, values=values)
                yield each


def typed_values(weights: Sequence[Tensor], types: int, limit: float | None = None) -> Tensor:
    """Return initial weights (N, K) of K types of axons, excitatory and inhibitory by turns.

    weights: (N, M) of each layer that leads to the neurons
    limit: magnitude of the larger of two types with a sign; None for the mean of the weights that
        have the sign of the type, over the axons of the type
    """
    sign, neurons = alternating(types), len(weights[0])
    if limit is not None:
        share = _SPREAD ** torch.div(torch.arange(types), 2, rounding_mode="floor")
        return sign * limit * share * torch.empty(neurons, types).uniform_(0.8, 1.0)
    of_type = [
        torch.cat([(s * weight[:, k::types]).relu() for weight in weights], 1)
        for k, s in enumerate(sign.tolist())
    ]
    means = torch.stack([w.sum(1) / (w > 0).sum(1).clamp(min=1) for w in of_type], 1)
    return sign * means.clamp(min=1e-6)


@torch.no_grad()
def _changed_by(fitted: Sequence[Weights], chip_name: str, types: int) -> str:
    """Return a sentence on what the axons of a chip make of weights; empty if they stay."""
    moved, whole = 0.0, 0.0
    for each in fitted:
        weight, deployed = each.layer.weight, each.numbers()[0]
        moved += float((deployed - weight).abs().sum()) if each.norm is None else 0.0
        whole += float(weight.abs().sum())
    if moved <= _SAME * whole:
        return ""
    axons = f"{types} weights for each neuron" if types else "one sign for each source"
    return (
        f"{chip_name} has {axons}: {100 * moved / whole:.0f} % of the weights, by magnitude, "
        "change for it, and the network computes something else until it is trained"
    )
