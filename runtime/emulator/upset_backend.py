"""The interpreter as a backend on which spikes are lost or made up, and bits of membranes flip.

A layer's timestep begins with the flips and ends with the loss: a neuron whose spike is lost was
reset, one that did not send a spurious spike was not. The ledger counts what arrives.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.damage import Damage, Keys, Upsets, keys, uniform
from spikedeploy.runtime.chips.layer import Layer, LayerState, Numbers, StepResult
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import SavedState, Schedule
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.emulator.interpreter_backend import InterpreterBackend

_FLIPS, _LOST, _SPURIOUS, _BIT = range(4)  # streams of draws
_KINDS = {"state-flips": _FLIPS, "lost-spikes": _LOST, "spurious-spikes": _SPURIOUS}


class _Chance:
    """The draws of a batch of B robots, and how often something was hit.

    seeds: (B,) of their episodes.
    window: how many windows have run since then.
    counts: (3, 2) hits and chances of each kind.
    """

    def __init__(self, upsets: Upsets, batch: int) -> None:
        self.upsets = upsets
        self.counts = np.zeros((len(_KINDS), 2), np.int64)
        self.seed(range(batch))

    def seed(self, seeds: Sequence[int]) -> None:
        """Start the draws of these episodes; counts go on."""
        self.seeds = np.array(seeds, np.int64)
        self._keys: Keys = keys(self.upsets.specimen, self.seeds.tolist())
        self.window = 0

    def spikes(self, layer: int, step: int, sent: NDArray[Any]) -> NDArray[Any]:
        """The spikes (B, N) that arrive of those that were sent."""
        arriving = sent
        fired = sent != 0
        if self.upsets.of("lost-spikes"):
            lost = self._hit("lost-spikes", (layer, step), fired)
            arriving = np.where(lost, 0, arriving).astype(sent.dtype)
        if self.upsets.of("spurious-spikes"):
            made_up = self._hit("spurious-spikes", (layer, step), ~fired)
            arriving = np.where(made_up, 1, arriving).astype(sent.dtype)
        return arriving

    def membranes(self, layer: int, step: int, membrane: Numbers, bits: int) -> Numbers:
        """Membranes (B, N) after bits have flipped, in registers of so many bits."""
        if not self.upsets.of("state-flips"):
            return membrane
        flips = self._hit("state-flips", (layer, step), np.ones(membrane.shape, np.bool_))
        if not flips.any():
            return membrane
        size = membrane.shape[1]
        which = (uniform(self._keys, (_BIT, layer, self.window, step), size) * bits).astype(int)
        stored = (membrane & ((1 << bits) - 1)) ^ (np.int64(1) << which)
        flipped = np.where(stored >> (bits - 1), stored - (1 << bits), stored)
        return np.where(flips, flipped, membrane)

    def _hit(
        self, name: str, place: tuple[int, int], chances: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Which chances (B, N) are hit."""
        layer, step = place
        stream = _KINDS[name]
        draws = uniform(self._keys, (stream, layer, self.window, step), chances.shape[1])
        hit = chances & (draws < self.upsets.of(name))
        self.counts[stream] += np.count_nonzero(hit), np.count_nonzero(chances)
        return np.asarray(hit)


class _UpsetInterpreter(Interpreter):
    """An interpreter whose layers are upset."""

    def __init__(self, program: Program, batch: int, chance: _Chance) -> None:
        super().__init__(program, batch)
        self._chance = chance
        self._places = {layer.name: place + 1 for place, layer in enumerate(program.layers)}
        self._bits = program.chip.arithmetic.state_bits[-1]

    def _advanced(
        self, layer: Layer, step: int, presynaptic: Sequence[Numbers], state: LayerState
    ) -> StepResult:
        place = self._places[layer.name]
        state.membrane = self._chance.membranes(place, step, state.membrane, self._bits)
        tick = super()._advanced(layer, step, presynaptic, state)
        if not layer.spiking:
            return tick
        return replace(tick, spikes=self._chance.spikes(place, step, tick.spikes))


class UpsetBackend(InterpreterBackend):
    """An interpreter with upsets as a Backend; a reset of states leaves the draws as they are."""

    def __init__(self, program: Program, schedule: Schedule, batch: int) -> None:
        if program.upsets is None:
            raise ValueError("a program without upsets runs on any other backend")
        self._chance = _Chance(program.upsets, batch)
        super().__init__(program, schedule, batch)

    def seed(self, seeds: Sequence[int]) -> None:
        """Start the draws of an episode of each robot (B,)."""
        self._chance.seed(seeds)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What was hit so far."""
        counts = self._chance.counts.tolist()
        found = [(upset, counts[_KINDS[upset.name]]) for upset in self._chance.upsets.each]
        return tuple(
            Damage(u.text, u.name, u.probability, hit, of, u.what, over_time=True)
            for u, (hit, of) in found
        )

    def run(self, rows: NDArray[Any], step: int | None = None) -> NDArray[Any]:
        """Spikes (T, B, N) as they reach the readout, from those of the input (T, B, M)."""
        arriving = np.stack([self._chance.spikes(0, t, row) for t, row in enumerate(rows)])
        left = super().run(arriving, step)
        self._chance.window += 1
        return left

    def saved(self) -> SavedState:
        """Copies of all states, spikes on their way, and draws."""
        chance = self._chance
        return {
            **super().saved(),
            "seeds": chance.seeds.copy(),
            "window": np.array(chance.window),
            "hits": chance.counts.copy(),
        }

    def restore(self, saved: SavedState) -> None:
        """Go on from there."""
        super().restore(saved)
        self._chance.seed(saved["seeds"].tolist())
        self._chance.window = int(saved["window"])
        self._chance.counts = saved["hits"].copy()

    def _fresh(self) -> Interpreter:
        return _UpsetInterpreter(self._program, self._batch, self._chance)
