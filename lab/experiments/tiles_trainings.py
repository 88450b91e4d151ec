"""Archives of what the trainings of hexapod-tiles left, from which others go on.

    python -m lab tiles-trainings pack --runs runs/hexapod-tiles
    python -m lab tiles-trainings unpack --runs runs/hexapod-tiles

`pack` writes an archive for each training that ended: settings, versions, metrics, and the policy
of each level of pruning, without optimisers and walks; and one with all evaluations. After
`unpack`, `python -m lab experiment hexapod-tiles` trains what is missing, and plays the walks that
all trainings begin with again.
"""

from pathlib import Path

from lab.experiments.archives import files_left, kept_levels
from lab.experiments.tiles import TilesDesign, is_walks

KEPT = kept_levels("hexapod-tiles")


def pack(runs: Path, archives: Path) -> list[Path]:
    """Write the archives of everything that is complete; return them.

    Raises ValueError where an archive holds files that `runs` lacks; then none is written.
    """
    trainings = TilesDesign(runs=str(runs)).trainings()
    kept = (each for each in trainings if not is_walks(each))
    return KEPT.write(runs, archives, files_left(runs, kept))


def main() -> int:
    """Pack or unpack, as the arguments say."""
    return KEPT.command(str(__doc__).split("\n", 1)[0], pack)
