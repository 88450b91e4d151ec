"""ONNX Runtime session of a float network, on one thread and without torch.

A file of a stranger can ask for any memory and time. One that computes with the operators of dense
networks alone cannot, and is opened as it is. Any other is first tried in a process with limits;
loops and branches are refused, because one trial says nothing about the next inference.
"""

import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.trainers.onnx_operators import operators

_ERRORS_ONLY = 3  # ONNX Runtime's severity level; failures raise exceptions anyway
_BYTES = 512 << 20  # that a trial may take, and for each byte of the file
_BYTES_OF_EACH = 8
_LIBRARIES = 2 << 30  # address space of Python and ONNX Runtime, where the system does not say it
_SECONDS = 10
_LARGEST_FILE = 1 << 30


def session(path: str | Path) -> Any:  # noqa: ANN401
    """Return the onnxruntime.InferenceSession of a file, or raise ArtifactError."""
    file = Path(path)
    if file.is_file():
        found = file.stat()
        _check(file, found.st_size, found.st_mtime_ns)
    network = _opened(path)
    _check_text(path, network)
    return network


def says_how_it_acts(network: Any) -> bool:  # noqa: ANN401
    """Return whether its metadata are those of our policies, which fix environment and units."""
    said: dict[str, str] = network.get_modelmeta().custom_metadata_map
    return {"env", "recipe"} <= said.keys()


def _check_text(path: str | Path, network: Any) -> None:  # noqa: ANN401
    """Raise ArtifactError where names or metadata, which are decoded when read, are no text."""
    try:
        for each in (*network.get_inputs(), *network.get_outputs()):
            _ = each.name, each.shape
        _ = network.get_modelmeta().custom_metadata_map
    except UnicodeDecodeError as error:
        raise ArtifactError(
            f"{path} has names or metadata that are no text ({error}). Export it again"
        ) from None


def _opened(path: str | Path) -> Any:  # noqa: ANN401
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = _ERRORS_ONLY
    try:
        return onnxruntime.InferenceSession(str(path), options, ["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime's errors share no other base class
        raise ArtifactError(f"{path} is not an ONNX file that can be run: {error}") from error


@lru_cache(maxsize=64)
def _check(path: Path, size: int, changed: int) -> None:
    """Raise ArtifactError where a file may take any time or memory; once for each version of it."""
    if size > _LARGEST_FILE:
        raise ArtifactError(f"{path} is {size} bytes; at most {_LARGEST_FILE}. Make it smaller.")
    found = operators(path)
    if found.nested:
        raise ArtifactError(
            f"{path} has loops, branches or functions of its own, whose time nothing bounds. "
            "Export the network without them."
        )
    if not found.elementary:
        _try(path, found.names)


def _try(path: Path, names: tuple[str, ...]) -> None:
    """Run the file once in a process with limits."""
    words = [sys.executable, "-c", f"from {__name__} import trial; trial()", str(path)]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=6 * _SECONDS)
    except subprocess.TimeoutExpired:
        why = f"it does not end within {_SECONDS} s"
    else:
        if not done.returncode:
            return
        lines = done.stderr.strip().splitlines()
        limits = f"it takes more than {_SECONDS} s or {_BYTES >> 20} MiB"
        why = lines[-1] if done.returncode == 1 and lines else limits
    raise ArtifactError(
        f"{path} cannot be run once on zeros: {why[:300]}. It has the operators "
        f"{', '.join(sorted(set(names)))[:200]}; export a plain dense network."
    )


def trial() -> None:
    """Run a file on zeros, within limits; what the process of `_try` does."""
    import resource

    own = Path("/proc/self/statm")
    taken = int(own.read_text().split()[0]) * resource.getpagesize() if own.exists() else _LIBRARIES
    most = taken + _BYTES + _BYTES_OF_EACH * Path(sys.argv[1]).stat().st_size
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
    try:
        found = _opened(sys.argv[1])
        kinds = {"tensor(float)": np.float32, "tensor(double)": np.float64}
        zeros = {
            each.name: np.zeros([n if isinstance(n, int) else 1 for n in each.shape], kind)
            for each in found.get_inputs()
            if (kind := kinds.get(each.type))
        }
        # other inputs are refused by whoever feeds them
        if len(zeros) == len(found.get_inputs()):
            found.run(None, zeros)
    except Exception as error:  # one line for the process that waits
        sys.exit(" ".join(str(error).split())[-300:])
