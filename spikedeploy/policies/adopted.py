"""A network of another tool as a policy: the file as its author meant it, and a codec beside it.

A file of another tool says neither how observations become spikes nor how output becomes actions.
A codec in JSON does, with the fields of `runtime.codec.codec.Codec`:

    {"timesteps": 16, "squash": "argmax",
     "normaliser": {"mean": [0, 0], "std": [1, 2], "clip": 3},
     "encoder": {"kind": "rate", "mode": "regular", "low": [-1, -1], "high": [1, 1]}}
"""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.console import say
from spikedeploy.outputs import check_output
from spikedeploy.policies.interface import DEFAULT_CHIP, FLOAT
from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.errors import ArtifactError, ConfigError, SpikedeployError
from spikedeploy.runtime.metadata import Provenance, Record

# which environment it is for is not known, and what marks it as written here
_ADOPTED = Provenance("", recipe="run --from")


def adopted(
    file: str,
    codec: Path | None,
    force: bool = False,
    fits: Callable[[Artifact], object] = id,
    **convention: Any,  # noqa: ANN401
) -> Path:
    """Write FILE.policy.nir beside a file of another tool, and return it.

    codec       JSON file
    force       whether a file that this function did not write is replaced
    fits        is called with the policy before anything is written, and raises where it is no use
    convention  written_by and options of artifact.load
    """
    path = Path(file)
    artifact = load(path, **convention)
    if codec is None:
        raise ConfigError(
            f"{file} says neither how observations become spikes nor how its output becomes "
            "actions: give --codec FILE.json; docs/own-network.md has one"
        )
    target = path.with_suffix(".policy.nir")
    policy = replace(artifact, codec=read_codec(codec), provenance=_ADOPTED)
    check_output("--from", target, (file, codec), force, _is_adopted)
    fits(policy)
    save(policy, target)
    say(f"{file}: {artifact.convention.describe()}")
    say(f"wrote {target}: a policy as any other")
    return target


def fits_on(chip: str | None, limits: bool, quantisation: Quantisation, policy: Artifact) -> None:
    """Raise what a chip has against a policy; "float" has nothing."""
    if chip != FLOAT:
        compile_program(policy, datasheet(chip or DEFAULT_CHIP), quantisation, limits=limits)


def _is_adopted(path: Path) -> bool:
    """Whether a file is an earlier output of `adopted`."""
    try:
        found = load(path).provenance
    except SpikedeployError:
        return False
    return found is not None and (found.env, found.recipe) == (_ADOPTED.env, _ADOPTED.recipe)


def read_codec(path: Path) -> Codec:
    """The codec in a JSON file."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ArtifactError(f"{path} is no JSON that can be read: {error}") from error
    if not isinstance(record, dict):
        raise ArtifactError(f"{path} holds no codec, but a {type(record).__name__}")
    try:
        arrays = _arrays(record)
    except (ValueError, OverflowError) as error:  # lists of different lengths
        raise ArtifactError(f"--codec {path} holds lists that are no arrays: {error}") from error
    try:
        return Codec.from_record(Record(arrays, str(path)))
    except ArtifactError as error:
        raise ArtifactError(f"--codec {error}; docs/own-network.md has a whole one") from error


def _arrays(record: dict[str, Any]) -> dict[str, Any]:
    """The record with arrays for lists."""
    return {name: _array(value) for name, value in record.items()}


def _array(value: Any) -> Any:  # noqa: ANN401
    if isinstance(value, dict):
        return _arrays(value)
    return np.asarray(value) if isinstance(value, list) else value
