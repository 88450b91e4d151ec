"""A hexapod that steps on no forbidden tile: environments and scripts of a project."""

from examples.hexapod_tiles.env import HexapodTiles, HexapodTilesAhead
from examples.hexapod_tiles.footholds import FootholdScript

footholds = FootholdScript("around")
footholds_ahead = FootholdScript("ahead")

__all__ = ["HexapodTiles", "HexapodTilesAhead", "footholds", "footholds_ahead"]
