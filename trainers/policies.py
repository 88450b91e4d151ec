"""The table of policies, and how to build one from a configuration or a checkpoint."""

from collections.abc import Mapping
from typing import Any

from trainers.config import MlpConfig, PopsanConfig, known
from trainers.features import Features, features
from trainers.mlp import MlpPolicy
from trainers.policy import Latent, Policy
from trainers.popsan import PopsanPolicy

__all__ = ["POLICIES", "Latent", "MlpPolicy", "Policy", "PopsanPolicy", "build", "from_config"]

POLICIES: dict[str, type[MlpPolicy] | type[PopsanPolicy]] = {
    "mlp": MlpPolicy,
    "popsan": PopsanPolicy,
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
    config: MlpConfig | PopsanConfig,
    observations: int,
    actions: int,
    clip: float = 4.0,
    columns: Mapping[str, slice] | None = None,
) -> Policy:
    """Return an untrained policy as configured; `columns` is the environment's OBSERVATION."""
    spec = {**config.model_dump(), "observations": observations, "actions": actions, "clip": clip}
    if isinstance(config, MlpConfig):
        spec["features"] = features(config.features, observations, columns).spec()
    return build(spec)
