"""The socket of `serve`: a ROUTER of ZeroMQ, whose every message is answered by one.

Nothing is authenticated, so it listens on this machine alone unless it is told otherwise.
"""

import sys
import threading
import time
import traceback
from ipaddress import IPv4Address

import zmq

from spikedeploy.realtime.protocol import RequestError, largest_request, parsed, refusal, reply
from spikedeploy.realtime.served_policy import Clients, ServedPolicy
from spikedeploy.runtime.errors import ConfigError, SpikedeployError

_WAIT = 200  # [ms] for a message, then whether to stop is asked
_HANDSHAKE = 2000  # [ms] for a connection to say that it speaks ZeroMQ
_HEARTBEAT = 10_000  # [ms] between signs of life that a silent connection is asked for
_QUEUED = 16  # messages of a client that wait; then it waits itself


class PolicyServer:
    """Answers clients until it is stopped; to be closed.

    endpoint  where it listens, as `tcp://127.0.0.1:5555`
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
        for option, value in _options(policy).items():
            self._socket.setsockopt(option, value)
        try:
            self._socket.bind(f"tcp://{_ipv4(address)}:{port or '*'}")
        except zmq.ZMQError as error:
            self.close()
            raise ConfigError(
                f"cannot listen on {address}:{port}: {error}. Give another --port, or 0 for one "
                "that is free."
            ) from error
        except ConfigError:
            self.close()
            raise
        self.endpoint = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def serve(self, stop: threading.Event) -> None:
        """Answer until `stop` is set."""
        while not stop.is_set():
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


def _ipv4(address: str) -> IPv4Address:
    try:
        return IPv4Address(address)
    except ValueError as error:
        raise ConfigError(
            f"--address {address[:40]!r} is no IPv4 address of this machine, as 127.0.0.1 is."
        ) from error
