"""The design of the kart experiment: ANN and SNN from scratch in three environments, and controls.

In every environment the float network and the spiking one are trained with each seed, and two
controls with fewer seeds: a float network of the SNN's size, and a linear policy. With the built-in
policies, all of them are evaluated on the same starts, which no training used.

kart-simulator's own figures are from its README's table: its best runs, one seed each. Its first
finishes on Grid and Steer follow from the steps per finish that it implies.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from spikedeploy import envs
from spikedeploy.experiments.evaluation import BuiltInEvaluation
from spikedeploy.experiments.trial import Trial
from spikedeploy.runtime.errors import ConfigError

WORLDS = ("kart-grid", "kart-gazebo", "kart-steer")
NETWORKS = ("ann", "snn")
CONTROLS = ("small", "linear")


@dataclass(frozen=True)
class ExperimentDesign:
    """The parts of the experiment.

    seeds      trainings of each network, from seed 0 up
    controls   trainings of each control
    folder     of the trials
    overrides  settings of every training, as `--set` takes them
    finishes   after which a training ends; 0 for never
    episodes   of every evaluation
    chip       on which spiking policies are evaluated
    """

    seeds: int = 5
    controls: int = 3
    folder: str = "runs/experiment-kart"
    overrides: Sequence[str] = ()
    finishes: int = 0
    episodes: int = 100
    chip: str = "loihi1"

    def trials(self) -> list[Trial]:
        """All trainings, seed by seed, so that results of every world come early; controls last."""
        return [
            self._trial(f"{world}-{policy}", seed)
            for policies, seeds in ((NETWORKS, self.seeds), (CONTROLS, self.controls))
            for seed in range(seeds)
            for world in WORLDS
            for policy in policies
        ]

    def built_in(self) -> list[BuiltInEvaluation]:
        """All evaluations of built-in policies."""
        return [
            BuiltInEvaluation(world, player, self.folder, self.episodes)
            for world in WORLDS
            for player in envs.spec(world).controls
        ]

    def _trial(self, recipe: str, seed: int) -> Trial:
        settings = (*self.overrides, f"stop_at_finishes={self.finishes}")
        return Trial(recipe, seed, self.folder, settings, self.episodes, self.chip)

    @property
    def parts(self) -> list[BuiltInEvaluation | Trial]:
        """All parts, the short evaluations first."""
        return [*self.built_in(), *self.trials()]


_OPTIONS = {
    "seeds": "seeds",
    "controls": "controls",
    "runs": "folder",
    "set": "overrides",
    "finishes": "finishes",
    "episodes": "episodes",
    "chip": "chip",
}


def asked(options: Mapping[str, Any]) -> ExperimentDesign:
    """The design of the options of a command; ConfigError where one is of other experiments."""
    if other := sorted(options.keys() - _OPTIONS):
        raise ConfigError(f"the experiment kart has no {other[0]}. Leave it out.")
    return ExperimentDesign(**{_OPTIONS[name]: value for name, value in options.items()})


@dataclass(frozen=True)
class _Peer:
    """Steps of its ANN and its SNN in one world, in thousands of environment steps.

    first  (ANN, SNN) to the first finish of training
    nth    (ANN, SNN) to the 300th
    """

    first: tuple[int, int]
    nth: tuple[int, int]

    @property
    def share(self) -> float:
        """Steps of the ANN / steps of the SNN."""
        return self.nth[0] / self.nth[1]


PEERS = {
    "kart-grid": _Peer((141, 175), (402, 406)),
    "kart-gazebo": _Peer((82, 22), (431, 507)),
    "kart-steer": _Peer((156, 441), (724, 957)),
}
