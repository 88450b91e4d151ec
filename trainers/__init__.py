"""The trainers: an environment goes in, a run folder with a trained policy comes out.

Table of contents; nothing heavy is imported until it is used. Adding an algorithm is one file and
one line in `ALGORITHMS`, adding a recipe one entry in `trainers.recipes`.
"""

from spikedeploy.trainers.recipes import RECIPES, Recipe

ALGORITHMS: dict[str, str] = {
    "sac": "spikedeploy.trainers.sac:Sac",
    "distill": "spikedeploy.trainers.distill:Distill",
    "ppo": "spikedeploy.trainers.ppo:Ppo",
}

__all__ = ["ALGORITHMS", "RECIPES", "Recipe"]
