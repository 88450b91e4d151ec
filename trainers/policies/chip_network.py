"""Policies that are a network of neurons on a chip, between a code and a linear readout.

    observation -> code -> the network -> linear map of its output, the mean over T -> action

The network is a torch module of the user, a NIR file, or `chain`, layers of a chip's own neurons.
Its forward pass is the chip's (trainers.through_chip), from states of 0 in each inference.
"""

import inspect
import math
import sys
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.envs.foreign import attribute, contained, import_target, is_target
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.codec.codec import (
    Codec,
    Encoder,
    Normaliser,
    PopulationEncoder,
    RateEncoder,
)
from spikedeploy.runtime.convention import Convention, Reset
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import NetworkConfig
from spikedeploy.trainers.fitting import alternating, fit
from spikedeploy.trainers.from_torch import network_from_torch
from spikedeploy.trainers.policies.delta_policy import DT
from spikedeploy.trainers.policies.policy import Head, Latent
from spikedeploy.trainers.policies.spiking import (
    CodedPolicy,
    PopsanPolicy,
    TorchPopulationEncoder,
    TorchRateEncoder,
)
from spikedeploy.trainers.surrogate_neurons import mean_rate
from spikedeploy.trainers.through_chip import ChipModule, convention_on, nearest_remark
from spikedeploy.trainers.torch_network import (
    FreeNeurons,
    TorchNetwork,
    Weights,
    network_of,
    to_array,
)

THRESHOLD = 1.0  # of every neuron of a chain; the compiler scales it with the weights
READOUT = "readout"  # node of the file
_OVERLAP = 0.6  # initial width of a receptive field, over the distance to the next
_FIELDS = 8  # of an observation, unless the chip has too few inputs
_LARGEST = 0.5  # weight [thresholds]


class NetworkPolicy(CodedPolicy):
    """A network on a chip between an encoder and a readout.

    network: its numbers are parameters of the policy
    settings: chip, code, timesteps, readout and surrogate; without settings.network the network is
        a `chain`, whose weights have limits, and of which capacities are not checked
    reset: reset of the neurons, where the chip has it
    at_threshold: whether neurons spike at the threshold already, where the chip leaves a choice
    readout: nn.Linear from the network's output, spikes or membranes, to `Latent.mean`
    changed: what the axons of the chip make of the network's weights, in a sentence
    """

    kind = "network"

    def __init__(
        self,
        observations: int,
        actions: int,
        network: TorchNetwork | Mapping[str, Any],
        settings: NetworkConfig,
        reset: Reset = "subtract",
        at_threshold: bool = False,
        clip: float = 4.0,
        head: Head = "continuous",
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.head = observations, actions, head
        self.settings, c = settings, settings
        self.coding, self.timesteps = c.coding, c.timesteps
        made = network if isinstance(network, TorchNetwork) else TorchNetwork.from_spec(**network)
        self.target = datasheet(c.chip)
        spikes = "reached" if at_threshold else "above"
        wanted = Convention(DT, reset, source="as trained", spikes=spikes)  # type: ignore[arg-type]
        stated = convention_on(self.target, wanted)
        self.reset, self.at_threshold = stated.reset, at_threshold
        populations = _populations(self.target, observations, c)
        width = self._add_code(observations, populations, c.reach, clip)
        if isinstance(self.encoder, TorchPopulationEncoder):
            # few fields: wide enough that no number between two of them is unseen
            spacing = 2 * c.reach / max(populations - 1, 1)
            nn.init.constant_(self.encoder.log_std, math.log(_OVERLAP * spacing))
        if math.prod(made.takes) != width:
            raise ConfigError(
                f"{c.network or 'the network'} takes {math.prod(made.takes)} inputs, and the code "
                f"of {observations} observations has {width}: {observations} x {populations} of a "
                "population code, 1 for each of a rate. Set policy.populations or policy.coding, "
                "or give its constructor the argument inputs."
            )
        limit = None if c.network else _largest_weight(self.target, c)
        limits = c.limits and bool(c.network)
        self.changed = fit(made, self.target, limit) if limits or limit is not None else ""
        surrogate = c.surrogate, c.surrogate_width
        self.module = ChipModule(
            made, self.target, stated, None, limits, *surrogate, detach_reset=True
        )
        self.latent_size = math.prod(made.puts)
        self.readout = nn.Linear(self.latent_size, actions)

    @property
    def network(self) -> TorchNetwork:
        """The network between code and readout."""
        return self.module.network

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        return super().spec() | {"settings": self.settings.model_dump(mode="json")}

    def layers_of(self, raster: Tensor) -> dict[str, Tensor]:
        """Return the spikes (T, B, N) of every spiking layer by its name."""
        shaped = raster.reshape(*raster.shape[:2], *self.network.takes)
        if not torch.is_grad_enabled():
            found = self.module.layers(shaped)
        else:
            self.module(shaped)
            names = {layer.name for layer in self.module.program().spiking}
            found = {name: rows for name, rows in self.module.spikes.items() if name in names}
        return {name: rows.flatten(2) for name, rows in found.items()}

    def forward_spikes(self, raster: Tensor) -> Latent:
        """Return the output for input spikes (T, B, M); rates where gradients are recorded."""
        output = self.module(raster.reshape(*raster.shape[:2], *self.network.takes)).flatten(2)
        hidden = output[-1] if self.settings.score == "last" else output.mean(0)
        rates: tuple[Tensor, ...] = ()
        if torch.is_grad_enabled():
            rates = tuple(
                mean_rate(self.module.spikes[layer.name]) for layer in self.module.program().spiking
            )
        return Latent(self.readout(hidden), hidden, rates)

    def artifact(self, origin: Provenance | None = None, dt: float = DT) -> Artifact:
        """Return the policy as an artifact, every number in float64: the network, then readout."""
        network, name = self.network, READOUT
        while name in network.names:
            name += "_"
        behind = Weights(self.readout, (self.latent_size,))
        edges = [(a, name if b == network.OUTPUT else b) for a, b in network.edges]
        whole = TorchNetwork(
            {**network.nodes, name: behind},
            [*edges, (name, network.OUTPUT)],
            network.takes,
            behind.puts,
        )
        return whole.artifact(replace(self.module.convention, dt=dt), codec_of(self), origin)


def codec_of(policy: CodedPolicy | PopsanPolicy) -> Codec:
    """Return normaliser, encoder and decoder, as a file holds them."""
    normalizer = policy.normalizer
    return Codec(
        Normaliser(to_array(normalizer.mean), to_array(normalizer.std), normalizer.clip),
        _encoder(policy.encoder),
        policy.timesteps,
        "argmax" if policy.head == "discrete" else "tanh",
        policy.settings.score if isinstance(policy, NetworkPolicy) else "mean",
    )


def _encoder(encoder: nn.Module) -> Encoder:
    if isinstance(encoder, TorchRateEncoder):
        return RateEncoder(to_array(encoder.low), to_array(encoder.high), encoder.mode)
    if isinstance(encoder, TorchPopulationEncoder):
        return PopulationEncoder(to_array(encoder.mean), to_array(encoder.std), encoder.threshold)
    raise ConfigError(f"{type(encoder).__name__} has no form in a file; add it to {__name__}")


def _populations(target: Chip, observations: int, config: NetworkConfig) -> int:
    """Return the neurons of the code for each observation.

    As many as the inputs of the chip allow, at most 8, unless the configuration says; an even
    number where axons have signs, so that each observation has axons of both.
    """
    if config.coding != "population":
        return 1
    inputs = target.limits.inputs if target.limits else None
    most = _FIELDS if inputs is None else min(_FIELDS, inputs // observations)
    if target.limits and target.limits.axon_signs:
        most -= most % 2
    if most < 2 and config.populations is None:
        raise ConfigError(
            f"{target.name} has {inputs} inputs, too few for two neurons of a population code for "
            f"each of {observations} observations. Choose --set policy.coding=regular, or another "
            "chip."
        )
    return config.populations or most


# -- making a policy


def network_policy(
    config: NetworkConfig, observations: int, actions: int, clip: float, head: Head
) -> NetworkPolicy:
    """Return the policy of a module:Class, of a NIR file, or of a chip's own neurons."""
    sizes = observations, actions
    target = datasheet(config.chip)
    if not config.network:
        if config.chip == "ideal":
            raise ConfigError(
                "name a network, --network my_module:Net or net.nir, or a chip whose own neurons "
                "make one, --for xylo-a2"
            )
        inputs = observations * _populations(target, observations, config)
        network = chain(target, inputs, config)
        return NetworkPolicy(*sizes, network, config, clip=clip, head=head)
    started: tuple[Codec, Weights] | None = None
    if is_target(config.network) and not Path(config.network).exists():
        network, wanted = _from_module(config, observations, actions)
    else:
        artifact = _read(config.network)
        network, wanted = network_of(artifact), artifact.convention
        if artifact.codec is not None:
            network, readout = _without_readout(config.network, network)
            started = artifact.codec, readout
            config = _continued(config, started, sizes, head)
            clip = artifact.codec.normaliser.clip
    config = _matching(config, math.prod(network.takes), observations)
    policy = NetworkPolicy(
        *sizes, network, config, wanted.reset, wanted.spikes == "reached", clip, head
    )
    policy.module.program()  # what does not fit is refused here
    _warn(policy.changed)
    _warn(nearest_remark(target, policy.module.convention, wanted))
    if config.chip == "ideal":
        _warn("the network is trained on 'ideal', which rounds nothing: --for CHIP names a chip")
    if started is not None:
        _start_from(policy, *started)
    return policy


def _matching(config: NetworkConfig, inputs: int, observations: int) -> NetworkConfig:
    """Return settings with as many neurons of the code as the network has inputs for."""
    fits = config.coding == "population" and inputs % observations == 0
    if config.populations is not None or not fits:
        return config
    return config.model_copy(update={"populations": inputs // observations})


def _warn(remark: str) -> None:
    """Print what the user should know of the network, on stderr."""
    if remark:
        print(remark, file=sys.stderr)


def _largest_weight(target: Chip, config: NetworkConfig) -> float:
    """Return the largest magnitude of a weight of a chain [thresholds].

    By default at most 0.5, with which the threshold is a whole number: 7/16 of 3 bits, 15/32 of 5
    bits with the sign, 127/256 of 8.
    """
    if config.limit is not None:
        return config.limit
    most = getattr(target.arithmetic, "weight_range", (0, 1))[1]
    return float(most / 2.0 ** math.ceil(math.log2(most / _LARGEST)))


def chain(target: Chip, inputs: int, config: NetworkConfig) -> TorchNetwork:
    """Return layers of neurons, and with weights, that the chip has.

    All neurons are without bias, so that a layer that no spike has reached yet stays at 0 however
    often the chip updates it.
    """
    limits, limit = target.limits, _largest_weight(target, config)
    numbers = {"threshold": torch.tensor(THRESHOLD), "gain": torch.ones(())}
    # where the chip leaves no choice, neurons without a current or without a leak
    leaks = limits is None or limits.membrane_loss != (0.0, 0.0)
    beta = 0.9375 if config.beta is None else config.beta
    numbers["membrane_decay"] = torch.tensor(beta if leaks else 1.0)
    alpha = 0.5 if config.alpha is None else config.alpha
    if isinstance(target.arithmetic, XyloArithmetic) and alpha:
        numbers["current_decay"] = torch.tensor(alpha)
    nodes: dict[str, Any] = {}
    widths = [inputs, *config.hidden, config.outputs]
    for number, (before, after) in enumerate(pairwise(widths), start=1):
        layer = nn.Linear(before, after, bias=False)
        nn.init.uniform_(layer.weight, -limit, limit)
        if limits is not None and limits.axon_signs:  # sources excite and inhibit by turns
            with torch.no_grad():
                layer.weight.abs_().mul_(alternating(before))
        nodes[f"fc{number}"] = Weights(layer, (before,))
        nodes[f"lif{number}"] = FreeNeurons((after,), numbers, ())
    names = [TorchNetwork.INPUT, *nodes, TorchNetwork.OUTPUT]
    return TorchNetwork(nodes, list(pairwise(names)), (widths[0],), (widths[-1],))


def _from_module(
    config: NetworkConfig, observations: int, actions: int
) -> tuple[TorchNetwork, Convention]:
    """Return the network of the user's module:Class, or function, or instance."""
    name = config.network
    module, _, within = name.partition(":")
    with torch.random.fork_rng():  # an import may draw, in the first training of a process alone
        found = attribute(name, import_target(name, module, "a network is module:Class"), within)
    width = observations * _populations(datasheet(config.chip), observations, config)
    if isinstance(found, nn.Module):
        made = deepcopy(found)
    else:
        with contained(name, "its constructor"):
            made = _made(name, found, (width, actions))
    first = next((each for each in made.modules() if isinstance(each, nn.Linear)), None)
    usual = (width if first is None else first.in_features,)
    network, convention = network_from_torch(made, tuple(getattr(made, "input_shape", usual)))
    weights = {n: w.layer.weight for n, w in network.nodes.items() if isinstance(w, Weights)}
    held = [id(each) for each in weights.values()]
    if shared := [name for name, each in weights.items() if held.count(id(each)) > 1]:
        _warn(f"{name}: layers {' and '.join(shared)} share weights; from here on each has its own")
    return network.detached(), convention


def _made(name: str, maker: Any, sizes: Sequence[int]) -> nn.Module:  # noqa: ANN401
    """Return what a class or function makes, given inputs and actions where it asks for them."""
    if not callable(maker):
        raise ConfigError(f"{name} is no class of torch modules, but {maker!r}")
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    parameters = inspect.signature(maker).parameters.values()
    required = [p.name for p in parameters if p.kind in kinds and p.default is p.empty]
    if len(required) > len(sizes):
        raise ConfigError(
            f"{name} asks for {', '.join(required)}: its constructor is given the number of "
            "inputs, and of actions, in this order, if it takes them. Give the others defaults."
        )
    given = sizes[: len(required)]
    try:
        made = maker(*given)
    except Exception as error:  # of the user's code
        raise ConfigError(
            f"{name}: making it failed with {type(error).__name__}: {error}. It was given "
            f"{', '.join(map(str, given)) or 'nothing'}: the number of inputs, and of actions, as "
            "far as it asks for them"
        ) from error
    if not isinstance(made, nn.Module):
        raise ConfigError(f"{name} makes {type(made).__name__}, and no torch.nn.Module")
    return made


# -- going on from a file


def _read(name: str) -> Artifact:
    path = Path(name)
    if path.suffix != ".nir" or not path.is_file():
        raise ConfigError(
            f"there is no network {name}: give my_module:Net, a torch module, or a .nir file that "
            "exists"
        )
    return load(path)


def _without_readout(name: str, network: TorchNetwork) -> tuple[TorchNetwork, Weights]:
    """Return a network without its last matrix, and that."""
    ends = network.sources(network.OUTPUT)
    readout = network.nodes.get(ends[0])
    if len(ends) != 1 or not isinstance(readout, Weights) or readout.layer.bias is None:
        raise ConfigError(
            f"{name}: its last node is no Affine behind neurons, which the host reads actions by: "
            "it cannot be trained on"
        )
    edges = [
        (source, network.OUTPUT if target == ends[0] else target)
        for source, target in network.edges
        if source != ends[0]
    ]
    nodes = {each: node for each, node in network.nodes.items() if each != ends[0]}
    return TorchNetwork(nodes, edges, network.takes, readout.takes), readout


def _continued(
    config: NetworkConfig, started: tuple[Codec, Weights], sizes: tuple[int, int], head: Head
) -> NetworkConfig:
    """Return settings with the code, timesteps and score of a file."""
    name, (codec, readout) = config.network, started
    encoder, squash = codec.encoder, "argmax" if head == "discrete" else "tanh"
    if not isinstance(encoder, RateEncoder | PopulationEncoder):
        raise ConfigError(
            f"{name} has the code {encoder.kind!r}, whose neurons remember through an episode: go "
            "on with `distill`, whose sparse students have it"
        )
    found = encoder.observed, readout.layer.out_features
    if found != sizes or codec.squash != squash:
        raise ConfigError(
            f"{name} takes {found[0]} observations and gives {found[1]} actions by "
            f"{codec.squash}; the environment has {sizes[0]} and {sizes[1]}, by {squash}"
        )
    is_rate = isinstance(encoder, RateEncoder)
    coding = encoder.mode if isinstance(encoder, RateEncoder) else "population"
    populations = 1 if is_rate else encoder.width // sizes[0]
    update = {
        "coding": coding, "populations": populations, "timesteps": codec.timesteps,
        "score": codec.score,
    }  # fmt: skip
    return config.model_copy(update=update)


@torch.no_grad()
def _start_from(policy: NetworkPolicy, codec: Codec, readout: Weights) -> None:
    """Take normaliser, code and readout of a file over."""
    encoder, normaliser = codec.encoder, codec.normaliser
    numbers = {"normalizer.mean": normaliser.mean, "normalizer.std": normaliser.std}
    if isinstance(encoder, RateEncoder):
        numbers |= {"encoder.low": encoder.low, "encoder.high": encoder.high}
    elif isinstance(encoder, PopulationEncoder):
        numbers |= {"encoder.mean": encoder.mean}
        policy.encoder.get_parameter("log_std").copy_(torch.from_numpy(encoder.std).log())
    held = policy.state_dict()
    for name, array in numbers.items():
        held[name].copy_(torch.from_numpy(array))
    policy.readout.load_state_dict(readout.layer.state_dict())
    policy.started = True
