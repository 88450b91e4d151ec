"""Run by a Python that has emlearn: the C of a dense network, and the headers that it includes.

    python emlearn_code.py FOLDER < network.json

network.json has the activation, the weights (in, out) and the biases of each layer. The C is that
of `emlearn.convert(…).save(name="net", inference=["loadable"])`; `inline` of 0.23.2 ends with a
ValueError at the name of an activation, and its fixed-point network multiplies nothing (FIXME).
"""

import json
import shutil
import sys
from importlib.metadata import version
from pathlib import Path

import emlearn
import numpy as np
from emlearn.net import c_generate_net_loadable


def main() -> None:
    """Write net.h and the headers; print the release of emlearn."""
    folder, network = Path(sys.argv[1]), json.load(sys.stdin)
    weights = [np.array(each, np.float32) for each in network["weights"]]
    biases = [np.array(each, np.float32) for each in network["biases"]]
    code = c_generate_net_loadable(network["activations"], weights, biases, prefix="net")
    (folder / "net.h").write_text(code)
    for header in Path(emlearn.__file__).parent.glob("eml_*.h"):
        shutil.copy(header, folder)
    print(version("emlearn"))
