"""A compiled program and its codec as a folder of C99, with a self-test of recorded numbers."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.costs import CCosts, costs
from spikedeploy.exporters.c.declarations import Declarations, bytes_of
from spikedeploy.exporters.c.decoder import DecoderWriter
from spikedeploy.exporters.c.encoders import encoder_gaps
from spikedeploy.exporters.c.int16_codec import Int16Codec, Int16Player, int16_codec
from spikedeploy.exporters.c.int16_writer import codec_files, selftest_files
from spikedeploy.exporters.c.network import NetworkWriter
from spikedeploy.exporters.c.packaging import Interface, package_files, package_names
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.refusals import check_codec, check_prefix, check_program
from spikedeploy.exporters.c.templates import filled, template
from spikedeploy.exporters.c.vectors import Recorded, driven, few, observed, vectors
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.trainers import atomic

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
    seen = observed(plan, observation[: few(plan, codec.timesteps)])
    raster = codec.encode_episode(observation)
    return _files(plan, seen, raster, origin, prefix, observation)


def network_in_c(
    program: Program, raster: NDArray[np.uint8], origin: str, prefix: str = "policy"
) -> CFiles:
    """C of a program alone; raster: (S, T, M) input spikes of its self-test."""
    plan = _plan(program, None, prefix)
    return _files(plan, driven(plan, raster), raster, origin, prefix)


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
            part = stack.enter_context(atomic.replacing(folder / name))
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
        f"{prefix}.h": filled(template("policy.h"), gaps),
        f"{prefix}.c": filled(template("policy.c"), {**gaps, **network.gaps()}),
    }
    if plan.codec is not None:
        parts["codec.c"] = filled(
            template("codec.c"), {**gaps, **_codec_gaps(plan, plan.codec, coder)}
        )
    parts["selftest.c"] = filled(template("selftest.c"), gaps)
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
    parts["Makefile"] = filled(template("Makefile"), {"integers": "", **gaps})
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
    """What several templates leave open."""
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
    """What the codec adds to the header and to the self-test."""
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
    """What the template of codec.c leaves open."""
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
