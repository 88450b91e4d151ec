"""Policies: torch modules from observation to action, the part that is deployed.

POLICIES is the table of kinds; `from_config` builds a policy from a configuration, `build` from
the spec in a checkpoint.

policy.py       Policy, and what it computes before an action is chosen
mlp.py          float multilayer perceptron, or a linear map
popsan.py       population-coded spiking actor
spiking_mlp.py  spiking multilayer perceptron with a linear readout
chip_snn.py     the same in the integers of a chip, from code to output neurons
chip_graph.py   its NIR graph, convention and codec
event_kernel.py chips that look at every event, compiled
delta_snn.py    event-driven: delta code, a layer of LIF neurons, leaky integrator readout
delta_mlp.py    delta network: the same with a layer of sigma-delta ReLU neurons
delta_graph.py  NIR graphs and codecs of both
pruned_mlp.py   small float network with a skip connection and masks
pruned.py       weights with masks
neurons.py      LIF and CuBa-LIF layers with surrogate gradients, firing rates
lif_kernel.py   their passes forward and back, compiled
encoders.py     population and rate codes
features.py     inputs of control policies
normaliser.py   observation normalisation and running statistics
"""

from collections.abc import Callable, Mapping
from typing import Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import PolicyConfig
from spikedeploy.trainers.policies.chip_snn import ChipSnnPolicy
from spikedeploy.trainers.policies.delta_mlp import DeltaMlpPolicy
from spikedeploy.trainers.policies.delta_snn import DeltaSnnPolicy
from spikedeploy.trainers.policies.features import Features, features
from spikedeploy.trainers.policies.mlp import MlpPolicy
from spikedeploy.trainers.policies.policy import Head, Latent, Policy
from spikedeploy.trainers.policies.popsan import PopsanPolicy
from spikedeploy.trainers.policies.pruned_mlp import PrunedMlpPolicy
from spikedeploy.trainers.policies.spiking_mlp import SpikingMlpPolicy
from spikedeploy.trainers.resolve import known

__all__ = [
    "ChipSnnPolicy",
    "DeltaMlpPolicy",
    "DeltaSnnPolicy",
    "Head",
    "Latent",
    "MlpPolicy",
    "Policy",
    "PopsanPolicy",
    "PrunedMlpPolicy",
    "SpikingMlpPolicy",
    "build",
    "from_config",
]

_POLICIES: dict[str, Callable[..., Policy]] = {
    "delta-snn": DeltaSnnPolicy,
    "delta-mlp": DeltaMlpPolicy,
    "pruned-mlp": PrunedMlpPolicy,
    "mlp": MlpPolicy,
    "popsan": PopsanPolicy,
    "spiking-mlp": SpikingMlpPolicy,
    "chip-snn": ChipSnnPolicy,
}


def build(spec: Mapping[str, Any]) -> Policy:
    """Return an untrained policy from the result of `Policy.spec`."""
    settings = dict(spec)
    policy = _POLICIES[known(settings.pop("kind"), _POLICIES, "kind of policy")]
    if "features" in settings:
        settings["features"] = Features(
            observations=settings["observations"], **settings["features"]
        )
    return policy(**settings)


def from_config(
    config: PolicyConfig,
    observations: int,
    actions: int,
    clip: float = 4.0,
    columns: Mapping[str, slice] | None = None,
    head: Head = "continuous",
) -> Policy:
    """Return an untrained policy as configured; `columns` is the environment's OBSERVATION."""
    spec = {**config.model_dump(), "observations": observations, "actions": actions, "clip": clip}
    if "features" in spec:
        spec["features"] = features(spec["features"], observations, columns).spec()
    if head == "discrete":
        if config.kind == "popsan":
            raise ConfigError(
                "a popsan has continuous actions, and this environment takes discrete ones: choose "
                "policy.kind spiking-mlp or mlp"
            )
        spec["head"] = head
    return build(spec)
