"""Packaging of C of a policy: a Zephyr module, a CMSIS layer, a cycle counter, a README."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

from spikedeploy.exporters.c.int16 import Int16Observations
from spikedeploy.exporters.c.templates import fill, template

ZEPHYR = ("zephyr/module.yml", "zephyr/CMakeLists.txt", "zephyr/Kconfig")
_BESIDE = ("cycles.h", "cycles.c", "README.md", "interface.json", *ZEPHYR)


@dataclass(frozen=True)
class Interface:
    """Interface that a firmware calls.

    int16: scales of the observations of the interface in 16-bit integers; None without one.
    doubles: whether there is one in doubles.
    choices: actions to choose from; 0 where an action is numbers.
    actions: numbers of an action.
    """

    int16: Int16Observations | None
    doubles: bool
    choices: int
    actions: int


def package_names(prefix: str) -> tuple[str, ...]:
    """The files that are written around the sources."""
    return (*_BESIDE, f"{prefix}.clayer.yml")


def package_files(interface: Interface, common: Mapping[str, str]) -> dict[str, str]:
    """Text of those files, by name."""
    prefix, sources = common["prefix"], _sources(interface, common["prefix"])
    gaps = {
        **common,
        "zephyr_sources": f"${{policy}}/{prefix}.c",
        "zephyr_choices": "\n".join(_zephyr_choices(interface, common["PREFIX"])),
        "files": "\n".join(f"        - file: {name}" for name in sources),
        "file_table": _table(("file", "holds"), list(_describe_files(interface, prefix).items())),
        "interface": _interface(interface, prefix),
        "what": _WHAT[interface.doubles],
        "zephyr_words": _ZEPHYR_WORDS if interface.doubles and interface.int16 else "",
        **(_cycles_of_int16(prefix) if interface.int16 else _cycles_of_doubles(prefix)),
    }
    kconfig = "\n".join([f"# {common['mark']}", *_kconfig(interface, common)])
    return {
        "cycles.h": fill(template("cycles.h"), gaps),
        "cycles.c": fill(template("cycles.c"), gaps),
        "README.md": fill(template("README.md"), gaps),
        "interface.json": _record(interface, common),
        "zephyr/module.yml": fill(template("module.yml"), gaps),
        "zephyr/CMakeLists.txt": fill(template("zephyr.cmake"), gaps),
        "zephyr/Kconfig": f"{kconfig}\n",
        f"{prefix}.clayer.yml": fill(template("clayer.yml"), gaps),
    }


_WHAT = {
    True: "A spiking policy in the integers of a chip.",
    False: "A float network with weights rounded to 8 bits.",
}
_ZEPHYR_WORDS = (
    "The interface in 16-bit integers is built unless `CONFIG_SPIKEDEPLOY_@PREFIX@_DOUBLES=y` says "
    "otherwise; `CONFIG_SPIKEDEPLOY_@PREFIX@_HOST=y` adds the tables of scales."
)


def _sources(interface: Interface, prefix: str) -> list[str]:
    """All sources that a firmware can need."""
    doubles = ["codec.c"] if interface.doubles else []
    if interface.int16 is None:
        return [f"{prefix}.c", *doubles]
    return [f"{prefix}.c", *(["codec_i16.c"] if interface.doubles else []), *doubles, "host_i16.c"]


def _describe_files(interface: Interface, prefix: str) -> dict[str, str]:
    """Describe each source and header, and what of the C library it needs."""
    own = {
        f"{prefix}.c": "the network in integers" if interface.doubles else "the network, all of it"
    }
    if interface.int16 is not None:
        own |= {f"{prefix}_i16.h": "the interface in 16-bit integers"}
        if interface.doubles:
            own |= {"codec_i16.c": "observation to spikes, membranes to action; needs no library"}
        library = "needs `math.h` and `string.h`"
        own |= {"host_i16.c": f"scales as tables, doubles around that interface; {library}"}
    if interface.doubles:
        own |= {
            f"{prefix}.h": "the interface in doubles, and the network alone",
            "codec.c": "the same for doubles; needs `math.h`, `float.h` and `string.h`",
        }
    return own


def _zephyr_choices(interface: Interface, upper: str) -> list[str]:
    lines = []
    if interface.doubles:
        lines += [
            f"  if(CONFIG_SPIKEDEPLOY_{upper}_DOUBLES)",
            "    zephyr_library_sources(${policy}/codec.c)",
            "    # a fused multiplication and addition would round otherwise",
            "    zephyr_library_compile_options(-ffp-contract=off)",
            "  endif()",
        ]
    if interface.doubles and interface.int16 is not None:
        lines += [
            f"  if(CONFIG_SPIKEDEPLOY_{upper}_INT16)",
            "    zephyr_library_sources(${policy}/codec_i16.c)",
            "  endif()",
        ]
    if interface.int16 is not None:
        lines += [
            f"  if(CONFIG_SPIKEDEPLOY_{upper}_HOST)",
            "    zephyr_library_sources(${policy}/host_i16.c)",
            "  endif()",
        ]
    return lines


def _kconfig(interface: Interface, common: Mapping[str, str]) -> list[str]:
    name = f"SPIKEDEPLOY_{common['PREFIX']}"
    lines = [f"config {name}", f'\tbool "Policy {common["origin"]}"', "", f"if {name}", ""]
    options = []
    if interface.doubles and interface.int16 is not None:
        options += [("_INT16", "The interface in 16-bit integers", f"!{name}_DOUBLES")]
    if interface.doubles:
        default = "n" if interface.int16 is not None else "y"
        options += [("_DOUBLES", "The interface in doubles", default)]
    if interface.int16 is not None:
        options += [("_HOST", "Scales as tables, and doubles around the 16-bit interface", "n")]
    for suffix, words, default in options:
        value = f"default y if {default}" if default.startswith("!") else f"default {default}"
        lines += [f"config {name}{suffix}", f'\tbool "{words}"', f"\t{value}", ""]
    return [*lines, "endif"]


def _interface(interface: Interface, prefix: str) -> str:
    """How a firmware calls the policy, and the scales."""
    words = []
    index = "the index of the chosen action"
    if interface.int16 is not None:
        what = index if interface.choices else "Q15 (32767 stands for 1)"
        words += [
            f"`{prefix}_reset_i16()` where an episode begins, then `{prefix}_act_i16(observation, "
            f"action)` in each control step. Observation k is the sensor's value in units of "
            "training times 2^exponent, rounded, and kept from low to high, beyond which training "
            f"clipped. An action is {what}.",
            "",
            _scales(interface.int16),
        ]
    if interface.doubles:
        what = index if interface.choices else "numbers as the environment takes them"
        words += [
            "",
            f"In doubles: `{prefix}_reset()` and `{prefix}_step(observation, action)`, with "
            f"observations in units of training, and actions that are {what}.",
        ]
    return "\n".join(words).strip()


def _scales(observations: Int16Observations) -> str:
    columns = (observations.exponent, observations.low, observations.high)
    rows = [
        (str(k), *map(str, row))
        for k, row in enumerate(zip(*(c.tolist() for c in columns), strict=True))
    ]
    return _table(("observation", "exponent", "low", "high"), rows)


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _record(interface: Interface, common: Mapping[str, str]) -> str:
    """interface.json: the scales, for programs."""
    found: dict[str, object] = {
        "format": common["mark"],
        "prefix": common["prefix"],
        "policy": common["origin"],
        "doubles": interface.doubles,
        "actions": interface.actions,
        "choices": interface.choices,
        "int16": None,
    }
    if interface.int16 is not None:
        scales = {n: getattr(interface.int16, n).tolist() for n in ("exponent", "low", "high")}
        found["int16"] = {**scales, "action": "index" if interface.choices else "Q15"}
    return json.dumps(found, indent=1) + "\n"


def _cycles_of_int16(prefix: str) -> dict[str, str]:
    upper = prefix.upper()
    return {
        "header": f"{prefix}_i16.h",
        "vectors": "vectors_i16.h",
        "action_type": "int16_t",
        "reset_call": f"{prefix}_reset_i16()",
        "steps_define": "VECTOR_STEPS",
        "step_call": f"{prefix}_act_i16(&vector_observation_i16[i * {upper}_OBSERVATIONS], action)",
    }


def _cycles_of_doubles(prefix: str) -> dict[str, str]:
    upper = prefix.upper()
    return {
        "header": f"{prefix}.h",
        "vectors": "vectors.h",
        "action_type": f"{prefix}_action_t",
        "reset_call": f"{prefix}_reset()",
        "steps_define": "VECTOR_INFERENCES",
        "step_call": f"(void){prefix}_step(&vector_observation[i * {upper}_OBSERVATIONS], action)",
    }
