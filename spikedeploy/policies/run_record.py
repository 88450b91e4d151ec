"""The records of a run folder: configuration, versions, checkpoint; read without torch."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spikedeploy.policies.registry import env_id
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_json
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.versions import own

# kinds of policies that are exported as NIR
SPIKING = ("popsan", "spiking-mlp", "network", "delta-snn")


def settings(run: Path) -> dict[str, Any]:
    """The resolved configuration of a run."""
    return _read(run / "config.json")


def env_of(run: Path) -> str | None:
    """Id of the environment that a run was trained in."""
    config = settings(run)
    with checked_record(run / "config.json"):
        return env_id(config["env"]["name"])


def versions(run: Path) -> dict[str, str | None]:
    """The package versions of a run, and its commit."""
    return _read(run / "versions.json")


def deployed_checkpoint(run: Path, checkpoint: str | None = None) -> str:
    """Name of the deployed checkpoint: the one asked for, else the best, else the last."""
    names = sorted(path.stem for path in (run / "checkpoints").glob("*.safetensors"))
    if checkpoint is None:
        return "best" if "best" in names else "last"
    if checkpoint not in names:
        raise ConfigError(
            f"{run} has no checkpoint {checkpoint!r}; it has: {', '.join(names) or 'none yet'}"
        )
    return checkpoint


def steps(run: Path, checkpoint: str | None = None) -> tuple[int, str]:
    """Length of the training of a checkpoint, and its unit: see Provenance."""
    path = run / "checkpoints" / f"{deployed_checkpoint(run, checkpoint)}.json"
    record = _read(path)
    unit = "environment steps" if "env_steps" in record else "updates"
    with checked_record(path):
        return int(record.get("env_steps", record.get("updates", 0))), unit


def checkpoint_record(run: Path, checkpoint: str) -> dict[str, Any]:
    """The numbers to read of a checkpoint; none where there is none yet."""
    file = run / "checkpoints" / f"{checkpoint}.json"
    return _read(file) if file.is_file() else {}


def describe_progress(run: Path) -> str:
    """The progress of a training that has not ended: `12 %`; empty where it has.

    Also empty for runs of earlier versions, which lack this record.
    """
    state = checkpoint_record(run, "last")
    ended = state.get("finished", True) or "share" not in state
    with checked_record(run / "checkpoints" / "last.json"):
        return "" if ended else f"{100 * state['share']:.0f} %"


def origin(run: Path, checkpoint: str | None = None) -> Provenance:
    """The provenance of the policy of a checkpoint, for an exported file."""
    config, name = settings(run), deployed_checkpoint(run, checkpoint)
    with checked_record(run / "config.json"):
        recipe, seed = str(config["recipe"]), int(config["seed"])
        chip = config["policy"].get("chip", "")
    return Provenance(
        env=env_of(run) or "",
        recipe=recipe,
        seed=seed,
        steps=steps(run, name)[0],
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        version=own(),
        checkpoint="" if name == deployed_checkpoint(run) else name,
        chip=str(chip),
    )


@contextmanager
def checked_record(path: Path) -> Iterator[None]:
    """Refuse the record in a file where a field that is taken is missing, or no such value."""
    try:
        yield
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError(
            f"{path} is damaged ({type(error).__name__}: {error}): copy it from a backup, or train "
            "again"
        ) from error


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise ConfigError(f"{path.parent} is no run folder: it has no {path.name}")
    return read_json(path, "copy it from a backup, or train again")


def format_of(run: Path) -> str:
    """The format of a run's policy: "nir" where it spikes, else "onnx"."""
    with checked_record(run / "config.json"):
        spikes = settings(run)["policy"]["kind"] in SPIKING
    return "nir" if spikes else "onnx"
