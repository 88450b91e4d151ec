"""A baseline without a network for the walking task: a table over the gait's phases, a few MACs.

    python -m lab phase-table [--macs 10] [--teacher hexapod/linear] [--write]

    action = clip(table[phase] + W observation, -1, 1)

The gait of Hexapod-v0 has 40 phases, which the observation holds as sine and cosine. Table (40, 18)
and W are fitted by least squares to a float teacher on its own walks, then on walks of the student
too (DAgger, six rounds); of W only the entries that lower the error most are kept, chosen one by
one (orthogonal matching pursuit). Both are rounded to 8 bits, one scale each. The student does not
see its own last action. The energy is that of docs/energy.md: MACs, 18 constants, and reads of 16
bits of 18 table entries and the observations.

--write puts the result into results/phase-table.json.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.experiments.costs import INT8, TABLES
from spikedeploy import envs, zoo
from spikedeploy.comparison.statistics import nested_ratio, stratified_bootstrap
from spikedeploy.envs.hexapod.env import BODY, layout
from spikedeploy.envs.rollout import rollout
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.files import write_text
from spikedeploy.seeds import EVALUATION

ROOT = Path(__file__).resolve().parents[2]
Array = NDArray[np.float64]
Controller = Callable[[Array], Array]
_PHASES = 40  # of the gait
_ROUNDS = 6  # of DAgger
_WALKS, _MORE = 4, 3  # of the teacher at first, and of the student in each round
_FIRST = 3000  # seed of the first walk that is learned from
_READ = 2.5e-12  # [J] of 16 bits, a quarter of an access of 64 (Horowitz 2014)
_NAMES = layout(BODY)


class Player:
    """A controller that plays episodes.

    noise: standard deviation of what is added to its actions.
    """

    def __init__(self, controller: Controller, noise: float = 0.0) -> None:
        self._controller, self._noise = controller, noise

    def reset(self, seed: int) -> None:
        """Draw noise from this seed on."""
        self._random = np.random.default_rng(seed)

    def act(self, observation: Array) -> Array:
        """The action (18,)."""
        action = self._controller(observation)
        noise = self._noise * self._random.normal(size=action.shape)
        return np.asarray(np.clip(action + noise, -1, 1))


class PhaseTable:
    """The student.

    table: (40, 18), W: (18, obs), both of 8 bits.
    """

    def __init__(self, seen: Array, wanted: Array, macs: int) -> None:
        """Fit to observations (S, obs) and the teacher's actions (S, 18)."""
        at, columns = phase(seen), _columns(seen.shape[1])
        here = np.stack([(at == k) / max((at == k).sum(), 1) for k in range(_PHASES)])
        mean_seen, mean_wanted = here @ seen, here @ wanted
        x, y = (seen - mean_seen[at])[:, columns], wanted - mean_wanted[at]
        weight = np.zeros((wanted.shape[1], seen.shape[1]))
        weight[:, columns] = _pursued(x, y, macs)
        self.weight = _in_8_bits(weight)
        self.table = _in_8_bits(mean_wanted - mean_seen @ weight.T)

    def __call__(self, observation: Array) -> Array:
        """The action (18,) of an observation (obs,)."""
        action = self.table[phase(observation[None])[0]] + self.weight @ observation
        return np.asarray(np.clip(action, -1, 1))

    def joules(self) -> dict[str, float]:
        """Energy of a control step [J]."""
        prices, (_, actions) = TABLES[INT8].joules, self.table.shape
        observed = int(self.weight.any(axis=0).sum())
        return {
            "operations": np.count_nonzero(self.weight) * prices["mac"],
            "constants": actions * prices["sop"],
            "reads": (actions + observed) * _READ,
        }


def _columns(observed: int) -> NDArray[np.int64]:
    """Places in the observation (obs,) that W may read."""
    names = [n for n in _NAMES if n not in ("previous", "phase")]
    return np.concatenate([np.arange(observed)[_NAMES[n]] for n in names])


def phase(seen: Array) -> NDArray[np.int64]:
    """Which of the 40 phases observations (S, obs) are at."""
    sine, cosine = seen[:, _NAMES["phase"]].T
    turns = np.arctan2(sine, cosine) / (2 * np.pi)
    return np.asarray(np.rint(turns * _PHASES).astype(np.int64) % _PHASES)


def _pursued(x: Array, y: Array, most: int) -> Array:
    """Weights (act, obs) of which so many are not 0, by orthogonal matching pursuit."""
    gram, toward = x.T @ x + 1e-6 * len(x) * np.eye(x.shape[1]), y.T @ x
    weight = np.zeros(toward.shape)
    for _ in range(most):
        left = toward - weight @ gram  # (act, obs) what each entry could still explain
        gain = np.where(weight == 0, left**2 / np.diag(gram), 0)
        action, column = np.unravel_index(gain.argmax(), gain.shape)
        chosen = [*np.flatnonzero(weight[action]).tolist(), int(column)]
        these = gram[np.ix_(chosen, chosen)]
        weight[action, chosen] = np.linalg.solve(these, toward[action, chosen])
    return weight


def _in_8_bits(numbers: Array) -> Array:
    scale = np.abs(numbers).max() / 127 or 1.0
    return np.asarray(np.rint(numbers / scale) * scale)


def fit(teacher: Controller, macs: int) -> PhaseTable:
    """The student of a teacher, after DAgger."""
    world = envs.make("hexapod")
    walks = [
        rollout(world, Player(teacher, 0.2 * (k % 2)), _FIRST + k).observation[:-1]
        for k in range(_WALKS)
    ]
    for number in range(_ROUNDS):
        seen = np.concatenate(walks)
        student = PhaseTable(seen, np.stack([teacher(each) for each in seen]), macs)
        begin = _FIRST + 100 * (number + 1)
        walks += [
            rollout(world, Player(student), seed).observation[:-1]
            for seed in range(begin, begin + _MORE)
        ]
    return student


def measure(student: PhaseTable, episodes: int) -> dict[str, Any]:
    """Size, return, ratio to SAC's and energy of a student on the episodes of evaluation."""
    world, seeds = envs.make("hexapod"), range(EVALUATION, EVALUATION + episodes)
    played = [rollout(world, Player(student), seed) for seed in seeds]
    returns = [each.total for each in played]
    of_sac = nested_ratio([returns], _sac()[:episodes])
    joules = student.joules()
    return {
        "macs": int(np.count_nonzero(student.weight)),
        "observations": int(student.weight.any(axis=0).sum()),
        "return": stratified_bootstrap([returns], np.random.default_rng(0)).mean.as_json(),
        "of_sac": of_sac.as_json(),
        "success": float(np.mean([each.success for each in played])),
        "joules": {**joules, "all": sum(joules.values())},
    }


def _sac() -> list[float]:
    """Returns of SAC by episode, as results/hexapod has them."""
    report = json.loads((ROOT / "results/hexapod/report.json").read_text("utf-8"))
    return next(row["returns"] for row in report["rows"] if row["policy"] == "sac")


def parse_options() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--macs", type=int, default=10)
    parser.add_argument("--teacher", default="hexapod/linear")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--write", action="store_true", help="into results/phase-table.json")
    return parser.parse_args()


def main() -> None:
    """Fit, play, print."""
    options = parse_options()
    teacher = OnnxController(zoo.path(options.teacher))
    command = (
        f"python -m lab phase-table --macs {options.macs} --teacher {options.teacher} "
        f"--episodes {options.episodes}"
    )
    found = measure(fit(teacher.act, options.macs), options.episodes)
    text = json.dumps({"command": command, **found}, indent=1)
    print(text)
    if options.write:
        write_text(ROOT / "results/phase-table.json", text + "\n")
