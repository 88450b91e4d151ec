"""A network whose accuracy fell on a chip, trained on through the chip's integers.

Outputs are summed over time. The loss is the cross entropy of labels; without labels the divergence
from the float twin's softmax (Hinton et al. 2015), or where actions are numbers the squared error.
First a search chooses where weights are clipped, without which two or three bits are spent on the
few largest; then Adam trains all numbers of the network through the chip. A part of the samples is
held out: it decides which numbers are kept, and when to stop.

A checkpoint is written at every validation. What a resumed adaptation computes depends on it and on
the number of the update alone, so that it ends with the same bits as one that was not stopped.
"""

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor, nn

from spikedeploy.runtime.artifact.artifact import Artifact, digest, load, save
from spikedeploy.runtime.emulator.running_network import run_network
from spikedeploy.runtime.errors import (
    ArtifactError,
    ConfigError,
    ObservationError,
    RuleError,
    SpikedeployError,
)
from spikedeploy.runtime.graph.shapes import Shape
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import Batch, Positive, Rate, Section
from spikedeploy.trainers.from_torch import artifact_from_torch
from spikedeploy.trainers.progress import Interrupt, ProgressBar
from spikedeploy.trainers.run_folder import read_checkpoint, write_checkpoint
from spikedeploy.trainers.runner import Learner, adam, descend, set_rate
from spikedeploy.trainers.through_chip import ChipModule, on_chip
from spikedeploy.trainers.torch_network import Weights

_TUNED = "adapted to "  # Artifact.tuned of what is written here begins so
_FEWEST = 10  # samples: with fewer, none or one would be held out
_EVERY = 50  # updates at most between two validations
_GRADIENT_NORM = 1.0
_SPREAD = 2.0  # standard deviation of the float twin's scores that the softmax sees
_CLIPS = (0.8, 0.65, 0.5, 0.4, 0.3, 0.2)  # of a layer's largest weight
_CLIP_GAIN = 0.95  # of the loss: less gained is not worth the limit on weights
_GROWTH = 2.0  # weights that are not clipped stay below so many times the largest at first
_CLIP_SAMPLES = 256
_MOST_HALVINGS = 10  # of the learning rate, beyond which numbers that a chip lacks are an error
# bytes of a neuron or input in a timestep of a sample in an update: 22 to 26 measured, of dense and
# convolutional networks on loihi1, odin and ideal
_STATE = 40
_NO_NUMBERS = (RuleError, ArtifactError)  # that a chip or a file holds, as thresholds below 0
_UNKNOWN_MEMORY = 1 << 32


class AdaptationSettings(Section):
    """How it is trained.

    epochs: most passes over the samples
    batch: samples of an update
    rate: learning rate of Adam; halved whenever half of the patience is over
    patience: validations without a better result, after which it stops
    held_out: share of the samples that validate, and are not trained on
    seed: seed of the samples held out and of the order of the others
    """

    epochs: Positive = 60
    batch: Batch = 64
    rate: Rate = 1e-3
    patience: Positive = 12
    held_out: float = Field(default=0.2, gt=0, le=0.5)
    seed: int = Field(default=0, ge=0)


@dataclass(frozen=True)
class AdaptationScore:
    """How good outputs, summed over time, are on the samples held out.

    accuracy: share whose largest output is the label's; None without labels
    agreement: share whose largest output is the float twin's; None where that means nothing: of a
        single output, and of a policy whose actions are numbers
    error: root mean square of the difference to the float twin, by the twin's standard deviation
    loss: what is trained
    """

    accuracy: float | None
    agreement: float | None
    error: float
    loss: float

    @property
    def rank(self) -> tuple[float, float, float]:
        """Accuracy, agreement and loss, as far as they are known: the larger the better."""
        agreement = 0.0 if self.accuracy is not None else self.agreement or 0.0
        return self.accuracy or 0.0, agreement, -self.loss


@dataclass(frozen=True, eq=False, repr=False)
class Adaptation:
    """The best network that was found, and its scores.

    artifact: the best network, with its convention
    chip: name as it was given
    trained, held_out: numbers of samples
    updates: number of gradient updates
    float_twin, before, after: scores of the network in float, of its float weights on the chip, and
        of the artifact on the chip
    finished: False where it was stopped; the artifact is the best until then
    """

    artifact: Artifact
    chip: str
    trained: int
    held_out: int
    updates: int
    float_twin: AdaptationScore
    before: AdaptationScore
    after: AdaptationScore
    finished: bool

    def save(self, path: str | Path) -> Path:
        """Write the artifact as a NIR file; return its path."""
        save(self.artifact, path)
        return Path(path)

    def __repr__(self) -> str:
        named = {"float": self.float_twin, "before": self.before, "after": self.after}
        scores = ", ".join(f"{name} {shown(score)}" for name, score in named.items())
        samples = f"{self.held_out:,} samples held out"
        return f"<adapted to {self.chip} in {self.updates:,} updates; {samples}: {scores}>"

    def as_json(self) -> dict[str, Any]:
        """Return all numbers as plain data."""
        return {
            "chip": self.chip,
            "finished": self.finished,
            "samples": {"trained": self.trained, "held_out": self.held_out},
            "updates": self.updates,
            "float": asdict(self.float_twin),
            "before": asdict(self.before),
            "after": asdict(self.after),
        }


def adapt(
    network: nn.Module | Artifact,
    chip_name: str,
    raster: NDArray[Any],
    labels: NDArray[Any] | None = None,
    *,
    input_shape: Sequence[int] | None = None,
    limits: bool = True,
    settings: AdaptationSettings | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    interrupt: Interrupt | None = None,
    quiet: bool = False,
) -> Adaptation:
    """Train a network through a chip; a torch module has the best numbers afterwards.

    raster: (B, T, *shape) spikes, or counts of them up to 255
    labels: (B,) whole numbers, the outputs that are to be the largest; None for what the float twin
        puts out
    input_shape: of a torch module, of one timestep of one sample
    limits: refuse what breaks a design rule of the chip; False trains what does not fit
    checkpoint: file that is written at each validation; none is by default
    resume: go on from the checkpoint
    interrupt: requests a stop, and is entered by the caller; by default Ctrl-C does

    Raises KeyboardInterrupt where it is stopped before its first validation.
    """
    # of the untouched numbers, as those of a module will be others soon
    twin = network if isinstance(network, Artifact) else artifact_from_torch(network, input_shape)
    module = on_chip(network, chip_name, input_shape, limits=limits)
    settings = settings or AdaptationSettings()
    if resume and checkpoint is None:
        raise ConfigError("resume goes on from a checkpoint: give the one that was written")
    if not any(each.requires_grad for each in module.network.parameters()):
        raise ConfigError(
            "no number of the network is trained: set requires_grad of those that may change"
        )
    samples = _samples(raster, module.network.takes)
    classes = None if labels is None else _classes(labels, len(samples), module.network.puts)
    _check_memory(module, settings.batch, samples.shape[1])
    origin = {
        "network": digest(twin),
        "chip": chip_name,
        "limits": limits,
        "raster": _sha256(samples),
        "labels": None if labels is None else _sha256(np.asarray(labels)),
        **{name: getattr(settings, name) for name in ("batch", "rate", "held_out", "seed")},
    }
    stop = interrupt or Interrupt()
    listening = nullcontext() if interrupt else stop
    with listening, ProgressBar(f"adapting to {chip_name}", quiet) as stop.bar:
        training = _Training(module, twin, samples, classes, settings, stop)
        if resume and checkpoint is not None:
            training.restore(checkpoint, origin)
        else:
            training.begin()
        stop.bar.say(training.describe(chip_name))
        finished = training.learn(stop.bar, checkpoint, origin)
    module.network.load_state_dict(training.policy.state_dict())
    return Adaptation(
        artifact=_artifact(module, twin, chip_name),
        chip=chip_name,
        trained=len(training.trained),
        held_out=len(training.held_out),
        updates=training.update,
        float_twin=training.score(training.targets[training.held_out], training.held_out),
        before=training.before,
        after=training.best,
        finished=finished,
    )


class _Training(Learner):
    """The loop, and what its checkpoints hold.

    module: the trained module; `policy` is the best network until now
    samples: (B, T, *takes)
    classes: (B,) or None
    targets: (B, N) outputs of the float twin, summed over time
    trained, held_out: numbers of samples
    bounds: parameter -> largest magnitude that it may have
    update, since, halvings: updates, validations without a better result, and halvings of the rate
    before, best: scores on the samples held out
    """

    def __init__(
        self,
        module: ChipModule,
        twin: Artifact,
        samples: NDArray[np.uint8],
        classes: Tensor | None,
        settings: AdaptationSettings,
        stopped: Callable[[], bool],
    ) -> None:
        self.module, self.samples, self.classes = module, samples, classes
        self.settings, self._stopped = settings, stopped
        self.modules = {"now": module.network}
        self.policy: Any = deepcopy(module.network)
        self.optimizers = {"adam": adam(module.network, settings.rate)}
        order = np.random.default_rng(settings.seed).permutation(len(samples))
        held = max(1, round(settings.held_out * len(samples)))
        self.held_out, self.trained = np.sort(order[:held]), np.sort(order[held:])
        self.targets = self._float_outputs(twin)
        chosen = twin.codec is None or twin.codec.chooses
        self._chooses = self.targets.shape[1] > 1 and chosen
        self.spread = float(self.targets[self.trained].std())
        if classes is None and bool((self.targets == self.targets[0]).all()):
            raise ObservationError(
                "the float twin's outputs are equal for all samples, so that there is nothing to "
                "adapt to. If no neuron spikes, the file is read otherwise than meant: --from "
                "names the tool that wrote it; or give --labels."
            )
        self.spread = self.spread or 1.0
        self.bounds: dict[str, float] = {}
        self.update, self.since, self.halvings = 0, 0, 0

    def _float_outputs(self, twin: Artifact) -> Tensor:
        """Return the outputs (B, N) of the float twin, summed over time."""
        network, found = run_network(twin, None, "none"), []
        for rows in self._batches(np.arange(len(self.samples))):
            network.reset()  # states that a policy keeps between inferences
            found.append(network.infer(self.samples[rows]).sum(axis=1))
        return torch.from_numpy(np.concatenate(found).astype(np.float32))

    def begin(self) -> None:
        """Score the float weights, then clip them where that lessens the loss."""
        self.before = self.best = self.validate()
        self._clip()
        self._keep_if_better(self.validate())

    def describe(self, chip_name: str) -> str:
        """Return what is known before it begins, in a line."""
        twin = self.score(self.targets[self.held_out], self.held_out)
        samples = f"{len(self.trained):,} samples train, {len(self.held_out):,} validate"
        return f"{samples}: float {shown(twin)}; float weights on {chip_name} {shown(self.before)}"

    def learn(self, bar: ProgressBar, checkpoint: Path | None, origin: Mapping[str, Any]) -> bool:
        """Train until validation does not improve; return whether that, or the end, came."""
        settings, losses = self.settings, list[float]()
        in_epoch = -(-len(self.trained) // settings.batch)
        total, every = settings.epochs * in_epoch, min(in_epoch, _EVERY)
        while self.update < total and self.since < settings.patience:
            if self._stopped():
                self.save(checkpoint, origin)
                return False
            losses.append(self._step(in_epoch))
            bar.move_to(self.update, total)
            if self.update % every and self.update < total:
                continue
            try:
                latest = self.validate()
            except _NO_NUMBERS:
                self._go_back()
                latest = self.validate()
            self._validated(latest)
            self.save(checkpoint, origin)
            name = "error" if self.classes is None else "accuracy"
            row = {"train_loss": float(np.nanmean(losses)), **{
                f"{which}_{name}": getattr(score, name)
                for which, score in (("eval", latest), ("best", self.best))
            }}  # fmt: skip
            bar.show(row)
            losses.clear()
        return True

    def _step(self, in_epoch: int) -> float:
        """Take one update; return its loss."""
        epoch, place = divmod(self.update, in_epoch)
        order = np.random.default_rng((self.settings.seed, epoch)).permutation(self.trained)
        rows = order[place * self.settings.batch :][: self.settings.batch]
        self.update += 1
        try:
            loss = self.loss(self.outputs(rows), rows)
        except _NO_NUMBERS:
            self._go_back()
            return math.nan
        if not math.isfinite(loss.item()):
            raise ConfigError(
                f"the loss is {loss.item():g} in update {self.update}: the learning rate "
                f"{self.settings.rate:g} is too large. Begin anew with a smaller one, --rate "
                f"{self.settings.rate / 10:g}."
            )
        adam_ = self.optimizers["adam"]
        set_rate(adam_, self.settings.rate * 0.5**self.halvings)
        descend(adam_, self.module.network, loss, _GRADIENT_NORM)
        self._limit()
        return loss.item()

    def _go_back(self) -> None:
        """Return to the best numbers, to go on more slowly; called in an `except`."""
        if self.halvings >= _MOST_HALVINGS:
            raise
        self.module.network.load_state_dict(self.policy.state_dict())
        self.halvings += 1

    def _validated(self, score: AdaptationScore) -> None:
        self.since = 0 if self._keep_if_better(score) else self.since + 1
        if self.since and self.since % max(self.settings.patience // 2, 1) == 0:
            self.halvings += 1

    def _keep_if_better(self, score: AdaptationScore) -> bool:
        if score.rank <= self.best.rank:
            return False
        self.best = score
        self.policy.load_state_dict(self.module.network.state_dict())
        return True

    def outputs(self, rows: NDArray[np.int64]) -> Tensor:
        """Return the outputs (R, N) of samples on the chip, summed over time."""
        spikes = torch.from_numpy(self.samples[rows]).float().swapaxes(0, 1)
        found: Tensor = self.module(spikes).sum(0).flatten(1)
        return found

    def loss(self, outputs: Tensor, rows: NDArray[np.int64]) -> Tensor:
        """Return cross entropy of labels or of the float twin's softmax, or the squared error."""
        twin, unit = self.targets[rows], self.spread
        if self.classes is not None:
            return nn.functional.cross_entropy(outputs * (_SPREAD / unit), self.classes[rows])
        if not self._chooses:
            return ((outputs - twin) / unit).square().mean()
        scores, wanted = (_SPREAD / unit * each for each in (outputs, twin))
        return nn.functional.kl_div(
            scores.log_softmax(1), wanted.log_softmax(1), reduction="batchmean", log_target=True
        )

    def validate(self) -> AdaptationScore:
        """Return the score of the present numbers."""
        return self.score(self._all_outputs(self.held_out), self.held_out)

    def score(self, outputs: Tensor, rows: NDArray[np.int64]) -> AdaptationScore:
        """Return the score of outputs (R, N)."""
        twin, largest = self.targets[rows], outputs.argmax(1)
        labels = None if self.classes is None else self.classes[rows]
        return AdaptationScore(
            None if labels is None else _share(largest == labels),
            _share(largest == twin.argmax(1)) if self._chooses else None,
            float((outputs - twin).square().mean().sqrt()) / self.spread,
            float(self.loss(outputs, rows)),
        )

    def _all_outputs(self, rows: NDArray[np.int64]) -> Tensor:
        with torch.no_grad():
            return torch.cat([self.outputs(each) for each in self._batches(rows)])

    def _batches(self, rows: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
        for first in range(0, len(rows), self.settings.batch):
            if self._stopped():
                raise KeyboardInterrupt
            yield rows[first : first + self.settings.batch]

    def _clip(self) -> None:
        """Choose the largest weight of each layer, one after the other, twice."""
        rows = np.random.default_rng(self.settings.seed).permutation(self.trained)[:_CLIP_SAMPLES]
        # layers that share a matrix have one name; what the user froze stays
        named = {n: p for n, p in self.module.network.named_parameters() if p.requires_grad}
        layers = [
            {
                n: named[n]
                for n in (f"listed.{k}.layer.weight", f"listed.{k}.layer.bias")
                if n in named
            }
            for k, node in enumerate(self.module.network.listed)
            if isinstance(node, Weights) and f"listed.{k}.layer.weight" in named
        ]
        initial = {name: p.detach().clone() for layer in layers for name, p in layer.items()}
        least = self._loss_of(rows)
        for layer in [*layers, *layers] if len(layers) > 1 else layers:
            least, bounds = self._clip_layer(layer, initial, rows, least)
            if bounds:
                self.bounds = {n: b for n, b in self.bounds.items() if n not in layer} | bounds
        for weight, *_ in layers:
            self.bounds.setdefault(weight, _GROWTH * float(initial[weight].abs().max()))

    def _clip_layer(
        self,
        layer: Mapping[str, Tensor],
        initial: Mapping[str, Tensor],
        rows: NDArray[np.int64],
        least: float,
    ) -> tuple[float, dict[str, float]]:
        """Clip the initial weights of a layer, or its biases too, where that lessens the loss most.

        layer: its weight, and its bias if it has one, by name
        least: loss of its present numbers, which stay where no clip lessens it enough

        Returns the loss, and the bounds of what was clipped.
        """
        present = {name: each.detach().clone() for name, each in layer.items()}
        weight, best = next(iter(layer)), dict[str, float]()
        largest = float(initial[weight].abs().max())
        for clipped in dict.fromkeys([(weight,), tuple(layer)]):
            for clip in _CLIPS:
                bounds = dict.fromkeys(clipped, clip * largest)
                _fill(layer, initial, bounds)
                if (found := self._loss_of(rows)) < _CLIP_GAIN * least:
                    least, best = found, bounds
        _fill(layer, initial if best else present, best)
        return least, best

    def _loss_of(self, rows: NDArray[np.int64]) -> float:
        try:
            return float(self.loss(self._all_outputs(rows), rows))
        except _NO_NUMBERS:  # such as where every weight becomes 0
            return math.inf

    def _limit(self) -> None:
        with torch.no_grad():
            for name, parameter in self.module.network.named_parameters():
                if (bound := self.bounds.get(name)) is not None:
                    parameter.clamp_(-bound, bound)

    def save(self, path: Path | None, origin: Mapping[str, Any]) -> None:
        """Write a checkpoint: the present and the best numbers, Adam, and the counters."""
        if path is None:
            return
        best = {f"policy.{name}": each for name, each in self.policy.state_dict().items()}
        state = {
            "origin": dict(origin),
            "update": self.update,
            "since": self.since,
            "halvings": self.halvings,
            "bounds": self.bounds,
            "before": asdict(self.before),
            "best": asdict(self.best),
        }
        write_checkpoint(path, state, {**best, **self.tensors()})

    def restore(self, path: Path, origin: Mapping[str, Any]) -> None:
        """Go on from a checkpoint; ConfigError where it is of another adaptation."""
        state, tensors = read_checkpoint(path)
        begun = state.get("origin", {})
        if other := [name for name in origin if begun.get(name) != origin[name]]:
            raise ConfigError(
                f"{path} was begun with another {', '.join(other)}: give what it was begun with, "
                "or begin anew without --resume"
            )
        self.load(tensors)
        self.update, self.since = state["update"], state["since"]
        self.halvings, self.bounds = state["halvings"], state["bounds"]
        self.before, self.best = (
            AdaptationScore(**state["before"]),
            AdaptationScore(**state["best"]),
        )


def is_adapted(path: Path) -> bool:
    """Return whether a file is a network that was adapted."""
    with suppress(SpikedeployError):
        return load(path).tuned.startswith(_TUNED)
    return False


def shown(score: AdaptationScore) -> str:
    """Return accuracy, or agreement and error, in words."""
    if score.accuracy is not None:
        return f"{score.accuracy:.1%}"
    agreement = "" if score.agreement is None else f"{score.agreement:.1%} as float, "
    return f"{agreement}error {score.error:.2f}"


def _fill(
    parameters: Mapping[str, Tensor], values: Mapping[str, Tensor], bounds: Mapping[str, float]
) -> None:
    """Set parameters to values, within bounds where there are some."""
    with torch.no_grad():
        for name, parameter in parameters.items():
            bound = bounds.get(name, math.inf)
            parameter.copy_(values[name].clamp(-bound, bound))


def _samples(raster: NDArray[Any], takes: Shape) -> NDArray[np.uint8]:
    """Return the raster as (B, T, *takes) in uint8."""
    wanted = ", ".join(["B", "T", *map(str, takes)])
    if raster.shape[2:] not in (takes, (math.prod(takes),)) or not raster.shape[1]:
        raise ObservationError(
            f"the raster has shape {raster.shape}; many samples of this network have ({wanted}), "
            "at least one timestep each."
        )
    if len(raster) < _FEWEST:
        raise ObservationError(
            f"the raster holds {len(raster)} samples; at least {_FEWEST} are needed, since some "
            "are held out to validate. A long recording can be cut into parts."
        )
    if raster.min() < 0 or raster.max() > 255 or (raster != np.rint(raster)).any():
        raise ObservationError(
            f"the raster holds numbers from {raster.min():g} to {raster.max():g}; a chip takes "
            "whole spikes. Encode it first, as rates or latencies."
        )
    return raster.astype(np.uint8).reshape(*raster.shape[:2], *takes)


def _classes(labels: NDArray[Any], samples: int, puts: Shape) -> Tensor:
    """Return the labels (B,), each the number of an output."""
    found, outputs = np.asarray(labels), math.prod(puts)
    if outputs == 1:
        raise ObservationError(
            "the network has one output, and labels need one for each class. Leave --labels out: "
            "it is adapted to its float twin."
        )
    whole = found.dtype.kind in "biuf" and not (found != np.rint(found)).any()
    if found.shape != (samples,) or not whole or found.min() < 0 or found.max() >= outputs:
        raise ObservationError(
            f"labels of shape {found.shape} and type {found.dtype} are not the number of the right "
            f"output, from 0 to {outputs - 1}, for each of {samples} samples."
        )
    return torch.from_numpy(found.astype(np.int64))


def _check_memory(module: ChipModule, batch: int, timesteps: int) -> None:
    """Refuse a batch whose states would not fit into the memory that is free."""
    network = module.network
    each = math.prod(network.takes) + sum(math.prod(node.puts) for node in network.nodes.values())
    found, free = _STATE * batch * timesteps * each, free_memory()
    if found > free:
        fits = int(free / (_STATE * timesteps * each) / 1.25)
        remedy = f"Give --batch {fits}." if fits else "Cut the samples into shorter ones."
        raise ObservationError(
            f"an update of {batch} samples of {timesteps} timesteps and {each:,} neurons and "
            f"inputs takes about {found / 2**20:,.0f} MiB, and {free / 2**20:,.0f} MiB of memory "
            f"are free. {remedy}"
        )


def free_memory() -> int:
    """Return the bytes of memory that programs can have; 4 GiB where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        (kibibytes,) = (line.split()[1] for line in lines if line.startswith("MemAvailable:"))
    except (OSError, ValueError):
        return _UNKNOWN_MEMORY
    return int(kibibytes) << 10


def _artifact(module: ChipModule, twin: Artifact, chip_name: str) -> Artifact:
    """Return the present numbers as an artifact that says for which chip they are."""
    made = replace(twin.provenance or Provenance(""), chip=chip_name)
    return replace(module.artifact(), provenance=made, tuned=f"{_TUNED}{chip_name}")


def _share(hits: Tensor) -> float:
    return float(hits.double().mean())


def _sha256(array: NDArray[Any]) -> str:
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()
