"""The socket of `serve`: a ROUTER of ZeroMQ, whose every message is answered by one.

Nothing is authenticated, so it listens on this machine alone unless it is told otherwise.
"""

import mmap
import sys
import threading
import time
import traceback
from ipaddress import IPv4Address
from pathlib import Path

import zmq

from spikedeploy.console import say
from spikedeploy.realtime.protocol import RequestError, largest_request, parsed, refusal, reply
from spikedeploy.realtime.served_policy import Clients, ServedPolicy
from spikedeploy.runtime.errors import ConfigError, SpikedeployError

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
