"""A hexapod that steps on no forbidden tile: environments and scripts of a project."""

from examples.hexapod_tiles.env import HexapodTiles, HexapodTilesAhead
from examples.hexapod_tiles.footholds import FootholdScript, RememberingScript

footholds = FootholdScript()
footholds_ahead = RememberingScript()

__all__ = ["HexapodTiles", "HexapodTilesAhead", "footholds", "footholds_ahead"]
