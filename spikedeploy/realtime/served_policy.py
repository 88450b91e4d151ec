"""A spiking policy that several clients act with, each in an episode of its own."""

from typing import Any

from spikedeploy.policies.costs import priced_by
from spikedeploy.policies.interface import DEFAULT_CHIP
from spikedeploy.policies.registry import find
from spikedeploy.realtime.protocol import VERSION, Request, RequestError, finite
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.machine import snapshot
from spikedeploy.runtime.emulator.network import chip_called
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metrics.energy import TABLES, energy_estimate

SPARED = 5.0  # [s] without a request in which a client keeps its place though others wait for one


class ServedPolicy:
    """A policy on a chip, loaded once.

    name      of the policy
    chip      as the command line takes it, or "float"
    observed  numbers of an observation
    """

    def __init__(
        self,
        reference: str,
        chip: str | None = None,
        backend: BackendName = "numpy",
        limits: bool = True,
    ) -> None:
        candidate = find(reference)
        if candidate.format != ".nir":
            raise ConfigError(
                f"{reference} is no spiking policy; `serve` runs .nir files, runs and shipped "
                "policies that spike."
            )
        self.name, self.chip = candidate.name, chip or candidate.chip or DEFAULT_CHIP
        on = chip_called(self.chip)
        options: dict[str, Any] = {"limits": limits} if on else {}
        self._first = SpikingController(
            load(candidate.path), on, "total", backend=backend, **options
        )
        self.observed = self._first.codec.encoder.observed
        self._program = self._first.program if on else None
        self._tables = priced_by(on)
        self._actions = int(candidate.actions or 0)
        self._first.act([0.0] * self.observed)  # takes memory and may compile before clients come

    def episode(self) -> "ServedEpisode":
        """A controller of its own for a client; the program is shared."""
        return ServedEpisode(snapshot(self._first, self._program), self._tables)

    def info(self) -> dict[str, Any]:
        """What clients have to know."""
        return {
            "protocol": VERSION,
            "policy": self.name,
            "chip": self.chip,
            "observations": self.observed,
            "actions": self._actions,
            "chooses": self._first.codec.chooses,
            "timesteps": self._first.codec.timesteps,
        }


class ServedEpisode:
    """The episode of one client.

    steps  actions since its last reset
    """

    def __init__(self, controller: SpikingController, tables: tuple[str, ...]) -> None:
        self.steps = 0
        self._controller, self._tables = controller, tables

    def reset(self, seed: int) -> dict[str, Any]:
        """Begin an episode."""
        self._controller.reset(seed)
        self.steps = 0
        return {"seed": seed}

    def act(self, request: Request) -> dict[str, Any]:
        """The action for an observation, and what of the step is wanted."""
        before = self._controller.ledger if request.want else None
        action = self._controller.act(request.observation).tolist()
        self.steps += 1
        answer = {"action": action, "step": self.steps}
        if before is not None:
            answer |= self._costs(self._controller.ledger.since(before), request.want)
        return answer

    def _costs(self, step: Ledger, want: tuple[str, ...]) -> dict[str, Any]:
        """Spikes of each layer, synaptic operations, energies [J] with their intervals."""
        costs: dict[str, Any] = {}
        if "spikes" in want:
            costs["spikes"] = step.by_layer("spike_out")
        if "sops" in want:
            costs["sops"] = step.total("sop")
        if "energy" in want:
            estimates = {name: energy_estimate(step, TABLES[name]) for name in self._tables}
            costs["energy_j"] = {
                name: {"value": each.value, "low": each.low, "high": finite(each.high)}
                for name, each in estimates.items()
            }
        return costs


class Clients:
    """The clients that a server knows, each with its episode; those that are idle are forgotten.

    Where there are no more places, a newcomer takes that of whoever asked nothing for longest, if
    that is longer than SPARED.

    policy  that they act with
    most    clients at a time
    idle    [s] without a request after which a client is forgotten
    """

    def __init__(self, policy: ServedPolicy, most: int, idle: float) -> None:
        self._policy, self._most, self._idle = policy, most, idle
        self._episodes: dict[bytes, ServedEpisode] = {}
        self._seen: dict[bytes, float] = {}

    def answer(self, client: bytes, request: Request, now: float) -> dict[str, Any]:
        """What a client is told.

        client  its name, which the connection decides
        now     [s] of a clock that only goes forward
        """
        self._forget(now)
        if client in self._episodes:
            self._seen[client] = now
        if request.do == "info":
            return self._policy.info()
        if request.do == "bye":
            self._episodes.pop(client, None)
            return {}
        if request.do == "reset":
            return self._entered(client, now).reset(request.seed)
        if client not in self._episodes:
            raise RequestError(
                f"no episode: send reset first; after {self._idle:g} s without a request, or "
                f"{SPARED:g} s where others wait for a place, it is forgotten"
            )
        return self._episodes[client].act(request)

    def _entered(self, client: bytes, now: float) -> ServedEpisode:
        if client not in self._episodes:
            if len(self._episodes) >= self._most:
                self._make_room(now)
            self._episodes[client], self._seen[client] = self._policy.episode(), now
        return self._episodes[client]

    def _make_room(self, now: float) -> None:
        """Forget who asked nothing for longest; refuse the newcomer where that is not long."""
        quietest = min(self._episodes, key=self._seen.__getitem__)
        if now - self._seen[quietest] <= SPARED:
            raise RequestError(
                f"there are {self._most} clients already: try again when one has said bye or was "
                f"idle for {min(SPARED, self._idle):g} s"
            )
        del self._episodes[quietest], self._seen[quietest]

    def _forget(self, now: float) -> None:
        for client in [c for c, seen in self._seen.items() if now - seen > self._idle]:
            self._episodes.pop(client, None)
            del self._seen[client]
