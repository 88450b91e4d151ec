"""The zoo: the policies that are shipped, `spikedeploy/zoo/<env>/<name>`, a card beside each."""

from pathlib import Path

FOLDER = Path(__file__).parent
SUFFIXES = (".onnx", ".nir")


def policies(env: str | None = None) -> list[Path]:
    """The shipped policy files, of one environment (short name) or of all, ordered by name."""
    return sorted(p for p in FOLDER.glob(f"{env or '*'}/*") if p.suffix in SUFFIXES)


def names() -> list[str]:
    """What the command line calls the shipped policies: `hexapod/popsan`."""
    return [f"{p.parent.name}/{p.stem}" for p in policies()]


def path(name: str) -> Path | None:
    """The file of a name as above, its suffix allowed; None where there is none."""
    wanted = name.removesuffix(".onnx").removesuffix(".nir")
    return next((p for p in policies() if f"{p.parent.name}/{p.stem}" == wanted), None)
