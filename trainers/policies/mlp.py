"""Float policies: a perceptron or linear map, of observations or features, and a pruned one."""

from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement, pairwise
from typing import Any

import torch
from torch import Tensor, nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import require_known
from spikedeploy.trainers.policies.copies import Copies, he_normal, weights_between
from spikedeploy.trainers.policies.policy import (
    Head,
    Latent,
    Policy,
    PrunedWeight,
    TorchNormaliser,
    full_precision,
)

_FEATURES = ("all", "phase", "bilinear", "fourier")
_HARMONICS = {"bilinear": 2, "fourier": 3}
# what the body should do is this minus what it does, or this: on the course and under commands
_ERRORS = ("heading", "turn_error", "speed", "speed_error", "lateral", "lateral_velocity")


class MlpPolicy(Policy):
    """A float network with ReLU; without hidden layers, a linear policy.

    hidden: widths of the hidden layers
    features: its inputs; None for all observations
    layers: the nn.Linear of each hidden layer, then that of the mean
    """

    kind = "mlp"

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Sequence[int] = (512, 512),
        features: "Features | None" = None,
        clip: float = 4.0,
        head: Head = "continuous",
    ) -> None:
        super().__init__()
        self.head = head
        self.observations, self.actions, self.hidden = observations, actions, tuple(hidden)
        self.features = features or Features("all", observations, [], [])
        self.normalizer = TorchNormaliser(self.features.size, clip)
        widths = (self.features.size, *hidden, actions)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(widths))
        self.latent_size = widths[-2]

    def features_of(self, observation: Tensor) -> Tensor:
        """Return the features (B, F) of raw observations."""
        features: Tensor = self.features(observation)
        return features

    def latent(self, observation: Tensor) -> Latent:
        """Return mean and last hidden activations."""
        hidden = self.normalizer(self.features_of(observation))
        for layer in self.layers[:-1]:
            hidden = torch.relu(layer(hidden))
        return Latent(full_precision(self.layers[-1], hidden), hidden)


class Features(nn.Module):
    """Columns or products of the raw observation, before normalisation.

    name: "all" for all observations; "phase" for sine and cosine of the gait's phase only;
        "bilinear" for {1, sin, cos, sin 2, cos 2} of the phase times {1, commands}, "fourier" for
        {1, sin k, cos k; k = 1, 2, 3} of the phase times {1, commands, errors, products of two
        commands, squares of errors}, both without the constant
    size: number of features F
    harmonics: of the phase in the products
    phase: columns of sine and cosine
    command: columns of the commands; none on a task without commands
    errors: columns of the errors of heading, turn rate, speed and side that "fourier" multiplies
    scales: columns of commands and errors
    pairs: columns of the two factors of each product and square
    """

    def __init__(
        self,
        name: str,
        observations: int,
        phase: Sequence[int],
        command: Sequence[int],
        errors: Sequence[int] = (),
    ) -> None:
        super().__init__()
        self.name = require_known(name, _FEATURES, "features")
        self.phase, self.command = list(phase), list(command)
        self.errors = list(errors) if name == "fourier" else []
        if name != "all" and len(self.phase) != 2:
            raise ConfigError(f"features '{name}' need the columns of sine and cosine of the phase")
        self.harmonics = _HARMONICS.get(name, 1)
        self.scales = self.command + self.errors
        squares = [(error, error) for error in self.errors]
        products = list(combinations_with_replacement(self.command, 2))
        self.pairs = products + squares if name == "fourier" else []
        waves, scales = 1 + 2 * self.harmonics, 1 + len(self.scales) + len(self.pairs)
        self.size = {"all": observations, "phase": 2}.get(name, waves * scales - 1)

    def forward(self, observation: Tensor) -> Tensor:
        """Return (B, F)."""
        if self.name == "all":
            return observation
        phase = observation[:, self.phase]
        if self.name == "phase":
            return phase
        one = torch.ones_like(phase[:, :1])
        pairs = [observation[:, [a]] * observation[:, [b]] for a, b in self.pairs]
        waves = torch.cat([one, *_waves(phase, self.harmonics)], dim=1)
        scales = torch.cat([one, observation[:, self.scales], *pairs], dim=1)
        return (scales[:, :, None] * waves[:, None, :]).flatten(1)[:, 1:]

    def spec(self) -> dict[str, Any]:
        """Return the arguments that rebuild these features, for JSON."""
        errors = {"errors": self.errors} if self.errors else {}
        return {"name": self.name, "phase": self.phase, "command": self.command, **errors}


def _waves(phase: Tensor, harmonics: int) -> list[Tensor]:
    """Return sine and cosine (B, 1) of the phase, of its double and so on, by angle addition."""
    sine, cosine = phase[:, :1], phase[:, 1:]
    # sin 2p = 2 sin p cos p ; cos 2p = cos^2 p - sin^2 p
    waves = [sine, cosine, 2 * sine * cosine, cosine**2 - sine**2]
    while len(waves) < 2 * harmonics:
        # sin (k+1)p = sin kp cos p + cos kp sin p ; cos (k+1)p = cos kp cos p - sin kp sin p
        last_sine, last_cosine = waves[-2:]
        waves.append(last_sine * cosine + last_cosine * sine)
        waves.append(last_cosine * cosine - last_sine * sine)
    return waves


def features(name: str, observations: int, columns: Mapping[str, slice] | None = None) -> Features:
    """Return features by name; `columns` is the environment's OBSERVATION table."""
    table = columns or {}

    def of(*groups: str) -> list[int]:
        found = [range(observations)[table[group]] for group in groups if group in table]
        return [column for each in found for column in each]

    return Features(name, observations, of("phase"), of("command"), of(*_ERRORS))


class PrunedMlpPolicy(Policy):
    """A float network with ReLU, a linear path past it, and masks on all weights.

    hidden: widths of the hidden layers, of all copies together; none make it a linear policy
    skip: whether the observation also reaches the output directly
    copies: of a network that serves several parts of a body; None for one network
    layers, biases: weights of each hidden layer, then of the output; and their biases
    past: weights of the skip connection
    """

    kind = "pruned-mlp"

    def __init__(
        self,
        observations: int,
        actions: int,
        hidden: Sequence[int] = (16,),
        skip: bool = True,
        clip: float = 4.0,
        head: Head = "continuous",
        copies: Copies | None = None,
    ) -> None:
        super().__init__()
        self.observations, self.actions, self.hidden = observations, actions, tuple(hidden)
        self.skip, self.head, self.copies = skip and bool(hidden), head, copies
        self.normalizer = TorchNormaliser(observations, clip)
        widths = list(pairwise((observations, *hidden, actions)))
        last = len(widths) - 1
        self.matrices = nn.ModuleList(
            weights_between(copies, pair, he_normal, reads=k == 0, acts=k == last)
            for k, pair in enumerate(widths)
        )
        self.biases = nn.ParameterList(torch.zeros(n) for _, n in widths)
        read = observations if self.skip else 0
        self.past = weights_between(copies, (read, actions), torch.zeros, reads=True, acts=True)
        self.latent_size = widths[-1][0]

    @property
    def layers(self) -> list[PrunedWeight]:
        """Weights of each hidden layer, then of the output."""
        return [matrix for matrix in self.matrices if isinstance(matrix, PrunedWeight)]

    def activations(self, observation: Tensor) -> tuple[Tensor, list[Tensor]]:
        """Return mean (B, act), and the inputs (B, M) of every matrix."""
        seen = self.normalizer(observation)
        inputs = [seen]
        *hidden, last = zip(self.layers, self.biases, strict=True)
        for matrix, bias in hidden:
            inputs.append(torch.relu(matrix.drive(inputs[-1], matrix()) + bias))
        mean = last[0].drive(inputs[-1], last[0]()) + last[1]
        if self.skip:
            mean = mean + self.past.drive(seen, self.past())
        return mean, inputs

    def latent(self, observation: Tensor) -> Latent:
        """Return mean and last hidden activations."""
        mean, inputs = self.activations(observation)
        return Latent(full_precision(nn.Identity(), mean), inputs[-1])
