"""Run folders: configuration, versions and checkpoints, read without torch; the policy in torch."""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.registry import FLOAT, Candidate, Controller, Env, Floats, env_id
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.runtime.files import read_json
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.versions import own

if TYPE_CHECKING:
    from torch import Tensor

    from spikedeploy.trainers.policies import Policy

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


def steps(run: Path, checkpoint: str | None = None) -> tuple[int, str]:
    """Length of the training of a checkpoint, and its unit: see Provenance."""
    path = run / "checkpoints" / f"{RunFolder(run).deployed(checkpoint)}.json"
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
    config, name = settings(run), RunFolder(run).deployed(checkpoint)
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
        checkpoint="" if name == RunFolder(run).deployed() else name,
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


class TorchController(Controller):
    """A policy in torch, float32; a random encoder uses the generator of the chip.

    `sampled` draws one of several actions from the softmax of their scores; `checkpoint` is of the
    run, by default its best, else its last.
    """

    def __init__(self, run: str, sampled: bool = False, checkpoint: str | None = None) -> None:
        import torch

        from spikedeploy.runtime.emulator.controllers import Sampler

        torch.set_num_threads(1)
        self._torch = torch
        self.policy = policy_of(run, checkpoint)
        self._sampler = Sampler(self.policy.head == "discrete") if sampled else None
        self.reset(0)

    @classmethod
    def describe(cls, path: Path) -> Candidate:
        """The candidate in a run folder."""
        policy = policy_of(path)
        network = "control" if policy.kind.startswith("pruned") else "ann"
        return Candidate(
            path=str(path),
            name=path.resolve().name,
            kind="snn" if policy.kind in SPIKING else network,
            format="run",
            env=env_of(path),
            observed=policy.observations,
            actions=policy.actions,
        )

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """The policy; a chip needs the exported file."""
        if chip not in (None, FLOAT):
            raise ConfigError(
                f"{candidate.path} is a run folder, which no chip runs; export it first: "
                f"spikedeploy export {shlex.quote(candidate.path)} --to nir"
            )
        return cls(candidate.path, setup.sampled)

    def reset(self, seed: int) -> None:
        """Seed the encoder's generator, and put states to rest; both run on between inferences."""
        from spikedeploy.runtime.codec.rate import Xorshift
        from spikedeploy.trainers.policies import DeltaSnnPolicy

        self._rng = Xorshift(seed, self.policy.observations)
        self._state = (
            self.policy.initial_states(1) if isinstance(self.policy, DeltaSnnPolicy) else None
        )
        if self._sampler is not None:
            self._sampler.reset(seed)

    def replay(self, observations: Floats) -> NDArray[Any]:
        """Actions (S, act) or (S,) for the observations (S, obs) of an episode, in their order."""
        batch = self._torch.as_tensor(observations, dtype=self._torch.float32)
        with self._torch.inference_mode():
            scores = self._scores(batch)
            if self._sampler is not None:
                return self._sampler(scores.double().numpy())
            action: NDArray[Any] = self.policy.decide(scores).numpy()
        return action if self.policy.head == "discrete" else action.astype(np.float64)

    def _scores(self, batch: "Tensor") -> "Tensor":
        from spikedeploy.exporters.parity import input_spikes_of
        from spikedeploy.trainers.policies import DeltaSnnPolicy
        from spikedeploy.trainers.policies.spiking import CodedPolicy

        policy = self.policy
        if isinstance(policy, DeltaSnnPolicy) and self._state is not None:
            return self._torch.cat([policy.advance(row[None], self._state)[0] for row in batch])
        if isinstance(policy, CodedPolicy):
            spikes = input_spikes_of(policy, batch, self._rng.draw_sequence)
            return policy.forward_spikes(spikes).mean
        return policy.scores(batch)


def policy_of(run: str | Path, checkpoint: str | None = None) -> "Policy":
    """The policy of a run; ConfigError where a checkpoint does not hold what it says."""
    try:
        policy = RunFolder.find(run).policy(checkpoint)
        float(getattr(policy.normalizer, "clip", 0.0))  # which nothing else looks at before it acts
        return policy
    # of torch, and of whatever else a value stands that is none
    except (RuntimeError, KeyError, TypeError, ValueError, AttributeError, MemoryError) as error:
        if isinstance(error, SpikedeployError):
            raise
        what = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ConfigError(
            f"{run}: checkpoint {checkpoint or 'best or last'} holds no whole policy ({what}): "
            "copy it from a backup, or take another with --checkpoint"
        ) from error
