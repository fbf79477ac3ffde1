"""pfedu: the algorithms of the book "Particle Filters, Alive", each as its chapter tells it.

Importing it needs numpy alone. Figures, explorers and their hosts are imported where they are used:
``pfedu.figures``, ``pfedu.explorers``, ``pfedu.live``.
"""

from pfedu import checks, dimension, gaussian, importance, models, resampling, studies, weights
from pfedu.adaptive import kld_filter
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
from pfedu.pmmh import particle_metropolis_hastings
from pfedu.smoothing import backward_smoother, genealogy_smoother, grid_smoother, rts_smoother
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
    "backward_smoother",
    "bootstrap_filter",
    "checks",
    "dimension",
    "extended_kalman_filter",
    "gaussian",
    "genealogy_smoother",
    "grid_filter",
    "grid_smoother",
    "importance",
    "importance_sample",
    "kalman_bank_filter",
    "kalman_filter",
    "kld_filter",
    "local_linear_filter",
    "models",
    "optimal_filter",
    "particle_metropolis_hastings",
    "rao_blackwellized_filter",
    "regularized_filter",
    "resampling",
    "rts_smoother",
    "studies",
    "unscented_kalman_filter",
    "weights",
]
