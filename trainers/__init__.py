"""Trainers: from an environment to a run folder with a trained policy.

`train.train` trains a recipe with an algorithm of the table ALGORITHMS; nothing heavy is imported
before. Configurations are pydantic models, checkpoints safetensors and JSON.

recipes.py        recipes of recipes.toml: what to train, as differences from defaults
config.py         models of the configuration; recipe, TOML file and overrides combined
train.py          from the name of a recipe to a run folder
runner.py         what all algorithms share: loop, validation, resuming; networks and optimisers
env_batch.py      copies of an environment, stepped as a batch, brought back where they were
run_folder.py     files of a run: configuration, lock, checkpoints with checksums
metrics_file.py   journal of metrics: CSV file, TensorBoard; and the learning curve
progress.py       progress bar, signals that stop at a checkpoint
versions.py       installed versions
onnx_session.py   ONNX Runtime session of a float network, tried within limits
sac.py            soft actor-critic
ppo.py            proximal policy optimisation
distill/          distillation of a teacher by DAgger
sparse/           imitation through whole walks, pruned by operations; then reward
through_chip.py   any network as a torch module whose forward pass is a chip
adapt.py          a network trained on through a chip, towards labels or its float twin
from_torch.py     what a torch module computes in a timestep
torch_layers.py   its leaf modules as nodes; torch_neurons/: neurons of other libraries
surrogate_neurons.py  LIF and CuBa-LIF layers with surrogate gradients, compiled, and firing rates
fitting.py        the nearest weights that the axons of a chip carry
torch_network.py  NIR nodes whose numbers are torch parameters
policies/         torch policies: MLP, PopSAN, spiking MLP, event-driven and pruned ones

An algorithm is a subclass of Runner and a line in ALGORITHMS; a recipe is an entry in recipes.toml.
"""

ALGORITHMS: dict[str, str] = {
    "sac": "spikedeploy.trainers.sac:Sac",
    "distill": "spikedeploy.trainers.distill.distill:Distill",
    "ppo": "spikedeploy.trainers.ppo:Ppo",
    "sparse": "spikedeploy.trainers.sparse.sparse:Sparse",
    "sparse-ppo": "spikedeploy.trainers.sparse.sparse_ppo:SparsePpo",
}
