"""Verify that a recorded run of an emulator or a chip is computed again, number by number."""

import re
from collections.abc import Callable
from pathlib import Path

from spikedeploy.runtime.chips.chip import CHIPS
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.traces.crossbar import crossbar_verdict
from spikedeploy.runtime.traces.fields import Fields, read_json
from spikedeploy.runtime.traces.layered import loihi_trace, spiker_trace, xylo_trace
from spikedeploy.runtime.traces.programs import program_trace
from spikedeploy.runtime.traces.sanafe import sanafe_verdict
from spikedeploy.runtime.traces.speck import speck_verdict
from spikedeploy.runtime.traces.verdict import TraceFile, Verdict, verdict_on

# who wrote a trace, by what its name, source and kind say -> the chip as that tool models it
_MAKERS = (
    (r"sana-?fe", "sanafe"),
    # before lava's simulations, to which prose compares boards
    (r"loihi[ _-]?2[ _-]?(hw|board|chip|hardware)|hw[ _-]loihi[ _-]?2", "loihi2"),
    (r"xylo", "xylo-a2"),
    (r"brian2", "loihi1-brian2"),
    (r"nengo", "loihi1-nengo"),
    (r"loihi1simcfg|loihi2simcfg", "loihi1"),
    (r"loihi[ _-]?2", "loihi2"),
    (r"lava", "loihi1"),
)
_READERS: dict[str, Callable[[Fields, str], TraceFile | Verdict]] = {
    **dict.fromkeys(("loihi1", "loihi1-brian2", "loihi1-nengo", "loihi2"), loihi_trace),
    **dict.fromkeys(("xylo-a2", "xylo-a3", "xylo-imu"), xylo_trace),
    **dict.fromkeys(("odin", "tinyodin"), crossbar_verdict),
    "spiker": spiker_trace,
    "sanafe": sanafe_verdict,
}
# letters of a text in which makers are looked for
_MOST_PROSE = 1000


def verify(path: Path) -> Verdict:
    """Replay a trace file by the specification of the arithmetic."""
    found = read_trace(path)
    return found if isinstance(found, Verdict) else verdict_on(found)


def read_trace(path: Path) -> TraceFile | Verdict:
    """The recorded run in a file; a Verdict where it is replayed in another way."""
    fields = read_json(path)
    if "program" in fields:  # an exported program, on any chip
        return program_trace(fields, path.parent)
    if "format" in fields:
        return speck_verdict(fields, path)
    name = _find_chip(fields, path.stem)
    if name not in _READERS:
        hint = "can be run but has no trace format" if name in CHIPS else "is not known"
        raise TraceError(
            f"{fields.where}: chip {name[:40]!r} {hint}. Traces may be of {', '.join(_READERS)}."
        )
    return _READERS[name](fields, name)


def _find_chip(fields: Fields, stem: str) -> str:
    """The chip that the file names, or that of the emulator which its prose names."""
    prose = {key: fields.text(key)[:_MOST_PROSE] for key in ("chip", "name", "source", "kind")}
    if prose["chip"]:
        return prose["chip"]
    # the name of the file is a last resort
    for text in (" ".join(prose.values()), stem):
        for pattern, name in _MAKERS:
            if re.search(pattern, text, re.IGNORECASE):
                return name
    raise TraceError(
        f"{fields.where}: its source is {prose['source'][:60]!r}, and no emulator or chip is known "
        f"by that. Add a field chip; it may be {', '.join(_READERS)}."
    )
