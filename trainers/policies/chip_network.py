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
from typing import TYPE_CHECKING, Any

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
    Score,
)
from spikedeploy.runtime.convention import Convention, Reset
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.fitting import Fitting, signs_by_turns, typed_values
from spikedeploy.trainers.from_torch import common_meaning, network_from_torch
from spikedeploy.trainers.neurons import mean_rate
from spikedeploy.trainers.policies.delta_policy import DT
from spikedeploy.trainers.policies.policy import Head, Latent
from spikedeploy.trainers.policies.spiking import (
    CodedPolicy,
    Coding,
    PopsanPolicy,
    TorchPopulationEncoder,
    TorchRateEncoder,
)
from spikedeploy.trainers.through_chip import ChipModule, convention_on, nearest_remark
from spikedeploy.trainers.torch_network import (
    FreeNeurons,
    TorchNetwork,
    Weights,
    network_of,
    to_array,
)
from spikedeploy.trainers.torch_neurons.adapter import Meaning

if TYPE_CHECKING:
    from spikedeploy.trainers.config import NetworkConfig

THRESHOLD = 1.0  # of every neuron of a chain; the compiler scales it with the weights
READOUT = "readout"  # node of the file
_OVERLAP = 0.6  # initial width of a receptive field, over the distance to the next
_FIELDS = 8  # of an observation, unless the chip has too few inputs
_LARGEST = 0.5  # weight [thresholds]


class NetworkPolicy(CodedPolicy):
    """A network on a chip between an encoder and a readout.

    network: its numbers are parameters of the policy
    chip: name of a datasheet, with options as on the command line
    reset: reset of the neurons: "subtract" or "zero", or the one that the chip has
    at_threshold: whether neurons spike at the threshold already, where the chip leaves a choice
    readout: nn.Linear from the network's output, spikes or membranes, to `Latent.mean`
    score: what of the output over the timesteps is read: its "mean", or its "last" value
    limits: refuse what breaks a design rule of the chip
    """

    kind = "network"

    def __init__(
        self,
        observations: int,
        actions: int,
        network: TorchNetwork | Mapping[str, Any],
        chip: str = "ideal",
        reset: Reset = "subtract",
        at_threshold: bool = False,
        coding: Coding = "population",
        populations: int = _FIELDS,
        reach: float = 2.0,
        timesteps: int = 8,
        score: Score = "mean",
        limits: bool = True,
        surrogate: str = "atan",
        surrogate_width: float | None = None,
        clip: float = 4.0,
        head: Head = "continuous",
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.head = observations, actions, head
        self.coding, self.populations, self.reach = coding, populations, reach
        self.chip, self.timesteps, self.score, self.limits = chip, timesteps, score, limits
        self.surrogate, self.surrogate_width = surrogate, surrogate_width
        made = network if isinstance(network, TorchNetwork) else TorchNetwork.from_spec(**network)
        self.target = datasheet(chip)
        wanted = Meaning(reset, "reached" if at_threshold else "above", "")
        stated = convention_on(self.target, Convention(DT, source="as trained"), wanted)
        self.reset, self.at_threshold = stated.reset, at_threshold
        width = self._add_code(observations, populations, reach, clip)
        if isinstance(self.encoder, TorchPopulationEncoder):
            # few fields: wide enough that no number between two of them is unseen
            spacing = 2 * reach / max(populations - 1, 1)
            nn.init.constant_(self.encoder.log_std, math.log(_OVERLAP * spacing))
        if math.prod(made.takes) != width:
            raise ConfigError(
                f"the network takes {math.prod(made.takes)} inputs, and the code of {observations} "
                f"observations has {width}: {observations} x {populations} of a population code, "
                "1 for each of a rate. Set policy.populations or policy.coding, or make the "
                "network for as many."
            )
        self.module = ChipModule(
            made, self.target, stated, None, limits, surrogate, surrogate_width, detach_reset=True
        )
        self.latent_size = math.prod(made.puts)
        self.readout = nn.Linear(self.latent_size, actions)

    @property
    def network(self) -> TorchNetwork:
        """The network between code and readout."""
        return self.module.network

    def layers_of(self, raster: Tensor) -> dict[str, Tensor]:
        """Return the spikes (T, B, N) of every spiking layer by its name."""
        self.module.records = True
        self._output(raster)
        self.module.records = False
        return self._layers()

    def _layers(self) -> dict[str, Tensor]:
        """Return the spikes (T, B, N) of the last forward pass."""
        names = {layer.name for layer in self.module.program().layers if layer.spiking}
        return {n: rows.flatten(2) for n, rows in self.module.spikes.items() if n in names}

    def _output(self, raster: Tensor) -> Tensor:
        """Return what the network puts out (T, B, N) for input spikes (T, B, M)."""
        shaped = raster.reshape(*raster.shape[:2], *self.network.takes)
        found: Tensor = self.module(shaped)
        return found.flatten(2)

    def forward_spikes(self, raster: Tensor) -> Latent:
        """Return the output for input spikes (T, B, M); rates where gradients are recorded."""
        output = self._output(raster)
        hidden = output[-1] if self.score == "last" else output.mean(0)
        layers = self._layers().values() if torch.is_grad_enabled() else ()
        return Latent(self.readout(hidden), hidden, tuple(mean_rate(each) for each in layers))

    def artifact(self, origin: Provenance | None = None, dt: float = DT) -> Artifact:
        """Return the policy as an artifact, every number in float64."""
        stated = replace(self.module.convention, dt=dt)
        return self._deployed().artifact(stated, codec_of(self), origin)

    def _deployed(self) -> TorchNetwork:
        """Return the network with the readout behind it."""
        network = self.network
        behind = Weights(self.readout, (self.latent_size,))
        nodes, name = dict(network.nodes), _free(READOUT, network.names)
        edges = [
            (source, name if target == network.OUTPUT else target)
            for source, target in network.edges
        ]
        return TorchNetwork(
            {**nodes, name: behind}, [*edges, (name, network.OUTPUT)], network.takes, behind.puts
        )


def _free(name: str, taken: Sequence[str]) -> str:
    while name in taken:
        name += "_"
    return name


def codec_of(policy: CodedPolicy | PopsanPolicy) -> Codec:
    """Return normaliser, encoder and decoder, as a file holds them."""
    normalizer = policy.normalizer
    return Codec(
        Normaliser(to_array(normalizer.mean), to_array(normalizer.std), normalizer.clip),
        _encoder(policy.encoder),
        policy.timesteps,
        "argmax" if policy.head == "discrete" else "tanh",
        policy.score if isinstance(policy, NetworkPolicy) else "mean",
    )


def _encoder(encoder: nn.Module) -> Encoder:
    if isinstance(encoder, TorchRateEncoder):
        return RateEncoder(to_array(encoder.low), to_array(encoder.high), encoder.mode)
    if isinstance(encoder, TorchPopulationEncoder):
        return PopulationEncoder(to_array(encoder.mean), to_array(encoder.std), encoder.threshold)
    raise ConfigError(f"{type(encoder).__name__} has no form in a file; add it to {__name__}")


def _populations(target: Chip, observations: int, wanted: int | None) -> int:
    """Return the neurons of the population code for each observation.

    wanted: None for as many as the inputs of the chip allow, at most 8; an even number where
        axons have signs, so that each observation has axons of both
    """
    inputs = target.limits.inputs if target.limits else None
    most = _FIELDS if inputs is None else min(_FIELDS, inputs // observations)
    if target.limits and target.limits.axon_signs:
        most -= most % 2
    if most < 2 and wanted is None:
        raise ConfigError(
            f"{target.name} has {inputs} inputs, too few for two neurons of a population code for "
            f"each of {observations} observations. Choose --set policy.coding=regular, or another "
            "chip."
        )
    return wanted or most


# -- a chain of a chip's own neurons


def _policy_for_chip(
    config: "NetworkConfig", observations: int, actions: int, clip: float, head: Head
) -> NetworkPolicy:
    """Return layers of a chip's neurons, without biases, that keep its design rules."""
    if config.chip == "ideal":
        raise ConfigError(
            "name a network, --network my_module:Net or net.nir, or a chip whose own neurons make "
            "one, --for xylo-a2"
        )
    # design rules are kept, but for capacities, which the exported file is checked for
    settings = _settings(config, observations, None) | {"limits": False}
    widths = [observations * settings["populations"], *config.hidden, config.outputs]
    layers = chain(datasheet(config.chip), widths, config.alpha, config.beta, config.limit)
    return NetworkPolicy(observations, actions, layers, clip=clip, head=head, **settings)


def chain(
    target: Chip,
    widths: Sequence[int],
    alpha: float | None = None,
    beta: float | None = None,
    limit: float | None = None,
) -> TorchNetwork:
    """Return layers of such widths, of neurons and with weights that the chip has.

    All neurons are without bias, so that a layer that no spike has reached yet stays at 0 however
    often the chip updates it.

    alpha, beta: decay factors of current and membrane in a timestep, where the chip leaves a
        choice; None for 0.5 and 0.9375
    limit: largest magnitude of a weight [thresholds]; None for at most 0.5, with which the
        threshold is a whole number: 7/16 of 3 bits, 15/32 of 5 bits with the sign, 127/256 of 8
    """
    arithmetic, limits = target.arithmetic, target.limits
    if limit is None:
        most = getattr(arithmetic, "weight_range", (0, 1))[1]
        limit = float(most / 2.0 ** math.ceil(math.log2(most / _LARGEST)))
    numbers = {"threshold": torch.tensor(THRESHOLD), "gain": torch.ones(())}
    # where the chip leaves no choice, neurons without a current or without a leak
    leaks = limits is None or limits.membrane_loss != (0.0, 0.0)
    numbers["membrane_decay"] = torch.tensor((0.9375 if beta is None else beta) if leaks else 1.0)
    current_decay = 0.5 if alpha is None else alpha
    if isinstance(arithmetic, XyloArithmetic) and current_decay:
        numbers["current_decay"] = torch.tensor(current_decay)
    types = 0 if arithmetic.own_weights else int(getattr(arithmetic, "axon_types", 0))
    nodes: dict[str, Any] = {}
    for number, (before, after) in enumerate(pairwise(widths), start=1):
        layer = nn.Linear(before, after, bias=False)
        nn.init.uniform_(layer.weight, -limit, limit)
        signs = values = None
        if types:
            values = typed_values([layer.weight.detach()], types, limit)
        elif limits is not None and limits.axon_signs:
            signs = signs_by_turns(layer.weight)
            with torch.no_grad():
                layer.weight.abs_().mul_(signs)
        nodes[f"fc{number}"] = Weights(layer, (before,), fitting=Fitting(limit, signs, values))
        nodes[f"lif{number}"] = FreeNeurons((after,), numbers, ())
    names = [TorchNetwork.INPUT, *nodes, TorchNetwork.OUTPUT]
    return TorchNetwork(nodes, list(pairwise(names)), (widths[0],), (widths[-1],))


# -- networks of the user


def network_policy(
    config: "NetworkConfig", observations: int, actions: int, clip: float, head: Head
) -> NetworkPolicy:
    """Return the policy of a module:Class, of a NIR file, or of a chip's own neurons."""
    if not config.network:
        return _policy_for_chip(config, observations, actions, clip, head)
    if is_target(config.network) and not Path(config.network).exists():
        return _policy_of_module(config, observations, actions, clip, head)
    return _policy_of_file(config, observations, actions, clip, head)


def _settings(config: "NetworkConfig", observations: int, inputs: int | None) -> dict[str, Any]:
    """Return the settings of the policy, with as many fields as the network has inputs for."""
    fields = 1
    if config.coding == "population":
        wanted = config.populations
        if wanted is None and inputs is not None and inputs % observations == 0:
            wanted = inputs // observations
        fields = _populations(datasheet(config.chip), observations, wanted)
    return {
        "chip": config.chip,
        "coding": config.coding,
        "populations": fields,
        "reach": config.reach,
        "timesteps": config.timesteps,
        "score": config.score,
        "limits": config.limits,
        "surrogate": config.surrogate,
        "surrogate_width": config.surrogate_width,
    }


def _policy_of_module(
    config: "NetworkConfig", observations: int, actions: int, clip: float, head: Head
) -> NetworkPolicy:
    name = config.network
    module, _, within = name.partition(":")
    with torch.random.fork_rng():  # an import may draw, in the first training of a process alone
        found = attribute(name, import_target(name, module, "a network is module:Class"), within)
    settings = _settings(config, observations, None)
    if isinstance(found, nn.Module):
        made = deepcopy(found)
    else:
        sizes = observations * settings["populations"], actions
        with contained(name, "its constructor"):
            made = _made(name, found, sizes)
    inputs = _inputs_of(made)
    settings = _settings(config, observations, inputs)
    width = observations * settings["populations"]
    if inputs is not None and inputs != width:
        raise ConfigError(
            f"{name} takes {inputs} inputs, and the code of {observations} observations has "
            f"{width}: set policy.populations, policy.coding, or give its constructor the argument "
            "inputs"
        )
    takes = tuple(getattr(made, "input_shape", (width,)))
    network, neurons = network_from_torch(made, takes)
    if shared := shared_weights(network):
        _warn(f"{name}: layers {' and '.join(shared)} share weights; from here on each has its own")
    meaning = common_meaning(neurons)
    policy = _policy(network.detached(), meaning, observations, actions, clip, head, settings)
    _warn(nearest_remark(policy.target, policy.module.convention, meaning))
    return policy


def _warn(remark: str) -> None:
    """Print what the user should know of the network, on stderr."""
    if remark:
        print(remark, file=sys.stderr)


def _policy(
    network: TorchNetwork,
    meaning: Meaning,
    observations: int,
    actions: int,
    clip: float,
    head: Head,
    settings: Mapping[str, Any],
) -> NetworkPolicy:
    fitted = network.fit(datasheet(settings["chip"])) if settings["limits"] else ""
    policy = NetworkPolicy(
        observations,
        actions,
        network,
        reset=meaning.reset,
        at_threshold=meaning.spikes == "reached",
        clip=clip,
        head=head,
        **settings,
    )
    policy.module.program()  # what does not fit is refused here
    _warn(fitted)
    if settings["chip"] == "ideal":
        _warn("the network is trained on 'ideal', which rounds nothing: --for CHIP names a chip")
    return policy


def _made(name: str, maker: Any, sizes: tuple[int, int]) -> nn.Module:  # noqa: ANN401
    """Return what a class or function makes, given inputs and actions where it asks for them."""
    if not callable(maker):
        raise ConfigError(f"{name} is no class of torch modules, but {maker!r}")
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    parameters = inspect.signature(maker).parameters.values()
    required = [p for p in parameters if p.kind in kinds and p.default is p.empty]
    if len(required) > len(sizes):
        names = ", ".join(p.name for p in required)
        raise ConfigError(
            f"{name} asks for {names}: its constructor is given the number of inputs, and of "
            "actions, in this order, if it takes them. Give the others defaults."
        )
    try:
        made = maker(*sizes[: len(required)])
    except Exception as error:  # of the user's code
        raise ConfigError(
            f"{name}: making it failed with {type(error).__name__}: {error}. It was given "
            f"{', '.join(map(str, sizes[: len(required)])) or 'nothing'}: the number of inputs, "
            "and of actions, as far as it asks for them"
        ) from error
    if not isinstance(made, nn.Module):
        raise ConfigError(f"{name} makes {type(made).__name__}, and no torch.nn.Module")
    return made


def shared_weights(network: TorchNetwork) -> list[str]:
    """Return the nodes whose matrix is that of another one, too."""
    weights = {n: id(w.layer.weight) for n, w in network.nodes.items() if isinstance(w, Weights)}
    held = list(weights.values())
    return [name for name, weight in weights.items() if held.count(weight) > 1]


def _inputs_of(module: nn.Module) -> int | None:
    """Return the inputs of a module, by its input_shape or its first matrix; None without both."""
    shape: Any = getattr(module, "input_shape", None)
    if shape is not None:
        return int(math.prod(shape))
    first = next((m for m in module.modules() if isinstance(m, nn.Linear)), None)
    return None if first is None else first.in_features


def _policy_of_file(
    config: "NetworkConfig", observations: int, actions: int, clip: float, head: Head
) -> NetworkPolicy:
    path = Path(config.network)
    if path.suffix != ".nir" or not path.is_file():
        raise ConfigError(
            f"there is no network {config.network}: give my_module:Net, a torch module, or a .nir "
            "file that exists"
        )
    artifact = load(path)
    network, meaning = network_of(artifact), _meaning_of(artifact)
    if artifact.codec is None:
        inputs = math.prod(network.takes)
        settings = _settings(config, observations, inputs)
        return _policy(network, meaning, observations, actions, clip, head, settings)
    return _gone_on(config, artifact, network, (observations, actions), head)


def _meaning_of(artifact: Artifact) -> Meaning:
    return Meaning(artifact.convention.reset, artifact.convention.spikes, "the file's neurons")


def _gone_on(
    config: "NetworkConfig",
    artifact: Artifact,
    network: TorchNetwork,
    sizes: tuple[int, int],
    head: Head,
) -> NetworkPolicy:
    """Return the policy that a file with a codec holds, with its code, readout and normaliser."""
    name, codec = config.network, artifact.codec
    assert codec is not None
    encoder, squash = codec.encoder, "argmax" if head == "discrete" else "tanh"
    if not isinstance(encoder, RateEncoder | PopulationEncoder):
        raise ConfigError(
            f"{name} has the code {encoder.kind!r}, whose neurons remember through an episode: go "
            "on with `distill`, whose sparse students have it"
        )
    rest, readout = _without_readout(name, network)
    found = encoder.observed, readout.layer.out_features
    if found != sizes or codec.squash != squash:
        raise ConfigError(
            f"{name} takes {found[0]} observations and gives {found[1]} actions by "
            f"{codec.squash}; the environment has {sizes[0]} and {sizes[1]}, by {squash}"
        )
    is_rate = isinstance(encoder, RateEncoder)
    settings = {
        **_settings(config, sizes[0], encoder.width),
        "coding": encoder.mode if isinstance(encoder, RateEncoder) else "population",
        "populations": 1 if is_rate else encoder.width // sizes[0],
        "timesteps": codec.timesteps,
        "score": codec.score,
    }
    policy = _policy(rest, _meaning_of(artifact), *sizes, codec.normaliser.clip, head, settings)
    with torch.no_grad():
        policy.readout.load_state_dict(readout.layer.state_dict())
        policy.normalizer.mean.copy_(torch.from_numpy(codec.normaliser.mean))
        policy.normalizer.std.copy_(torch.from_numpy(codec.normaliser.std))
        if isinstance(encoder, RateEncoder):
            policy.encoder.get_buffer("low").copy_(torch.from_numpy(encoder.low))
            policy.encoder.get_buffer("high").copy_(torch.from_numpy(encoder.high))
        else:
            policy.encoder.get_parameter("mean").copy_(torch.from_numpy(encoder.mean))
            policy.encoder.get_parameter("log_std").copy_(torch.from_numpy(encoder.std).log())
    policy.started = True
    return policy


def _without_readout(name: str, network: TorchNetwork) -> tuple[TorchNetwork, Weights]:
    """Return a network without its last matrix, and that."""
    ends = [source for source, target in network.edges if target == network.OUTPUT]
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
