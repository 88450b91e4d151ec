"""A trial of one file: everything that spikedeploy does with such a file."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from benchmarks.fuzz_readers import READERS
from spikedeploy.emulation.open_loop import emulate_artifact
from spikedeploy.envs.errors import EnvError
from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.artifact.presets.preset import PRESETS
from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.errors import ConventionError, SpikedeployError
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint
from spikedeploy.runtime.families.cuba.floating_point import CubaFloat64
from spikedeploy.runtime.graph.ports import ports

TIMESTEPS = 3
# no fast kernels compute these: their machine is the interpreter
FAST = CubaFixedPoint | CubaFloat64
INTERPRETED = [name for name in CHIPS if not isinstance(chip(name).arithmetic, FAST)]
QUANTISATIONS = (
    PLAIN,
    Quantisation(rounding="truncate"),
    Quantisation("channel"),
    Quantisation("channel", headroom="proven"),
)
OURS = (SpikedeployError, EnvError)


def attempt(path: Path, rng: np.random.Generator) -> tuple[bool, tuple[str, ...]]:
    """Whether the file was read, and names of the SpikedeployErrors that were raised.

    Anything else comes through.
    """
    refused: list[str] = []
    with warnings.catch_warnings():
        # a warning would be a wrong result that somebody scrolls past
        warnings.simplefilter("error")
        if path.suffix == ".nir":
            return _network(path, rng, refused), tuple(refused)
        for read in READERS[path.suffix]:
            with _ours(refused):
                read(path)
    return len(refused) < len(READERS[path.suffix]), tuple(refused)


def _network(path: Path, rng: np.random.Generator, refused: list[str]) -> bool:
    try:
        artifact = load(path)
    except ConventionError as error:
        # the usual remedy: a dt
        refused.append(type(error).__name__)
        try:
            artifact = load(path, dt=1e-3)
        except OURS as again:
            refused.append(type(again).__name__)
            return False
    except OURS as error:
        refused.append(type(error).__name__)
        return False
    rasters = {
        port.name: (rng.random((TIMESTEPS, *port.shape)) < 0.3).astype(np.uint8)
        for port in ports(artifact.graph.inputs)
    }
    for name, limits in _where(rng):
        with _ours(refused):
            emulation = emulate_artifact(artifact, name, rasters, limits=limits)
            emulation.as_json()
            emulation.save(path.with_suffix(".out"))
    for work in (_judged, _read_like, _kept, _driven):
        with _ours(refused):
            work(path, artifact, rng)
    return True


def _where(rng: np.random.Generator) -> Iterator[tuple[str, bool]]:
    """Chips to run on, and whether within their limits; one is always interpreted."""
    chips = [str(rng.choice(list(CHIPS))), str(rng.choice(INTERPRETED))]
    return zip(("float", "ideal", *chips), (True, True, *(rng.random(2) < 0.5)), strict=True)


@contextmanager
def _ours(refused: list[str]) -> Iterator[None]:
    """Note a SpikedeployError."""
    try:
        yield
    except OURS as error:
        refused.append(type(error).__name__)


def _judged(_: Path, artifact: Artifact, rng: np.random.Generator) -> None:
    """Every chip's rules and compiler; refusals are not noted, as some chip always refuses."""
    quantisation = QUANTISATIONS[int(rng.integers(len(QUANTISATIONS)))]
    for name in CHIPS:
        check(artifact, chip(name))
        with suppress(*OURS):
            compile_program(artifact, chip(name), quantisation, limits=False)


def _read_like(path: Path, _: Artifact, rng: np.random.Generator) -> None:
    load(path, like=str(rng.choice(list(PRESETS))))


def _kept(path: Path, artifact: Artifact, _: np.random.Generator) -> None:
    """Write the file and read it back."""
    copy = path.with_suffix(".copy")
    save(artifact, copy)
    load(copy)


def _driven(_: Path, artifact: Artifact, rng: np.random.Generator) -> None:
    """Encode an observation."""
    if artifact.codec is None:
        return
    observation = rng.normal(size=(1, artifact.codec.encoder.observed))
    artifact.codec.encode(observation)
