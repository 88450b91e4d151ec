"""Which versions of what are installed, read from their metadata without importing anything."""

from importlib.metadata import PackageNotFoundError, version

RUN = ("numpy", "nir", "h5py", "gymnasium", "mujoco", "onnxruntime", "matplotlib", "av")
TRAIN = ("torch", "snntorch", "pydantic", "safetensors", "onnx")


def installed(package: str) -> str | None:
    """The version of a package, None where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def own() -> str:
    """The version of spikedeploy itself."""
    return installed("spikedeploy") or "not installed"
