"""`run --watch`: the run of before, and what a browser is told and shows of it."""

import http.client
import json
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from contextlib import closing, suppress
from dataclasses import replace

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.comparison.evaluation import run_policy
from spikedeploy.envs.rollout import rollout
from spikedeploy.live import _MOST_STEPS, LiveView, WatchedLoop, WatchedStep, steps_event
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.recordings import Step
from spikedeploy.runtime.errors import ConfigError
from tests.paths import ROOT
from tests.waiting import PATIENCE, wait_until

RATE = 500.0


class Kept:
    """A view that keeps what it is handed."""

    def __init__(self):
        self.begun, self.steps, self.outcomes = [], [], []

    def begin(self, head):
        self.begun.append(head)
        self.table, self.deadline = head["table"], head["deadline"]

    def step(self, step):
        self.steps.append(step)

    def over(self, outcome):
        self.outcomes.append(outcome)


def data_of(message):
    return json.loads(message.split(b"data: ")[1])


@pytest.mark.parametrize(("policy", "chip"), [("popsan", "loihi2"), ("popsan", "float"),
                                              ("sac", None)])  # fmt: skip
def test_a_watched_run_is_the_run_of_before_bit_for_bit(stroll, policy, chip):
    seeds, view = range(10_000, 10_002), Kept()
    plain = run_policy(f"stroll/{policy}", None, chip, seeds)
    loop = WatchedLoop(view, RATE, None, None)
    watched = run_policy(f"stroll/{policy}", None, chip, seeds, loop=loop)
    assert watched.as_json() == plain.as_json()
    env, candidate = envs.make("stroll"), find(f"stroll/{policy}")
    alone = rollout(env, open_policy(candidate, chip, env), seeds[0])
    actions = np.stack([each.step.action for each in view.steps[:20]])
    assert actions.tobytes() == alone.action.tobytes()
    assert [each["total"] for each in view.outcomes] == plain.rows[0].returns


def test_what_is_told_adds_up_to_what_is_reported(stroll):
    view = Kept()
    loop = WatchedLoop(view, RATE, "1s", None)
    (row,) = run_policy("stroll/popsan", None, None, [10_000], loop=loop).as_json()
    assert view.table == "horowitz45-int8"
    assert [step.number for step in view.steps] == list(range(20))
    sops = [each.step.ledger.total("sop") for each in view.steps]
    assert sum(sops) / 20 == pytest.approx(row["sops_per_inference"])
    (begun,) = view.begun
    assert (begun["label"], begun["env"], begun["period"]) == ("popsan · loihi1", "stroll", 0.02)
    data = data_of(steps_event(view.steps[5:9], view.table, view.deadline))
    assert (data["first"], data["steps"], data["missed"]) == (5, 4, view.steps[8].missed)
    assert data["actions"]["shape"] == [4, 2]
    assert data["tracks"][0]["unit"] == "%"
    names = [layer["name"] for layer in data["network"]["layers"]]
    assert names == ["input", "n2", "n4", "n6"]


def test_the_rate_is_the_environments_and_large_layers_are_left_out_by_name(stroll):
    view = Kept()
    run_policy("stroll/popsan", None, None, [0], loop=WatchedLoop(view, None, None, None))
    assert (view.begun[-1]["rate"], view.deadline) == (50.0, 1 / 50)
    watched = view.steps[0]
    wide = {**watched.step.spikes, "input": np.zeros((5, 9000), np.uint8)}
    uncounted = replace(watched.step, spikes=wide, ledger=None)
    data = data_of(steps_event([replace(watched, step=uncounted)], view.table, 1.0))
    assert data["network"]["left_out"] == ["input: 9,000 neurons"]
    assert data["network"]["sops"] is None


def test_the_command_says_where_to_look_and_json_stays_json(stroll, command):
    code, out, err = command("run", "stroll/popsan", "--watch", "--rate", RATE, "--json")
    assert code == 0
    assert json.loads(out)["real_time"]["steps"] == 20
    assert "watch at http://127.0.0.1:" in err


@pytest.mark.parametrize(("words", "why"), [
    (["--port", "8000"], "--port goes with --watch"),
    (["--watch", "--video", "x.mp4"], "leave --video out"),
    (["--watch", "--deadline", "soon"], "is no time"),
    (["--watch", "--rate", "0"], "--rate"),
])  # fmt: skip
def test_options_that_make_no_sense_are_refused(stroll, command, words, why):
    code, _, err = command("run", "stroll/popsan", *words)
    assert code == 2
    assert why in " ".join(err.split())


PATIENT = f"""
from spikedeploy import cli, live
live._CLOSING = {PATIENCE}  # two seconds may be too few on a busy core
cli.main()
"""


def test_ctrl_c_ends_the_run_while_a_browser_listens():
    line = ["run", "hexapod/sparse", "--watch", "--episodes", "9"]
    process = subprocess.Popen(
        [sys.executable, "-c", PATIENT, *line], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    try:
        address = process.stderr.readline().split()[-1]
        with urllib.request.urlopen(f"{address}events", timeout=PATIENCE) as stream:
            wait_until(lambda: stream.readline() == b"event: begin\n")
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 130
            assert b"event: end\n" in stream.read()
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def test_the_page_draws_the_run_and_keeps_its_last_picture(stroll, browser):
    from selenium.webdriver.support.ui import WebDriverWait

    def state(name, wanted):
        script = f"return document.documentElement.dataset.{name}"
        WebDriverWait(browser, PATIENCE).until(lambda found: found.execute_script(script) == wanted)

    size = {"width": 390, "height": 900, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    with closing(LiveView()) as view:
        browser.get(view.address)
        assert view.wait(PATIENCE)
        loop = WatchedLoop(view, 100.0, None, None)
        playing = threading.Thread(
            target=run_policy, args=("stroll/popsan", None, None, range(3)), kwargs={"loop": loop}
        )
        playing.start()
        state("ready", "3")
        playing.join()
    state("state", "ended")
    WebDriverWait(browser, PATIENCE).until(
        lambda found: found.find_element("id", "now").text == "0.38 s, control step 19"
    )
    shown = browser.find_element("tag name", "main").text
    assert "popsan · loihi1 in stroll" in shown
    assert "episode 3, seed 2" in shown
    assert "by horowitz45-int8" in shown
    assert "time limit" in shown
    titles = [each.text for each in browser.find_elements("css selector", ".strip span")]
    for wanted in ("input spikes", "membranes of", "synaptic operations", "time of the policy"):
        assert any(title.startswith(wanted) for title in titles), wanted
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    browser.find_element("tag name", "body").send_keys("\ue012" * 4)  # arrow left looks back
    assert browser.find_element("id", "now").text == "0.30 s, control step 15"
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


# -- the server of `run --watch`


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
    return WatchedStep(Step(np.zeros(2), 1.0, {}), number, 1.0, 0.0, 0, 0)


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
    monkeypatch.setattr("spikedeploy.live._CLOSING", PATIENCE)
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
