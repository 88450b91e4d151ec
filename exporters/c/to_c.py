"""A compiled program and its codec as a folder of C99, with a self-test of recorded numbers."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.codec import DecoderWriter, encoder_gaps
from spikedeploy.exporters.c.declarations import Declarations, bytes_of, narrowest_of
from spikedeploy.exporters.c.int16 import Int16Codec, Int16Player, int16_codec
from spikedeploy.exporters.c.int16_writer import codec_files, selftest_files
from spikedeploy.exporters.c.network import NetworkWriter
from spikedeploy.exporters.c.packaging import Interface, package_files, package_names
from spikedeploy.exporters.c.plan import Plan, check_codec, check_prefix, check_program
from spikedeploy.exporters.c.templates import fill, template
from spikedeploy.files import replacing
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import Recording, concatenate_recordings
from spikedeploy.runtime.emulator.machine import Machine

# numbers of a self-test, about; at least two inferences are recorded
_NUMBERS = 60_000
_INFERENCES = 20


@dataclass(frozen=True, eq=False)
class Recorded:
    """Inferences of an episode from its beginning; S of them, each of T timesteps.

    observation: (S, obs); None where the network runs alone.
    raster: (S, T, M) input spikes.
    layers: what each layer did, name -> (S, T, N).
    action: (S, act); None likewise.
    """

    observation: NDArray[np.float64] | None
    raster: NDArray[np.uint8]
    layers: dict[str, Recording]
    action: NDArray[np.float64] | None


def record_observations(plan: Plan, observation: NDArray[np.float64]) -> Recorded:
    """Run the interpreter on observations (S, obs) of one episode, with the seed 0."""
    if plan.codec is None:
        raise TypeError("a network without a codec has no observations")
    machine = Machine(plan.program, 1, "none", trace=True, backend="interpreter")
    raster = plan.codec.encode_episode(observation)
    found, actions = [], []
    for rows in raster:
        actions.append(plan.codec.decode(machine.infer(rows[None])).reshape(-1))
        found.append(machine.recordings)
    action = np.array(actions, np.float64)
    return Recorded(observation, raster, concatenate_recordings(found, axis=0), action)


def record_raster(plan: Plan, raster: NDArray[np.uint8]) -> Recorded:
    """Run the interpreter on input spikes (S, T, M), from zero states."""
    machine = Machine(plan.program, 1, "none", trace=True, backend="interpreter")
    found = []
    for rows in raster:
        machine.infer(rows[None])
        found.append(machine.recordings)
    return Recorded(None, raster, concatenate_recordings(found, axis=0), None)


def count_inferences(plan: Plan, timesteps: int) -> int:
    """Inferences that make a self-test of moderate size."""
    each = timesteps * sum(plan.sizes.values())
    return int(np.clip(_NUMBERS // each, 2, _INFERENCES))


def vectors(plan: Plan, recorded: Recorded) -> str:
    """vectors.h: the recorded numbers as C."""
    out = Declarations()
    inferences, timesteps, _ = recorded.raster.shape
    rows = recorded.raster.reshape(inferences * timesteps, -1)
    reset = timesteps if plan.program.convention.state == "reset" else len(rows)
    names = [layer.name for layer in plan.program.layers]
    sizes = [plan.sizes[name] for name in names]
    at, channels = np.nonzero(rows)
    out.constant("vector_events", np.searchsorted(at, np.arange(len(rows) + 1)), "uint32_t")
    out.constant("vector_channels", _nonempty(channels), plan.id_kind)
    if recorded.observation is None:
        out.constant("vector_times", _nonempty(rows[at, channels]), "uint8_t")
    else:
        out.constant("vector_observation", recorded.observation.astype(np.float64))
        out.constant("vector_action", _actions(recorded))
    out.constant("vector_first", np.cumsum([0, *sizes]), "uint32_t")
    for quantity in ("current", "membrane", "spikes"):
        values = [getattr(recorded.layers[name], quantity) for name in names]
        every = np.concatenate([v.reshape(len(rows), -1).astype(np.int64) for v in values], axis=1)
        out.constant(f"vector_{quantity}", every, narrowest_of(every))
    counts = {"INFERENCES": inferences, "ROWS": len(rows), "RESET": reset, "NEURONS": sum(sizes)}
    defines = [f"#define VECTOR_{name} {value}u" for name, value in counts.items()]
    return "\n".join(["#include <math.h>", "#include <stdint.h>", "", *defines, "", out.text, ""])


def _actions(recorded: Recorded) -> NDArray[np.float64]:
    if recorded.action is None:
        raise TypeError("no actions were recorded")
    return recorded.action


def _nonempty(values: NDArray[np.integer]) -> NDArray[np.integer]:
    """The values, or one 0: C has no empty arrays."""
    return values if values.size else np.zeros(1, np.int64)


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


def costs(plan: Plan, raster: NDArray[np.uint8], rom: int, ram: int) -> CCosts:
    """Costs of a plan; raster: (S, T, M) input spikes of an episode, for the typical operations."""
    layers, timesteps = plan.program.layers, raster.shape[1]
    each = sum(_most(plan, synapses) for layer in layers for synapses in layer.synapses)
    machine = Machine(plan.program, 1, "total")
    for rows in raster:
        machine.infer(rows[None])
    return CCosts(
        rom=rom,
        ram=ram,
        sops=machine.ledger.per_inference("sop"),
        sops_max=timesteps * each,
        events=float(raster.sum(axis=(1, 2), dtype=np.int64).mean()),
        events_max=timesteps * plan.events_max * plan.times_max[plan.program.input],
        neuron_updates=timesteps * sum(layer.size for layer in layers),
    )


def _most(plan: Plan, synapses: Synapses) -> int:
    """Synaptic operations of a projection in a timestep, where all that can spike does."""
    fan_out = synapses.fan_out
    encoder = plan.codec.encoder if plan.codec else None
    if synapses.source == plan.program.input and isinstance(encoder, DeltaEncoder):
        return _most_of_delta(fan_out, encoder)
    return int(fan_out.sum()) * plan.times_max[synapses.source]


def _most_of_delta(fan_out: NDArray[np.int64], encoder: DeltaEncoder) -> int:
    """The same of a delta code: an observation moves up or down, and not both."""
    signs = fan_out.reshape(encoder.observed, 2, encoder.most)
    of_sign = signs.sum(axis=2) if encoder.code == "unary" else signs.max(axis=2)
    return int(of_sign.max(axis=1).sum())


MARK = "exported by spikedeploy as C"
MAKEFILE, RECORD = "Makefile", "interface.json"
NAMES = ("policy.h", "policy.c", "codec.c", "selftest.c", "vectors.h", MAKEFILE)
# of the interface in 16-bit integers, where there is one
INT16_NAMES = ("policy_i16.h", "codec_i16.c", "host_i16.c", "selftest_i16.c", "vectors_i16.h")
_INT16_STEPS = 200  # of the self-test


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


def file_names(prefix: str, codec: bool) -> tuple[str, ...]:
    """The files that an export with this prefix writes."""
    own = ("policy.h", "policy.c", "policy_i16.h")
    every = (*NAMES, *INT16_NAMES) if codec else tuple(n for n in NAMES if n != "codec.c")
    named = tuple(n.replace("policy", prefix) if n in own else n for n in every)
    return (*named, *package_names(prefix)) if codec else named


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
    plan = _plan(program, codec, prefix)
    seen = record_observations(plan, observation[: count_inferences(plan, codec.timesteps)])
    raster = codec.encode_episode(observation)
    return _files(plan, seen, raster, origin, prefix, observation)


def network_in_c(
    program: Program, raster: NDArray[np.uint8], origin: str, prefix: str = "policy"
) -> CFiles:
    """C of a program alone; raster: (S, T, M) input spikes of its self-test."""
    plan = _plan(program, None, prefix)
    return _files(plan, record_raster(plan, raster), raster, origin, prefix)


def write(files: CFiles, folder: Path) -> None:
    """Write all files into a folder."""
    write_texts(files.text, folder)


def write_texts(texts: Mapping[str, str], folder: Path) -> None:
    """Write files by name into a folder, some of them into folders in it: all, or none.

    They get their names when all are whole: first RECORD, which says whose they are, and last the
    Makefile, which is away meanwhile, so that no make builds a mixture of two exports.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:  # which ends in reverse order
        for name in sorted(texts, key=lambda name: (name == RECORD) - (name == MAKEFILE)):
            (folder / name).parent.mkdir(exist_ok=True)
            part = stack.enter_context(replacing(folder / name))
            part.write_text(texts[name], encoding="ascii")
        (folder / MAKEFILE).resolve().unlink(missing_ok=True)


def printable(origin: str) -> str:
    """Words of a file as they may stand in a comment of C."""
    known = "".join(c if c.isalnum() or c in " ._:=,+-()/" else "?" for c in origin)
    return known.encode("ascii", "replace").decode()


def _plan(program: Program, codec: Codec | None, prefix: str) -> Plan:
    check_prefix(prefix)
    check_program(program)
    return Plan(program, codec)


def _files(
    plan: Plan,
    seen: Recorded,
    raster: NDArray[np.uint8],
    origin: str,
    prefix: str,
    observation: NDArray[np.float64] | None = None,
) -> CFiles:
    network, coder = NetworkWriter(plan), Declarations(bytes_of(plan.kind), bytes_of(plan.id_kind))
    gaps = _gaps(plan, origin, prefix)
    parts = {
        f"{prefix}.h": fill(template("policy.h"), gaps),
        f"{prefix}.c": fill(template("policy.c"), {**gaps, **network.gaps()}),
    }
    if plan.codec is not None:
        parts["codec.c"] = fill(
            template("codec.c"), {**gaps, **_codec_gaps(plan, plan.codec, coder)}
        )
    parts["selftest.c"] = fill(template("selftest.c"), gaps)
    parts["vectors.h"] = f"/* {MARK} */\n{vectors(plan, seen)}"
    integers = int16_codec(plan)
    scales = integers.observations if isinstance(integers, Int16Codec) else None
    if plan.codec is not None:
        choices = int(gaps["actions_to_choose"])
        kit = Interface(scales, True, choices, int(gaps["actions"]))
        parts |= package_files(kit, gaps)
    if isinstance(integers, Int16Codec) and observation is not None:
        parts |= codec_files(plan, integers, gaps, prefix)[0]
        parts |= _int16_selftest(plan, integers, observation, gaps)
        gaps |= {"integers": template("int16.mk")}
    parts["Makefile"] = fill(template("Makefile"), {"integers": "", **gaps})
    memory = network.out.rom + coder.rom, network.out.ram + coder.ram
    found = costs(plan, raster, *memory)
    return CFiles(parts, found, integers if isinstance(integers, str) else "")


def _int16_selftest(
    plan: Plan, codec: Int16Codec, observation: NDArray[np.float64], gaps: Mapping[str, str]
) -> dict[str, str]:
    """The self-test of the interface in 16-bit integers, on the first observations (S, obs)."""
    rows = codec.observations.quantise(observation[:_INT16_STEPS])
    player = Int16Player(plan.program, codec)
    return selftest_files(rows, np.array([player.act(row) for row in rows]), gaps)


def _gaps(plan: Plan, origin: str, prefix: str) -> dict[str, str]:
    """Gaps of several templates."""
    codec, program = plan.codec, plan.program
    sources = f"{prefix}.c codec.c" if codec else f"{prefix}.c"
    actions = ", and every action to 1e-12" if codec and not codec.chooses else ""
    return {
        "mark": MARK,
        "origin": printable(origin),
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "inputs": str(program.width),
        "events_max": str(plan.events_max),
        "layers": str(len(program.layers)),
        "int_kind": plan.kind,
        "id_kind": plan.id_kind,
        "input_count_kind": plan.count_kind(program.input),
        "sources": sources,
        "libs": "-lm" if codec else "",
        "actions_too": actions,
        "run": template("run_codec.c" if codec else "run_network.c"),
        "codec_defines": "",
        "codec_calls": "",
        **(_codec_header(codec, plan) if codec else {}),
    }


def _codec_header(codec: Codec, plan: Plan) -> dict[str, str]:
    """Gaps that the codec fills in the header and in the self-test."""
    scores = DecoderWriter(plan, codec, Declarations()).scores
    exact = 'compare("an action", inference, 0u, a, found, wanted);'
    return {
        "codec_defines": template("codec_defines.h"),
        "codec_calls": template("codec_calls.h"),
        "seed_call": _SEED if codec.encoder.random else "",
        "observations": str(codec.encoder.observed),
        "actions_to_choose": str(scores if codec.chooses else 0),
        "actions": "1" if codec.chooses else str(scores),
        "timesteps": str(codec.timesteps),
        "action_kind": "int32_t" if codec.chooses else "double",
        "compare_action": exact if codec.chooses else _NEAR,
    }


_NEAR = """\
const double size = (wanted < 0.0) ? -wanted : wanted;
    const double apart = (found > wanted) ? (found - wanted) : (wanted - found);
    compare("an action (1: within 1e-12)", inference, 0u, a,
            apart <= (1e-12 * ((size > 1.0) ? size : 1.0)), 1);"""
_SEED = """
/* Start the random numbers anew, as an episode with this seed does; 0 after a reset. */
void @prefix@_seed(uint64_t seed);
"""


def _codec_gaps(plan: Plan, codec: Codec, out: Declarations) -> dict[str, str]:
    """Gaps of the template of codec.c."""
    encoder = encoder_gaps(codec, out)
    decoder = DecoderWriter(plan, codec, out).gaps()
    kept = plan.program.convention.state == "kept"
    reset = "    @prefix@_net_reset();\n" + ("" if kept else decoder["decoder_reset"])
    return {
        **encoder,
        **decoder,
        "declarations": out.text,
        "codec_functions": encoder["encoder"] + decoder["decoder"],
        "choices": decoder["scores"] if codec.chooses else "0",
        "encoder_reset": encoder["reset"],
        "seed_function": encoder["seed"],
        "inference_reset": "" if kept else reset,
    }
