"""kart-simulator's own figures, from its README's table: its best runs, one seed each.

Its first finishes on Grid and Steer follow from the steps per finish that it implies.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Peer:
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
    "kart-grid": Peer((141, 175), (402, 406)),
    "kart-gazebo": Peer((82, 22), (431, 507)),
    "kart-steer": Peer((156, 441), (724, 957)),
}
