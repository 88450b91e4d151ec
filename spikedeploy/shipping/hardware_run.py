"""`run --via`: episodes that hardware in simulation has driven, beside the emulated chip's."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from spikedeploy.comparison.comparison import Comparison
from spikedeploy.emulation import rtl_backend
from spikedeploy.policies.registry import find
from spikedeploy.runtime.emulator.backend import BackendMaker
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.verilog_folder import folder_of, open_hardware


@dataclass(frozen=True)
class CoreDriver:
    """Hardware that is ready to drive.

    folder: folder in which it was built.
    name: name of its row.
    chip: chip whose integers it computes.
    backend: makes the backend of a machine.
    states: to which every timestep is added.
    """

    folder: Path
    name: str
    chip: str
    backend: BackendMaker
    states: rtl_backend.StateComparison

    def beside_emulated(
        self, played: Comparison, emulate: Callable[[], Comparison]
    ) -> "HardwareRun":
        """Play the episodes on the emulated chip as well; return both results."""
        states = self.states.as_json()  # before a page plays episodes once more
        (row,), (emulated,) = played.rows, emulate().rows
        return HardwareRun(self.folder, states, row.returns, emulated.returns)


@contextmanager
def driver(folder: Path, policy: str) -> Iterator[CoreDriver]:
    """Hardware of a folder that `export --to verilog` wrote of this policy.

    Raises ConfigError where the folder is of another policy, is damaged, or cannot be built.
    """
    candidate = find(policy)
    if candidate.format != ".nir":
        raise ConfigError(f"--via {folder}: {policy} is no spiking policy in a file, so no core's")
    found = folder_of(Path(candidate.path), folder)
    states = rtl_backend.StateComparison()
    with open_hardware(found, Path(candidate.path)) as hardware:
        make = partial(rtl_backend.RtlBackend, hardware=hardware, comparison=states)
        yield CoreDriver(folder, f"{candidate.name} in RTL", found.chip, make, states)


@dataclass(frozen=True)
class HardwareRun:
    """Episodes that hardware has driven, and the same that the emulated chip has.

    folder: folder of the hardware.
    states: every number of both, compared while the hardware drove, as data.
    returns: return of each episode on the hardware; emulated: on the emulated chip.
    """

    folder: Path
    states: dict[str, Any]
    returns: Sequence[float]
    emulated: Sequence[float]

    @property
    def equal(self) -> bool:
        """True if no state differs, and every return to its last bit."""
        return not self.states["differing"] and list(self.returns) == list(self.emulated)

    def as_json(self) -> dict[str, Any]:
        """All of it as data."""
        returns = {"returns": list(self.returns), "emulated_returns": list(self.emulated)}
        return {"folder": str(self.folder), "equal": self.equal, **returns, **self.states}

    def lines(self) -> tuple[str, ...]:
        """Lines for a terminal."""
        found, clocks = self.states, self.states["clocks"]
        same = sum(a == b for a, b in zip(self.returns, self.emulated, strict=True))
        return (
            f"Hardware: {self.folder} in simulation, {found['timesteps']:,} timesteps of "
            f"{clocks['mean']:,.0f} clocks ({clocks['least']:,} to {clocks['most']:,}).",
            f"{found['differing']:,} of {found['numbers']:,} currents, membranes, spikes and "
            f"outputs differ from the emulated chip's; {same} of {len(self.returns)} returns "
            "equal its own to the last bit.",
            *([f"First difference: {found['first']}."] if found["first"] else []),
        )
