"""The design of the kart experiment: trainings from scratch in three worlds, and what drives them.

A preset is what a policy learns from: `default` is this project's observation, reward and settings
of PPO, `classic` kart-simulator's, `corridor` the default ones on corridors that are drawn anew in
each episode. With every preset and seed four policies are trained in each world: the float network,
the spiking one, and two controls, a float network of the spiking one's size and a linear policy.
With the scripts, all are evaluated on the same starts, which no training used.

kart-simulator's own figures are from its README's table: its best runs, one seed each. Its first
finishes on Grid and Steer follow from the steps per finish that it implies.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lab.experiments.evaluation import BuiltInEvaluation
from lab.experiments.kart.heldout import TrackEvaluation
from lab.experiments.trial import Trial
from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError

WORLDS = ("kart-grid", "kart-gazebo", "kart-steer")
NETWORKS = ("ann", "snn")
CONTROLS = ("small", "linear")
POLICIES = (*NETWORKS, *CONTROLS)
DEFAULT, CLASSIC, CORRIDOR = "default", "classic", "corridor"
LEARNING = (DEFAULT, CLASSIC)  # presets on big_S, as kart-simulator's
PRESETS = (*LEARNING, CORRIDOR)
COUNT = 300  # finishes of training, as kart-simulator's table has it
GREEDY = 0.95  # share of greedy validation episodes that must finish

Part = BuiltInEvaluation | Trial | TrackEvaluation

# networks before controls; what the page begins with comes first
_ORDER = (
    (DEFAULT, NETWORKS), (DEFAULT, CONTROLS), (CORRIDOR, NETWORKS), (CLASSIC, ("ann",)),
    (CLASSIC, ("snn",)), (CORRIDOR, CONTROLS), (CLASSIC, CONTROLS),
)  # fmt: skip
_VALIDATION = ("validation.every=10000", "validation.episodes=20")  # shares in steps of 5 %
_QUICK = (
    "steps=64", "horizon=32", "env.count=2", "epochs=1", "minibatch=32", "critic_hidden=[8]",
    "validation.every=64", "validation.episodes=2", "validation.limit=10", "checkpoint_every=64",
)  # fmt: skip


@dataclass(frozen=True)
class ExperimentDesign:
    """The parts of the experiment.

    seeds      trainings of each network, from seed 0 up
    controls   trainings of each control
    folder     of the trials
    overrides  settings of every training, as `--set` takes them
    finishes   after which a training ends; 0 for never, or for COUNT with the classic preset
    episodes   of every evaluation
    starts     of every policy on each held-out track
    chip       on which spiking policies are evaluated
    quick      whether it is a first look, of seconds a part
    """

    seeds: int = 5
    controls: int = 5
    folder: str = "runs/experiment-kart"
    overrides: Sequence[str] = ()
    finishes: int = 0
    episodes: int = 100
    starts: int = 50
    chip: str = "loihi1"
    quick: bool = False

    def trials(self) -> list[Trial]:
        """All trainings, seed by seed, so that results of every world come early."""
        return [
            self._trial(preset, world, policy, seed)
            for preset, policies in _ORDER
            for seed in range(self.controls if policies == CONTROLS else self.seeds)
            for world in WORLDS
            for policy in policies
        ]

    def built_in(self) -> list[BuiltInEvaluation]:
        """All evaluations of built-in policies on big_S."""
        return [
            BuiltInEvaluation(world, player, self.folder, self.episodes)
            for world in WORLDS
            for player in envs.spec(world).controls
        ]

    def on_tracks(self) -> list[TrackEvaluation]:
        """The evaluations on all tracks: of scripts, and of what was trained on one or many."""
        trained = [trial for trial in self.trials() if preset_of(trial) != CLASSIC]
        drivers: list[Trial | BuiltInEvaluation] = [*self.built_in(), *trained]
        return [TrackEvaluation(each, self.starts) for each in drivers]

    def settings(self, preset: str) -> tuple[str, ...]:
        """Settings of the trainings of a preset.

        With the classic preset only learning counts, in kart-simulator's metric: with that it ends.
        `--set stop_at_greedy=0.95` goes on until greedy episodes finish, too.
        """
        enough = self.finishes or (COUNT if preset == CLASSIC else 0)
        quick = _QUICK if self.quick else ()
        return (*_VALIDATION, f"stop_at_finishes={enough}", *quick, *self.overrides)

    def _trial(self, preset: str, world: str, policy: str, seed: int) -> Trial:
        return Trial(
            recipe(preset, world, policy),
            seed,
            self.folder,
            self.settings(preset),
            self.episodes,
            self.chip,
        )

    @property
    def parts(self) -> list[Part]:
        """All parts, the short evaluations first."""
        return [*self.built_in(), *self.trials(), *self.on_tracks()]


def recipe(preset: str, world: str, policy: str) -> str:
    """`kart-grid-snn`, `kart-grid-classic-snn`."""
    return f"{world}-{policy}" if preset == DEFAULT else f"{world}-{preset}-{policy}"


def preset_of(trial: Trial) -> str:
    """The preset of a training, by its recipe."""
    found = [preset for preset in (CLASSIC, CORRIDOR) if f"-{preset}-" in trial.recipe]
    return found[0] if found else DEFAULT


_OPTIONS = {
    "seeds": "seeds",
    "controls": "controls",
    "runs": "folder",
    "set": "overrides",
    "finishes": "finishes",
    "episodes": "episodes",
    "chip": "chip",
    "quick": "quick",
}
_FIRST_LOOK = {
    "seeds": 1, "controls": 1, "folder": "runs/kart-quick", "episodes": 2, "starts": 2,
}  # fmt: skip


def asked(options: Mapping[str, Any]) -> ExperimentDesign:
    """The design of the options of a command; ConfigError where one is of other experiments."""
    if other := sorted(options.keys() - _OPTIONS):
        raise ConfigError(f"the experiment kart has no {other[0]}. Leave it out.")
    given = {_OPTIONS[name]: value for name, value in options.items()}
    return ExperimentDesign(**{**(_FIRST_LOOK if given.get("quick") else {}), **given})


@dataclass(frozen=True)
class _Peer:
    """Steps of its networks in one world, in thousands of environment steps.

    first  policy -> to the first finish of training
    nth    policy -> to the 300th
    """

    first: Mapping[str, int]
    nth: Mapping[str, int]

    @property
    def share(self) -> float:
        """Steps of the ANN / steps of the SNN."""
        return self.nth["ann"] / self.nth["snn"]


PEERS = {
    "kart-grid": _Peer({"ann": 141, "snn": 175}, {"ann": 402, "snn": 406}),
    "kart-gazebo": _Peer({"ann": 82, "snn": 22}, {"ann": 431, "snn": 507}),
    "kart-steer": _Peer({"ann": 156, "snn": 441}, {"ann": 724, "snn": 957}),
}
