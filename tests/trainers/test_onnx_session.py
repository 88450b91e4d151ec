import pytest

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.trainers.distill.teachers import teacher
from spikedeploy.trainers.onnx_session import session


def test_a_file_that_is_not_onnx_is_refused_in_one_line(tmp_path):
    file = tmp_path / "broken.onnx"
    file.write_bytes(b"not a network")
    with pytest.raises(ArtifactError, match="is not an ONNX file that can be run"):
        session(file)
    with pytest.raises(ArtifactError, match="is not an ONNX file that can be run"):
        teacher(str(file), "hexapod")
