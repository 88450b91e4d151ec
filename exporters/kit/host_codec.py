"""Encoder and decoder of a policy on its host; NumPy only.

They compute in float64 as the emulator does, so that actions are equal to the last bit.
"""

import numpy as np

_PARTS, _LARGEST = 256, 2.0**30  # of the delta code: parts of a step; most of them
_LEVELS = 256  # of the rate code


class Encoder:
    """Observations to input spikes.

    codec: the record in program.json or policy.json.
    """

    def __init__(self, codec):
        self._normaliser = {name: np.array(each) for name, each in codec["normaliser"].items()}
        self._encoder = codec["encoder"]
        self._timesteps = codec["timesteps"]
        self._observed = len(self._normaliser["mean"])
        self._kind = getattr(self, f"_{self._encoder['kind']}")
        self.reset()

    def reset(self, seed=0):
        """Begin an episode; seed: of what is random."""
        self._sent = np.zeros(self._observed, np.int64)
        self._random = _first_states(seed, self._observed)

    def __call__(self, observation):
        """Spikes (T, M) of an observation (obs,)."""
        seen = np.asarray(observation, np.float64)
        if seen.shape != (self._observed,) or not np.isfinite(seen).all():
            raise ValueError(f"an observation has {self._observed} finite numbers")
        with np.errstate(over="ignore"):
            x = (seen - self._normaliser["mean"]) / self._normaliser["std"]
            clip = self._normaliser["clip"]
            x = np.maximum(np.minimum(x, clip), -clip)
        return self._kind(x).reshape(self._timesteps, -1).astype(np.int64)

    def _delta(self, x):
        """Return signed events of observations that moved since their last event."""
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

    def _population(self, x):
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

    def _rate(self, x):
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

    def _events(self, x):
        """Return counts of events, as channels or spread over timesteps."""
        most, code = self._encoder["most"], self._encoder["code"]
        n = np.minimum(np.maximum(np.floor(x), 0), most).astype(np.int64)
        if code == "spread":
            return (n > np.arange(self._timesteps)[:, None]).astype(np.int64)
        grouped = n.reshape(self._encoder["polarities"], 1, -1) >= np.arange(1, most + 1)[:, None]
        rows = np.zeros((self._timesteps, grouped.size), np.int64)
        rows[0] = grouped.ravel()
        return rows


def _first_states(seed, width):
    """States (M,) of the random numbers of a seed."""

    def mix(x):
        x = (x ^ (x >> np.uint32(16))) * np.uint32(0x85EBCA6B)
        x = (x ^ (x >> np.uint32(13))) * np.uint32(0xC2B2AE35)
        return x ^ (x >> np.uint32(16))

    low, high = np.array([[seed % 2**32], [seed // 2**32 % 2**32]], np.uint32)
    begun = mix(mix(low + np.uint32(0x9E3779B9)) + high)
    return np.maximum(mix(begun + np.arange(width, dtype=np.uint32)), np.uint32(1))


def _next_states(x):
    """The random numbers after a timestep: xorshift32."""
    x = x ^ (x << np.uint32(13))
    x = x ^ (x >> np.uint32(17))
    return x ^ (x << np.uint32(5))


class Decoder:
    """Map the output of a chip to actions.

    record: with codec, bias and terms of the outputs.
    """

    def __init__(self, record):
        self._codec, self._plain = record["codec"], record["plain"]
        self._bias, self._terms = np.array(record["bias"]), []
        for term in record["terms"]:
            weight = None if term["weight"] is None else np.array(term["weight"])
            self._terms.append({**term, "weight": weight, "scale": np.array(term["scale"])})
        self.reset()

    def reset(self):
        """Forget what is still to arrive."""
        sizes = [t["size"] if t["weight"] is None else len(t["weight"]) for t in self._terms]
        self._late = [
            np.zeros((term["lag"], 1, size)) for term, size in zip(self._terms, sizes, strict=True)
        ]

    def __call__(self, values):
        """Return the action for each term's layer output (T, N) in an inference."""
        count = len(values[0])
        output = np.empty((count, 1, len(self._bias)))
        output[...] = self._bias
        for k, (term, rows) in enumerate(zip(self._terms, values, strict=True)):
            rows = rows[:, None, :] * term["scale"] if term["scale"].size else rows[:, None, :]
            rows = np.concatenate([self._late[k], rows.astype(np.float64)])
            self._late[k], rows = rows[count:], rows[:count]
            if self._plain and term["weight"] is not None:
                # as the emulator's host does it where spikes of one layer alone leave
                flat = rows.reshape(-1, len(term["weight"])).dot(term["weight"]) + self._bias
                output = flat.reshape(count, 1, -1)
            elif self._plain:
                output = rows
            else:
                total = output[..., term["first"] : term["first"] + term["size"]]
                total += rows if term["weight"] is None else rows @ term["weight"]
        if self._codec.get("score", "mean") == "last":
            scores = output[-1]
        else:
            scores = np.add.reduce(output.swapaxes(0, 1), axis=1) / count
        if self._codec["squash"] == "argmax":
            return np.int64(scores.argmax(axis=1)[0])
        return (np.tanh(scores) if self._codec["squash"] == "tanh" else scores)[0]
