"""The difference equation that a NIR neuron becomes under a convention.

    I[t] = a I[t-1] + gain x[t]          a = 1 - dt/tau_syn  or  exp(-dt/tau_syn)
    V[t] = b V[t-1] + I[t] + leak        b = 1 - dt/tau_mem  or  exp(-dt/tau_mem)
    gain = (1-a) w_in (1-b) r            leak = (1-b) v_leak
    spike where V[t] > threshold, then V[t] = v_reset  or  V[t] - (threshold - v_reset)

The gain of the membrane, (1-b) r, is applied to the input, once for all timesteps. Neurons without
a synaptic current have a = 0; integrators without a leak have b = 1, and dt r for (1-b) r.

NIR does not store the timestep of a file; it is inferred from the gains of the neurons. Tools that
discretise by forward Euler write r = tau_mem/dt and w_in = tau_syn/dt, for gains of 1.
Then dt = tau_mem/r in every neuron, and w_in dt / tau_syn = 1 confirms it.

Sigma-delta neurons: what a file says of a NIR node `I` that is more than an integrator.

    sigma[t] = sigma[t-1] + x[t]              the `I`; x are weights times graded spikes
    a = max(sigma + bias, 0)
    e = a / threshold - q                     q: graded spikes sent so far, added up
    k = sign(e) floor(|e| + 1/2) where |e| >= 1, else 0 ;  q = q + k

k is sent: a signed whole number. The weights behind it count it in thresholds, so they hold the
threshold as a factor. Nothing is sent while the activation is less than a threshold away from what
was sent, as in lava (proc.sdn: |delta| >= vth). lava sends the rest at once in units of a power of
two, rounded down; here the unit is the threshold, to the nearest (after O'Connor and Welling 2017).

NIR has no such node. A tool that does not read the metadata sees the integrator alone.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, ConventionError, node_error
from spikedeploy.runtime.metadata import Record, StoredRecord, Tree

Array = NDArray[np.float64]

LEAKY = (nir.LIF, nir.LI)
CURRENT_BASED = (nir.CubaLIF, nir.CubaLI)
_INTEGRATORS = (nir.IF, nir.I)
SPIKING = (nir.LIF, nir.CubaLIF, nir.IF)
NEURONS = (*LEAKY, *CURRENT_BASED, *_INTEGRATORS)

# Relative rounding error of parameters by their dtype. Exporters write r = tau/dt and w_in = tau/dt
# for a gain of 1; a gain that differs from 1 by no more than this is taken as exactly 1, so that
# results equal bit for bit those of a simulator without that multiplication.
ROUNDING = {np.float16: 1e-2, np.float32: 1e-5, np.float64: 1e-9}


@dataclass(frozen=True, eq=False)
class DiscreteNeuron:
    """Coefficients of the neurons of one node; each array has the shape of its parameters, (*N).

    current_decay: decay factor a of the current, or None where the input itself is the current.
    membrane_decay: decay factor b of the membrane.
    gain: factor of the input.
    leak: added to the membrane in every timestep.
    threshold: or None where neurons do not spike and the membrane is the output.
    v_reset: membrane after a spike.
    """

    current_decay: Array | None
    membrane_decay: Array
    gain: Array
    leak: Array
    threshold: Array | None
    v_reset: Array

    def flat(self) -> "DiscreteNeuron":
        """Return the neurons along one axis (N,), in C order."""
        return replace(self, **{n: v.ravel() for n, v in vars(self).items() if v is not None})


@np.errstate(over="ignore", invalid="ignore")
def discretise(name: str, node: nir.NIRNode, convention: Convention) -> DiscreteNeuron:
    """The difference equation of a node of one of the kinds NEURONS.

    Raises ConventionError where the convention cannot step it: dt > tau under forward Euler, a gain
    or leak that overflows, several spikes of a zero threshold. `name` is for messages.
    """
    current_decay, gain = None, float64(node.r)
    leak = np.zeros_like(gain)
    if isinstance(node, _INTEGRATORS):
        membrane_decay = np.ones_like(gain)
        gain = convention.dt * gain
    else:
        tau = "tau" if isinstance(node, LEAKY) else "tau_mem"
        membrane_decay, complement = _decay(name, node, tau, convention)
        leak = complement * float64(node.v_leak)
        gain = complement * gain
    if isinstance(node, CURRENT_BASED):
        current_decay, complement = _decay(name, node, "tau_syn", convention)
        gain = complement * float64(node.w_in) * gain
    if not np.isfinite(gain).all() or not np.isfinite(leak).all():
        found = f"at dt = {convention.dt:g} s its gain or leak is too large for float64"
        raise node_error(name, found, "Choose another dt.", ConventionError)
    gain[np.abs(gain - 1) <= _rounding(node)] = 1.0
    if not isinstance(node, SPIKING):
        return DiscreteNeuron(current_decay, membrane_decay, gain, leak, None, np.zeros_like(gain))
    if convention.spikes == "many" and not (node.v_threshold > node.v_reset).all():
        found = "its threshold is not above v_reset: spikes 'many' would be infinitely many"
        raise node_error(name, found, "Choose spikes 'above'.", ConventionError)
    threshold, v_reset = float64(node.v_threshold), float64(node.v_reset)
    return DiscreteNeuron(current_decay, membrane_decay, gain, leak, threshold, v_reset)


def _rounding(node: nir.NIRNode) -> float:
    return ROUNDING.get(node.r.dtype.type, ROUNDING[np.float64])


def _decay(name: str, node: nir.NIRNode, field: str, convention: Convention) -> tuple[Array, Array]:
    """The decay factor of one timestep, and 1 minus it computed without cancellation."""
    # a tau below the smallest float64 forgets everything at once
    tau = getattr(node, field)
    with np.errstate(over="ignore", divide="ignore"):
        step = convention.dt / float64(tau)
    if convention.integrator == "exponential":
        return np.exp(-step), -np.expm1(-step)
    # for tau = dt, rounding puts dt/tau beside 1
    rounding = max(_rounding(node), ROUNDING.get(tau.dtype.type, 0.0))
    if step.max() > 1 + rounding:
        longest = f"{field} = {convention.dt / step.max():.9g} s"
        found = f"dt = {convention.dt:.9g} s is longer than {longest}: Euler would overshoot"
        remedy = "Choose a shorter dt, or the exponential integrator."
        raise node_error(name, found, remedy, ConventionError)
    near = np.abs(step - 1) <= 4 * np.finfo(tau.dtype).eps
    step = np.where(near, 1.0, np.minimum(step, 1.0))
    return 1 - step, step


def float64(values: NDArray[Any]) -> Array:
    """A parameter in float64, in which products of float32 do not round visibly."""
    return values.astype(np.float64)


_DEFAULT = "the file does not say: NIR's usual"
_SNNTORCH_DT = 1e-4  # [s] what snnTorch 1.0.0 writes, whatever was meant


def _unsaid(dt: float, given: Mapping[str, Any]) -> str:
    """Describe the assumptions on a file, and how to state them unless a reset was given."""
    if "reset" in given:
        return _DEFAULT
    asked = (
        "this dt is that of snnTorch: if it wrote the file, --from snntorch"
        if math.isclose(dt, _SNNTORCH_DT, rel_tol=1e-6)
        else "if snnTorch, Norse … wrote the file: --from TOOL"
    )
    return f"{_DEFAULT}; {asked}"


class _InferredTimestep(NamedTuple):
    """The dt that the gains of a graph imply.

    dt: [s], or None where they imply none or contradict each other.
    reason: from which equation and nodes, or why not; a clause for messages.
    confirmed: True if the gains w_in of the synapses agree.
    """

    dt: float | None
    reason: str
    confirmed: bool = False


def infer_timestep(graph: nir.NIRGraph) -> _InferredTimestep:
    """The dt for which every gain of the graph is 1, if one exists."""
    neurons = {n: node for n, node in sorted(graph.nodes.items()) if isinstance(node, NEURONS)}
    if not neurons:
        return _InferredTimestep(None, "no node of the graph has a time constant")
    if any((node.r <= 0).any() for node in neurons.values()):
        return _InferredTimestep(None, "a gain r is not above 0")
    candidates = np.concatenate([_candidates(node) for node in neurons.values()])
    if not np.isfinite(candidates).all() or not candidates.min() > 0:
        return _InferredTimestep(None, "tau/r is too large or too small for float64")
    tolerance = max(_rounding(node) for node in neurons.values())
    dt = rounded_timestep(float(np.median(candidates)), tolerance)
    for name, node in neurons.items():
        if contradiction := _contradiction(node, dt, tolerance):
            return _InferredTimestep(None, f"in node {name!r} {contradiction}")
    confirmed = any(isinstance(node, CURRENT_BASED) for node in neurons.values())
    return _InferredTimestep(dt, f"dt = tau/r in {', '.join(neurons)}", confirmed)


def _contradiction(node: nir.NIRNode, dt: float, tolerance: float) -> str:
    """Return the reason why a node contradicts this dt; empty where it does not."""
    found = _candidates(node)
    if np.abs(found / dt - 1).max() > tolerance:
        return f"tau/r is {found.min():g} s and not {dt:g} s"
    # forward Euler needs tau > dt, so r > 1; tools that leave dt out of r write r = 1
    if not isinstance(node, _INTEGRATORS) and (node.r <= 1).any():
        return f"r is {node.r.min():g}, a gain and not tau/dt"
    if isinstance(node, CURRENT_BASED):
        gain = dt * node.w_in / node.tau_syn
        if np.abs(gain - 1).max() > tolerance:
            return f"w_in dt/tau_syn is {gain.max():g}, not 1"
    return ""


def infer_convention(graph: nir.NIRGraph, given: Mapping[str, Any]) -> Convention:
    """NIR's usual discretisation, with the given options, and the inferred dt unless it is given.

    Raises ArtifactError where dt is neither given nor implied by the gains.
    """
    if "dt" in given:
        return Convention(given["dt"], source=_unsaid(given["dt"], given)).with_options(given)
    evidence = infer_timestep(graph)
    if evidence.dt is None:
        raise ArtifactError(
            f"the file does not say its timestep and it cannot be inferred: {evidence.reason}. "
            "Give the dt in seconds of the tool that wrote the file, or name that tool with "
            "--from."
        )
    source = f"{evidence.reason}; {_unsaid(evidence.dt, given)}"
    return Convention(evidence.dt, source=source).with_options(given)


def _candidates(node: nir.NIRNode) -> Array:
    """The dt of each neuron for which its membrane's gain is 1."""
    with np.errstate(over="ignore", under="ignore"):
        if isinstance(node, _INTEGRATORS):
            return np.ravel(1 / node.r)
        tau = node.tau_mem if isinstance(node, CURRENT_BASED) else node.tau
        return np.ravel(tau / node.r)


def rounded_timestep(dt: float, tolerance: float) -> float:
    """The dt [s] to four digits, where only the rounding of the file's dtype distinguishes them."""
    short = float(f"{dt:.4g}")
    return short if abs(short / dt - 1) <= tolerance else dt


GRADED_MOST = 2**53  # of a graded spike in floats: whole numbers up to it are exact in float64

_REMARK = (
    "a = max(sigma + bias, 0), sigma the membrane of this I; it sends k = round(a / threshold - q) "
    "where that is at least 1 either way, q the sum of all k; tools that do not read this see an "
    "integrator"
)


@dataclass(frozen=True, eq=False)
class SigmaDelta(StoredRecord):
    """The sigma-delta neurons of one node.

    threshold: (N,) or the node's shape; distance that a graded spike of 1 stands for, above 0.
    bias: of the same shape, added to sigma before the rectification.
    """

    label: ClassVar[str] = "sigma-delta neurons"

    threshold: Array
    bias: Array

    def __post_init__(self) -> None:
        if self.threshold.shape != self.bias.shape:
            raise ArtifactError(
                f"sigma-delta neurons: threshold has shape {self.threshold.shape}, bias "
                f"{self.bias.shape}. Give one of each for each neuron."
            )
        if not (self.threshold > 0).all():
            raise self.wrong(f"threshold holds {self.threshold.min():g}; each must be above 0")

    def to_record(self) -> Tree:
        """The fields as the file stores them, and a remark for readers of other tools."""
        return {**super().to_record(), "remark": _REMARK}

    @classmethod
    def from_record(cls, record: Record) -> "SigmaDelta":
        """The neurons stored in a file; its remark is not read."""
        stored = {name: value for name, value in record.fields.items() if name != "remark"}
        return super().from_record(Record(stored, record.where))


def check_sigma_delta(graph: nir.NIRGraph, neurons: Mapping[str, SigmaDelta]) -> None:
    """Refuse sigma-delta neurons whose node is none, or has another shape."""
    for name, each in sorted(neurons.items()):
        node = graph.nodes.get(name)
        if not isinstance(node, nir.I):
            kind = "there is no such node" if node is None else f"it is {type(node).__name__}"
            raise node_error(name, f"the metadata call it sigma-delta neurons, a NIR I; {kind}")
        if each.threshold.shape != node.r.shape:
            shapes = f"have shape {each.threshold.shape}, the node {node.r.shape}"
            raise node_error(name, f"its sigma-delta thresholds {shapes}")
