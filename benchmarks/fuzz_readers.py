"""What reads the files that are no networks, by their suffix."""

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import nir
import numpy as np
from gymnasium.spaces import Box, Discrete

from benchmarks.fuzz_corpus import chain, lif
from spikedeploy import zoo
from spikedeploy.commands.evidence import settings as settings_of
from spikedeploy.emulation.open_loop import emulate_artifact
from spikedeploy.emulation.rasters import read_inputs
from spikedeploy.emulation.recorded_spikes import read_recorded
from spikedeploy.envs.ghosts import Ghosts
from spikedeploy.envs.kart import track_file
from spikedeploy.envs.rollout import Rollout
from spikedeploy.play.draft_files import draft_of, open_draft
from spikedeploy.policies import run, run_record
from spikedeploy.policies.adopted import read_codec
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.traces.verify import verify
from spikedeploy.shipping.recorded_evaluation import recorded
from spikedeploy.trainers import metrics
from spikedeploy.trainers.distill.own_spaces import OwnSpaces
from spikedeploy.trainers.distill.sb3_teacher import sb3_teacher
from spikedeploy.trainers.ppo.config import PpoConfig
from spikedeploy.trainers.resolve import resolve
from spikedeploy.trainers.run_folder import RunFolder

LOW, HIGH = (np.array([[a], [b]], np.float32) for a, b in ((-0.3, 5.0), (0.1, 9.0)))
# environments of the models of Stable-Baselines3: discrete actions, and continuous ones
SPACES = (
    OwnSpaces("cart", Box(-1, 1, (4,)), Discrete(2)),
    OwnSpaces("reach", Box(-9, 9, (2, 2)), Box(LOW, HIGH)),
)


@cache
def network() -> Artifact:
    """Two neurons, each with an input of its own."""
    graph = chain([2], [2], weights=nir.Linear(np.eye(2)), cells=lif(2))
    return Artifact(graph, None, Convention(1e-3))


def raster(path: Path) -> None:
    """Play it to a network."""
    emulate_artifact(network(), "float", read_inputs(path, network()))


def recording(path: Path) -> None:
    """Read it as what another framework recorded of a network."""
    read_recorded(path, network())


def policy(path: Path) -> None:
    """Open an ONNX file, act, and count."""
    player = OnnxController(path)
    rng = np.random.default_rng(0)
    player.act(rng.normal(size=player.observed))
    player.effective_macs(rng.normal(size=(3, player.observed)))


def settings(path: Path) -> None:
    """Settings of a training."""
    resolve(PpoConfig, "kart-grid-ann", file=path)


def track(path: Path) -> None:
    """What karts drive on."""
    copy = path.with_name("file.drawn.json")
    shutil.copyfile(path, copy)
    track_file.load(copy)


def card(path: Path) -> None:
    """What `reproduce` takes from a card, beside a policy."""
    beside = path.with_name("file.policy.onnx")
    if not beside.exists():
        shutil.copyfile(zoo.FOLDER / "kart-steer" / "linear.onnx", beside)
    recorded(str(path), settings_of)


def report(path: Path) -> None:
    """What `reproduce` takes from a report."""
    folder = path.with_suffix(".folder")
    folder.mkdir(exist_ok=True)
    shutil.copyfile(path, folder / "report.json")
    recorded(str(folder), settings_of)


def draft(path: Path) -> None:
    """What `draw` begins with."""
    drawn = path.with_name("file.drawn.json")
    shutil.copyfile(path, draft_of(drawn))
    open_draft(drawn)


def configuration(path: Path) -> None:
    """The configuration of a run."""
    folder = path.with_suffix(".run")
    folder.mkdir(exist_ok=True)
    shutil.copyfile(path, folder / "config.json")
    run_record.settings(folder)
    RunFolder(folder).config(PpoConfig)


def teacher(number: int) -> Callable[[Path], None]:
    """A model of Stable-Baselines3 that teaches in one of SPACES."""

    def read(path: Path) -> None:
        found = sb3_teacher(str(path), SPACES[number])
        found.act_all(np.zeros((2, found.observations)))

    return read


def exported(folder: Path) -> None:
    """What exports, `run` and `publish` take from a run folder."""
    run_record.origin(folder)
    run_record.unfinished(folder)
    run_record.versions(folder)
    found = run.describe(folder)
    run.TorchController(str(folder)).act(np.zeros(found.observed))


def rows(folder: Path) -> None:
    """The rows of its metrics."""
    if (folder / "metrics.csv").is_file():
        metrics.read(folder / "metrics.csv")


def ghosts(folder: Path) -> None:
    """The ghosts of a run folder."""
    for path in (folder / "ghosts").glob("*.npz"):
        Ghosts.load(path)


READERS: dict[str, tuple[Callable[[Path], object], ...]] = {
    ".npy": (raster,),
    ".npz": (raster, recording),
    ".h5": (raster,),
    ".onnx": (policy,),
    ".ghosts": (Ghosts.load,),
    ".rollout": (Rollout.load,),
    ".toml": (settings,),
    ".track": (track,),
    ".trace": (verify,),
    ".json": (read_codec, card, report, draft, configuration),
    ".zip": (teacher(0), teacher(1)),
    ".run": (exported, rows, ghosts),
}
