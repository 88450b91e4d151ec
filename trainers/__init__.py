"""Trainers: from an environment to a run folder with a trained policy.

`train.train` trains a recipe with an algorithm of the table ALGORITHMS; nothing heavy is imported
before. Configurations are pydantic models, checkpoints safetensors and JSON.

sac/             soft actor-critic
ppo/             proximal policy optimisation
distill/         distillation of a teacher by DAgger
sparse/          imitation through whole walks, pruned by operations
sparse_ppo/      reward after imitation, for what sparse/ left
policies/        torch policies: MLP, PopSAN, spiking MLP, event-driven and pruned ones
train.py         from the name of a recipe to a run folder
runner.py        what all algorithms share: loop, validation, metrics, checkpoints, resuming
recipe.py        what a recipe is
recipes.py       table of recipes
any_env_recipes.py  those of any environment, which the command line names
sparse_recipes.py  those of sparse policies, their baselines, and PPO after imitation
config.py        models of the configuration
resolve.py       recipe, TOML file and overrides combined into a configuration
run_folder.py    files of a run: configuration, versions, checkpoints
run_lock.py      one process to a run folder
checksums.py     checksums of its files
interrupt.py     signals that stop a training at a checkpoint
episode_history.py  what brings an environment back where it was, on resuming
journal.py       metrics to CSV file, TensorBoard and progress bar
progress.py      the bar on a terminal, lines elsewhere
metrics.py       the CSV file, and the learning curve
tables.py        such files checked before a run goes on
env_batch.py     copies of an environment, stepped as a batch
validation.py    deterministic episodes that choose the best checkpoint
critic.py        float networks that estimate returns
adam.py          the optimiser and its state
onnx_session.py  ONNX Runtime session of a float network, tried within limits
onnx_operators.py  what an ONNX file computes with, read from its bytes
atomic.py        atomic writes
write_errors.py  a file that could not be written, in a sentence

An algorithm is a subclass of Runner and a line in ALGORITHMS; a recipe is an entry in RECIPES.
"""

from spikedeploy.trainers.recipe import Recipe
from spikedeploy.trainers.recipes import RECIPES

ALGORITHMS: dict[str, str] = {
    "sac": "spikedeploy.trainers.sac.sac:Sac",
    "distill": "spikedeploy.trainers.distill.distill:Distill",
    "ppo": "spikedeploy.trainers.ppo.ppo:Ppo",
    "sparse": "spikedeploy.trainers.sparse.sparse:Sparse",
    "sparse-ppo": "spikedeploy.trainers.sparse_ppo.sparse_ppo:SparsePpo",
}

__all__ = ["ALGORITHMS", "RECIPES", "Recipe"]
