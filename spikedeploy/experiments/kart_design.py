"""What belongs to the kart experiment: ANN and SNN from scratch in three worlds, and controls.

Every world trains the float network and the spiking one with each seed, and with fewer seeds two
controls: a float network of the spiking one's size, and a linear policy. Beside them stand the
players that are built in. All of them are then judged on the same starts, which no training saw.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from spikedeploy import envs
from spikedeploy.experiments.evaluation import Drive
from spikedeploy.experiments.trial import Trial

WORLDS = ("kart-grid", "kart-gazebo", "kart-steer")
NETWORKS = ("ann", "snn")
CONTROLS = ("small", "linear")


@dataclass(frozen=True)
class ExperimentDesign:
    """What belongs to the experiment.

    seeds      trainings of each network, from seed 0 up
    controls   trainings of each control
    folder     where the trials lie
    overrides  settings of every training, as `--set` takes them
    finishes   of training after which it ends; 0 for never
    episodes   of every evaluation
    chip       that spiking policies are evaluated on
    """

    seeds: int = 5
    controls: int = 3
    folder: str = "runs/experiment-kart"
    overrides: Sequence[str] = ()
    finishes: int = 0
    episodes: int = 100
    chip: str = "loihi1"

    def trials(self) -> list[Trial]:
        """All trainings: seed by seed, so that every world is seen early, the controls last."""
        return [
            self._trial(f"{world}-{policy}", seed)
            for policies, seeds in ((NETWORKS, self.seeds), (CONTROLS, self.controls))
            for seed in range(seeds)
            for world in WORLDS
            for policy in policies
        ]

    def drives(self) -> list[Drive]:
        """All evaluations of players that are built in."""
        return [
            Drive(world, player, self.folder, self.episodes)
            for world in WORLDS
            for player in envs.spec(world).controls
        ]

    def _trial(self, recipe: str, seed: int) -> Trial:
        settings = (*self.overrides, f"stop_at_finishes={self.finishes}")
        return Trial(recipe, seed, self.folder, settings, self.episodes, self.chip)

    @property
    def parts(self) -> list[Drive | Trial]:
        """Everything, the short evaluations first."""
        return [*self.drives(), *self.trials()]
