"""The server of `run --watch`: what it answers, whom it refuses, and browsers that do harm."""

import http.client
import json
import socket
import time
from contextlib import closing, suppress
from select import select

import pytest

from spikedeploy.live.backlog import Backlog, Listeners
from spikedeploy.live.server import _OTHERS, _PATIENCE, _REQUEST, _STREAMS, LiveServer
from spikedeploy.live.steps import Message, message
from spikedeploy.runtime.errors import ConfigError


@pytest.fixture
def server():
    with closing(LiveServer(Listeners(most=5))) as found:
        yield found


def port(server):
    return server.server_address[1]


def asked(server, path="/", method="GET", **headers):
    """Status, headers and body of an answer."""
    with closing(http.client.HTTPConnection("127.0.0.1", port(server), timeout=5)) as connection:
        names = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, headers=names)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


def listening(server):
    """A connection to the events, once the server knows it."""
    connection = http.client.HTTPConnection("127.0.0.1", port(server), timeout=5)
    connection.request("GET", "/events")
    answer = connection.getresponse()
    assert answer.getheader("Content-Type") == "text/event-stream"
    return answer


def events(answer):
    """(kind, data) of a stream that ends."""
    for block in answer.read().decode().split("\n\n"):
        if block.startswith("event:"):
            kind, data = block.split("\n")
            yield kind.removeprefix("event: "), json.loads(data.removeprefix("data: "))


def steps(number):
    return message("steps", {"first": number})


def test_the_page_and_its_two_files_are_all_there_is_to_read(server):
    for path in ("/", "/live.js", "/live.css"):
        status, headers, body = asked(server, path)
        assert (status, len(body)) == (200, int(headers["Content-Length"]))
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert b"://" not in body.replace(b"http://www.w3.org", b"")
    paths = ("/../pyproject.toml", "/live.js/../../cli.py", "//etc/passwd", "/%2e%2e/cli.py", "/?x",
             "/live.JS", "/" + "a" * 60_000)  # fmt: skip
    for path in paths:
        assert asked(server, path)[0] == 404


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "localhost:80:80",
                                  "127.0.0.1@evil.example", "", "0.0.0.0"])  # fmt: skip
def test_names_that_only_lead_to_this_machine_are_refused(server, host):
    for path in ("/", "/live.js", "/events"):
        assert asked(server, path, Host=host)[0] == 403


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:9000", "127.0.0.1:1"])
def test_a_forwarded_port_is_served(server, host):
    assert asked(server, Host=host)[0] == 200


def test_pages_of_other_origins_may_link_here_and_no_more(server):
    for site in ("cross-site", "same-site"):
        assert asked(server, "/", Sec_Fetch_Site=site)[0] == 200
        assert asked(server, "/events", Sec_Fetch_Site=site)[0] == 403
    assert asked(server, "/live.js", Sec_Fetch_Site="same-origin")[0] == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "HEAD", "OPTIONS", "PATCH"])
def test_only_get_is_answered(server, method):
    assert asked(server, method=method)[0] == 405


def test_requests_that_are_none_end_their_connection_and_nobody_elses(server, capfd):
    for bytes_ in (b"\x00\xff\n\n", b"GET / HTTP/9.9\r\n\r\n", b"GET\r\n\r\n", b"a" * 70_000,
                   b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 200 + b"\r\n",
                   b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil\r\n\r\n"):  # fmt: skip
        with socket.create_connection(("127.0.0.1", port(server)), timeout=5) as connection:
            connection.sendall(bytes_)
            connection.shutdown(socket.SHUT_WR)
            with suppress(ConnectionResetError):
                assert b" 200 " not in connection.recv(100)
    assert asked(server)[0] == 200
    assert capfd.readouterr().err == ""


def test_several_browsers_hear_the_same_and_a_late_one_what_is_kept(server):
    first, second = listening(server), listening(server)
    assert server.listeners.some(5)
    for told in (message("begin", {"episode": 1}), *map(steps, range(4))):
        server.listeners.tell(told)
    late = listening(server)
    server.listeners.tell(message("end", {}))
    heard = [[kind for kind, _ in events(each)] for each in (first, second, late)]
    assert heard == [["begin", *["steps"] * 4, "end"]] * 3
    assert server.listeners.drained(5)


def test_a_slow_browser_loses_the_oldest_control_steps_and_nothing_else():
    backlog = Backlog(3)
    for told in (message("begin", {}), *map(steps, range(10)), message("over", {})):
        backlog.add(told)
    assert [m.kind for m in backlog] == ["begin", "steps", "steps", "steps", "over"]
    assert b'"first":7' in backlog.take()[1].text
    backlog.add(steps(11))
    backlog.add(message("begin", {}))  # whose picture replaces what was waiting
    assert [m.kind for m in backlog] == ["begin"]


def test_a_browser_that_reads_nothing_keeps_nobody_waiting(server):
    stalled = socket.socket()
    stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
    stalled.connect(("127.0.0.1", port(server)))
    stalled.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert server.listeners.some(5)
    large, longest = Message("steps", b"x" * 1_000_000), 0.0
    for _ in range(50):
        begin = time.perf_counter()
        server.listeners.tell(large)
        longest = max(longest, time.perf_counter() - begin)
        time.sleep(0.002)
    assert longest < _PATIENCE / 2  # one that is waited for takes all of it
    assert asked(server)[0] == 200
    stalled.close()
    assert server.listeners.drained(5)


def test_browsers_that_leave_are_forgotten(server, monkeypatch, capfd):
    monkeypatch.setattr("spikedeploy.live.server._SILENCE", 0.05)
    answers = [listening(server) for _ in range(3)]
    for answer in answers:
        answer.close()
    assert server.listeners.drained(10)
    assert capfd.readouterr().err == ""


def test_silent_connections_lock_no_browser_out(server):
    silent = [socket.create_connection(("127.0.0.1", port(server))) for _ in range(_OTHERS + 20)]
    answer = listening(server)
    assert asked(server)[0] == 200
    closed, until = [], time.monotonic() + 5
    while len(closed) < 20 and time.monotonic() < until:
        time.sleep(0.01)
        closed = select(silent, [], [], 0)[0]
    assert len(closed) >= 20  # the oldest, so that threads are bounded too
    assert silent[0] in closed
    assert silent[-1] not in closed
    server.listeners.tell(message("end", {}))
    assert list(events(answer)) == [("end", {})]
    for each in silent:
        each.close()


@pytest.mark.parametrize("begun", [b"", b"GET / HTTP/1.1\r\nHost: local"])
def test_a_connection_without_a_whole_request_is_closed(server, monkeypatch, begun):
    monkeypatch.setattr("spikedeploy.live.server._Handler.timeout", 0.1)
    with socket.create_connection(("127.0.0.1", port(server)), timeout=5) as silent:
        silent.sendall(begun)
        assert silent.recv(100) == b""
    assert _REQUEST <= 5


def test_streams_are_bounded_and_others_are_answered_beside_them(server, monkeypatch):
    answers = [listening(server) for _ in range(_STREAMS)]
    assert asked(server, "/events")[0] == 503
    assert asked(server)[0] == 200
    server.listeners.tell(message("end", {}))
    for answer in answers:
        answer.read()
    assert server.listeners.drained(5)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:8000",
                                    "http://127.0.0.1:8001", "http://localhost:8000"])  # fmt: skip
def test_foreign_origins_get_no_events(server, origin):
    for path in ("/events", "/live.js"):
        assert asked(server, path, Host="127.0.0.1:8000", Origin=origin)[0] == 403
    same = {"Host": "127.0.0.1:8000", "Origin": "http://127.0.0.1:8000"}
    assert asked(server, "/live.js", **same)[0] == 200


def test_a_port_that_is_taken_is_refused_in_a_sentence(server):
    with pytest.raises(ConfigError, match=rf"--port {port(server)}: cannot listen on 127.0.0.1"):
        LiveServer(Listeners(), port(server))
