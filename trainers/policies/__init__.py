"""Policies: torch modules from observation to action, the part that is deployed.

_POLICIES is the table of kinds; `from_config` builds a policy from a configuration, `build` from
the spec in a checkpoint.

policy.py          Policy, what it computes before an action; normalisation; weights with masks
mlp.py             float multilayer perceptron or linear map; a pruned one, with a skip
spiking.py         several timesteps an inference: encoders, PopSAN, spiking MLP
chip_network.py    a network on a chip between code and readout: the user's, or a chip's own neurons
delta_policy.py    events in, states that live on: delta code, LIF neurons, NIR graphs
"""

from collections.abc import Callable, Mapping
from inspect import signature
from typing import Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import (
    DeltaSnnConfig,
    NetworkConfig,
    PolicyConfig,
    require_known,
)
from spikedeploy.trainers.policies.chip_network import NetworkPolicy, network_policy
from spikedeploy.trainers.policies.delta_policy import DeltaSnnPolicy
from spikedeploy.trainers.policies.mlp import MlpPolicy, PrunedMlpPolicy
from spikedeploy.trainers.policies.policy import Head, Latent, Policy
from spikedeploy.trainers.policies.spiking import PopsanPolicy, SpikingMlpPolicy

__all__ = [
    "DeltaSnnPolicy",
    "Head",
    "Latent",
    "MlpPolicy",
    "NetworkPolicy",
    "Policy",
    "PopsanPolicy",
    "PrunedMlpPolicy",
    "SpikingMlpPolicy",
    "build",
    "from_config",
]

_POLICIES: dict[str, Callable[..., Policy]] = {
    "delta-snn": DeltaSnnPolicy,
    "pruned-mlp": PrunedMlpPolicy,
    "mlp": MlpPolicy,
    "popsan": PopsanPolicy,
    "spiking-mlp": SpikingMlpPolicy,
    "network": NetworkPolicy,
}

_SETTINGS: dict[str, Any] = {"delta-snn": DeltaSnnConfig, "network": NetworkConfig}


def build(spec: Mapping[str, Any]) -> Policy:
    """Return an untrained policy from the result of `Policy.spec`."""
    settings = dict(spec)
    policy = _POLICIES[require_known(settings.pop("kind"), _POLICIES, "kind of policy")]
    if unknown := sorted(set(settings) - set(signature(policy).parameters)):
        raise ConfigError(
            f"a policy of kind {spec['kind']!r} has no {', '.join(unknown)}: another version of "
            "spikedeploy saved it. Use that one, or train it anew"
        )
    if "settings" in settings:
        settings["settings"] = _SETTINGS[spec["kind"]](**settings["settings"])
    return policy(**settings)


def from_config(
    config: PolicyConfig,
    observations: int,
    actions: int,
    clip: float = 4.0,
    head: Head = "continuous",
) -> Policy:
    """Return an untrained policy as configured."""
    if isinstance(config, NetworkConfig):
        return network_policy(config, observations, actions, clip, head)
    if isinstance(config, DeltaSnnConfig):
        return DeltaSnnPolicy(observations, actions, config, clip, head)
    spec = {**config.model_dump(), "observations": observations, "actions": actions, "clip": clip}
    if head == "discrete":
        if config.kind == "popsan":
            raise ConfigError(
                "a popsan has continuous actions, and this environment takes discrete ones: choose "
                "policy.kind spiking-mlp or mlp"
            )
        spec["head"] = head
    return build(spec)
