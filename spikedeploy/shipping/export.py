"""Formats in which a policy is written, in one table; the function of each states its options.

A function of the table takes a policy (.nir or .onnx file, shipped policy, run folder, its name
under runs/, or "last") and the file or folder to write, None where it has a place of its own; then
its options by keyword. A new format is a file with such a function, and a line of EXPORTERS.
"""

import inspect
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from spikedeploy.exporters.check import ExportResult
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix
from spikedeploy.trainers.config import require_known
from spikedeploy.trainers.run_folder import RunFolder

EXPORTERS = {
    "nir": "export_file:export_nir",
    "onnx": "export_file:export_onnx",
    "c": "export_c:export_c",
    "verilog": "verilog:export_verilog",
    "program": "export_program:export_program",
}
# the flag of an option whose name in Python is another
_FLAGS = {"raster": "input", "tool": "for", "written_by": "from"}


def export(
    policy: str,
    to: str | None = None,
    path: Path | None = None,
    **options: Any,  # noqa: ANN401
) -> ExportResult:
    """Write a policy in a format of EXPORTERS; `to` None is what the path ends in, or NIR or ONNX.

    options: of the format's function, such as chip or observations.

    Raises ConfigError for an option that the format has not.
    """
    to = _format(policy, path, options) if to is None else require_known(to, EXPORTERS, "format")
    module, _, name = EXPORTERS[to].partition(":")
    function: Callable[..., ExportResult] = getattr(import_module(f"{__package__}.{module}"), name)
    known = [*inspect.signature(function).parameters][2:]
    for option in options:
        if option not in known:
            given = ", ".join(map(_flag, known))
            raise ConfigError(f"{_flag(option)} is no option of --to {to}, which has {given}")
    return function(policy, path, **options)


def _flag(option: str) -> str:
    return f"--{_FLAGS.get(option, option).replace('_', '-')}"


def _format(policy: str, path: Path | None, options: Mapping[str, Any]) -> str:
    """The format where none is named."""
    if {"tool", "nir_compat"} & options.keys():
        return "nir"
    ending = "" if path is None else suffix(path)[1:]
    if ending in ("nir", "onnx"):
        return ending
    from spikedeploy.policies.run_record import format_of
    from spikedeploy.shipping.sources import is_nir_file

    return "nir" if is_nir_file(policy) else format_of(RunFolder.find(policy).path)
