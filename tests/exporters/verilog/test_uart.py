"""The UART link in simulation, by its pins: whatever the line does, each timestep is done once."""

import random
import subprocess

import pytest

from tests.board_designs import needs_simulation, scripts, write_design

LINK, PINS = scripts().link, scripts().pins
TOKENS, WORDS = 128, 64  # of a request, of a reply


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The design of a board around a core that counts, in Verilator."""
    folder = tmp_path_factory.mktemp("pins")
    write_design(folder, "icebreaker")
    words = "verilator --cc --exe --build -O2 -Wno-fatal -CFLAGS -O0 --prefix Vpins"
    sources = ["top.v", "uart.v", "link.v", "policy_core.v", "pins_main.cpp"]
    done = subprocess.run(
        [*words.split(), "--top-module", "top", *sources, "--Mdir", "obj", "-o", "../pins"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return folder / "pins"


@pytest.fixture
def port(program):
    """A port to the design, just configured."""
    opened = PINS.PinsPort(program, bit_times=8000)
    yield opened
    opened.close()


def steps_of(rng, count):
    return [[rng.randrange(0x8000) for _ in range(rng.randrange(20))] for _ in range(count)]


def expected(steps, done):
    return [[len(axons), sum(axons), done + k + 1] for k, axons in enumerate(steps)]


def noisy(rng, rate):
    """Bytes of a line on which each fault hits so many of them."""

    def through(symbols):
        found = []
        for symbol in symbols:
            kind = int(rng.random() / rate)
            if kind == 0:
                found.append(symbol ^ 1 << rng.randrange(8))
            elif kind == 1:  # lost
                continue
            elif kind == 2:
                found += [symbol, rng.randrange(256)]
            elif kind == 3:
                found.append(PINS.BROKEN | symbol)
            elif kind == 4:
                found += [PINS.GLITCH | rng.randrange(1, 40), symbol]
            elif kind == 5:
                found += [PINS.SILENCE | 255] * rng.randrange(30) + [symbol]
            else:
                found.append(symbol)
        return found

    return through


def test_the_checksum_is_the_one_that_it_is_named_after():
    assert LINK.crc(b"123456789") == 0x6F91  # CRC-16/MCRF4XX of Cook's catalogue
    body = bytes([3, 1, 4])
    assert LINK.crc(body + LINK.crc(body).to_bytes(2, "little")) == 0


@needs_simulation
def test_words_come_back_in_order_for_timesteps_of_any_size(port):
    rng, link = random.Random(1), LINK.Link(port, TOKENS, WORDS, 3)
    done = 0
    for count in (1, 2, 21, 22, 40):
        steps = steps_of(rng, count)
        assert link.infer(steps) == expected(steps, done)
        done += count
    large = [list(range(300)), []]  # more tokens than a request has
    assert link.infer(large) == expected(large, done)
    link.reset()
    assert link.infer([[5]]) == [[1, 5, 1]]
    assert link.repeated == 0


@needs_simulation
@pytest.mark.parametrize("rate", [0.0005, 0.002])
def test_each_timestep_is_done_once_whatever_becomes_of_bytes(port, rate):
    rng, link = random.Random(2), LINK.Link(port, TOKENS, WORDS, 3, tries=50)
    port.noise = noisy(rng, rate)
    done = 0
    for _ in range(40):
        steps = steps_of(rng, rng.randrange(1, 4))
        assert link.infer(steps) == expected(steps, done)
        done += len(steps)
    assert link.repeated > 0


@needs_simulation
def test_replies_that_are_damaged_are_asked_for_again_and_nothing_is_done_twice(port, monkeypatch):
    rng, link = random.Random(3), LINK.Link(port, TOKENS, WORDS, 3, tries=50)
    read = port.read

    def damaged(size):
        came = bytearray(read(size))
        for k in range(len(came)):
            if rng.random() < 0.02:
                came[k] ^= 1 << rng.randrange(8)
        return bytes(came)

    monkeypatch.setattr(port, "read", damaged)
    done = 0
    for _ in range(30):
        steps = steps_of(rng, 2)
        assert link.infer(steps) == expected(steps, done)
        done += 2
    assert link.repeated > 3


def restart(port, program):
    """Put a board that has just been configured behind an open port."""
    fresh = PINS.PinsPort(program)
    port._process, fresh._process = fresh._process, port._process
    fresh.close()


@needs_simulation
@pytest.mark.parametrize("before", [0, 7, 252, 253, 254, 255])  # 253: the next number is 0
def test_a_board_that_restarts_gives_no_words_of_forgotten_states(port, program, before):
    link = LINK.Link(port, TOKENS, WORDS, 3)
    for done in range(before):
        assert link.infer([[4]]) == [[1, 4, done + 1]]
    restart(port, program)
    for _ in range(3):  # whatever the number of the request
        with pytest.raises(LINK.LinkError, match=r"not answered 5 requests.*or has it restarted\?"):
            link.infer([[4]])
    with pytest.raises(LINK.LinkError, match="restarted"):
        link.reset()
    # who begins anew is answered
    link = LINK.Link(port, TOKENS, WORDS, 3)
    assert link.infer([[5], [6]]) == [[1, 5, 1], [1, 6, 2]]


@needs_simulation
@pytest.mark.parametrize("sequence", [0, 1, 200])
def test_requests_with_tokens_are_not_answered_before_an_empty_one(port, sequence):
    asks = LINK.request(sequence, [4, 0x8000])
    damaged = bytearray(LINK.request(9, []))
    damaged[-1] ^= 1  # no greeting
    for frame in (asks, damaged, asks):
        port.write(bytes(frame))
        assert port.read(1) == b""
    for number in (0, 100):
        port.write(LINK.request(number, []))
        assert port.read(5) == LINK.reply(number, [])
    asks = LINK.request(sequence ^ 1, [4, 0x8000])
    port.write(asks)
    assert port.read(17) == LINK.reply(sequence ^ 1, [1, 4, 1])


@needs_simulation
def test_more_or_fewer_words_than_the_policy_has_are_an_error(port):
    for words in (2, 4):
        link = LINK.Link(port, TOKENS, WORDS, words)
        with pytest.raises(LINK.LinkError, match=rf"6 words to 2 timesteps of {words} words each"):
            link.infer([[4], []])


@needs_simulation
def test_a_request_that_breaks_off_ends_by_itself(port):
    link = LINK.Link(port, TOKENS, WORDS, 3)
    # the next one is taken for its rest, and repeated
    port.write(LINK.request(77, [1, 2, 3])[:6])
    assert link.infer([[4]]) == [[1, 4, 1]]
    assert link.repeated == 1
    # behind a silence of 6 ms it is heard at once
    port.write(LINK.request(78, [1, 2, 3])[:6])
    port.read(1)
    assert link.infer([[4]]) == [[1, 4, 2]]
    assert link.repeated == 1


@needs_simulation
def test_a_request_with_a_wrong_checksum_or_length_reaches_no_core(port):
    link = LINK.Link(port, TOKENS, WORDS, 3)
    wrong = bytearray(LINK.request(99, [7, 0x8000]))
    wrong[3] ^= 1
    long = LINK.request(99, [7] * 200)
    for frame in (bytes(wrong), long):
        port.write(frame)
        assert port.read(1) == b""
    assert link.infer([[4]]) == [[1, 4, 1]]


@needs_simulation
def test_a_repeated_request_is_answered_and_not_done_again(port):
    link = LINK.Link(port, TOKENS, WORDS, 3)
    frame = LINK.request(200, [4, 5, 0x8000])
    for _ in range(3):
        port.write(frame)
        assert port.read(17) == LINK.reply(200, [2, 9, 1])
    assert link.infer([[4]]) == [[1, 4, 2]]


def test_a_reply_is_found_behind_bytes_that_are_none():
    frame = LINK.reply(5, [1, 2**32 - 1])
    received = bytearray(b"\x5a\x07\x5a" + LINK.reply(4, [9]) + frame[:4])
    assert LINK.find_reply(received, 5) == (None, len(frame) - 4)
    received += frame[4:]
    assert LINK.find_reply(received, 5) == ([1, 2**32 - 1], 0)
    assert not received


def test_a_board_that_is_silent_is_an_error_that_says_what_to_look_at():
    class Silent:
        timeout = None

        def write(self, data):
            return len(data)

        def read(self, size=1):
            return b""

    with pytest.raises(LINK.LinkError, match=r"has not answered 5 requests\. Is the bitstream on"):
        LINK.Link(Silent(), TOKENS, WORDS, 3)
