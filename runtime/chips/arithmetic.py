"""The arithmetic of a chip: everything in which the numbers of one chip differ from another's.

The compiler, the emulator, the design rules and the analysis use this interface and no other, so a
new family of chips is a class that implements it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import Field
from typing import Any, ClassVar, NamedTuple, NoReturn, Protocol

import numpy as np

from spikedeploy.runtime.chips.layer import (
    NEVER,
    Layer,
    LayerState,
    Network,
    Numbers,
    Recording,
    StepResult,
    Synapses,
    with_starts,
)
from spikedeploy.runtime.chips.quantisation import CHOICES, PLAIN, Quantisation
from spikedeploy.runtime.chips.registers import magnitude
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError, RuleError

_AT_THRESHOLD = (
    "neurons spike above their threshold; the convention says 'reached', at it too. They differ "
    "where a membrane on the chip is the threshold exactly"
)


class Description(NamedTuple):
    """An arithmetic in a few words each, for tables of datasheets."""

    neurons: str
    weights: str
    membrane: str


class ArithmeticDefaults(Protocol):
    """Defaults of an arithmetic, from which families inherit."""

    # whether its numbers differ from those of the network in float
    is_rounded: ClassVar[bool] = True
    # width of a graded spike between neurons [bits], with the sign; None where it has none
    graded_bits: ClassVar[int | None] = None
    choices: ClassVar[tuple[str, ...]] = ("rounding",)  # fields of Quantisation that can be chosen
    # spikes and floor that a convention must name; None where no source says
    spikes_and_floor: ClassVar[tuple[str, str] | None] = None
    # kinds of rounding, one after another, that take the network to the chip; or none
    ablation_steps: ClassVar[tuple[str, ...]] = ()
    # name of the published model of the time that it takes, other than a table of times
    time_model: ClassVar[str | None] = None

    @property
    def backends(self) -> Mapping[str, str]:
        """Name -> "module:class" of each backend, besides the interpreter, that has kernels."""
        return {}

    @property
    def input_spikes_max(self) -> int:
        """Spikes of an input channel in a timestep."""
        return 1

    @property
    def weights_have_signs(self) -> bool:
        """True where one of a weight's bits is its sign; else a list or an axon has it."""
        return True

    @property
    def own_weights(self) -> bool:
        """True where every synapse has a weight of its own."""
        return True

    @property
    def weight_max(self) -> int:
        """Largest weight: one bit is the sign where `weights_have_signs`."""
        bits: int = getattr(self, "weight_bits")  # noqa: B009 (families define it)
        return int((1 << (bits - self.weights_have_signs)) - 1)

    @property
    def threshold_range(self) -> tuple[int, int]:
        """Step and largest threshold [state units], of chips that compute in integers."""
        return 1, NEVER - 1

    @property
    def all_at_once(self) -> bool:
        """True where all layers advance as one: spikes reach others in the same timestep."""
        return False

    @property
    def by_events(self) -> bool:
        """True where neurons are looked at only when an event reaches them, one after another."""
        return False

    def update_together(
        self,
        network: Network,
        presynaptic: Mapping[str, Sequence[Numbers]],
        states: Mapping[str, LayerState],
    ) -> Mapping[str, StepResult]:
        """Advance all layers by one timestep, where they do so `all_at_once`; else none.

        presynaptic: layer -> spikes (B, M) through each of its synapses; those of the input count.
        """
        return {}

    # what can be compiled

    def check_convention(self, convention: Convention, chip_name: str) -> None:
        """Refuse conventions by which the neurons cannot spike."""
        if convention.spikes not in ("above", "reached") or convention.floor != "none":
            refuse_convention(convention, chip_name)

    def check_quantisation(self, quantisation: Quantisation, chip_name: str) -> None:
        """Refuse choices that the arithmetic lacks."""
        for option in CHOICES:
            found = getattr(quantisation, option)
            if option not in self.choices and found != getattr(PLAIN, option):
                raise ConfigError(
                    f"{option} is {found!r}; on {chip_name} only {' and '.join(self.choices)} can "
                    "be chosen. Leave it out, or choose another chip."
                )

    def prepare(
        self, layers: Sequence[Layer], source: str, convention: Convention, delay: int, waits: bool
    ) -> tuple[list[Layer], list[str]]:
        """The float layers with starts and delays, and remarks on what is not as in the file.

        layers: with the lags of the graph for delays, all starting at once.
        source: name of the network's input.
        delay: [timesteps] from a spike to its arrival on the chip.
        waits: start each layer when the first spikes can reach it.
        """
        differs = convention.spikes == "reached" and not self.spikes_at_threshold
        remarks = [_AT_THRESHOLD] if differs else []
        input_delay = self.input_delay(delay)
        return with_starts(layers, source, delay, waits, input_delay), remarks

    def input_delay(self, delay: int) -> int:
        """Delay of the network's input [timesteps] on a chip with this delay of spikes."""
        return delay

    def check_output(self, network: Network) -> None:
        """Refuse an output layer whose spikes cannot leave the chip."""
        return

    def ranges(self, layers: Sequence[Layer], timesteps: int | None) -> list[str]:
        """Return a warning for each quantised layer whose leak does not bound its registers.

        timesteps: T of an inference; None where it is not known, or states are kept.
        """
        return []

    def transport_remarks(self, layers: Sequence[Layer], network_input: str) -> list[str]:
        """Return a remark on the transport of spikes between neurons, where that is a choice."""
        return []

    # used by the design rules

    @property
    def spikes_at_threshold(self) -> bool:
        """True where a membrane equal to the threshold spikes, not only one above it."""
        return False

    @property
    def weight_lists(self) -> int:
        """Lists that hold the weights of an axon: 2 where each sign has its own."""
        return 1

    # used by the analysis and the metrics

    @property
    def decay_one(self) -> int:
        """The decay factor that keeps everything, as a layer stores it."""
        return 1

    def partly_rounded(self, before: Layer, after: Layer, step: str) -> Layer:
        """The layer in float64 and state units, rounded up to one of the ablation steps.

        before, after: in float, and as quantised.
        """
        raise ConfigError(f"rounding step {step!r}: this arithmetic has no such step.")

    def before_reset(self, layer: Layer, convention: Convention, ran: Recording) -> Numbers:
        """Membranes (B, T, N) before a spike reset them [state units]; NaN where none can tell.

        ran: what the layer did.
        """
        if not layer.spiking:
            return ran.membrane
        if convention.reset == "subtract":
            return np.asarray(ran.membrane + layer.threshold * ran.spikes)
        return np.where(ran.spikes > 0, np.nan, ran.membrane)


class Arithmetic(ArithmeticDefaults, Protocol):
    """The full interface of an arithmetic, including what every family must define itself.

    It is a frozen dataclass, whose fields are options of the chip.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def weight_bits(self) -> int:
        """Width of a weight [bits]; the sign is none of them where a list says it."""

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]."""

    @property
    def spikes_max(self) -> int:
        """Spikes of a neuron in a timestep."""

    def quantise(
        self, network: Network, quantisation: Quantisation, timesteps: int | None, limits: bool
    ) -> Sequence[Layer]:
        """The float layers of the network in the numbers of the chip.

        timesteps: T of an inference; None where it is not known, or states are kept.
        limits: False leaves out the rules that are about capacity and not about the arithmetic.
        """

    def update(
        self, network: Network, layer: Layer, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""

    def describe(self) -> Description:
        """Neurons, weights and membrane in a few words each."""


def check_weights_left(layer: Layer, synapses: Sequence[Synapses], why: str) -> None:
    """Refuse the layer if all of its weights become 0 in these synapses.

    why: the number beside which the largest weight is too small, and what to do.
    """
    before = max(magnitude(s.weight) for s in layer.synapses)
    if before > 0 and not any(s.weight.any() for s in synapses):
        raise RuleError(
            f"rule weight-bits: layer {layer.name!r}: every weight becomes 0. The largest, "
            f"{before:g}, is too small {why}"
        )


def check_thresholds(layer: Layer, whole: Numbers, why: str) -> Numbers:
    """Refuse thresholds below 0, and those above it that became 0; return the whole ones (N,).

    why: the number beside which those are too small, and what to do.
    """
    if (layer.threshold < 0).any():
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold {layer.threshold.min():g} is "
            "below 0; the chip's thresholds are not. Train with positive thresholds."
        )
    lost = (whole == 0) & (layer.threshold > 0)
    if lost.any():
        least = layer.threshold[lost].min()
        raise RuleError(
            f"rule threshold-range: layer {layer.name!r}: threshold {least:g} becomes 0 {why}"
        )
    return whole


def refuse_convention(convention: Convention, chip_name: str) -> NoReturn:
    """Refuse conventions other than one spike above the threshold, and no floor."""
    raise RuleError(
        f"rule convention: spikes {convention.spikes!r}, floor {convention.floor!r}: a neuron "
        f"on {chip_name} sends one spike where its membrane is above the threshold, and its "
        "membrane has no floor. Run in float."
    )
