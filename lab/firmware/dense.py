"""Dense policies as C through emlearn, in the folder layout of an export."""

import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

from lab.firmware.targets import SOURCES, pipe

_ACTIVATIONS = {"Relu": "relu", "Tanh": "tanh", "Identity": "identity"}
_PLAIN = re.compile(r"Sub Div Clip( Gemm (Relu|Tanh|Identity))+")
_FLOATS = "static const float {name}[] = {{{values}}};\n"


class Dense(NamedTuple):
    """A plain dense policy: scaled and clipped observation, layers, action.

    weights: (in, out) each.
    activations: of each layer, in emlearn's words.
    """

    mean: NDArray[np.float32]
    factor: NDArray[np.float32]
    clip: tuple[float, float]
    weights: list[NDArray[np.float32]]
    biases: list[NDArray[np.float32]]
    activations: list[str]

    @property
    def chooses(self) -> bool:
        """Return whether the action is the largest of the outputs."""
        return self.activations[-1] == "identity"


def read(file: Path) -> Dense | None:
    """The policy of an ONNX file; None where it is more than layers."""
    graph = onnx.load(file).graph
    kinds = [node.op_type for node in graph.node]
    if not _PLAIN.fullmatch(" ".join(kinds)):
        return None
    value: dict[str, Any] = {each.name: numpy_helper.to_array(each) for each in graph.initializer}
    count = kinds.count("Gemm")
    return Dense(
        value["mean"],
        1 / value["std"],
        (float(value["lowest"]), float(value["highest"])),
        [value[f"weight{k}"].T for k in range(1, count + 1)],
        [value[f"bias{k}"] for k in range(1, count + 1)],
        [_ACTIVATIONS[kind] for kind in kinds[4::2]],
    )


def write(policy: Dense, python: Path, observations: NDArray[np.float64], folder: Path) -> str:
    """Fill the folder; the release of emlearn."""
    actions = 1 if policy.chooses else policy.weights[-1].shape[1]
    (folder / "policy.h").write_text(_header(policy, observations.shape[1], actions))
    vectors = f"#define VECTOR_INFERENCES {len(observations)}u\n"
    vectors += _array("vector_observation", observations.ravel().astype(np.float32))
    (folder / "vectors.h").write_text(f"#include <stdint.h>\n{vectors}")
    low, high = policy.clip
    scales = f"#define SCALE_LOWEST {low}f\n#define SCALE_HIGHEST {high}f\n"
    scales += _array("scale_mean", policy.mean) + _array("scale_factor", policy.factor)
    (folder / "scales.h").write_text(scales)
    (folder / "dense.c").write_bytes((SOURCES / "dense.c").read_bytes())
    return _emlearn(policy, python, folder)


def read_observations(folder: Path) -> NDArray[np.float64]:
    """(steps, obs) of the self-test of an export."""
    text = (folder / "vectors.h").read_text()
    found = re.search(r"double vector_observation\[\d+\] = \{([^}]*)\}", text)
    steps = re.search(r"VECTOR_INFERENCES (\d+)u", text)
    if not (found and steps):
        raise RuntimeError(f"{folder}/vectors.h has no observations")
    numbers = [float.fromhex(word) for word in found[1].replace(",", " ").split()]
    return np.array(numbers).reshape(int(steps[1]), -1)


def _header(policy: Dense, observed: int, actions: int) -> str:
    kind = "int32_t" if policy.chooses else "float"
    return f"""#include <stdint.h>
#define POLICY_OBSERVATIONS {observed}
#define POLICY_ACTIONS {actions}
#define POLICY_CHOOSES {int(policy.chooses)}
#define POLICY_GEMMS {len(policy.weights)}
#define OBSERVATION float
typedef {kind} policy_action_t;
void policy_reset(void);
int policy_step(const float *observation, policy_action_t *action);
"""


def _array(name: str, values: NDArray[np.float32]) -> str:
    words = ", ".join(f"{float(value).hex()}f" for value in values)
    return _FLOATS.format(name=name, values=words)


def _emlearn(policy: Dense, python: Path, folder: Path) -> str:
    network = {
        "weights": [each.tolist() for each in policy.weights],
        "biases": [each.tolist() for each in policy.biases],
        "activations": policy.activations,
    }
    # isolated: what this process imports from is nothing to that Python
    words = [str(python), "-I", str(SOURCES / "emlearn_code.py"), str(folder)]
    return pipe(words, json.dumps(network)).strip()
