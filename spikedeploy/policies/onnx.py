"""ONNX files: float networks, run by ONNX Runtime on one thread."""

import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.rollout import Rollout
from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.costs import UNCOUNTED, Costs, float_costs
from spikedeploy.policies.registry import Candidate, Controller, Env, Floats, env_id
from spikedeploy.runtime.codec.codec import observed_numbers
from spikedeploy.runtime.emulator.controllers import Sampler
from spikedeploy.runtime.errors import ArtifactError, ObservationError
from spikedeploy.trainers.onnx_session import DTYPES, NEXT, States, infer, initial_states, session

KINDS = ("ann", "control")
HEADS = ("continuous", "discrete")

_STEP = "snn-step"  # what exporters.spiking_onnx writes


class OnnxController(Controller):
    """A float network: observation (obs,) in, action (act,) out, or () where it chooses one.

    path: path of the file
    metadata: metadata of the exporter: env, recipe, seed, kind, head, name, macs ...
    observed: size of the observation
    actions: size of the action, or number of actions to choose from
    chooses: whether the output is logits, of which the largest is taken

    A file with states, such as the memory of a GRU, keeps them from one control step to the next.

    `sampled` draws from the softmax of the logits instead.
    """

    def __init__(self, path: str | Path, sampled: bool = False) -> None:
        self.path = path
        self._session = session(path)
        self.metadata = _metadata(path, self._session)
        if self.metadata.get("kind") == _STEP:
            raise ArtifactError(
                f"{path} is one step of a spiking policy, whose states whoever runs it keeps, as "
                "docs/other-tools.md shows. To play it, give the .nir file that it was made of"
            )
        self._input, (self._output, *self._presynaptic) = _ends(path, self._session)
        self._dtype = DTYPES[self._input.type]
        self._states = initial_states(self._session)
        self._single = self._input.shape[0] == 1 or bool(self._states)
        self.observed = _width(path, self._input)
        self.actions = _width(path, self._output)
        self.chooses = self.metadata.get("head") == "discrete"
        self._sampler = Sampler(self.chooses) if sampled else None

    @classmethod
    def describe(cls, path: Path) -> Candidate:
        """The candidate in an ONNX file; files without our metadata count as float networks."""
        policy = cls(path)
        return Candidate(
            path=str(path),
            name=path.stem,
            kind=policy.metadata.get("kind", KINDS[0]),
            format=".onnx",
            env=env_id(policy.metadata.get("env", "")),
            observed=policy.observed,
            actions=policy.actions,
        )

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """The network, loaded."""
        return cls(candidate.path, setup.sampled)

    def reset(self, seed: int) -> None:
        """Start an episode: states are 0, and sampling begins anew."""
        self._states = initial_states(self._session)
        if self._sampler is not None:
            self._sampler.reset(seed)

    def replay(self, observations: Floats) -> NDArray[Any]:
        """Actions (S, act) or (S,) for the observations (S, obs) of an episode."""
        output = self._run([self._output], observations, self._states)[0]
        if self._sampler is not None:
            return self._sampler(output)
        return output.argmax(axis=1) if self.chooses else output

    def costs(self, played: Rollout) -> Costs:
        """Multiply-accumulates, all of them and the effective ones; the energies of both.

        `energy_j` is that of all. Terms besides the operations are alike by every table.
        """
        if "macs" not in self.metadata:
            return replace(UNCOUNTED, effective_acs=0.0)
        return float_costs(
            float(self.metadata["macs"]),
            self.effective_macs(played.observation[:-1]),
            self.biases,
            self.reads,
            hidden=len(self._presynaptic) != 1,
        )

    def effective_macs(self, observations: Floats) -> float | None:
        """Mean multiply-accumulates with non-zero input; None where the file cannot tell.

        observations: (S, obs) of an episode from its beginning, where there are states
        """
        if not self._presynaptic:
            return None
        presynaptic = self._run(self._presynaptic, observations, initial_states(self._session))
        # MACs = sum over weight matrices of non-zero inputs x fan-out
        operations = zip(presynaptic, self._fan_outs(), strict=True)
        return float(
            sum(((x != 0) @ fan_out).sum() for x, fan_out in operations) / len(observations)
        )

    @property
    def reads(self) -> int | None:
        """Observations with a weight; None where the file computes features of them, or no list."""
        if not self._presynaptic or _width(self.path, self._presynaptic[0]) != self.observed:
            return None
        return int(np.count_nonzero(self._fan_outs()[0]))

    @property
    def biases(self) -> int | None:
        """Units that are used, each of which has a bias; None where the file cannot tell.

        Units of a GRU have six.
        """
        if "biases" in self.metadata:
            return int(self.metadata["biases"])
        if not self._presynaptic:
            return None
        return sum(int(np.count_nonzero(each)) for each in self._fan_outs()[1:]) + self.actions

    def _fan_outs(self) -> list[NDArray[np.int64]]:
        """Weights (M,) of each input of each matrix; pruned networks say how many are left."""
        if "fan_out" in self.metadata:
            said = [np.array(each, np.int64) for each in json.loads(self.metadata["fan_out"])]
            widths = [_width(self.path, each) for each in self._presynaptic]
            if widths != (found := [len(each) for each in said]):
                raise ArtifactError(
                    f"{self.path} says fan_out of {found} units, and its matrices take {widths}. "
                    "Export it again"
                )
            return said
        ends = [_width(self.path, each) for each in (*self._presynaptic, self._output)]
        return [np.full(width, target) for width, target in pairwise(ends)]

    def _run(self, outputs: list[Any], observations: Floats, states: States) -> list[Floats]:
        observed = observed_numbers(observations)
        if observed.shape[1:] != (self.observed,) or not np.isfinite(observed).all():
            raise ObservationError(
                f"{self.path} observes {self.observed} numbers, all finite; found "
                f"{observed.shape[1:]}"
            )
        with np.errstate(over="ignore"):  # 1e308 is finite, and infinite in float32
            batch = observed.astype(self._dtype)
        names = [each.name for each in outputs]
        parts = batch[:, None] if self._single else [batch]
        try:
            runs = [infer(self._session, names, part, states) for part in parts]
        except Exception as error:  # ONNX Runtime's errors share no other base class
            raise ArtifactError(
                f"{self.path} cannot be run on observations of {self.observed} numbers: "
                f"{' '.join(str(error).split())[:300]}. Export it again"
            ) from error
        found = [np.asarray(np.concatenate(each), np.float64) for each in zip(*runs, strict=True)]
        if not all(np.isfinite(each).all() for each in found):
            raise ObservationError(
                f"{self.path} puts out NaN or infinity: its weights are damaged, or the "
                "observation is far outside of what it was trained on"
            )
        return found


def _metadata(path: str | Path, session: Any) -> dict[str, str]:  # noqa: ANN401
    """Metadata of the exporter, whose numbers are checked here."""
    said: dict[str, str] = dict(session.get_modelmeta().custom_metadata_map)
    try:
        macs, biases = float(said.get("macs", 0)), int(said.get("biases", 0))
        counts = [np.array(each, np.int64) for each in json.loads(said.get("fan_out", "[]"))]
        sound = math.isfinite(macs) and min(macs, biases) >= 0
        sound &= all(each.ndim == 1 for each in counts)
    except (ValueError, TypeError, OverflowError, RecursionError):
        sound = False
    if not sound:
        found = {key: said[key][:40] for key in ("macs", "biases", "fan_out") if key in said}
        raise ArtifactError(
            f"{path} says {found}; macs and biases must be numbers of 0 or more, fan_out lists of "
            "whole numbers. Export it again"
        )
    for key, known in (("kind", (*KINDS, _STEP)), ("head", HEADS)):
        if said.get(key, known[0]) not in known:
            raise ArtifactError(f"{path} says {key} {said[key]!r}; known are {', '.join(known)}")
    return said


def _ends(path: str | Path, session: Any) -> tuple[Any, list[Any]]:  # noqa: ANN401
    """The input and the outputs, which must be those of a policy: (B, width) of floats.

    Inputs and outputs of states stand behind them, and are left out.
    """
    states = initial_states(session)
    behind = {f"{NEXT}{name}" for name in states}
    inputs = [each for each in session.get_inputs() if each.name not in states]
    outputs = [each for each in session.get_outputs() if each.name not in behind]
    for each in (*inputs, *outputs):
        if each.type not in DTYPES or len(each.shape or ()) != 2:
            raise ArtifactError(
                f"{path}: {each.name!r} is a {each.type} {each.shape}; a policy takes and puts out "
                "tensors of floats (batch, width). Export it so"
            )
    batches = [each.shape[0] for each in inputs if isinstance(each.shape[0], int)]
    if len(inputs) != 1 or not outputs or batches not in ([], [1]):
        raise ArtifactError(
            f"{path} has {len(inputs)} inputs {[each.shape for each in inputs]} and {len(outputs)} "
            "outputs; a policy has one input, the observations, with a free first axis, and "
            f"states, each with an output {NEXT}NAME of its width. Export it so"
        )
    return inputs[0], outputs


def _width(path: str | Path, value: Any) -> int:  # noqa: ANN401
    """The last dimension of an input or output, which the file must fix."""
    width = value.shape[-1] if value.shape else None
    if not isinstance(width, int):
        raise ArtifactError(f"{path}: the last dimension of {value.name!r} must be a fixed number")
    return width
