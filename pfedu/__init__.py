"""pfedu: the algorithms of the book "Particle Filters, Alive", each as its chapter tells it.

Importing it needs numpy alone. Figures, explorers and their hosts are imported where they are used:
``pfedu.figures``, ``pfedu.explorers``, ``pfedu.live``.
"""

from pfedu import dimension, gaussian, importance, models, resampling, studies, weights
from pfedu.filters import (
    auxiliary_filter,
    bootstrap_filter,
    kalman_bank_filter,
    local_linear_filter,
    optimal_filter,
    rao_blackwellized_filter,
    regularized_filter,
)
from pfedu.grid import GridError, grid_filter
from pfedu.importance import importance_sample
from pfedu.kalman import extended_kalman_filter, kalman_filter
from pfedu.models import MissingPieceError
from pfedu.particle_filter import ParticleFilter
from pfedu.track import Track
from pfedu.unscented import unscented_kalman_filter
from pfedu.weights import ZeroLikelihoodError

__version__ = "0.1.0"

__all__ = [
    "GridError",
    "MissingPieceError",
    "ParticleFilter",
    "Track",
    "ZeroLikelihoodError",
    "auxiliary_filter",
    "bootstrap_filter",
    "dimension",
    "extended_kalman_filter",
    "gaussian",
    "grid_filter",
    "importance",
    "importance_sample",
    "kalman_bank_filter",
    "kalman_filter",
    "local_linear_filter",
    "models",
    "optimal_filter",
    "rao_blackwellized_filter",
    "regularized_filter",
    "resampling",
    "studies",
    "unscented_kalman_filter",
    "weights",
]
