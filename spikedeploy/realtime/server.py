"""Requests to `serve` and its replies: one JSON object each, as docs/realtime.md lists them."""

import json
import math
import mmap
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any

import zmq

from spikedeploy.console import say
from spikedeploy.policies.costs import priced_by
from spikedeploy.policies.registry import find
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.network import chip_called
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.runtime.metrics.energy import TABLES, energy_estimate

# Requests to `serve` and its replies: one JSON object each, as docs/realtime.md l

VERSION = 1
REQUESTS = ("info", "reset", "act", "bye")
WANTED = ("spikes", "sops", "energy")
_FIELDS = {"do", "seed", "observation", "want"}
_LARGEST_SEED = 2**63
# bytes of a request besides its observation, and of each number in it
_ENVELOPE, _NUMBER = 4096, 32


class RequestError(SpikedeployError):
    """A request that is none, or that cannot be answered now."""


@dataclass(frozen=True)
class Request:
    """What a client asks for.

    do           one of REQUESTS
    seed         of the episode that `reset` begins
    observation  of `act`, as JSON has it
    want         of `act`: some of WANTED
    """

    do: str
    seed: int = 0
    observation: Any = None
    want: tuple[str, ...] = ()


def largest_request(observed: int) -> int:
    """Bytes that a request with so many observed numbers may have."""
    return _ENVELOPE + _NUMBER * observed


def parsed(body: bytes) -> Request:
    """The request in a message; RequestError where it is none."""
    fields = _object(body)
    if unknown := sorted(set(fields) - _FIELDS):
        raise RequestError(
            f"unknown field {unknown[0][:40]!r}; a request has {', '.join(sorted(_FIELDS))}"
        )
    do, seed, want = fields.get("do"), fields.get("seed", 0), fields.get("want", [])
    if do not in REQUESTS:
        raise RequestError(f"'do' is {str(do)[:40]!r}; it must be one of {', '.join(REQUESTS)}")
    if type(seed) is not int or not 0 <= seed < _LARGEST_SEED:
        raise RequestError("'seed' must be a whole number from 0 to 2^63 - 1")
    if not isinstance(want, list) or not all(each in WANTED for each in want):
        raise RequestError(f"'want' must be a list of some of {', '.join(WANTED)}")
    if do == "act" and not isinstance(fields.get("observation"), list):
        raise RequestError("'act' needs 'observation', a list of numbers")
    return Request(do, seed, fields.get("observation"), tuple(want))


def reply(answer: Mapping[str, Any]) -> bytes:
    """The message of an answer."""
    return json.dumps({"ok": True, **answer}, allow_nan=False).encode()


def refusal(sentence: str) -> bytes:
    """The message of an error."""
    return json.dumps({"ok": False, "error": " ".join(sentence.split())}).encode()


def finite(value: float) -> float | None:
    """The number; None, JSON's null, for infinity."""
    return value if math.isfinite(value) else None


def _object(body: bytes) -> dict[str, Any]:
    try:
        found = json.loads(body.decode())
    except (ValueError, RecursionError) as error:  # no UTF-8, no JSON, or one nested too deep
        raise RequestError(f"the request is no JSON: {str(error)[:80]}") from error
    if not isinstance(found, dict):
        raise RequestError(f"the request is a JSON {type(found).__name__}, and no object")
    return found


# A spiking policy that several clients act with, each in an episode of its own.

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
        self.name, self.chip = candidate.name, str(chip or candidate.default_chip)
        on = chip_called(self.chip)
        options: dict[str, Any] = {"limits": limits} if on else {}
        artifact = load(candidate.path)
        self._controller = partial(
            SpikingController, artifact, on, "total", backend=backend, **options
        )
        self._first = self._controller()
        self.observed = self._first.codec.encoder.observed
        self._tables = priced_by(on)
        self._actions = int(candidate.actions or 0)
        self._first.act([0.0] * self.observed)  # takes memory and may compile before clients come

    def episode(self) -> "ServedEpisode":
        """A controller of its own for a client."""
        return ServedEpisode(self._controller(), self._tables)

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


# The socket of `serve`: a ROUTER of ZeroMQ, whose every message is answered by on

_WAIT = 200  # [ms] for a message, then whether to stop is asked
_HANDSHAKE = 2000  # [ms] for a connection to say that it speaks ZeroMQ
_HEARTBEAT = 10_000  # [ms] between signs of life that a silent connection is asked for
_QUEUED = 16  # messages of a client that wait; then it waits itself
# memory that the service may take beyond that of the policy, and for each client [bytes]
_GROWTH, _CLIENT = 256 << 20, 16 << 20
_STATM = Path("/proc/self/statm")
_REBIND, _PAUSE = 5.0, 0.1  # [s] in which the port must be had again, and between two tries


class PolicyServer:
    """Answers clients until it is stopped; to be closed.

    endpoint  where it listens, as `tcp://127.0.0.1:5555`
    reopened  times that all connections were closed because what was sent took too much memory
    """

    def __init__(
        self,
        policy: ServedPolicy,
        address: str = "127.0.0.1",
        port: int = 0,
        clients: int = 32,
        idle: float = 60.0,
    ) -> None:
        self._policy, self._most, self._idle = policy, clients, idle
        self.reopened = 0
        wanted = f"tcp://{_ipv4(address)}:{port or '*'}"
        try:
            self._open(wanted)
        except zmq.ZMQError as error:
            self.close()
            raise ConfigError(
                f"cannot listen on {address}:{port}: {error}. Give another --port, or 0 for one "
                "that is free."
            ) from error
        self.endpoint = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def serve(self, stop: threading.Event) -> None:
        """Answer until `stop` is set."""
        most = _resident() + _GROWTH + self._most * _CLIENT
        while not stop.is_set():
            # a message of endless frames is none to ZeroMQ before its last, and nothing bounds it
            if _resident() > most:
                self._reopen()
                most = _resident() + _GROWTH + self._most * _CLIENT
            if self._socket.poll(_WAIT):
                client, *frames = self._socket.recv_multipart()
                # a REQ socket puts an empty frame before its message, a DEALER none
                envelope = frames[:1] if frames[:1] == [b""] else []
                answer = self._answer(client, frames[len(envelope) :])
                self._socket.send_multipart([client, *envelope, answer])

    def close(self) -> None:
        """Give the port back, at once."""
        self._socket.close(linger=0)
        self._context.term()

    def _open(self, endpoint: str) -> None:
        """A socket without connections, and without clients."""
        self._clients = Clients(self._policy, self._most, self._idle)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.ROUTER)
        for option, value in _options(self._policy).items():
            self._socket.setsockopt(option, value)
        self._socket.bind(endpoint)

    def _reopen(self) -> None:
        """Close all connections, which gives their memory back; clients connect again."""
        self.close()
        self.reopened += 1
        say(
            "all connections were closed: messages without an end took hundreds of MiB. Clients "
            "that wait for a reply have to connect again; episodes begin anew with a reset."
        )
        until = time.monotonic() + _REBIND
        while not self._bound(self.endpoint):
            if time.monotonic() > until:
                raise ConfigError(f"the port of {self.endpoint} was taken by another program")
            time.sleep(_PAUSE)

    def _bound(self, endpoint: str) -> bool:
        """Whether the port was free again, and is ours."""
        try:
            self._open(endpoint)
        except zmq.ZMQError:
            self.close()
            return False
        return True

    def _answer(self, client: bytes, frames: list[bytes]) -> bytes:
        """The reply to a message, whatever it holds."""
        try:
            if len(frames) != 1:
                raise RequestError(f"a request is one frame, not {len(frames)}")
            return reply(self._clients.answer(client, parsed(frames[0]), time.monotonic()))
        except SpikedeployError as error:
            return refusal(str(error))
        except Exception as error:  # a bug must not end the service of the others
            traceback.print_exc(file=sys.stderr)
            return refusal(f"the server failed at this request: {type(error).__name__}")


def _options(policy: ServedPolicy) -> dict[int, int]:
    """Bounds on what connections may send and hold."""
    return {
        zmq.MAXMSGSIZE: largest_request(policy.observed),  # a larger one ends its connection
        zmq.RCVHWM: _QUEUED,
        zmq.SNDHWM: _QUEUED,  # a client that reads no more loses replies, nobody waits for it
        zmq.HANDSHAKE_IVL: _HANDSHAKE,
        zmq.HEARTBEAT_IVL: _HEARTBEAT,
        zmq.LINGER: 0,
    }


def _resident() -> int:
    """Memory of this process [bytes]; 0 where the system does not say it."""
    try:
        pages = int(_STATM.read_text().split()[1])
    except OSError:
        return 0
    return pages * mmap.PAGESIZE


def _ipv4(address: str) -> IPv4Address:
    try:
        return IPv4Address(address)
    except ValueError as error:
        raise ConfigError(
            f"--address {address[:40]!r} is no IPv4 address of this machine, as 127.0.0.1 is."
        ) from error
