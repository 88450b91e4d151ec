"""Small settings of sparse trainings, in the environment `stroll`."""

from spikedeploy.trainers.sparse.settings import SparseConfig

_SMALL = {
    "env": {"name": "stroll"},
    "budget": 10.0,
    "teacher_walks": 2,
    "noisy_walks": 1,
    "walks": 2,
    "dense_updates": 12,
    "dense_rounds": 2,
    "levels": (20.0,),
    "level_updates": 12,
    "polish": 1,
    "polish_updates": 8,
    "prune_every": 3,
    "window": 8,
    "burn_in": 2,
    "batch": 6,
    "validation": {"every": 4, "episodes": 2},
    "log_every": 4,
    "checkpoint_every": 100,
}


def settings(recipe="stroll-sparse", **changes):
    """A configuration that trains in a second."""
    policy = {"kind": "delta-snn", "hidden": 5}
    fields = {"algorithm": "sparse", "recipe": recipe, "policy": policy, **_SMALL, **changes}
    return SparseConfig.model_validate(fields)
