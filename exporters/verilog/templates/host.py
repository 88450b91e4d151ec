"""Host of the policy on the board: observations in, actions out; NumPy and pyserial.

    python3 host.py PORT      replay episode.json on the board, and compare the actions

    from host import open_board
    policy = open_board("/dev/ttyUSB1")
    policy.reset()                        # where an episode begins
    action = policy.act(observation)      # in each control step

link.py, host_codec.py, policy.json and episode.json stand beside this file. Actions are equal to
the emulator's to the last bit.
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
from host_codec import Decoder, Encoder
from link import Link, LinkError, Port

HERE = Path(__file__).resolve().parent


class Policy:
    """The policy: encoder and decoder here, the network on the board.

    link: to the board.
    record: policy.json.
    """

    def __init__(self, link: Link, record: dict[str, Any]) -> None:
        self.link, self._resets = link, record["state"] == "reset"
        self._encode, self._decode = Encoder(record["codec"]), Decoder(record)
        self._outputs, self._terms = record["outputs"], record["terms"]

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
        values = self._values(np.array(self.link.infer(spikes, forget=self._resets), np.uint32))
        return self._decode([values[term["layer"]] for term in self._terms])

    def _values(self, words: Any) -> dict[str, Any]:  # noqa: ANN401
        """Membranes or spikes (T, N) by layer, of the words (T, words)."""
        found, at = {}, 0
        for output in self._outputs:
            count, neurons = output["words"], output["neurons"]
            part = np.ascontiguousarray(words[:, at : at + count]).astype("<u4")
            if output["silent"]:
                rows = part.view("<i4").astype(np.int64)
            else:
                rows = np.unpackbits(part.view(np.uint8), axis=1, bitorder="little")[:, :neurons]
            found[output["layer"]], at = rows, at + count
        return found


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
