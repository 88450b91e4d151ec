"""Return and synaptic operations of a run, on seeds that are for choosing.

They are neither those of its own validation, on which its best checkpoint was chosen, nor those of
`compare`, on which whoever tuned is to be judged.
"""

from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy.comparison.episodes import EpisodeJob, play
from spikedeploy.comparison.lineup import alone
from spikedeploy.files import as_text
from spikedeploy.policies.registry import find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.tuning.plan import TuningPlan

FIRST_SEED, _MOST = 9_000, 1_000  # validation of trainings begins below, evaluation above


def evaluated(run: Path, plan: TuningPlan) -> tuple[float, float | None]:
    """Mean return of the exported policy, and its SOPs a control step; None of a float one."""
    if plan.episodes > _MOST:
        raise ConfigError(f"--episodes {plan.episodes}: there are seeds for {_MOST} at most")
    env = RunFolder(run).settings()["env"]
    entry = alone(find(runnable(str(run))), plan.chip)[-1]
    options = as_text(env["options"])
    played = [
        play(EpisodeJob(env["name"], options, entry.candidate, entry.chip, FIRST_SEED + k, {}))
        for k in range(plan.episodes)
    ]
    sops: list[Any] = [episode.costs.sops for episode in played]
    known = None if None in sops else float(np.mean(sops))
    return float(np.mean([episode.total for episode in played])), known
