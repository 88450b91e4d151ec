"""Policies: torch modules from observation to action, the part that is deployed.

POLICIES is the table of kinds; `from_config` builds a policy from a configuration, `build` from
the spec in a checkpoint.

policy.py          Policy, what it computes before an action; normalisation; weights with masks
mlp.py             float multilayer perceptron or linear map; a pruned one, with a skip
spiking.py         several timesteps an inference: encoders, PopSAN, spiking MLP
chip_network.py    a network on a chip between code and readout: the user's, or a chip's own neurons
shared_weights.py  networks that serve several parts of a body with the same weights
delta_policy.py    one timestep a control step: delta code, LIF or sigma-delta neurons, NIR graphs
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from spikedeploy.envs.foreign import attribute, contained, import_target, is_target
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import (
    DeltaMlpConfig,
    DeltaSnnConfig,
    NetworkConfig,
    PolicyConfig,
    require_known,
)
from spikedeploy.trainers.policies.chip_network import NetworkPolicy, network_policy
from spikedeploy.trainers.policies.delta_policy import DeltaMlpPolicy, DeltaSnnPolicy
from spikedeploy.trainers.policies.mlp import MlpPolicy, PrunedMlpPolicy
from spikedeploy.trainers.policies.policy import Head, Latent, Policy
from spikedeploy.trainers.policies.shared_weights import Copies
from spikedeploy.trainers.policies.spiking import PopsanPolicy, SpikingMlpPolicy

__all__ = [
    "DeltaMlpPolicy",
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
    "delta-mlp": DeltaMlpPolicy,
    "pruned-mlp": PrunedMlpPolicy,
    "mlp": MlpPolicy,
    "popsan": PopsanPolicy,
    "spiking-mlp": SpikingMlpPolicy,
    "network": NetworkPolicy,
}

_SETTINGS: dict[str, Any] = {"delta-snn": DeltaSnnConfig, "delta-mlp": DeltaMlpConfig}


def build(spec: Mapping[str, Any]) -> Policy:
    """Return an untrained policy from the result of `Policy.spec`."""
    settings = dict(spec)
    policy = _POLICIES[require_known(settings.pop("kind"), _POLICIES, "kind of policy")]
    if settings.get("copies"):
        settings["copies"] = Copies(**settings["copies"])
    if "settings" in settings:
        settings["settings"] = _SETTINGS[spec["kind"]](**settings["settings"])
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
    if isinstance(config, NetworkConfig):
        return network_policy(config, observations, actions, clip, head)
    if isinstance(config, DeltaMlpConfig):
        return DeltaMlpPolicy(observations, actions, config, clip, head)
    if isinstance(config, DeltaSnnConfig):
        copies = _shared(config.copies, columns or {}) if config.copies else None
        return DeltaSnnPolicy(observations, actions, config, clip, head, copies)
    spec = {**config.model_dump(), "observations": observations, "actions": actions, "clip": clip}
    if target := spec.pop("copies", ""):
        copies = _shared(target, columns or {})
        spec["hidden"] = [copies.count * width for width in spec["hidden"]]
        spec["copies"] = copies.spec()
    if head == "discrete":
        if config.kind == "popsan":
            raise ConfigError(
                "a popsan has continuous actions, and this environment takes discrete ones: choose "
                "policy.kind spiking-mlp or mlp"
            )
        spec["head"] = head
    return build(spec)


def _shared(target: str, columns: Mapping[str, slice]) -> Copies:
    """Return the copies that the user's module:function makes of the environment's OBSERVATION.

    It returns which observations each copy reads (K, F), their signs (K, F), and the actions (K, n)
    that each sets.
    """
    if not is_target(target) or not columns:
        raise ConfigError(
            f"copies: {target!r} must be module:function, and the environment must have an "
            "OBSERVATION"
        )
    module, _, name = target.partition(":")
    layout = attribute(target, import_target(target, module, "copies is module:function"), name)
    with contained(target, "a call"):
        return Copies(*(np.asarray(each).tolist() for each in layout(columns)))
