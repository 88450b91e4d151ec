"""The table of policies, and how to build one from a configuration or a checkpoint."""

from collections.abc import Mapping
from typing import Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import PolicyConfig, known
from spikedeploy.trainers.features import Features, features
from spikedeploy.trainers.mlp import MlpPolicy
from spikedeploy.trainers.policy import Head, Latent, Policy
from spikedeploy.trainers.popsan import PopsanPolicy
from spikedeploy.trainers.spiking_mlp import SpikingMlpPolicy

__all__ = [
    "POLICIES",
    "Latent",
    "MlpPolicy",
    "Policy",
    "PopsanPolicy",
    "SpikingMlpPolicy",
    "build",
    "from_config",
]

POLICIES: dict[str, type[MlpPolicy] | type[PopsanPolicy] | type[SpikingMlpPolicy]] = {
    "mlp": MlpPolicy,
    "popsan": PopsanPolicy,
    "spiking-mlp": SpikingMlpPolicy,
}


def build(spec: Mapping[str, Any]) -> Policy:
    """Return an untrained policy from what `Policy.spec` gave."""
    settings = dict(spec)
    policy = POLICIES[known(settings.pop("kind"), POLICIES, "kind of policy")]
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
                "a popsan puts out numbers, and this environment takes one of several actions: "
                "choose policy.kind spiking-mlp or mlp"
            )
        spec["head"] = head
    return build(spec)
