"""`serve`: a spiking policy that other programs act with, over ZeroMQ.

Requests and replies are one JSON object each, as docs/realtime.md lists them. Nothing is
authenticated, so the socket listens on this machine alone unless another address is given.
"""

import json
import sys
import threading
import time
import traceback
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Any, Literal

import zmq
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from spikedeploy.policies.nir import read_policy
from spikedeploy.policies.registry import find
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.running_network import chip_or_float
from spikedeploy.runtime.errors import ConfigError, SpikedeployError

VERSION = 1
# bytes of a request besides its observation, and of each number in it
_ENVELOPE, _NUMBER = 4096, 32
_WAIT = 200  # [ms] for a message, before `stop` is looked at again
_HANDSHAKE = 2000  # [ms] for a connection to say that it speaks ZeroMQ
_QUEUED = 16  # messages of a client that wait; then it waits itself


class RequestError(SpikedeployError):
    """A request that is none, or that cannot be answered now."""


class Request(BaseModel):
    """A request of a client.

    do: what is asked for
    seed: seed of the episode that `reset` begins
    observation: observation of `act`, as JSON has it
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    do: Literal["info", "reset", "act", "bye"]
    seed: int = Field(default=0, ge=0, lt=2**63)
    observation: list[Any] = []

    @classmethod
    def parse(cls, body: bytes) -> "Request":
        """Return the request in a message; RequestError where it is none."""
        try:
            return cls.model_validate_json(body)
        except ValidationError as error:
            first = error.errors()[0]
            place = ", ".join(["the request", *map(str, first["loc"])])
            raise RequestError(f"{place}: {first['msg']}"[:200]) from error


class ServedPolicy:
    """A policy on a chip, read once.

    name: name of the policy
    chip: name as on the command line, or "float"
    observed: numbers of an observation
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
        self._artifact, self._on = read_policy(candidate.path), chip_or_float(self.chip)
        self._options: dict[str, Any] = {"backend": backend, "limits": limits}
        first = self.controller()
        self._codec, self.observed = first.codec, first.codec.encoder.observed
        self._actions = int(candidate.actions or 0)
        first.act([0.0] * self.observed)  # takes memory and may compile before clients come

    def controller(self) -> SpikingController:
        """A controller of its own for a client."""
        return SpikingController(self._artifact, self._on, "none", **self._options)

    def info(self) -> dict[str, Any]:
        """The reply to `info`."""
        return {
            "protocol": VERSION,
            "policy": self.name,
            "chip": self.chip,
            "observations": self.observed,
            "actions": self._actions,
            "chooses": self._codec.chooses,
            "timesteps": self._codec.timesteps,
        }


@dataclass
class _Client:
    """A client: its controller, its actions since the last reset, and when it was heard last."""

    controller: SpikingController
    steps: int
    heard: float


class Clients:
    """Clients of a server, each with its episode; idle ones are forgotten.

    policy: policy that answers them
    most: clients at a time
    idle: [s] without a request after which a client is forgotten
    """

    def __init__(self, policy: ServedPolicy, most: int, idle: float) -> None:
        self._policy, self._most, self._idle = policy, most, idle
        self._known: dict[bytes, _Client] = {}

    def answer(self, name: bytes, request: Request, now: float) -> dict[str, Any]:
        """The reply to a request of a client.

        name: of the client, which the connection decides
        now: [s] of a clock that only goes forward
        """
        self._known = {n: c for n, c in self._known.items() if now - c.heard <= self._idle}
        if request.do == "info":
            return self._policy.info()
        if request.do == "bye":
            self._known.pop(name, None)
            return {}
        client = self._known.get(name)
        if request.do == "reset":
            return self._reset(name, client, request.seed, now)
        if client is None:
            raise RequestError(
                f"no episode: send reset first; after {self._idle:g} s without a request it is "
                "forgotten"
            )
        client.heard = now
        action = client.controller.act(request.observation).tolist()
        client.steps += 1
        return {"action": action, "step": client.steps}

    def _reset(self, name: bytes, client: _Client | None, seed: int, now: float) -> dict[str, Any]:
        """Begin an episode."""
        if client is None and len(self._known) >= self._most:
            raise RequestError(
                f"there are {self._most} clients already: try again when one has said bye or was "
                f"idle for {self._idle:g} s"
            )
        controller = client.controller if client else self._policy.controller()
        self._known[name] = _Client(controller, 0, now)
        controller.reset(seed)
        return {"seed": seed}


class PolicyServer:
    """Answers clients until it is stopped; to be closed.

    endpoint: where it listens, as `tcp://127.0.0.1:5555`
    """

    def __init__(
        self,
        policy: ServedPolicy,
        address: str = "127.0.0.1",
        port: int = 0,
        clients: int = 32,
        idle: float = 60.0,
    ) -> None:
        self._clients = Clients(policy, clients, idle)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.ROUTER)
        for option, value in {
            zmq.MAXMSGSIZE: largest_request(policy.observed),  # a larger one ends its connection
            zmq.RCVHWM: _QUEUED,
            zmq.SNDHWM: _QUEUED,  # a client that reads no more loses replies, none waits for it
            zmq.HANDSHAKE_IVL: _HANDSHAKE,
            zmq.LINGER: 0,
        }.items():
            self._socket.setsockopt(option, value)
        try:
            self._socket.bind(f"tcp://{IPv4Address(address)}:{port or '*'}")
        except ValueError as error:
            self.close()
            raise ConfigError(
                f"--address {address[:40]!r} is no IPv4 address of this machine, as 127.0.0.1 is."
            ) from error
        except zmq.ZMQError as error:
            self.close()
            raise ConfigError(
                f"cannot listen on {address}:{port}: {error}. Give another --port, or 0 for one "
                "that is free."
            ) from error
        self.endpoint = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def serve(self, stop: threading.Event) -> None:
        """Answer until `stop` is set."""
        while not stop.is_set():
            if self._socket.poll(_WAIT):
                client, *frames = self._socket.recv_multipart()
                # a REQ socket puts an empty frame before its message, a DEALER none
                envelope = frames[:1] if frames[:1] == [b""] else []
                reply = json.dumps(self._answer(client, frames[len(envelope) :]), allow_nan=False)
                self._socket.send_multipart([client, *envelope, reply.encode()])

    def close(self) -> None:
        """Close the port at once."""
        self._socket.close(linger=0)
        self._context.term()

    def _answer(self, client: bytes, frames: list[bytes]) -> dict[str, Any]:
        """The reply to a message, whatever it holds."""
        try:
            if len(frames) != 1:
                raise RequestError(f"a request is one frame, not {len(frames)}")
            request = Request.parse(frames[0])
            return {"ok": True, **self._clients.answer(client, request, time.monotonic())}
        except SpikedeployError as error:
            return {"ok": False, "error": " ".join(str(error).split())}
        except Exception as error:  # a bug must not end the service of the others
            traceback.print_exc(file=sys.stderr)
            return {
                "ok": False,
                "error": f"the server failed at this request: {type(error).__name__}",
            }


def largest_request(observed: int) -> int:
    """Bytes that a request with so many observed numbers may have."""
    return _ENVELOPE + _NUMBER * observed
