"""Central pattern generator: a tripod gait of six phase-locked sines."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

LEGS = ("RF", "RM", "RR", "LF", "LM", "LR")
JOINTS = ("coxa", "femur", "tibia")

# Tripods RF-RR-LM and RM-LF-LR step in antiphase: a phase shift of pi flips the signs of sine and
# cosine, so that one sign per leg is the whole coupling. In LEGS the tripods alternate.


class Gait:
    """Open-loop tripod gait.

    phase      [rad], in [0, 2 pi)
    frequency  [Hz]
    yaw        [action unit] amplitude of the coxa
    lift       [action unit] amplitude of the femur during swing
    extend     [action unit] amplitude of the tibia during swing
    """

    def __init__(
        self,
        frequency: float = 1.25,
        yaw: float = 0.35,
        lift: float = 0.45,
        extend: float = 0.20,
    ) -> None:
        self.frequency = frequency
        self.yaw = yaw
        self.lift = lift
        self.extend = extend
        self.phase = 0.0

    def reset(self, phase: float) -> None:
        """Set the phase [rad]."""
        self.phase = phase % math.tau

    def advance(self, dt: float) -> None:
        """Advance the phase by dt [s]."""
        self.phase = (self.phase + math.tau * self.frequency * dt) % math.tau

    def command(self) -> NDArray[np.float64]:
        """Command (18,) at the current phase, leg by leg coxa, femur, tibia [action unit]."""
        sine = math.sin(self.phase)
        # forward while sin(phase) > 0, when the foot is in the air
        coxa = -self.yaw * math.cos(self.phase)
        swing, other = max(0.0, sine), max(0.0, -sine)
        one = coxa, self.lift * swing, self.extend * swing
        opposite = -coxa, self.lift * other, self.extend * other
        return np.array((*one, *opposite) * 3)
