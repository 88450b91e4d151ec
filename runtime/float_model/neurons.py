"""Neurons in floating point: integration, spikes, and what a spike does to the membrane.

With r[t] = 1 where the membrane that the timestep before left is above the threshold,

    P[t] = b V[t-1] + I[t] + leak                      before a reset
    zero, subtract      spike where P > threshold, then V = v_reset, or V = P - height
    zero-delayed        V = b v_reset + I + leak where r, else P; of CubaLIF V = v_reset where r
    subtract-delayed    V = P - r height
    subtract-ahead      C = P - r height, spike where C > threshold, then V = C - (spike - r) height
    none                V = P

where height = threshold - v_reset, and where delayed neurons spike by V itself. The last four are
snnTorch's (snntorch 1.0.0, _neurons/leaky.py and synaptic.py): its default is subtract-delayed;
subtract-ahead is its subtraction with reset_delay=False, where a membrane that is still above the
threshold after its reset spikes again only above twice the threshold.
"""

from typing import Any, TypeAlias

import nir
import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ObservationError
from spikedeploy.runtime.graph.neurons import discretise
from spikedeploy.runtime.graph.sigma_delta import GRADED_MOST, SigmaDelta

Array: TypeAlias = NDArray[np.floating[Any]]
# resets that act in the timestep after a spike, or already ahead of the next one
_LATE = ("zero-delayed", "subtract-delayed", "subtract-ahead")


class FloatNeurons:
    """A layer of neurons; puts out its spikes, or its membranes where it has no threshold."""

    def __init__(
        self, name: str, node: nir.NIRNode, convention: Convention, dtype: DTypeLike
    ) -> None:
        layer = discretise(name, node, convention)
        self.name = name
        self.reset_mode = convention.reset
        self.late = layer.threshold is not None and convention.reset in _LATE
        self.spikes = convention.spikes
        self.a = None if layer.current_decay is None else layer.current_decay.astype(dtype)
        self.b = layer.membrane_decay.astype(dtype)
        self.gain = layer.gain.astype(dtype)
        self.leak = layer.leak.astype(dtype)
        self.threshold = None if layer.threshold is None else layer.threshold.astype(dtype)
        self.v_reset = layer.v_reset.astype(dtype)
        self.floor = _floor(layer.threshold, convention)
        self.current: Array | None = None
        self.membrane: Array | None = None

    def reset(self) -> None:
        """Set currents and membranes to 0."""
        self.current = self.membrane = None

    def __call__(self, x: Array) -> Array:
        """Spikes or membranes (B, T, *N) of the next T timesteps."""
        output = np.empty_like(x)
        current, membrane = self._state(x[:, 0])
        drive = x * self.gain
        for t in range(x.shape[1]):
            # I = a I + gain x
            current = drive[:, t] if self.a is None else self.a * current + drive[:, t]
            # V = b V + I + leak
            before = membrane
            membrane = self.b * membrane + current + self.leak
            if self.late:
                output[:, t], membrane = self._fire_late(before, membrane, current)
            else:
                output[:, t], membrane = self._fire(membrane)
        self.current, self.membrane = current, membrane
        return output

    def _fire(self, membrane: Array) -> tuple[NDArray[Any], Array]:
        """Output (B, *N) of this timestep, and the membrane after the reset."""
        if self.threshold is None:
            return membrane, membrane
        spikes = self._spikes(membrane, self.threshold)
        if self.reset_mode == "subtract":
            membrane = membrane - spikes * (self.threshold - self.v_reset)
        elif self.reset_mode == "zero":
            membrane = np.where(spikes, self.v_reset, membrane)
        return spikes, self._floored(membrane)

    def _fire_late(
        self, before: Array, membrane: Array, current: Array
    ) -> tuple[NDArray[Any], Array]:
        """Spikes (B, *N) of this timestep, and the membrane, reset by the spikes of the last one.

        before: (B, *N) membrane that the timestep before left.
        membrane: (B, *N) as it would be without a reset.
        """
        threshold = np.asarray(self.threshold)
        due = self._spikes(before, threshold)
        height = threshold - self.v_reset
        if self.reset_mode == "zero-delayed":
            # a LIF keeps its input of the timestep, a CubaLIF does not
            kept = self.b * self.v_reset + current + self.leak
            membrane = np.where(due, kept if self.a is None else self.v_reset, membrane)
        else:
            membrane = membrane - due * height
        spikes = self._spikes(membrane, threshold)
        if self.reset_mode == "subtract-ahead":
            membrane = membrane - (spikes.astype(int) - due) * height
        return spikes, self._floored(membrane)

    def _floored(self, membrane: Array) -> Array:
        return membrane if self.floor is None else np.maximum(membrane, self.floor)

    def _spikes(self, membrane: Array, threshold: Array) -> NDArray[Any]:
        """Number of spikes (B, *N) in this timestep."""
        if self.spikes == "above":
            return np.asarray(membrane > threshold)
        reached = membrane >= threshold
        if self.spikes == "reached":
            return np.asarray(reached)
        # n = floor((V - v_reset) / (threshold - v_reset))
        count = np.floor((membrane - self.v_reset) / (threshold - self.v_reset))
        return np.asarray(count * reached)

    def _state(self, like: Array) -> tuple[Array, Array]:
        """Current and membrane before the first timestep, of the shape of its input."""
        if self.current is None or self.membrane is None:
            return np.zeros_like(like), np.zeros_like(like)
        if self.membrane.shape != like.shape:
            raise ObservationError(
                f"node {self.name!r} holds the state of {len(self.membrane)} networks, the raster "
                f"is for {len(like)}. Call reset() between batches of different size."
            )
        return self.current, self.membrane


class SigmaDeltaNeurons(FloatNeurons):
    """A layer of sigma-delta neurons (runtime.graph.sigma_delta); puts out graded spikes.

    sent: (B, *N) graded spikes so far, added up.
    """

    def __init__(
        self,
        name: str,
        node: nir.NIRNode,
        convention: Convention,
        dtype: DTypeLike,
        neurons: SigmaDelta,
    ) -> None:
        super().__init__(name, node, convention, dtype)
        self.step = neurons.threshold.astype(dtype)
        self.bias = neurons.bias.astype(dtype)
        self.sent: Array | None = None

    def reset(self) -> None:
        """Set sigma to 0, as if nothing had been sent."""
        super().reset()
        self.sent = None

    def _fire(self, membrane: Array) -> tuple[NDArray[Any], Array]:
        """Graded spikes (B, *N) of this timestep, and sigma, which stays."""
        sent = np.zeros_like(membrane) if self.sent is None else self.sent
        # e = max(sigma + b, 0) / threshold - q
        apart = np.maximum(membrane + self.bias, 0) / self.step - sent
        far = np.abs(apart)
        graded = np.where(far >= 1, np.sign(apart) * np.floor(far + 0.5), 0)
        graded = np.clip(graded, -GRADED_MOST, GRADED_MOST)
        self.sent = sent + graded
        return graded, membrane


def _floor(threshold: NDArray[np.float64] | None, convention: Convention) -> Array | None:
    """Lower bound of the membranes (*N), or None where there is none."""
    if threshold is None or convention.floor == "none":
        return None
    return np.zeros_like(threshold) if convention.floor == "zero" else -threshold
