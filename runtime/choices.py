"""Choices that a user has, by name: loaded without NumPy, so that the command line offers them."""

from typing import Literal

# runtime.convention says what each means
Reset = Literal["zero", "subtract", "zero-delayed", "subtract-delayed", "subtract-ahead", "none"]
Integrator = Literal["euler", "exponential"]
State = Literal["reset", "kept"]
SpikeCondition = Literal["above", "reached", "many"]
Floor = Literal["none", "zero", "threshold"]
Clock = Literal["gated", "pipelined", "free"]

# runtime.chips.quantisation.Quantisation
Granularity = Literal["layer", "channel"]
Rounding = Literal["nearest", "truncate"]

# what computes a chip: runtime.emulator.backend
BackendName = Literal["numpy", "numba", "auto", "interpreter"]

# units of a teacher's actions: trainers.distill.teacher
Units = Literal["own", "scaled"]
