"""Plan of a program as C: names, types, magnitudes, spikes that are kept; and refusals."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import bytes_of, narrowest
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.population import MAX_TABLE_TIMESTEPS, PopulationEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.program import Program, ReadoutTerm
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters
from spikedeploy.runtime.families.integrate_and_fire.arithmetic import IntegrateAndFire
from spikedeploy.runtime.families.integrate_and_fire.neurons import IntegrateAndFireRules

_INT32 = 2**31 - 1
# room for a product with a decay factor, and for one more addition
_INT64 = 2**62


@dataclass(frozen=True)
class Magnitudes:
    """Largest magnitudes of a layer, whatever the spikes.

    arriving: of any partial sum of the weights, the bias included [units of the sums].
    states: of any number in the update [state units].
    registers: of what reaches each register of CuBa-LIF neurons before it is held, by its name
        [state units]; empty for other neurons.
    """

    arriving: int
    states: int
    registers: Mapping[str, int]

    @property
    def kind(self) -> str:
        """The C type that holds all of them."""
        return "int32_t" if max(self.arriving, self.states) <= _INT32 else "int64_t"


def sum_weights(layer: Layer, times_max: Mapping[str, int]) -> int:
    """Largest magnitude of a sum of weights of a timestep, in any order.

    times_max: spikes of a neuron of each source in a timestep.
    """
    total: NDArray[np.int64] = np.abs(layer.bias.astype(np.int64))
    for synapses in layer.synapses:
        weight = np.abs(synapses.weight.astype(np.int64))
        total = total + weight.sum(axis=0) * times_max[synapses.source]
    return int(total.max(initial=0))


def bound_cuba(
    layer: Layer, registers: CubaRegisters, weights: int, timesteps: int | None
) -> Magnitudes:
    """Magnitudes of CuBa-LIF neurons.

    weights: the sum of `sum_weights`.
    timesteps: T where states are reset after each inference; None where they are kept.
    """
    one = registers.decay_one
    summed = weights << registers.mantissa_shift
    drive = _hold(registers.accumulator, summed)
    keeps = int(layer.current_decay.max(initial=0)), int(layer.membrane_decay.max(initial=0))
    current = _bound_state(layer, registers.current, drive, keeps[0] / one, timesteps)
    pushed = current + int(np.abs(layer.voltage_bias).max(initial=0))
    push = _hold(registers.push, pushed)
    membrane = _bound_state(layer, registers.membrane, push, keeps[1] / one, timesteps)
    threshold = int(layer.threshold.max(initial=0)) if layer.spiking else 0
    states = max(summed, current + drive, pushed, membrane + push, membrane + threshold)
    if max(states, (membrane + current) * one) > _INT64:
        raise _unbounded(layer)
    reached = {
        "accumulator": summed,
        "current": _bound_before(drive, keeps[0] / one, current),
        "push": pushed,
        "membrane": _bound_before(push, keeps[1] / one, membrane),
    }
    return Magnitudes(weights, states, reached)


def bound_integrate(layer: Layer, rules: IntegrateAndFireRules, weights: int) -> Magnitudes:
    """Magnitudes of integrate-and-fire neurons; weights: the sum of `sum_weights`."""
    weights += int(np.abs(layer.voltage_bias).max(initial=0))
    held = _bound(rules.membrane)
    if held is None:
        raise _unbounded(layer)
    leak = int(layer.membrane_decay.max(initial=0)) if rules.leak != "shift" else 0
    threshold = int(layer.threshold.max(initial=0)) if layer.spiking else 0
    return Magnitudes(weights, max(held, threshold) + weights + leak + threshold, {})


def _bound(register: Register) -> int | None:
    """Largest magnitude that a register lets pass; None where it lets all pass, or wraps once."""
    if register.between is not None:
        return max(map(abs, register.between))
    half = 1 << (register.bits - 1)
    return None if register.overflow in ("none", "wrap-once") else half


def _hold(register: Register, before: int) -> int:
    """Largest magnitude after a register that gets at most `before`."""
    half = 1 << (register.bits - 1)
    if register.overflow == "wrap-once" and register.between is None and before > half:
        return max(half, before - 2 * half)
    bound = _bound(register)
    return before if bound is None else min(before, bound)


def _bound_state(
    layer: Layer, register: Register, added: int, keeps: float, timesteps: int | None
) -> int:
    """Largest magnitude of a state that keeps this part of itself, and gets `added`."""
    bound, half = _bound(register), 1 << (register.bits - 1)
    if bound is not None:
        return bound
    if register.overflow == "wrap-once" and added <= 2 * half:
        return half
    reached = [added / (1 - keeps)] if keeps < 1 else []
    reached += [float(added) * timesteps] if timesteps is not None else []
    if not reached:
        raise _unbounded(layer)
    return int(min(reached)) + 1


def _bound_before(added: int, keeps: float, state: int) -> int:
    """Largest magnitude that a state reaches before its register holds it.

    added: to what is left of it; state: its largest magnitude as held.
    """
    # rounded toward zero, what is left is no more than its part, so that the sum of the geometric
    # series bounds the state even if nothing holds it
    free = int(added / (1 - keeps)) + 1 if keeps < 1 else state + added
    return min(free, state + added)


def _unbounded(layer: Layer) -> ConfigError:
    return ConfigError(
        f"--to c: layer {layer.name!r}: nothing bounds its states to 62 bits, so that integers of "
        "C could overflow. Choose registers that saturate or wrap, or another model of the chip."
    )


@dataclass(frozen=True, eq=False)
class Plan:
    """A program and its codec, with the answers that several files of C need.

    codec: None where the chip's part alone is written.
    """

    program: Program
    codec: Codec | None

    @cached_property
    def names(self) -> dict[str, str]:
        """The name in C of the input and of each layer."""
        layers = {layer.name: f"l{k}" for k, layer in enumerate(self.program.layers)}
        return {self.program.input: "in", **layers}

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Channels of the input, neurons of each layer."""
        layers = {layer.name: layer.size for layer in self.program.layers}
        return {self.program.input: self.program.width, **layers}

    @cached_property
    def times_max(self) -> dict[str, int]:
        """Spikes of a neuron in a timestep, of the input and each layer."""
        chip = self.program.chip
        layers = dict.fromkeys((layer.name for layer in self.program.layers), chip.spikes_max)
        return {self.program.input: chip.input_spikes_max if not self.codec else 1, **layers}

    def several(self, source: str) -> bool:
        """Return True if a neuron of a source can spike several times in a timestep."""
        return self.times_max[source] > 1

    @property
    def events_max(self) -> int:
        """Input channels that can spike in one timestep."""
        encoder = self.codec.encoder if self.codec else None
        if isinstance(encoder, DeltaEncoder):
            each = encoder.most if encoder.code == "unary" else 1
            return each * encoder.observed
        return self.program.width

    @cached_property
    def slots(self) -> dict[str, int]:
        """Timesteps of which the spikes are kept: as late as they are read, and the present."""
        latest = dict.fromkeys(self.names, 0)
        for layer, lags in zip(self.program.layers, self.program.lags, strict=True):
            for synapses, lag in zip(layer.synapses, lags, strict=True):
                latest[synapses.source] = max(latest[synapses.source], lag)
        for term in self.terms:
            if self.is_spiking(term):
                latest[term.layer] = max(latest[term.layer], term.lag)
        return {name: lag + 1 for name, lag in latest.items()}

    @property
    def terms(self) -> tuple[ReadoutTerm, ...]:
        """All that the host receives, of one Output after another."""
        return self.program.taps

    @cached_property
    def bias(self) -> NDArray[np.float64]:
        """(scores,) bias of the output in every timestep."""
        return np.concatenate([outlet.bias for outlet in self.program.ways_out])

    @cached_property
    def score_weights(self) -> list[tuple[int, NDArray[np.float64]]]:
        """Of each term: the first score that it adds to, and its weights (N, its scores)."""
        firsts, first = [], 0
        for outlet in self.program.ways_out:
            firsts += [first] * len(outlet.taps)
            first += len(outlet.bias)
        return [(at, self._weights(term)) for at, term in zip(firsts, self.terms, strict=True)]

    def _weights(self, term: ReadoutTerm) -> NDArray[np.float64]:
        size = self.sizes[term.layer]
        weight = np.eye(size) if term.weight is None else term.weight
        if self.is_spiking(term):
            return weight
        scale = np.broadcast_to(self.program.layer(term.layer).scale, (size,))
        return np.asarray(scale[:, None] * weight)

    def is_spiking(self, term: ReadoutTerm) -> bool:
        """True where the host receives spikes of a layer, and not its membranes."""
        return term.layer == self.program.input or self.program.layer(term.layer).spiking

    def slot(self, name: str, lag: int = 0) -> str:
        """C for the index of the spikes of a source some timesteps ago."""
        slots, of = self.slots[name], self.names[name]
        if slots == 1:
            return "0"
        return f"({of}_head + {slots - lag}u) % {slots}u" if lag else f"{of}_head"

    @cached_property
    def kind(self) -> str:
        """The C type of all states and sums."""
        return max((each.kind for each in self.magnitudes.values()), key=bytes_of)

    @property
    def id_kind(self) -> str:
        """The C type of the number of a channel or neuron."""
        return narrowest(0, max(self.sizes.values()) - 1)

    def count_kind(self, name: str) -> str:
        """The C type of the number of a source's channels that spike."""
        return narrowest(0, self.capacity(name))

    def capacity(self, name: str) -> int:
        """Channels or neurons of a source that can spike in one timestep."""
        return self.events_max if name == self.program.input else self.sizes[name]

    @property
    def largest(self) -> int:
        """Largest magnitude of a state of any layer [state units]."""
        return max(each.states for each in self.magnitudes.values())

    def states_max(self, name: str) -> int:
        """Largest magnitude of a state of a layer, whatever the spikes [state units]."""
        return self.magnitudes[name].states

    @cached_property
    def magnitudes(self) -> dict[str, Magnitudes]:
        """Largest magnitudes of each layer, by its name."""
        return {layer.name: self._bound(layer) for layer in self.program.layers}

    def _bound(self, layer: Layer) -> Magnitudes:
        arithmetic = self.program.chip.arithmetic
        weights = sum_weights(layer, self.times_max)
        if isinstance(arithmetic, IntegrateAndFire):
            return bound_integrate(layer, arithmetic, weights)
        if not isinstance(arithmetic, CubaFixedPoint):
            raise TypeError(type(arithmetic).__name__)
        return bound_cuba(layer, arithmetic, weights, self._window)

    @property
    def _window(self) -> int | None:
        """Timesteps after which all states are reset; None where they are kept."""
        reset = self.program.convention.state == "reset"
        return self.codec.timesteps if self.codec and reset else None


_PREFIX = re.compile(r"[a-z][a-z0-9_]{0,30}")
# what PREFIX.h, PREFIX.c and libPREFIX.so, which `make lib` writes, would stand in the place of;
# of headers those of C99 to C23 and of POSIX, and what these include
_TAKEN = {
    "a header of C or its systems": """
        assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal
        stdalign stdarg stdatomic stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn
        string tgmath threads time uchar wchar wctype aio cpio dirent dlfcn endian fcntl fmtmsg
        fnmatch ftw glob grp iconv langinfo libgen libintl malloc memory monetary mqueue ndbm netdb
        nl_types poll pthread pwd regex sched search semaphore spawn strings stropts syslog tar
        termios trace ulimit unistd utime utmpx values wordexp alloca features""",
    "a reserved word of C": """
        alignas alignof asm auto bool break case char const constexpr continue default do double
        else enum extern false for fortran goto if inline int long main nullptr register restrict
        return short signed sizeof static static_assert struct switch thread_local true typedef
        typeof typeof_unqual union unsigned void volatile while""",
    "a library of the system": "asan c crypt dl gcc gcc_s m resolv rt stdc ubsan util",
    "a file that is written beside it": """
        codec selftest vectors makefile gnumakefile codec_i16 host_i16 selftest_i16 vectors_i16
        cycles""",
    "a device on Windows": " ".join(
        ["con aux nul prn", *(f"{port}{n}" for port in ("com", "lpt") for n in range(10))]
    ),
}
_DECAY_BITS = 24


def check_program(program: Program) -> None:
    """Refuse programs whose arithmetic is not written in C."""
    arithmetic, chip = program.chip.arithmetic, program.chip.name
    if not isinstance(arithmetic, (CubaFixedPoint, IntegrateAndFire)):
        raise ConfigError(
            f"--to c: chip {chip!r} computes with {type(arithmetic).__name__}; C is written for "
            "integers of Loihi's kind and of integrate-and-fire neurons. Choose loihi1, int, "
            "truenorth, odin, tinyodin, speck2f or spiker."
        )
    if isinstance(arithmetic, CubaFixedPoint) and arithmetic.decay_bits > _DECAY_BITS:
        raise ConfigError(f"--to c: decay_bits is {arithmetic.decay_bits}; at most {_DECAY_BITS}.")
    if arithmetic.together:
        raise ConfigError(
            f"--to c: the queue of {chip!r} is on, and is not written in C. Choose queue=off, "
            "where the program relays the spikes."
        )
    if program.graded:
        raise ConfigError(
            f"--to c: layer {min(program.graded)!r}: sigma-delta neurons send graded spikes, which "
            "is not written in C. Train neurons that spike."
        )
    if program.clock == "free":
        raise ConfigError(
            "--to c: clock 'free': layers run on between their windows, as on a chip whose cores "
            "all advance, which is not written in C. Compile with clock='gated' or 'pipelined'."
        )
    if program.host:
        raise ConfigError(
            f"--to c: readout {program.host[0].name!r}: its membranes do not leave {chip}, so that "
            "the host integrates it in float, which is not written in C. Choose a chip that gives "
            "membranes out, such as loihi1."
        )
    if program.damage or program.upsets is not None:
        raise ConfigError("--to c: a chip with faults is not written in C. Leave --faults out.")
    _check_synapses(program)


def _check_synapses(program: Program) -> None:
    seen = {program.input}
    for layer, lags in zip(program.layers, program.lags, strict=True):
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            late = lag > 0 or synapses.source in seen
            if synapses.shift or synapses.current or not late:
                raise ConfigError(
                    f"--to c: layer {layer.name!r}: the synapses from {synapses.source!r} have "
                    f"shift {synapses.shift}, current {synapses.current} and lag {lag}; C is "
                    "written for 0, 0 and a source that comes first."
                )
        seen.add(layer.name)


def check_codec(codec: Codec) -> None:
    """Refuse codes that are not written in C."""
    encoder = codec.encoder
    if not isinstance(encoder, (DeltaEncoder, RateEncoder, PopulationEncoder)):
        raise ConfigError(
            f"--to c: encoder {encoder.kind!r} is not written in C. Train with delta, rate or "
            "population."
        )
    if isinstance(encoder, PopulationEncoder) and codec.timesteps > MAX_TABLE_TIMESTEPS:
        raise ConfigError(
            f"--to c: a population code over {codec.timesteps} timesteps; its table has at most "
            f"{MAX_TABLE_TIMESTEPS}. Train with fewer."
        )


def check_prefix(prefix: str) -> None:
    """Refuse what cannot begin the names of C."""
    if not _PREFIX.fullmatch(prefix):
        raise ConfigError(
            f"--prefix {prefix[:40]!r}: names of C begin with it; choose a small letter, then "
            "small letters, digits and '_', 31 at most."
        )
    for what, names in _TAKEN.items():
        if prefix in names.split():
            raise ConfigError(
                f"--prefix {prefix!r} is the name of {what}; {prefix}.h, {prefix}.c and "
                f"lib{prefix}.so would stand in its place. Choose another, such as {prefix}_policy."
            )
