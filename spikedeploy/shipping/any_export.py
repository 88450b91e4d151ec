"""A run folder or a file in another format, as the command `export` writes it."""

from pathlib import Path
from typing import Any

from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import require_known

_FORMATS = ("nir", "onnx", "c", "verilog", "program", "xylo")


def export_as(
    policy: str,
    to: str | None,
    path: Path | None = None,
    *,
    chip: str | None = None,
    board: str | None = None,
    quantise: str = "layer",
    force: bool = False,
    **options: Any,  # noqa: ANN401
) -> Path:
    """Write a policy in a format; return the file or folder.

    policy: .nir file, shipped policy, run folder, its name under runs/, or "last".
    to: one of nir, onnx, c, verilog, program and xylo; None is what the path ends in.
    chip, board, quantise: as on the command line, for the formats that have them.
    force: whether files that no export wrote are replaced.
    options: of the format's own function, such as env or observations.

    Raises ConfigError where a written file does not do what the policy does.
    """
    from spikedeploy.shipping import export_c, export_file, export_program, export_run
    from spikedeploy.shipping.export_verilog import export_verilog

    if to is not None:
        require_known(to, _FORMATS, "format")
    folders = {"quantisation": Quantisation(quantise), "force": force, **options}  # type: ignore[arg-type]
    if to == "c":
        return export_c.export_c(policy, chip, path, **folders).folder
    if to == "verilog":
        return export_verilog(policy, chip, board, path, **folders).folder
    if to == "program":
        return export_program.export_program(policy, chip, path, **folders).folder
    if to == "xylo":
        checked = export_file.export_xylo(policy, chip, path, force=force, **options)
    elif export_file.is_nir_file(policy):
        if to == "onnx":
            checked = export_file.export_onnx(policy, path, force=force, **options)
        else:
            checked = export_file.export_nir(policy, path, None, None, force=force, **options)
    else:
        checked = export_run.export_run(policy, to, path, force=force, **options)
    if failed := [check for check in checked.checks if not check.passed]:
        raise ConfigError(
            f"{checked.path} does not do what {policy} does: {failed[0].name}, {failed[0].detail}"
        )
    return checked.path
