"""From points of range sensors to distances: a local occupancy map and exact distance transforms, compiled."""

from wbmpc.mapping.distances import distance_grid
from wbmpc.mapping.local_map import LocalMap

__all__ = ["LocalMap", "distance_grid"]
