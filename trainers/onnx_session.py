"""ONNX Runtime session of a float network, on one thread and without torch."""

from pathlib import Path
from typing import Any

import onnxruntime

from spikedeploy.runtime.errors import ArtifactError

_ERRORS_ONLY = 3  # ONNX Runtime's severity level; failures raise exceptions anyway


def session(path: str | Path) -> Any:  # noqa: ANN401
    """Return the onnxruntime.InferenceSession of a file, or raise ArtifactError."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = _ERRORS_ONLY
    try:
        return onnxruntime.InferenceSession(str(path), options, ["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime's errors share no other base class
        raise ArtifactError(f"{path} is not an ONNX file that can be run: {error}") from error
