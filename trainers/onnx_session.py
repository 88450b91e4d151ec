"""A float network's ONNX file, opened to be run on one thread; needs no torch."""

from pathlib import Path
from typing import Any

import onnxruntime

from spikedeploy.runtime.errors import ArtifactError

ERRORS_ONLY = 3  # ONNX Runtime's severity: what goes wrong is said by the exception


def session(path: str | Path) -> Any:  # noqa: ANN401
    """Return the onnxruntime.InferenceSession of a file, or raise ArtifactError."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = ERRORS_ONLY
    try:
        return onnxruntime.InferenceSession(str(path), options, ["CPUExecutionProvider"])
    except Exception as error:  # the runtime's own kinds of error share no other base
        raise ArtifactError(f"{path} is not an ONNX file that can be run: {error}") from error
