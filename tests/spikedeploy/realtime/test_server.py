"""`serve`: what clients are answered, and that none of them harms another."""

import json
import runpy
import signal
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest

from spikedeploy.api import load
from spikedeploy.realtime.server import (
    Clients,
    Request,
    RequestError,
    ServedPolicy,
    largest_request,
)
from spikedeploy.runtime.errors import ConfigError
from tests.paths import ROOT
from tests.waiting import PATIENCE

zmq = pytest.importorskip("zmq")
from spikedeploy.realtime.server import PolicyServer  # noqa: E402 - it needs zmq

POLICY = "kart-steer/sparse"


@pytest.fixture(scope="module")
def policy():
    return ServedPolicy(POLICY, "loihi1")


@pytest.fixture
def server(policy):
    """A server on a free port of this machine."""
    running, stop = PolicyServer(policy), threading.Event()
    thread = threading.Thread(target=running.serve, args=(stop,))
    thread.start()
    yield running
    stop.set()
    thread.join(PATIENCE)
    assert not thread.is_alive()
    running.close()


@pytest.fixture
def connect(server):
    """What connects a client to the server."""
    context, sockets = zmq.Context(), []

    def connected(kind=zmq.REQ):
        sockets.append(context.socket(kind))
        sockets[-1].setsockopt(zmq.LINGER, 0)
        sockets[-1].setsockopt(zmq.RCVTIMEO, 1000 * int(PATIENCE))
        sockets[-1].connect(server.endpoint)
        return sockets[-1]

    yield connected
    for each in sockets:
        each.close()
    context.term()


def sent(client, body):
    """The reply to a message."""
    client.send(body)
    return json.loads(client.recv())


def ask(client, **request):
    return sent(client, json.dumps(request).encode())


def observations(policy, count, seed):
    return np.random.default_rng(seed).normal(0, 1, (count, policy.observed))


def expected(rows):
    """Actions of the policy itself."""
    controller = load(POLICY).on("loihi1").controller()
    return [controller.act(row).tolist() for row in rows]


def test_clients_get_the_actions_of_the_policy_each_of_its_own_episode(policy, connect):
    clients, rows = [connect(), connect()], [observations(policy, 10, seed) for seed in (1, 2)]
    for client in clients:
        assert ask(client, do="reset", seed=0) == {"ok": True, "seed": 0}
    found = [[], []]
    for k in range(10):
        for each, client in enumerate(clients):
            answer = ask(client, do="act", observation=rows[each][k].tolist())
            assert answer["step"] == k + 1
            found[each].append(answer["action"])
    assert found == [expected(rows[0]), expected(rows[1])]


def test_info_says_what_a_client_has_to_know(policy, connect):
    found = ask(connect(), do="info")
    assert (found["protocol"], found["observations"]) == (1, policy.observed)
    assert (found["policy"], found["chip"], found["actions"]) == ("sparse", "loihi1", 5)


BAD = {
    **dict.fromkeys((b"", b"{", b"\xff\xfe", b"[" * 3000), "JSON"),
    **dict.fromkeys((b"[]", b"7"), "object"),
    **dict.fromkeys((b"{}", b'{"do": "fly"}', b'{"do": ["act"]}'), "do"),
    b'{"do": "act"}': "shape",
    b'{"do": "act", "observation": 7}': "observation",
    b'{"do": "act", "observation": [1, 2]}': "shape",
    b'{"do": "act", "observation": [[1], [1, 2]]}': "no array of numbers",
    b'{"do": "act", "observation": ["1"]}': "not real numbers",
    b'{"do": "act", "observation": [{}]}': "observation",
    b'{"do": "reset", "seed": -1}': "seed",
    b'{"do": "reset", "seed": 1.5}': "seed",
    b'{"do": "reset", "seed": true}': "seed",
    b'{"do": "reset", "seeds": 1}': "seeds",
}


def test_what_is_no_request_is_answered_by_a_sentence_and_the_episode_goes_on(policy, connect):
    client, rows = connect(), observations(policy, 2, 1)
    ask(client, do="reset")
    first = ask(client, do="act", observation=rows[0].tolist())
    for body, said in BAD.items():
        answer = sent(client, body)
        assert (answer["ok"], said in answer["error"]) == (False, True), (body, answer)
        assert "\n" not in answer["error"]
    second = ask(client, do="act", observation=rows[1].tolist())
    assert [first["action"], second["action"]] == expected(rows)


def test_numbers_that_are_none_and_act_before_reset_are_refused(policy, connect):
    client, zeros = connect(), ["0"] * (policy.observed - 1)
    answer = ask(client, do="act", observation=[0.0] * policy.observed)
    assert "send reset first" in answer["error"]
    ask(client, do="reset")
    for number in ("NaN", "Infinity", "-Infinity", "1e999", "1" + "0" * 400):
        body = ", ".join([number, *zeros])
        answer = sent(client, f'{{"do": "act", "observation": [{body}]}}'.encode())
        assert not answer["ok"], number


def test_a_message_that_is_too_large_ends_its_connection_and_nobody_elses(policy, connect):
    other, large = connect(), connect(zmq.DEALER)
    ask(other, do="reset")
    large.setsockopt(zmq.RCVTIMEO, 300)
    large.send(b"x" * (largest_request(policy.observed) + 1))
    with pytest.raises(zmq.Again):
        large.recv()
    assert ask(other, do="act", observation=[0.0] * policy.observed)["ok"]


def test_messages_of_several_frames_and_of_dealers_are_answered(connect):
    client = connect(zmq.DEALER)
    client.send(b'{"do": "info"}')
    assert json.loads(client.recv())["ok"]
    client.send_multipart([b"", b"{}", b"{}"])
    empty, answer = client.recv_multipart()
    assert (empty, "one frame" in json.loads(answer)["error"]) == (b"", True)


def test_a_client_that_floods_and_reads_nothing_keeps_nobody_from_answers(policy, connect):
    flooding, other = connect(zmq.DEALER), connect()
    for _ in range(3000):
        if flooding.poll(0, zmq.POLLOUT):
            flooding.send(b'{"do": "info"}')
    ask(other, do="reset")
    assert ask(other, do="act", observation=[0.0] * policy.observed)["ok"]


def test_bytes_that_are_no_zeromq_and_silent_connections_do_no_harm(server, policy, connect):
    port = int(server.endpoint.rpartition(":")[2])
    strangers = [socket.create_connection(("127.0.0.1", port)) for _ in range(20)]
    for each in strangers[:10]:
        each.sendall(b"GET / HTTP/1.1\r\n\r\n" * 10)
    client = connect()
    assert ask(client, do="reset")["ok"]
    for each in strangers:
        each.close()
    assert ask(client, do="act", observation=[0.0] * policy.observed)["ok"]


def test_clients_are_few_and_idle_ones_are_forgotten(policy):
    clients, reset = Clients(policy, most=2, idle=10), Request(do="reset")
    act = Request(do="act", observation=[0.0] * policy.observed)
    clients.answer(b"a", reset, 0)
    clients.answer(b"b", reset, 4)
    with pytest.raises(RequestError, match="2 clients already"):
        clients.answer(b"c", reset, 4.5)
    clients.answer(b"b", act, 8)
    clients.answer(b"d", Request(do="info"), 11)  # a was idle for more than 10 s
    with pytest.raises(RequestError, match="send reset first"):
        clients.answer(b"a", act, 11)
    clients.answer(b"c", reset, 11)
    clients.answer(b"c", Request(do="bye"), 12)  # and d never had an episode
    clients.answer(b"a", reset, 12)


def test_a_request_that_meets_a_bug_is_answered_and_the_server_lives(policy, connect, monkeypatch):
    def fails(self):
        raise ZeroDivisionError

    monkeypatch.setattr(ServedPolicy, "info", fails)
    client = connect()
    assert "ZeroDivisionError" in ask(client, do="info")["error"]
    assert ask(client, do="reset")["ok"]


def test_addresses_and_ports_that_are_none_are_refused(policy, server):
    port = int(server.endpoint.rpartition(":")[2])
    for address, at, said in (
        ("localhost; rm", 0, "no IPv4"),
        ("127.0.0.1", port, "cannot listen"),
    ):
        with pytest.raises(ConfigError, match=said):
            PolicyServer(policy, address, at)


def test_the_float_twin_is_served_too_and_what_does_not_spike_is_not():
    served = ServedPolicy(POLICY, "float").controller()
    served.reset(0)
    controller = load(POLICY).controller()
    row = [0.1] * controller.codec.encoder.observed
    assert served.act(row).tolist() == controller.act(row).tolist()
    with pytest.raises(ConfigError, match="no spiking policy"):
        ServedPolicy("hexapod/sac")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_end_the_command_at_once(number, code):
    words = ["serve", POLICY, "--port", "0"]
    process = subprocess.Popen(
        [sys.executable, "-m", "spikedeploy", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    with process, socket.socket() as client:
        try:
            line = process.stdout.readline()
            # an open connection is no reason to stay
            client.connect(("127.0.0.1", int(line.rpartition(":")[2])))
            process.send_signal(number)
            found = process.wait(PATIENCE)
        finally:
            process.kill()
    assert found in (code, -number)  # shells say 128 + the signal of both


def test_the_example_of_a_client_whose_reply_is_lost_connects_and_resets_again(capsys, monkeypatch):
    context, asked = zmq.Context(), []

    def answers():
        while asked.count("bye") == 0:
            client, empty, body = router.recv_multipart()
            asked.append(json.loads(body)["do"])
            lost = asked.count("act") == 1 and asked[-1] == "act"
            if not lost:
                router.send_multipart([client, empty, b'{"ok": true, "observations": 2}'])

    with context.socket(zmq.ROUTER) as router:
        router.linger, router.rcvtimeo = 1000, 1000 * int(PATIENCE)
        at = f"tcp://127.0.0.1:{router.bind_to_random_port('tcp://127.0.0.1')}"
        thread = threading.Thread(target=answers)
        thread.start()
        monkeypatch.setattr(sys, "argv", ["serve_client.py", at])
        left = runpy.run_path(str(ROOT / "examples" / "serve_client.py"))
        thread.join()
    left["socket"].context.term()
    context.term()
    assert asked == ["info", "reset", "act", "info", "reset", "act", "bye"]
    assert "connecting again" in capsys.readouterr().err
