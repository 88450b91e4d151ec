"""The server of `run --watch`: what it answers, whom it refuses, and what browsers hear."""

import http.client
import json
import socket
import time
from contextlib import closing, suppress

import numpy as np
import pytest

from spikedeploy.live import _MOST_STEPS, LiveView, WatchedStep
from spikedeploy.runtime.errors import ConfigError
from tests.waiting import PATIENCE, wait_until


@pytest.fixture
def view():
    with closing(LiveView()) as found:
        yield found


def port(view):
    return int(view.address.rsplit(":", 1)[1].strip("/"))


def connection_to(view):
    return http.client.HTTPConnection("127.0.0.1", port(view), timeout=PATIENCE)


def asked(view, path="/", method="GET", **headers):
    """Status, headers and body of an answer."""
    with closing(connection_to(view)) as connection:
        names = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, headers=names)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


def listening(view):
    """A connection to the events."""
    connection = connection_to(view)
    connection.request("GET", "/events")
    answer = connection.getresponse()
    assert answer.getheader("Content-Type") == "text/event-stream"
    return answer


def events(text):
    """(kind, data) of the events of a stream."""
    for block in text.decode().split("\n\n"):
        if block.startswith("event:"):
            kind, data = block.split("\n")
            yield kind.removeprefix("event: "), json.loads(data.removeprefix("data: "))


def step(number):
    return WatchedStep(number, np.zeros(2), 1.0, 1.0, {}, None, None, None, 0.0, 0, 0)


HEAD = {"table": "horowitz45-int8", "deadline": 0.02}


def play(view, steps):
    view.begin({"episode": 1, **HEAD})
    for number in range(steps):
        view.step(step(number))


def test_the_page_and_its_two_files_are_all_there_is_to_read(view):
    for path in ("/", "/live.js", "/live.css"):
        status, headers, body = asked(view, path)
        assert (status, len(body)) == (200, int(headers["Content-Length"]))
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert b"://" not in body.replace(b"http://www.w3.org", b"")
    for path in ("/../pyproject.toml", "/live.js/../../cli.py", "//etc/passwd", "/?x", "/live.JS"):
        assert asked(view, path)[0] == 404


@pytest.mark.parametrize(("host", "status"), [
    ("evil.example", 403), ("127.0.0.1.evil.example", 403), ("localhost:80:80", 403),
    ("127.0.0.1@evil.example", 403), ("", 403), ("0.0.0.0", 403),
    ("localhost", 200), ("LOCALHOST:9000", 200), ("127.0.0.1:1", 200),
])  # fmt: skip
def test_names_that_only_lead_to_this_machine_are_refused(view, host, status):
    for path in ("/", "/live.js") if status == 200 else ("/", "/live.js", "/events"):
        assert asked(view, path, Host=host)[0] == status


def test_pages_of_other_origins_may_link_here_and_no_more(view):
    for site in ("cross-site", "same-site"):
        assert asked(view, "/", Sec_Fetch_Site=site)[0] == 200
        assert asked(view, "/events", Sec_Fetch_Site=site)[0] == 403
    assert asked(view, "/live.js", Sec_Fetch_Site="same-origin")[0] == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:8000",
                                    "http://127.0.0.1:8001", "http://localhost:8000"])  # fmt: skip
def test_foreign_origins_get_no_events(view, origin):
    for path in ("/events", "/live.js"):
        assert asked(view, path, Host="127.0.0.1:8000", Origin=origin)[0] == 403
    same = {"Host": "127.0.0.1:8000", "Origin": "http://127.0.0.1:8000"}
    assert asked(view, "/live.js", **same)[0] == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "HEAD", "OPTIONS", "PATCH"])
def test_only_get_is_answered(view, method):
    assert asked(view, method=method)[0] == 405


def test_requests_that_are_none_end_their_connection_and_nobody_elses(view, capfd):
    for bytes_ in (b"\x00\xff\n\n", b"GET / HTTP/9.9\r\n\r\n",
                   b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil\r\n\r\n"):  # fmt: skip
        with socket.create_connection(("127.0.0.1", port(view)), timeout=PATIENCE) as connection:
            connection.sendall(bytes_)
            connection.shutdown(socket.SHUT_WR)
            with suppress(ConnectionResetError):
                assert b" 200 " not in connection.recv(100)
    assert asked(view)[0] == 200
    assert capfd.readouterr().err == ""


def test_several_browsers_hear_the_same_and_a_late_one_what_is_kept(view, monkeypatch):
    monkeypatch.setattr("spikedeploy.live._GOODBYE", PATIENCE)
    first, second = listening(view), listening(view)
    assert view.wait(PATIENCE)
    play(view, 4)
    time.sleep(0.2)
    late = listening(view)
    wait_until(lambda: view._browsers == 3)
    view.over({"total": 4.0})
    view.close()
    for each in (first, second, late):
        heard = list(events(each.read()))
        assert [kind for kind, _ in heard if kind != "steps"] == ["begin", "over", "end"]
        assert sum(data["steps"] for kind, data in heard if kind == "steps") == 4


def test_a_slow_browser_misses_the_oldest_control_steps_and_nothing_else(view):
    play(view, _MOST_STEPS + 7)
    view.over({"total": 4.0})
    heard = view.events()
    (begin,), (steps,), (over,) = (events(next(heard)) for _ in range(3))
    assert (begin[0], over) == ("begin", ("over", {"total": 4.0}))
    assert (steps[1]["first"], steps[1]["steps"]) == (7, _MOST_STEPS)
    view.begin({"episode": 2, **HEAD})  # whose picture replaces what was there
    assert next(events(next(heard)))[1]["episode"] == 2


def test_a_browser_that_reads_nothing_keeps_nobody_waiting(view, monkeypatch):
    monkeypatch.setattr("spikedeploy.live._Handler.timeout", PATIENCE)
    stalled = socket.socket()
    stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
    stalled.connect(("127.0.0.1", port(view)))
    stalled.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert view.wait(PATIENCE)
    view.begin({"scene": "x" * 5_000_000, **HEAD})
    play(view, 100)
    assert asked(view)[0] == 200
    assert view._browsers == 1  # whose thread is still sending
    stalled.close()


def test_browsers_that_leave_are_forgotten(view, monkeypatch, capfd):
    monkeypatch.setattr("spikedeploy.live._SILENCE", 0.05)
    answers = [listening(view) for _ in range(3)]
    assert view.wait(PATIENCE)
    for answer in answers:
        answer.close()
    wait_until(lambda: view._browsers == 0)
    assert capfd.readouterr().err == ""


def test_a_connection_without_a_whole_request_is_closed(view, monkeypatch):
    monkeypatch.setattr("spikedeploy.live._Handler.timeout", 0.1)
    with socket.create_connection(("127.0.0.1", port(view)), timeout=PATIENCE) as silent:
        silent.sendall(b"GET / HTTP/1.1\r\nHost: local")
        assert silent.recv(100) == b""


def test_a_port_that_is_taken_is_refused_in_a_sentence(view):
    with pytest.raises(ConfigError, match=rf"--port {port(view)}: cannot listen on 127.0.0.1"):
        LiveView(port(view))
