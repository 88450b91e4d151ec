"""The files of an export: those around the sources that a build needs, and writing them all."""

import json
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from spikedeploy.exporters.c import int16
from spikedeploy.exporters.c.declarations import Declarations, render
from spikedeploy.exporters.c.int16 import Int16Observations, Integers
from spikedeploy.exporters.rendering import one_line
from spikedeploy.runtime.files import replacing

MARK = "exported by spikedeploy as C"
MAKEFILE, RECORD = "Makefile", "interface.json"
# name of a file -> its template
_AROUND = {
    "cycles.h": "cycles.h",
    "cycles.c": "cycles.c",
    "README.md": "README.md",
    RECORD: "",
    "zephyr/module.yml": "module.yml",
    "zephyr/CMakeLists.txt": "zephyr.cmake",
    "zephyr/Kconfig": "Kconfig",
    "{prefix}.clayer.yml": "clayer.yml",
}
_SPIKING = ("{prefix}.h", "{prefix}.c", "codec.c", "selftest.c", "vectors.h")
INT16 = ("{prefix}_i16.h", "codec_i16.c", "host_i16.c", "selftest_i16.c", "vectors_i16.h")
_DENSE = ("{prefix}_i16.h", "{prefix}.c", *INT16[2:], MAKEFILE)


def file_names(prefix: str, spiking: bool = True) -> tuple[str, ...]:
    """The files that an export with this prefix can write, of a spiking or of a float policy."""
    names = (*_SPIKING, *_AROUND, *INT16, MAKEFILE) if spiking else (*_DENSE, *_AROUND)
    return tuple(name.format(prefix=prefix) for name in names)


def common_values(prefix: str, origin: str) -> dict[str, Any]:
    """Values that all templates take; origin: words of a file, for a comment."""
    return {
        "mark": MARK,
        "origin": one_line(origin),
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "id_t": f"{prefix}_id_t",
        "int_t": f"{prefix}_int_t",
        "q15": int16,
    }


def package_files(values: Mapping[str, Any]) -> dict[str, str]:
    """Text of the files around the sources, by name.

    values: of the templates, with
        int16: scales of the observations of the interface in 16-bit integers; None without one.
        doubles: whether there is one in doubles.
        observations, actions: numbers of each.
        choices: actions to choose from; 0 where an action is numbers.
    """
    texts = {
        name.format(prefix=values["prefix"]): render(template, **values) if template else ""
        for name, template in _AROUND.items()
    }
    keys = {"format": "mark", "prefix": "prefix", "policy": "origin", "doubles": "doubles"}
    keys |= {"actions": "actions", "choices": "choices", "int16": "int16"}
    record = {key: values[name] for key, name in keys.items()}
    scales: Int16Observations | None = values["int16"]
    if scales is not None:
        found = {name: getattr(scales, name).tolist() for name in ("exponent", "low", "high")}
        record["int16"] = {**found, "action": "index" if values["choices"] else "Q15"}
    return {**texts, RECORD: json.dumps(record, indent=1) + "\n"}


def int16_files(
    values: Mapping[str, Any], observation: Integers, action: Integers
) -> dict[str, str]:
    """The header of the interface in 16-bit integers, its host, and its self-test.

    observation: (S, obs) of the self-test; action: (S, act) for them.
    """
    out = Declarations()
    out.constant("vector_observation_i16", observation, "int16_t")
    out.constant("vector_action_i16", action, "int16_t")
    vectors = {"name": "VECTORS_I16", "includes": ("stdint",), "counts": {"STEPS": len(action)}}
    return {
        f"{values['prefix']}_i16.h": render("policy_i16.h", **values),
        "host_i16.c": render("host_i16.c", **values, out=Declarations(storage="const")),
        "selftest_i16.c": render("selftest_i16.c", **values),
        "vectors_i16.h": render("vectors.h", **values, **vectors, out=out),
    }


def write_texts(texts: Mapping[str, str], folder: Path, record: str = RECORD) -> None:
    """Write files by name into a folder, some of them into folders in it: all, or none.

    They get their names when all are complete: first the record, which names their owner, and last
    the Makefile, which is absent meanwhile, so that no make builds a mixture of two exports.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:  # which ends in reverse order
        for name in sorted(texts, key=lambda name: (name == record) - (name == MAKEFILE)):
            (folder / name).parent.mkdir(exist_ok=True)
            part = stack.enter_context(replacing(folder / name))
            part.write_text(texts[name], encoding="ascii")
        (folder / MAKEFILE).resolve().unlink(missing_ok=True)
