"""Host of the policy on the board: observations in, actions out; NumPy and pyserial.

    python3 host.py PORT      replay episode.json on the board, and compare the actions

    from host import open_board
    policy = open_board("/dev/ttyUSB1")
    policy.reset()                        # where an episode begins
    action = policy.act(observation)      # in each control step

link.py, policy.json and episode.json stand beside this file. The host encodes and decodes in
float64 as the emulator does, so that actions are equal to the last bit.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

try:
    import numpy as np
except ModuleNotFoundError:
    sys.exit("host.py needs NumPy: pip install numpy")
from link import Link, LinkError, Port

HERE = Path(__file__).resolve().parent
_PARTS, _LARGEST = 256, 2.0**30  # of the delta code: parts of a step; most of them
_LEVELS = 256  # of the rate code

Floats = np.ndarray[Any, np.dtype[np.float64]]
Rows = np.ndarray[Any, np.dtype[np.int64]]


class Encoder:
    """Observations to input spikes.

    codec: the record in policy.json.
    """

    def __init__(self, codec: dict[str, Any]) -> None:
        self._normaliser = {name: np.array(each) for name, each in codec["normaliser"].items()}
        self._encoder: dict[str, Any] = codec["encoder"]
        self._timesteps: int = codec["timesteps"]
        self._observed = len(self._normaliser["mean"])
        self._kind = getattr(self, f"_{self._encoder['kind']}")
        self.reset()

    def reset(self, seed: int = 0) -> None:
        """Begin an episode; seed: of what is random."""
        self._sent = np.zeros(self._observed, np.int64)
        self._random = _first_states(seed, self._observed)

    def __call__(self, observation: Sequence[float]) -> Rows:
        """Spikes (T, M) of an observation (obs,)."""
        seen = np.asarray(observation, np.float64)
        if seen.shape != (self._observed,) or not np.isfinite(seen).all():
            raise ValueError(f"an observation has {self._observed} finite numbers")
        with np.errstate(over="ignore"):
            x = (seen - self._normaliser["mean"]) / self._normaliser["std"]
            clip = self._normaliser["clip"]
            x = np.maximum(np.minimum(x, clip), -clip)
        rows: Rows = self._kind(x).reshape(self._timesteps, -1).astype(np.int64)
        return rows

    def _delta(self, x: Floats) -> Rows:
        """Signed events of what has moved since the last event."""
        step = np.array([np.inf if s is None else s for s in self._encoder["step"]])
        most, threshold = self._encoder["most"], self._encoder["threshold"]
        with np.errstate(over="ignore"):
            parts = x / step * _PARTS
        parts = np.rint(np.maximum(np.minimum(parts, _LARGEST), -_LARGEST)).astype(np.int64)
        k, rows = np.arange(1, most + 1), []
        for _ in range(self._timesteps):
            apart = parts - _PARTS * self._sent
            n = np.minimum((np.abs(apart) + _PARTS // 2) >> 8, most)
            n = np.where(np.abs(apart) > threshold, np.sign(apart) * n, 0)
            signed = (n[:, None] * np.array([1, -1]))[:, :, None]
            rows.append(signed >= k if self._encoder["code"] == "unary" else signed == k)
            self._sent = self._sent + n
        return np.array(rows)

    def _population(self, x: Floats) -> Rows:
        """Integrate-and-fire neurons with Gaussian receptive fields."""
        mean, std = np.array(self._encoder["mean"]), np.array(self._encoder["std"])
        drive = (x[:, None] - mean) / std
        drive *= drive
        drive *= -0.5
        drive = np.exp(drive)
        membrane, threshold, rows = drive.copy(), self._encoder["threshold"], []
        for t in range(self._timesteps):
            if t:
                membrane -= threshold * rows[-1]
                membrane += drive
            rows.append(membrane > threshold)
        return np.array(rows)

    def _rate(self, x: Floats) -> Rows:
        """Carries of an 8-bit accumulator that starts at 128; or a random byte below the rate."""
        low, high = np.array(self._encoder["low"]), np.array(self._encoder["high"])
        share = np.minimum(np.maximum((x - low) / (high - low), 0), 1)
        n = np.rint(share * _LEVELS).astype(np.int64)
        rows = []
        for t in range(self._timesteps):
            if self._encoder["mode"] == "regular":
                rows.append((n * (t + 1) + 128) // _LEVELS - (n * t + 128) // _LEVELS)
            else:
                self._random = _next_states(self._random)
                rows.append((self._random >> np.uint32(24)) < n)
        return np.array(rows)

    def _events(self, x: Floats) -> Rows:
        """Counts of events, of channels or spread over timesteps."""
        most, code = self._encoder["most"], self._encoder["code"]
        n = np.minimum(np.maximum(np.floor(x), 0), most).astype(np.int64)
        if code == "spread":
            return (n > np.arange(self._timesteps)[:, None]).astype(np.int64)
        grouped = n.reshape(self._encoder["polarities"], 1, -1) >= np.arange(1, most + 1)[:, None]
        rows = np.zeros((self._timesteps, grouped.size), np.int64)
        rows[0] = grouped.ravel()
        return rows


def _first_states(seed: int, width: int) -> Any:  # noqa: ANN401
    """States (M,) of the random numbers of a seed."""

    def mix(x: Any) -> Any:  # noqa: ANN401
        x = (x ^ (x >> np.uint32(16))) * np.uint32(0x85EBCA6B)
        x = (x ^ (x >> np.uint32(13))) * np.uint32(0xC2B2AE35)
        return x ^ (x >> np.uint32(16))

    low, high = np.array([[seed % 2**32], [seed // 2**32 % 2**32]], np.uint32)
    begun = mix(mix(low + np.uint32(0x9E3779B9)) + high)
    return np.maximum(mix(begun + np.arange(width, dtype=np.uint32)), np.uint32(1))


def _next_states(x: Any) -> Any:  # noqa: ANN401
    """The random numbers after a timestep: xorshift32."""
    x = x ^ (x << np.uint32(13))
    x = x ^ (x >> np.uint32(17))
    return x ^ (x << np.uint32(5))


class Decoder:
    """What leaves the core to actions.

    record: policy.json.
    """

    def __init__(self, record: dict[str, Any]) -> None:
        self._codec, self._outputs = record["codec"], record["outputs"]
        self._bias, self._terms = np.array(record["bias"]), record["terms"]
        self._plain: bool = record["plain"]
        for term in self._terms:
            term["weight"] = None if term["weight"] is None else np.array(term["weight"])
            term["scale"] = np.array(term["scale"])
        self.reset()

    def reset(self) -> None:
        """Forget what is still to arrive."""
        sizes = {output["layer"]: output["neurons"] for output in self._outputs}
        self._late = [np.zeros((term["lag"], 1, sizes[term["layer"]])) for term in self._terms]

    def __call__(self, words: Sequence[Sequence[int]]) -> Any:  # noqa: ANN401
        """The action of the words of the timesteps of an inference."""
        values = self._values(np.array(words, np.uint32))
        output = np.empty((len(words), 1, len(self._bias)))
        output[...] = self._bias
        for k, term in enumerate(self._terms):
            rows = values[term["layer"]]
            if term["scale"].size:
                rows = rows * term["scale"]
            rows = np.concatenate([self._late[k], rows.astype(np.float64)])
            self._late[k], rows = rows[len(words) :], rows[: len(words)]
            if self._plain and term["weight"] is not None:
                # as the emulator's host does it where spikes of one layer alone leave
                flat = rows.reshape(-1, len(term["weight"])).dot(term["weight"]) + self._bias
                output = flat.reshape(len(words), 1, -1)
            elif self._plain:
                output = rows
            else:
                total = output[..., term["first"] : term["first"] + term["size"]]
                total += rows if term["weight"] is None else rows @ term["weight"]
        if self._codec.get("score", "mean") == "last":
            scores = output[-1]
        else:
            scores = np.add.reduce(output.swapaxes(0, 1), axis=1) / len(words)
        if self._codec["squash"] == "argmax":
            return np.int64(scores.argmax(axis=1)[0])
        return (np.tanh(scores) if self._codec["squash"] == "tanh" else scores)[0]

    def _values(self, words: Any) -> dict[str, Any]:  # noqa: ANN401
        """Membranes or spikes (T, 1, N) by layer, of the words (T, words)."""
        found, at = {}, 0
        for output in self._outputs:
            count, neurons = output["words"], output["neurons"]
            part = np.ascontiguousarray(words[:, at : at + count]).astype("<u4")
            if output["silent"]:
                rows = part.view("<i4").astype(np.int64)
            else:
                rows = np.unpackbits(part.view(np.uint8), axis=1, bitorder="little")[:, :neurons]
            found[output["layer"]], at = rows[:, None, :], at + count
        return found


class Policy:
    """The policy: encoder and decoder here, the network on the board.

    link: to the board.
    record: policy.json.
    """

    def __init__(self, link: Link, record: dict[str, Any]) -> None:
        self.link, self._resets = link, record["state"] == "reset"
        self._encode, self._decode = Encoder(record["codec"]), Decoder(record)

    def reset(self, seed: int = 0) -> None:
        """Begin an episode; seed: of an encoder that is random."""
        self._encode.reset(seed)
        self._decode.reset()
        self.link.reset()

    def act(self, observation: Sequence[float]) -> Any:  # noqa: ANN401
        """The action for an observation.

        LinkError where the board does not answer, as after a restart, or not so many words.
        """
        rows = self._encode(observation)
        if self._resets:
            self._decode.reset()
        spikes = [np.flatnonzero(row).tolist() for row in rows]
        return self._decode(self.link.infer(spikes, forget=self._resets))


def read(name: str) -> Any:  # noqa: ANN401
    """The contents of a file of the export."""
    try:
        return json.loads((HERE / name).read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise SystemExit(f"{name} cannot be read ({error}); export the policy again") from error


def open_policy(port: Port) -> Policy:
    """The policy on the board at an open port."""
    record = read("policy.json")
    sizes = record["link"]
    return Policy(Link(port, sizes["tokens"], sizes["words"], sizes["timestep"]), record)


def open_board(port: str, baud: int | None = None) -> Policy:
    """The policy on the board at a port such as /dev/ttyUSB1; baud: of the design on it."""
    try:
        import serial
    except ImportError as error:
        raise SystemExit("pyserial is not installed: pip install pyserial") from error
    try:
        opened = serial.Serial(port, baud or read("policy.json")["link"]["baud"])
    except (OSError, ValueError) as error:
        raise SystemExit(f"{port} cannot be opened: {error}") from error
    # USB converters collect bytes for 16 ms otherwise; not all systems let a program say so
    with suppress(AttributeError, NotImplementedError, OSError, ValueError):
        opened.set_low_latency_mode(True)
    return open_policy(opened)


def replay(policy: Policy, steps: int | None = None) -> int:
    """Replay episode.json on the board; 0 where all actions are equal to the last bit."""
    episode = read("episode.json")
    observations, expected = (np.array(episode[name]) for name in ("observation", "action"))
    count = min(steps or len(expected), len(expected))
    policy.reset(episode["seed"])
    taken = []
    for step in range(count):
        begun = time.perf_counter()
        action = policy.act(observations[step])
        taken.append(time.perf_counter() - begun)
        if not np.array_equal(np.asarray(action), expected[step]):
            print(f"differs: control step {step}: expected {expected[step]}, found {action}")
            return 1
    print(
        f"equal: {count} actions; {1e3 * float(np.mean(taken)):.2f} ms a control step, at most "
        f"{1e3 * max(taken):.2f} ms; {policy.link.repeated} requests repeated"
    )
    return 0


def main() -> int:
    """Replay the episode on the board at a port; the exit code."""
    parser = argparse.ArgumentParser(description="Compare the board with the emulator's actions.")
    parser.add_argument("port", help="of the board, such as /dev/ttyUSB1 or COM4")
    parser.add_argument("--baud", type=int, help="where the design was built with another")
    parser.add_argument("--steps", type=int, help="control steps; all of episode.json without it")
    arguments = parser.parse_args()
    try:
        return replay(open_board(arguments.port, arguments.baud), arguments.steps)
    except LinkError as error:
        raise SystemExit(str(error)) from error


if __name__ == "__main__":
    sys.exit(main())
