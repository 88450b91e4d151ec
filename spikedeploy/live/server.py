"""The page of `run --watch` and its events, over HTTP on 127.0.0.1.

Whoever can open a connection on this machine may look; nothing can be changed. Pages of other
origins are kept out: by the name of the host, as DNS may lead a name of theirs here, and by what
browsers say of where a request comes from.
"""

import re
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from socket import SHUT_RDWR, socket
from socketserver import TCPServer, ThreadingMixIn
from typing import Any

from spikedeploy.live.backlog import Listeners
from spikedeploy.reports.page import REPLAY_ASSETS, asset
from spikedeploy.runtime.errors import ConfigError

_HOST = re.compile(r"(127\.0\.0\.1|localhost)(:[0-9]{1,5})?", re.IGNORECASE)
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
    "Connection": "close",
}
_STREAMS = 32  # of events at a time; further ones are refused
_OTHERS = 64  # connections without a stream at a time; then the oldest is closed
_REQUEST = 5.0  # [s] of silence before a request is whole
_PATIENCE = 10.0  # [s] for a browser to take what it is sent
_SILENCE = 2.0  # [s] after which a comment shows whether the browser is still there


class LiveServer(ThreadingMixIn, TCPServer):
    """Answers in threads from the beginning on; to be closed.

    listeners  the browsers
    address    of the page
    """

    daemon_threads = True
    allow_reuse_address = True
    request_queue_size = 2 * _OTHERS

    def __init__(self, listeners: Listeners, port: int = 0) -> None:
        self.listeners = listeners
        self._streams = threading.BoundedSemaphore(_STREAMS)
        # connections without a stream, the oldest first
        self._others: dict[socket, None] = {}
        # guards them: a socket is not closed by its thread while a newcomer shuts it down
        self._lock = threading.Lock()
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except OSError as error:
            raise ConfigError(
                f"--port {port}: cannot listen on 127.0.0.1 ({error.strerror}). Give another, or "
                "leave it out for one that is free."
            ) from error
        self.address = f"http://127.0.0.1:{self.server_address[1]}/"
        threading.Thread(target=self.serve_forever, args=(0.05,), daemon=True).start()

    def close(self) -> None:
        """Give the port back."""
        self.shutdown()
        self.server_close()

    @cached_property
    def files(self) -> dict[str, tuple[str, bytes]]:
        """Path -> type and content: nothing else is there to be read."""
        script = "\n".join(asset(name) for name in (*REPLAY_ASSETS, "live.js"))
        style = asset("page.css") + asset("live.css")
        texts = {
            "/": ("text/html", asset("live.html")),
            "/live.js": ("text/javascript", script),
            "/live.css": ("text/css", style),
        }
        return {path: (kind, text.encode()) for path, (kind, text) in texts.items()}

    def process_request(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        """Answer in a thread; what asks for nothing makes room for what comes after it."""
        with self._lock:
            if len(self._others) >= _OTHERS:
                oldest = next(iter(self._others))
                del self._others[oldest]
                with suppress(OSError):
                    oldest.shutdown(SHUT_RDWR)
            self._others[request] = None
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:  # noqa: ANN401
        """Close a connection."""
        self._forget(request)
        super().shutdown_request(request)

    @contextmanager
    def stream(self, connection: socket) -> Iterator[bool]:
        """A place for a stream, which no newcomer takes; whether one was free."""
        free = self._streams.acquire(blocking=False)
        try:
            if free:
                self._forget(connection)
            yield free
        finally:
            if free:
                self._streams.release()

    def _forget(self, connection: socket) -> None:
        with self._lock:
            self._others.pop(connection, None)

    def handle_error(self, request: socket | tuple[bytes, socket], client_address: Any) -> None:  # noqa: ANN401
        """A browser that leaves is no error."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    server: LiveServer
    server_version, sys_version, protocol_version = "spikedeploy", "", "HTTP/1.1"
    timeout = _REQUEST

    def do_GET(self) -> None:
        """A file, or the events."""
        self.connection.settimeout(_PATIENCE)
        if not self._ours():
            self._refuse(HTTPStatus.FORBIDDEN)
        elif self.path == "/events":
            with self.server.stream(self.connection) as free:
                self._events() if free else self._refuse(HTTPStatus.SERVICE_UNAVAILABLE)
        elif self.path in self.server.files:
            kind, content = self.server.files[self.path]
            self._answer(HTTPStatus.OK, f"{kind}; charset=utf-8", content)
        else:
            self._refuse(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Refuse: there is nothing to change."""
        self._refuse(HTTPStatus.METHOD_NOT_ALLOWED)

    do_HEAD = do_PUT = do_DELETE = do_PATCH = do_OPTIONS = do_POST  # noqa: N815

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the terminal is the run's."""

    def _ours(self) -> bool:
        """Whether the request is of our page, or of somebody who typed its address."""
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or not _HOST.fullmatch(hosts[0]):
            return False
        ours = {f"http://{hosts[0].lower()}"}
        origins = {each.lower() for each in self.headers.get_all("Origin", [])}
        site = self.headers.get("Sec-Fetch-Site", "none")
        # a link may lead to the page
        return self.path == "/" or (origins <= ours and site in ("none", "same-origin"))

    def _events(self) -> None:
        """Send what there is to tell, until the end."""
        self._head(HTTPStatus.OK, "text/event-stream")
        listeners = self.server.listeners
        with listeners.one() as backlog:
            while True:
                messages = listeners.next(backlog, _SILENCE)
                self.wfile.write(b"".join(m.text for m in messages) or b": nothing new\n\n")
                if messages and messages[-1].kind == "end":
                    return

    def _refuse(self, status: HTTPStatus) -> None:
        self._answer(status, "text/plain; charset=utf-8", f"{status.phrase}\n".encode())

    def _answer(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self._head(status, kind, {"Content-Length": str(len(content))})
        if self.command != "HEAD":
            self.wfile.write(content)

    def _head(self, status: HTTPStatus, kind: str, more: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, **_HEADERS, **(more or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        self.close_connection = True
