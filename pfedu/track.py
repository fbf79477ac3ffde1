"""What every filter gives back, and how every filter reads its record."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Track:
    """The posterior of each time step, as one filter sees it.

    All filters give the same fields, so any two tracks can be laid over each other; what a filter
    does not have is None. Leading axes ``...`` are independent runs.

    Attributes
    ----------
    mean : ndarray, shape (..., T+1, n_x)
        Posterior means, in the units of the state; row k is time k.
    cov : ndarray, shape (..., T+1, n_x, n_x)
        Posterior covariances.
    log_likelihood_increments : ndarray, shape (..., T+1)
        log p(y_k | y_0, ..., y_{k-1}); zero where the measurement is missing.
    n_eff : ndarray, shape (..., T+1) or None
        Effective number of particles after weighing and before resampling.
    resampled : ndarray of bool, shape (..., T+1) or None
        Whether particles were resampled after the estimate of that step.
    particles : ndarray, shape (..., T+1, N, n_x) or None
        With ``keep=True``: the particles that carry the posterior of each step.
    log_weights : ndarray, shape (..., T+1, N) or None
        With ``keep=True``: their normalised log weights, before resampling.
    ancestors : ndarray of int, shape (..., T+1, N) or None
        With ``keep=True``: which particle of step k-1 each particle of step k comes from.
    grid : ndarray, shape (G,), or tuple of two, shapes (G_1,) and (G_2,), or None
        Grid filter: the nodes; for a state of two dimensions those of each axis.
    density : ndarray, shape (..., T+1, G) or (..., T+1, G_1, G_2), or None
        Grid filter: posterior density at the nodes, or at all pairs of them.

    Examples
    --------
    >>> import pfedu
    >>> track = pfedu.kalman_filter(pfedu.models.random_walk(), [[np.nan], [0.5], [1.0]])
    >>> track.mean.shape, track.cov.shape, track.n_eff
    ((3, 1), (3, 1, 1), None)
    """

    mean: np.ndarray
    cov: np.ndarray
    log_likelihood_increments: np.ndarray
    n_eff: np.ndarray | None = None
    resampled: np.ndarray | None = None
    particles: np.ndarray | None = None
    log_weights: np.ndarray | None = None
    ancestors: np.ndarray | None = None
    grid: np.ndarray | None = None
    density: np.ndarray | None = None

    @property
    def log_likelihood(self):
        """log p(y_0, ..., y_T), the sum of the increments: (...)."""
        return self.log_likelihood_increments.sum(axis=-1)

    @property
    def sd(self):
        """Posterior standard deviation of each state: (..., T+1, n_x)."""
        return np.sqrt(np.diagonal(self.cov, axis1=-2, axis2=-1))


def read_record(y, n_y):
    """Check a record of measurements and find its missing rows.

    Parameters
    ----------
    y : array_like, shape (..., T+1, n_y)
        One row a time step. A row of NaN is a missing measurement: it is predicted over, not
        corrected. A vector (T+1,) is taken as a record of a single quantity.
    n_y : int
        Number of quantities the model measures.

    Returns
    -------
    y : ndarray, shape (..., T+1, n_y)
    missing : ndarray of bool, shape (..., T+1)

    Raises
    ------
    ValueError
        If the shape does not fit, a value is infinite or masked, or a row is NaN in part only.

    Examples
    --------
    >>> from pfedu.track import read_record
    >>> y, missing = read_record([np.nan, 2.0], n_y=1)
    >>> y.shape, missing.tolist()
    ((2, 1), [True, False])
    """
    if np.ma.is_masked(y):
        raise ValueError("the record has masked values, whose mask would be lost: a missing measurement is NaN here, "
                         "y.astype(float).filled(np.nan)")  # fmt: skip
    y = np.asarray(y, dtype=float)
    if y.ndim == 1 and n_y == 1:
        y = y[:, None]
    if y.ndim < 2 or y.shape[-1] != n_y or y.shape[-2] == 0:
        raise ValueError(f"the record must have shape (..., T+1, {n_y}), one row a time step; got {y.shape}")
    nan = np.isnan(y)
    missing = nan.all(axis=-1)
    if (nan.any(axis=-1) != missing).any():
        row = np.argwhere(nan.any(axis=-1) != missing)[0].tolist()
        raise ValueError(f"row {row} of the record is NaN in part: a missing measurement is a row of NaN throughout")
    if np.isinf(y).any():
        raise ValueError(f"the record has an infinite value in row {np.argwhere(np.isinf(y).any(axis=-1))[0].tolist()}")
    return y, missing
