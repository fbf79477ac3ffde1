"""pfedu: the algorithms of the book "Particle Filters, Alive", each as its chapter tells it.

Importing it needs numpy alone. Figures, explorers and their hosts are imported where they are used:
``pfedu.figures``, ``pfedu.explorers``, ``pfedu.live``.
"""

from pfedu import gaussian, models, resampling, weights
from pfedu.filters import bootstrap_filter
from pfedu.grid import GridError, grid_filter
from pfedu.kalman import kalman_filter
from pfedu.models import MissingPieceError
from pfedu.track import Track
from pfedu.weights import ZeroLikelihoodError

__version__ = "0.1.0"

__all__ = [
    "GridError",
    "MissingPieceError",
    "Track",
    "ZeroLikelihoodError",
    "bootstrap_filter",
    "gaussian",
    "grid_filter",
    "kalman_filter",
    "models",
    "resampling",
    "weights",
]
