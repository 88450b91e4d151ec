"""The decoder in C: spikes and membranes that leave the chip to actions."""

from math import ldexp

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, narrowest, number
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.templates import template
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.compiler.program import ReadoutTerm
from spikedeploy.runtime.errors import ConfigError

Floats = NDArray[np.float64]

# of 1/16 each, up to where tanh is 1 within 1e-13
_STEPS = 240


class DecoderWriter:
    """Writes what becomes of that which leaves the chip.

    scores: numbers of the output, of which actions are made.
    """

    def __init__(self, plan: Plan, codec: Codec, out: Declarations) -> None:
        self.plan, self.codec, self.out = plan, codec, out
        self._layers = {layer.name: k for k, layer in enumerate(plan.program.layers)}
        for term in plan.terms:
            if term.layer not in self._layers:
                raise ConfigError(
                    f"--to c: the output receives {term.layer!r}, which is no layer of the chip."
                )
        self._places = self._first_scores()
        self.scores = len(self._bias())

    def gaps(self) -> dict[str, str]:
        """The functions of the decoder, and what a reset does to it."""
        terms = list(enumerate(self.plan.terms))
        for k, term in terms:
            self._declare(k, term)
        clear = [line for k, term in terms for line in self._clear(k, term)]
        return {
            "decoder": template("decode.c"),
            "scores": str(self.scores),
            "clear": _lines(clear),
            "add": _lines([line for k, term in terms for line in self._add(k, term)]),
            "weigh": _lines([line for k, term in terms for line in self._weigh(k, term)]),
            "act": _lines(self._act()),
            "score_start": self._start(),
            "squash_function": self._squash(),
            "decoder_reset": _lines([line for k, term in terms for line in self._forget(k, term)]),
        }

    def _squash(self) -> str:
        """The function tanh in C, where it is needed, with its table."""
        if self.codec.squash != "tanh":
            return ""
        table = [int(ldexp(value, 64)) for value in np.tanh(np.arange(_STEPS) / 16)]
        self.out.constant("tanh_of", np.array(table, np.uint64))
        return template("squash.c")

    def _first_scores(self) -> list[int]:
        """The first number of the output that each term adds to."""
        places, first = [], 0
        for outlet in self.plan.program.outlets:
            places += [first] * len(outlet.taps)
            first += outlet.port.size
        return places or [0]

    def _bias(self) -> Floats:
        program = self.plan.program
        if program.outlets:
            return np.concatenate([outlet.bias for outlet in program.outlets])
        if program.readout is None:
            return np.zeros(self.plan.sizes[program.output])
        return program.readout.bias

    def _silent(self, term: ReadoutTerm) -> bool:
        return not self.plan.program.layer(term.layer).spiking

    def _size(self, term: ReadoutTerm) -> int:
        return self.plan.sizes[term.layer]

    def _kind(self, term: ReadoutTerm) -> str:
        """The C type of what is added up."""
        if self._silent(term):
            return self.plan.kind if self.codec.timesteps == 1 else "int64_t"
        kind = narrowest(0, self.codec.timesteps * self.plan.times_max[term.layer])
        return kind if kind in ("uint8_t", "uint16_t") else "uint32_t"

    def _declare(self, k: int, term: ReadoutTerm) -> None:
        size = self._size(term)
        self.out.variable(f"total{k}", self._kind(term), size)
        if self._silent(term) and term.lag:
            self.out.variable(f"late{k}", "@prefix@_int_t", term.lag, size)
            self.out.variable(f"late{k}_at", "uint32_t")

    def _clear(self, k: int, term: ReadoutTerm) -> list[str]:
        zero = "0" if self._silent(term) else "0u"
        return [f"for (n = 0u; n < {self._size(term)}u; n++) {{", f"    total{k}[n] = {zero};", "}"]

    def _forget(self, k: int, term: ReadoutTerm) -> list[str]:
        if not (self._silent(term) and term.lag):
            return []
        return [
            "{",
            "    uint32_t n;",
            "    uint32_t t;",
            f"    late{k}_at = 0u;",
            f"    for (t = 0u; t < {term.lag}u; t++) {{",
            f"        for (n = 0u; n < {self._size(term)}u; n++) {{",
            f"            late{k}[t][n] = 0;",
            "        }",
            "    }",
            "}",
        ]

    def _add(self, k: int, term: ReadoutTerm) -> list[str]:
        silent, size, kind = self._silent(term), self._size(term), self._kind(term)
        late = 0 if silent else term.lag
        lines = [f"@prefix@_net_layer({self._layers[term.layer]}u, {late}u, &view);"]
        if not silent:
            times = "view.times[n]" if self.plan.times_max[term.layer] > 1 else "1u"
            total = f"total{k}[view.id[n]]"
            added = f"{total} = ({kind})({total} + {times});"
            return [*lines, "for (n = 0u; n < view.count; n++) {", f"    {added}", "}"]
        lines.append(f"for (n = 0u; n < {size}u; n++) {{")
        if not term.lag:
            return [*lines, f"    total{k}[n] += view.membrane[n];", "}"]
        row = f"late{k}[late{k}_at][n]"
        lines += [f"    total{k}[n] += {row};", f"    {row} = view.membrane[n];", "}"]
        return [*lines, f"late{k}_at = (late{k}_at + 1u) % {term.lag}u;"]

    def _weigh(self, k: int, term: ReadoutTerm) -> list[str]:
        """C that adds what a term has added up to the scores, times its weights."""
        size, first = self._size(term), self._places[k]
        weight = np.eye(size) if term.weight is None else term.weight
        if self._silent(term):
            scale = np.broadcast_to(self.plan.program.layer(term.layer).scale, (size,))
            weight = scale[:, None] * weight
        if weight.shape[0] == weight.shape[1] and not (weight - np.diag(np.diag(weight))).any():
            return self._diagonal(k, np.diag(weight), first)
        rows, columns = np.nonzero(weight)
        out, starts = self.out, np.searchsorted(rows, np.arange(size + 1))
        start, target = (
            out.constant(f"read{k}_first", starts),
            out.constant(f"read{k}_score", columns + first),
        )
        value = out.constant(f"read{k}_weight", weight[rows, columns])
        return [
            f"for (n = 0u; n < {size}u; n++) {{",
            f"    if (total{k}[n] != 0) {{",
            f"        const double total = (double)total{k}[n];",
            f"        for (a = {start}[n]; a < {start}[n + 1u]; a++) {{",
            f"            score[{target}[a]] += total * {value}[a];",
            "        }",
            "    }",
            "}",
        ]

    def _diagonal(self, k: int, weight: Floats, first: int) -> list[str]:
        """The same where each neuron has a score of its own."""
        if (weight == weight[0]).all():
            factor = number(float(weight[0]))
        else:
            factor = f"{self.out.constant(f'read{k}_weight', weight)}[n]"
        times = "" if factor == "1.0" else f" * {factor}"
        place = f"n + {first}u" if first else "n"
        value = f"(double)total{k}[n]{times}"
        return [f"for (n = 0u; n < {len(weight)}u; n++) {{", f"    score[{place}] += {value};", "}"]

    def _start(self) -> str:
        """C for what a score begins with: its bias in every timestep."""
        bias = self._bias() * self.codec.timesteps
        if (bias == bias[0]).all():
            return number(float(bias[0]))
        return f"{self.out.constant('bias', bias)}[a]"

    def _act(self) -> list[str]:
        """C from scores to actions."""
        timesteps = self.codec.timesteps
        value = "score[a]" if timesteps == 1 else f"score[a] / {number(float(timesteps))}"
        loop = f"for (a = 0u; a < {self.scores}u; a++) {{"
        if self.codec.chooses:
            return [
                loop,
                f"    score[a] = {value};",
                "}",
                "action[0] = 0;",
                f"for (a = 1u; a < {self.scores}u; a++) {{",
                "    if (score[a] > score[action[0]]) {",
                "        action[0] = (int32_t)a;",
                "    }",
                "}",
            ]
        squashed = f"squash({value})" if self.codec.squash == "tanh" else value
        return [loop, f"    action[a] = {squashed};", "}"]


def _lines(lines: list[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)
