"""A compiled program and its codec, or a float network, as C99 with a self-test of its numbers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.codec_values import codec_values
from spikedeploy.exporters.c.declarations import (
    Declarations,
    bytes_of,
    narrowest_of,
    render,
)
from spikedeploy.exporters.c.int8 import Int8Mlp
from spikedeploy.exporters.c.int16 import Int16Codec, Int16Player, int16_codec
from spikedeploy.exporters.c.packaging import (
    MAKEFILE,
    common_values,
    file_names,
    int16_files,
    package_files,
)
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.refusals import check_codec, check_prefix, check_program
from spikedeploy.runtime.chips.layer import Recording, Synapses
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import concatenate_recordings
from spikedeploy.runtime.emulator.machine import Machine

# numbers of a self-test, about; at least two inferences are recorded
_NUMBERS = 60_000
_INFERENCES = 20
_INT16_STEPS = 200  # of the self-test


@dataclass(frozen=True)
class CCosts:
    """Memory, and operations of an inference.

    rom: constants [bytes]; the code comes on top, which the compiler decides, and which has the
        weights of projections with few synapses.
    ram: static variables [bytes]; the stack comes on top, less than 1 kB without the C library.
    sops, sops_max: synaptic operations, the mean of those recorded and the most there can be.
    events, events_max: input spikes, likewise.
    neuron_updates: each neuron in each timestep.
    """

    rom: int
    ram: int
    sops: float
    sops_max: int
    events: float
    events_max: int
    neuron_updates: int


@dataclass(frozen=True)
class CFiles:
    """C of a program.

    text: of each file, by name.
    costs: memory and operations.
    without_int16: why there is no interface in 16-bit integers; "" where there is one.
    """

    text: Mapping[str, str]
    costs: CCosts
    without_int16: str = ""


def policy_in_c(
    program: Program,
    codec: Codec,
    observation: NDArray[np.float64],
    origin: str,
    prefix: str = "policy",
) -> CFiles:
    """C of a program and its codec.

    observation: (S, obs) of one episode from its beginning; all count for the typical operations,
        the first few become the self-test.
    origin: where the program comes from, for a comment.
    prefix: what the names in C begin with.
    """
    check_codec(codec)
    check_prefix(prefix)
    check_program(program)
    plan = Plan(program, codec)
    each = codec.timesteps * sum(program.sizes.values())
    tested = int(np.clip(_NUMBERS // each, 2, _INFERENCES))
    raster, scores = codec.encode_episode(observation), len(plan.bias)
    code = int16_codec(plan)
    values = {
        **common_values(prefix, origin),
        "plan": plan,
        "codec": codec,
        "observations": codec.encoder.observed,
        "actions": 1 if codec.chooses else scores,
        "choices": scores if codec.chooses else 0,
        "doubles": True,
        "int16": code.observations if isinstance(code, Int16Codec) else None,
        **codec_values(codec),
    }
    texts, memory = _sources(plan, values)
    coder = _declarations(plan, prefix)
    texts["codec.c"] = render("codec.c", **values, out=coder)
    texts |= _selftest(plan, values, raster[:tested], observation[:tested])
    texts |= package_files(values)
    if isinstance(code, Int16Codec):
        rows, player = (
            code.observations.quantise(observation[:_INT16_STEPS]),
            Int16Player(program, code),
        )
        own = {**values, "code": code}
        texts["codec_i16.c"] = render("codec_i16.c", **own, out=_declarations(plan, prefix))
        texts |= int16_files(own, rows, np.array([player.act(row) for row in rows]))
    texts[MAKEFILE] = render(MAKEFILE, **values)
    costs = _costs(plan, raster, memory.rom + coder.rom, memory.ram + coder.ram)
    ordered = {name: texts[name] for name in file_names(prefix) if name in texts}
    return CFiles(ordered, costs, code if isinstance(code, str) else "")


def network_in_c(
    program: Program, raster: NDArray[np.uint8], origin: str, prefix: str = "policy"
) -> CFiles:
    """C of a program alone; raster: (S, T, M) input spikes of its self-test."""
    check_prefix(prefix)
    check_program(program)
    plan = Plan(program, None)
    values = {
        **common_values(prefix, origin),
        "plan": plan,
        "codec": None,
        "int16": None,
        "choices": 0,
    }
    texts, memory = _sources(plan, values)
    texts |= _selftest(plan, values, raster, None)
    texts[MAKEFILE] = render(MAKEFILE, **values)
    return CFiles(texts, _costs(plan, raster, memory.rom, memory.ram))


def mlp_in_c(
    network: Int8Mlp, observation: NDArray[np.float64], origin: str, prefix: str = "policy"
) -> dict[str, str]:
    """C of a quantised float network, text by name; observation: (S, obs) of the self-test."""
    check_prefix(prefix)
    values = {
        **common_values(prefix, origin),
        "network": network,
        "observations": len(network.observations.exponent),
        "actions": network.actions,
        "scores": network.scores,
        "choices": network.scores if network.chooses else 0,
        "doubles": False,
        "int16": network.observations,
    }
    rows = network.observations.quantise(observation)
    texts = {
        **int16_files(values, rows, network.act(rows)),
        f"{prefix}.c": render("dense_i16.c", **values, out=Declarations()),
        MAKEFILE: render("dense.mk", **values),
        **package_files(values),
    }
    return {name: texts[name] for name in file_names(prefix, spiking=False)}


def _declarations(plan: Plan, prefix: str) -> Declarations:
    """Return empty declarations for a file that includes the header."""
    kinds = {f"{prefix}_int_t": plan.kind, f"{prefix}_id_t": plan.id_kind}
    return Declarations({name: bytes_of(kind) for name, kind in kinds.items()})


def _sources(plan: Plan, values: Mapping[str, Any]) -> tuple[dict[str, str], Declarations]:
    """The header and the network, and what it declares."""
    prefix = values["prefix"]
    out = _declarations(plan, prefix)
    header = {f"{prefix}.h": render("policy.h", **values)}
    return {**header, f"{prefix}.c": render("policy.c", **values, out=out)}, out


def _selftest(
    plan: Plan,
    values: Mapping[str, Any],
    raster: NDArray[np.uint8],
    observation: NDArray[np.float64] | None,
) -> dict[str, str]:
    """The self-test, and what the interpreter computes from input spikes (S, T, M) as C.

    observation: (S, obs) that the spikes encode, one episode from its beginning; None where the
        network runs alone.
    """
    machine = Machine(plan.program, 1, "none", trace=True, backend="interpreter")
    found, actions = [], []
    for inference in raster:
        output = machine.infer(inference[None])
        if plan.codec is not None:
            actions.append(plan.codec.decode(output).reshape(-1))
        found.append(machine.recordings)
    layers: dict[str, Recording] = concatenate_recordings(found, axis=0)
    out = Declarations()
    inferences, timesteps, _ = raster.shape
    rows = raster.reshape(inferences * timesteps, -1)
    at, channels = np.nonzero(rows)
    out.constant("vector_events", np.searchsorted(at, np.arange(len(rows) + 1)), "uint32_t")
    # C has no empty arrays
    out.constant("vector_channels", channels if len(at) else np.zeros(1, np.int64), plan.id_kind)
    if observation is None:
        times = rows[at, channels] if len(at) else np.zeros(1, np.int64)
        out.constant("vector_times", times, "uint8_t")
    else:
        out.constant("vector_observation", observation.astype(np.float64))
        out.constant("vector_action", np.array(actions, np.float64))
    sizes = [layer.size for layer in plan.layers]
    out.constant("vector_first", np.cumsum([0, *sizes]), "uint32_t")
    for quantity in ("current", "membrane", "spikes"):
        each = [getattr(layers[layer.name], quantity) for layer in plan.program.layers]
        columns = [v.reshape(len(rows), -1).astype(np.int64) for v in each]
        together = np.concatenate(columns, axis=1)
        out.constant(f"vector_{quantity}", together, narrowest_of(together))
    reset = timesteps if plan.program.convention.state == "reset" else len(rows)
    counts = {"INFERENCES": inferences, "ROWS": len(rows), "RESET": reset, "NEURONS": sum(sizes)}
    vectors = {"name": "VECTORS", "includes": ("math", "stdint"), "counts": counts, "out": out}
    return {
        "selftest.c": render("selftest.c", **values),
        "vectors.h": render("vectors.h", **values, **vectors),
    }


def _costs(plan: Plan, raster: NDArray[np.uint8], rom: int, ram: int) -> CCosts:
    """Costs of a plan; raster: (S, T, M) input spikes of an episode, for the typical operations."""
    layers, timesteps = plan.program.layers, raster.shape[1]
    most = sum(_most_operations(plan, synapses) for layer in layers for synapses in layer.synapses)
    machine = Machine(plan.program, 1, "total")
    for rows in raster:
        machine.infer(rows[None])
    return CCosts(
        rom=rom,
        ram=ram,
        sops=machine.ledger.per_inference("sop"),
        sops_max=timesteps * most,
        events=float(raster.sum(axis=(1, 2), dtype=np.int64).mean()),
        events_max=timesteps * plan.input.capacity * plan.input.times_max,
        neuron_updates=timesteps * sum(layer.size for layer in layers),
    )


def _most_operations(plan: Plan, synapses: Synapses) -> int:
    """Synaptic operations of a projection in a timestep, where all that can spike does."""
    fan_out = synapses.fan_out
    encoder = plan.codec.encoder if plan.codec else None
    if synapses.source != plan.program.input or not isinstance(encoder, DeltaEncoder):
        return int(fan_out.sum()) * plan.times_max[synapses.source]
    # an observation moves up or down, and not both
    signs = fan_out.reshape(encoder.observed, 2, encoder.most)
    of_sign = signs.sum(axis=2) if encoder.code == "unary" else signs.max(axis=2)
    return int(of_sign.max(axis=1).sum())
