"""The nearest weights that the axons of a chip carry; gradients pass straight through.

Some chips keep a sign for each source (ODIN), others a weight for each type of axon (TrueNorth).
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

_SPREAD = 0.5  # of initial types of axons: the smaller weight over the larger one


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
        values: Tensor | None = None,
    ) -> None:
        super().__init__()
        self.limit = limit
        self.register_buffer("signs", signs)
        # a parameter stays the one that it is: layers with the same neurons share it
        self.values = None if values is None else nn.Parameter(values)
        if isinstance(values, nn.Parameter):
            self.values = values

    def forward(self, latent: Tensor) -> Tensor:
        """Return the weights (N, M, ...) that are deployed for those that are trained."""
        if self.values is not None:
            return self._crossbar(latent, self.values)
        fitting = latent.detach()
        if self.limit is not None:
            fitting = fitting.clamp(-self.limit, self.limit)
        if self.signs is not None:
            sign = self.signs.reshape(1, -1, *[1] * (latent.ndim - 2))
            fitting = sign * (sign * fitting).relu()
        return passing(fitting, latent)

    def _crossbar(self, latent: Tensor, values: Tensor) -> Tensor:
        types = values.shape[1]
        number = torch.arange(latent.shape[1])
        of_type = number % types
        # W[n, m] = g[n, type of m] at a connected crosspoint: where the latent weight has the sign
        # of the type. The first of each type reaches all neurons, so that whoever puts axons
        # together again by their weights, as design rules do, finds these types and no others
        sign = _turns(types)[of_type].to(latent.dtype)
        present = (sign * latent > 0) | (number < types)
        connected = passing(present.to(latent.dtype), sign * latent)
        clipped = values
        if self.limit is not None:
            clipped = passing(values.detach().clamp(-self.limit, self.limit), values)
        return connected * clipped[:, of_type]

    @torch.no_grad()
    def settle(self, weight: Tensor) -> None:
        """Set weights that an update gave another sign than their source's back to 0.

        Further away they would be 0 for many updates more.
        """
        if self.signs is not None:
            weight.copy_(self(weight))

    def spec(self) -> dict[str, Any]:
        """Return the shapes from which `from_spec` makes an equal one, for JSON."""
        types = None if self.values is None else list(self.values.shape)
        signs = None if self.signs is None else len(self.signs)
        return {"limit": self.limit, "signs": signs, "values": types}

    @classmethod
    def from_spec(
        cls, limit: float | None, signs: int | None, values: list[int] | None
    ) -> "Fitting":
        """Return one of these shapes, with numbers to be loaded."""
        return cls(
            limit,
            None if signs is None else torch.ones(signs),
            None if values is None else torch.ones(values),
        )


def passing(value: Tensor, gradient_to: Tensor) -> Tensor:
    """Return the value exactly; its gradient passes straight on to another tensor."""
    # x - x is 0, so that no rounding is added
    return value.detach() + (gradient_to - gradient_to.detach())


def _turns(count: int) -> Tensor:
    """Return 1 and -1 by turns."""
    return 1.0 - 2.0 * (torch.arange(count) % 2)


def typed_values(weights: Sequence[Tensor], types: int, limit: float | None = None) -> Tensor:
    """Return initial weights (N, K) of K types of axons, excitatory and inhibitory by turns.

    weights: (N, M) of each layer that leads to the neurons
    limit: magnitude of the larger of two types with a sign; None for the mean of the weights that
        have the sign of the type, over the axons of the type
    """
    sign, places = _turns(types), torch.div(torch.arange(types), 2, rounding_mode="floor")
    share = _SPREAD**places
    if limit is not None:
        neurons = len(weights[0])
        return (sign * limit * share).repeat(neurons, 1) * _varied(neurons, types)
    of_type = [
        torch.cat([(s * weight[:, k::types]).relu() for weight in weights], 1)
        for k, s in enumerate(sign.tolist())
    ]
    means = torch.stack([w.sum(1) / (w > 0).sum(1).clamp(min=1) for w in of_type], 1)
    return sign * means.clamp(min=1e-6)


def _varied(neurons: int, types: int) -> Tensor:
    return torch.empty(neurons, types).uniform_(0.8, 1.0)


def signs_by_turns(weight: Tensor) -> Tensor:
    """Return 1 or -1 for each source (M,): they excite and inhibit by turns."""
    return _turns(weight.shape[1])


def signs_by_majority(weights: Sequence[Tensor]) -> Tensor:
    """Return for each source (M,) the sign of the sum of its weights, 1 where it is 0."""
    total = torch.stack([w.transpose(0, 1).flatten(1).sum(1) for w in weights]).sum(0)
    return torch.where(total < 0, -1.0, 1.0)
