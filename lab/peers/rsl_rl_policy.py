"""A policy of rsl_rl, exported as its runner exports, with what it does with observations.

    python -m lab rsl-rl-policy [FOLDER]

writes policy.onnx and actions.npz (observation, action) into tests/golden/rsl_rl, which
tests/trainers/distill/test_teachers.py reads. It needs rsl-rl-lib and onnxscript, which nothing
else here does. Weights are drawn, not trained; the normaliser has seen observations.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parents[2] / "tests" / "golden" / "rsl_rl"
SIZES = 4, 2  # observations and actions of tests/own_env.py


def policy() -> Any:  # noqa: ANN401
    """An actor with hidden layers of ELU, a normaliser and a Gaussian head."""
    import torch
    from rsl_rl.models.mlp_model import MLPModel
    from tensordict import TensorDict

    torch.manual_seed(3)
    seen = TensorDict({"policy": 3.0 + 2.0 * torch.randn(256, SIZES[0])}, batch_size=[256])
    head = {"class_name": "rsl_rl.modules.distribution:GaussianDistribution", "init_std": 1.0}
    made = MLPModel(
        seen, {"actor": ["policy"]}, "actor", SIZES[1],
        hidden_dims=[16, 8], obs_normalization=True, distribution_cfg=head,
    )  # fmt: skip
    made.update_normalization(seen)
    with torch.no_grad():
        for value in made.mlp.parameters():
            value.normal_(0.0, 0.6)
        # into the odd bounds of the environment, and sometimes past them
        *_, last = (each for each in made.mlp.modules() if isinstance(each, torch.nn.Linear))
        last.weight *= torch.tensor([[0.1], [1.0]])
        last.bias.copy_(torch.tensor([-0.1, 7.0]))
    return made.eval()


def main() -> None:
    """Record it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=FOLDER)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    import torch
    from tensordict import TensorDict

    made = policy()
    seen = 3.0 + 2.0 * torch.randn(32, SIZES[0])
    with torch.no_grad():
        action = made(TensorDict({"policy": seen}, batch_size=[len(seen)]))
    np.savez(folder / "actions.npz", observation=seen.numpy(), action=action.numpy())
    network = made.as_onnx(verbose=False).eval()
    # as rsl_rl.runners.OnPolicyRunner.export_policy_to_onnx calls it, in one file
    torch.onnx.export(
        network, network.get_dummy_inputs(), folder / "policy.onnx", export_params=True,
        opset_version=18, input_names=network.input_names, output_names=network.output_names,
        external_data=False,
    )  # fmt: skip
    _forget_paths(folder / "policy.onnx")


def _forget_paths(path: Path) -> None:
    """Take out where on this machine the lines of the network's code stood."""
    import onnx

    made = onnx.load(path)
    del made.graph.metadata_props[:]
    for node in made.graph.node:
        del node.metadata_props[:]
    onnx.save(made, path)
