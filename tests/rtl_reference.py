"""ODIN, tinyODIN and Spiker+ in plain Python, from the rules of their RTL, and runs of them.

It shares no line with the package: its runs are traces for what no recording here covers.
"""

from collections import deque
from itertools import pairwise

import numpy as np

ODIN = {"chip": "odin", "low": 0, "high": 255, "entries": 32, "weights": (-7, 7)}
TINYODIN = {"chip": "tinyodin", "low": -2048, "high": 2047, "entries": 128, "weights": (-8, 7)}


def odin_trace(kind, *, thr, leak, weights, inputs, rec=None, host="wait", order="index", **more):
    """A trace of a run: `more` may have start, disabled and rng, which shuffles the events."""
    n = len(thr)
    start, disabled = more.get("start", [0] * n), more.get("disabled", [0] * n)
    closed = rec is not None and host != "relays"
    v, queue = list(start), deque()
    events, v_event, s_event, dropped = [], [], [], []

    def work(t, name, index=None):
        for i in range(n):
            if name == "tref":
                v[i] = max(v[i] - leak[i], 0) if v[i] > 0 else min(v[i] + leak[i], 0)
            else:
                row = weights[index] if name == "axon" else rec[index]
                v[i] = min(max(v[i] + row[i], kind["low"]), kind["high"])
        fired = [i for i in range(n) if v[i] >= thr[i]]
        for i in fired:
            v[i] = 0
        seen = [i for i in fired if not disabled[i]]
        events.append([t, name] if name == "tref" else [t, name, index])
        v_event.append(list(v))
        s_event.append(seen)
        held, lost = (0 if name == "tref" else 1), []
        for i in seen if closed else []:
            if len(queue) + held < kind["entries"]:
                queue.append(("neuron", i))
            else:
                lost.append(i)
        if lost:
            dropped.append([len(events) - 1, lost])

    def turn(t):
        if queue:
            work(t, *queue.popleft())
        while host == "wait" and queue:
            work(t, *queue.popleft())

    v_end, s_end, late = [], [], [0] * n
    for t, row in enumerate(inputs):
        before = len(s_event)
        work(t, "tref")
        turn(t)
        sent = [m for m, count in enumerate(row) for _ in range(count)]
        if order == "random":
            more["rng"].shuffle(sent)
        for m in sent:
            queue.append(("axon", m))
            turn(t)
        if host == "relays":
            for i, count in enumerate(late):
                for _ in range(count):
                    work(t, "neuron", i)
        while host != "stream" and queue:
            work(t, *queue.popleft())
        if host == "stream" and t == len(inputs) - 1:
            while queue:
                work(t, *queue.popleft())
        late = [sum(i in s for s in s_event[before:]) for i in range(n)]
        v_end.append(list(v))
        s_end.append(late)
    return {
        "chip": kind["chip"],
        "source": "a plain Python model",
        "index": "[pre][post]",
        "params": {
            "thr": thr, "leak": leak, "start": start, "disabled": disabled, "reset": "zero",
            "closed_loop": closed, "host": host, "order": order,
        },
        "weights": weights, "input_spikes": inputs, "v": v_end, "s": s_end, "events": events,
        "v_event": v_event, "s_event": s_event, "weights_rec": rec, "dropped_by_full_fifo": dropped,
    }  # fmt: skip


def random_odin(kind, seed, *, size=10, width=8, steps=40, rate=0.3, thr=(5, 40), **more):
    """A trace of a random network; `most` spikes of an input, `loop` or "layers" on the chip."""
    rng = np.random.default_rng(seed)
    low, high = kind["weights"]
    low = more.pop("low", low)
    most, loop = more.pop("most", 1), more.pop("loop", False)
    inputs = rng.integers(1, most + 1, (steps, width)) * (rng.random((steps, width)) < rate)
    rec = rng.integers(-high, 3, (size, size))
    if loop == "layers":  # the first half onto the second: what spikes at once may be many
        rec = rng.integers(low, high + 1, (size, size))
        rec[:, : size // 2] = rec[size // 2 :] = 0
    made = {
        "thr": rng.integers(*thr, size).tolist() if isinstance(thr, tuple) else thr,
        "leak": rng.integers(0, 4, size).tolist(),
        "weights": rng.integers(low, high + 1, (width, size)).tolist(),
        "inputs": inputs.tolist(),
        "rec": rec.tolist() if loop else None,
        "rng": rng,
    }
    return odin_trace(kind, **{**made, **more})


def spiker_trace(layers, inputs):
    """A trace of layers: weights, weights_rec, threshold, shift, neuron_bits, reset and v_reset.

    fires = v > threshold; v = reset where it fires, else v - (v >> shift); then inputs, then
    neurons by index, saturating each; spikes leave in this timestep and are heard in the next.
    """
    states = [[0] * len(layer["threshold"]) for layer in layers]
    sent = [[0] * len(state) for state in states]
    for layer in layers:
        layer.update({"v": [], "v_begun": [], "s": []})
    for row in inputs:
        heard, sent = sent, []
        for k, layer in enumerate(layers):
            v, top = states[k], 2 ** (layer["neuron_bits"] - 1)
            fired = [x > limit for x, limit in zip(v, layer["threshold"], strict=True)]
            for i, fires in enumerate(fired):
                fixed = layer["reset"] == "fixed"
                after = layer["v_reset"][i] if fixed else v[i] - layer["threshold"][i]
                v[i] = after if fires else v[i] - v[i] // 2 ** layer["shift"]
            layer["v_begun"].append(list(v))
            arriving = [(layer["weights"], heard[k - 1] if k else row)]
            if "weights_rec" in layer:
                arriving.append((layer["weights_rec"], heard[k]))
            for weights, spikes in arriving:
                for m, count in enumerate(spikes):
                    for i in range(len(v)) if count else ():
                        v[i] = min(max(v[i] + weights[m][i], -top), top - 1)
            layer["v"].append(list(v))
            layer["s"].append([int(fires) for fires in fired])
            sent.append(layer["s"][-1])
    return {"chip": "spiker", "source": "a plain Python model", "index": "[pre][post]",
            "input_spikes": inputs, "layers": layers}  # fmt: skip


def random_spiker(seed, sizes, *, bits=16, weight=5, shift=3, reset="subtract", loop=False, **more):
    """A trace of a random network of layers of these sizes, the input first."""
    rng = np.random.default_rng(seed)
    half = 2 ** (weight - 1)
    layers = []
    for width, size in pairwise(sizes):
        layer = {
            "weights": rng.integers(-half, half, (width, size)).tolist(),
            "threshold": rng.integers(*more.get("threshold", (5, 40)), size).tolist(),
            "shift": shift, "neuron_bits": bits, "weight_bits": weight, "reset": reset,
        }  # fmt: skip
        if reset == "fixed":
            layer["v_reset"] = rng.integers(*more.get("v_reset", (0, 1)), size).tolist()
        if loop:
            layer["weights_rec"] = rng.integers(-half, half, (size, size)).tolist()
        layers.append(layer)
    rate = more.get("rate", 0.4)
    return spiker_trace(layers, (rng.random((60, sizes[0])) < rate).astype(int).tolist())
