"""Features: the inputs of a float policy, all observations or those of a control."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.resolve import known

_FEATURES = ("all", "phase", "bilinear")


class Features(nn.Module):
    """Columns or products of the raw observation, before normalisation.

    name: "all" for all observations; "phase" for sine and cosine of the gait's phase only;
        "bilinear" for {1, sin, cos, sin 2, cos 2} of the phase times {1, commands}, without the
        constant
    size: number of features F
    phase: columns of sine and cosine
    command: columns of the commands; none on a task without commands
    """

    def __init__(self, name: str, observations: int, phase: list[int], command: list[int]) -> None:
        super().__init__()
        self.name = known(name, _FEATURES, "features")
        self.phase, self.command = list(phase), list(command)
        if name != "all" and len(self.phase) != 2:
            raise ConfigError(f"features '{name}' need the columns of sine and cosine of the phase")
        sizes = {"all": observations, "phase": 2, "bilinear": 5 * (1 + len(self.command)) - 1}
        self.size = sizes[name]

    def forward(self, observation: Tensor) -> Tensor:
        """Return (B, F)."""
        if self.name == "all":
            return observation
        phase = observation[:, self.phase]
        return phase if self.name == "phase" else self._products(phase, observation)

    def _products(self, phase: Tensor, observation: Tensor) -> Tensor:
        sine, cosine = phase[:, :1], phase[:, 1:]
        one = torch.ones_like(sine)
        # sin 2p = 2 sin p cos p ; cos 2p = cos^2 p - sin^2 p
        waves = torch.cat([one, phase, 2 * sine * cosine, cosine**2 - sine**2], dim=1)
        scales = torch.cat([one, observation[:, self.command]], dim=1)
        return (scales[:, :, None] * waves[:, None, :]).flatten(1)[:, 1:]

    def spec(self) -> dict[str, Any]:
        """Return the arguments that rebuild these features, for JSON."""
        return {"name": self.name, "phase": self.phase, "command": self.command}


def features(name: str, observations: int, columns: Mapping[str, slice] | None = None) -> Features:
    """Return features by name; `columns` is the environment's OBSERVATION table."""
    found = {
        group: list(range(observations))[columns[group]] if columns and group in columns else []
        for group in ("phase", "command")
    }
    return Features(name, observations, found["phase"], found["command"])
