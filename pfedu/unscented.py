"""The unscented Kalman filter: a Gaussian is carried through a function by a few well chosen points."""

from dataclasses import dataclass

import numpy as np

from pfedu.gaussian import log_density, solve, sqrt_cov
from pfedu.kalman import gaussian_filter, require_gaussian

NOISES = ("additive", "augmented")


@dataclass(frozen=True)
class Unscented:
    r"""The scaled unscented transform.

    .. math::
        \mathcal X_0 = m, \quad \mathcal X_{\pm j} = m \pm \sqrt{n + \lambda}\, S_j, \quad
        \lambda = \alpha^2 (n + \kappa) - n, \quad S S^\top = P

    .. math::
        W_0^m = \frac{\lambda}{n + \lambda}, \quad W_0^c = W_0^m + 1 - \alpha^2 + \beta, \quad
        W_j = \frac{1}{2 (n + \lambda)}

    Sources: Julier (2002); Wan and van der Merwe (2000); Crassidis, lecture 19, has alpha = 1, beta = 2, kappa = 0.

    Parameters
    ----------
    alpha, beta, kappa : float
        Spread of the points; prior knowledge of the kurtosis (2 for a Gaussian); secondary spread.

    Raises
    ------
    ValueError
        If alpha is not positive.

    Examples
    --------
    >>> from pfedu.unscented import Unscented
    >>> points = Unscented().points(np.array([1.0]), np.array([[4.0]]))
    >>> points.ravel().tolist()
    [1.0, 3.0, -1.0]
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self):
        if not self.alpha > 0:
            raise ValueError(f"alpha must be positive, got {self.alpha}")

    def _spread(self, n):
        spread = self.alpha**2 * (n + self.kappa)  # n + lambda
        if not spread > 0:
            raise ValueError(f"alpha^2 (n + kappa) must be positive for n = {n}, got {spread}: use a larger kappa")
        return spread

    def points(self, m, P, name="P"):
        """Sigma points of N(m, P): (..., 2n+1, n); ``name`` is what an error calls P."""
        n = m.shape[-1]
        arms = np.sqrt(self._spread(n)) * np.swapaxes(sqrt_cov(P, name), -1, -2)  # (..., n, n): a row an arm
        m = m[..., None, :]
        return np.concatenate([m, m + arms, m - arms], axis=-2)

    def weights(self, n):
        """Weights of the mean and of the covariance for n dimensions: twice (2n+1,)."""
        spread = self._spread(n)
        mean = np.full(2 * n + 1, 0.5 / spread)
        mean[0] = 1.0 - n / spread
        cov = mean.copy()
        cov[0] += 1.0 - self.alpha**2 + self.beta
        return mean, cov


def unscented_kalman_filter(model, y, *, noise="additive", alpha=1.0, beta=2.0, kappa=0.0):
    r"""Kalman filter whose moments are taken over sigma points.

    .. math::
        m^- = \sum_j W_j^m f(\mathcal X_j), \quad P^- = \sum_j W_j^c d_j d_j^\top + Q, \quad
        S = \sum_j W_j^c e_j e_j^\top + R, \quad K = \Big(\sum_j W_j^c d_j e_j^\top\Big) S^{-1}

    With ``noise="additive"`` Q is added to P⁻ and new points are drawn for the measurement. With ``"augmented"``
    the points span state and noise together, the noise enters the step where the model has it, and the same
    points serve the measurement: the form of the lecture, and the one for noise that is not simply added.
    Sources: Simon, *Optimal State Estimation* (2006), section 14.3; Crassidis, lecture 19.

    Parameters
    ----------
    model : AdditiveGaussian
    y : array_like, shape (..., T+1, n_y)
        Measurements, row k is time k; leading axes are independent records. A row of NaN is missing.
    noise : str
        ``"additive"`` or ``"augmented"``.
    alpha, beta, kappa : float
        As in :class:`Unscented`.

    Returns
    -------
    Track
        An approximation: nothing in it says how good.

    Raises
    ------
    MissingPieceError
        If the model has no functions f and h with Gaussian noise.
    ValueError
        If the record does not fit the model, or a covariance is not positive semi-definite.

    Examples
    --------
    >>> import pfedu
    >>> model, y = pfedu.models.random_walk(), [[1.0], [2.0]]
    >>> unscented, exact = pfedu.unscented_kalman_filter(model, y), pfedu.kalman_filter(model, y)
    >>> bool(np.allclose(unscented.mean, exact.mean, rtol=1e-12))
    True
    """
    if noise not in NOISES:
        raise ValueError(f"noise must be one of {', '.join(NOISES)}, got {noise!r}")
    require_gaussian(model, "the unscented Kalman filter")
    if noise == "additive" and not model.noise_is_additive:
        raise ValueError(f"the noise of {type(model).__name__} is not simply added: use noise='augmented'")
    transform = Unscented(alpha, beta, kappa)
    return gaussian_filter(
        model, y, *(sampled(model, transform) if noise == "additive" else augmented(model, transform))
    )


def sampled(model, transform):
    """The two updates with additive noise, for one Gaussian or many.

    Parameters
    ----------
    model : AdditiveGaussian
    transform : Unscented

    Returns
    -------
    predict : callable
        ``(k, m, P) -> (m, P)`` for m (..., n_x) and P (..., n_x, n_x).
    correct : callable
        ``(k, m, P, y) -> (m, P, log_likelihood)`` for y (..., n_y).

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.unscented import Unscented, sampled
    >>> predict, correct = sampled(pfedu.models.random_walk(q=1.0), Unscented())
    >>> predict(1, np.zeros((2, 1)), np.ones((2, 1, 1)))[1].ravel().tolist()
    [2.0, 2.0]
    """

    def predict(k, m, P):
        X = model.f(k, transform.points(m, P, f"the covariance of step {k}"))
        m, d, W = centred(X, transform, m.shape[-1])
        return m, np.swapaxes(d * W[:, None], -1, -2) @ d + model.Q

    def correct(k, m, P, y):
        X = transform.points(m, P, f"the covariance of step {k}")
        return by_points(model, k, m, y, X, transform, m.shape[-1])

    return predict, correct


def augmented(model, transform):
    """The two updates with points that span state and noise; the measurement uses the points of the prediction.

    Parameters
    ----------
    model : AdditiveGaussian
        Its ``step(k, x, w)`` says where the noise acts.
    transform : Unscented

    Returns
    -------
    predict, correct : callable
        As those of :func:`sampled`; ``correct`` belongs to the ``predict`` before it.

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.unscented import Unscented, augmented
    >>> predict, correct = augmented(pfedu.models.random_walk(q=1.0), Unscented())
    >>> predict(1, np.zeros((2, 1)), np.ones((2, 1, 1)))[1].round(12).ravel().tolist()
    [2.0, 2.0]
    """
    n, last = model.n_x, {}

    def predict(k, m, P):
        both = np.zeros((*P.shape[:-2], 2 * n, 2 * n))
        both[..., :n, :n], both[..., n:, n:] = P, model.Q
        mean = np.concatenate([m, np.zeros_like(m)], axis=-1)
        points = transform.points(mean, both, f"the covariance of step {k}")
        last["X"] = X = model.step(k, points[..., :n], points[..., n:])
        m, d, W = centred(X, transform, 2 * n)
        return m, np.swapaxes(d * W[:, None], -1, -2) @ d

    def correct(k, m, P, y):
        X = last.get("X")
        if X is None:  # time 0: nothing was predicted
            return sampled(model, transform)[1](k, m, P, y)
        return by_points(model, k, m, y, X, transform, 2 * n)

    return predict, correct


def centred(X, transform, n):
    r"""Weighted mean of points, and deviations with weights that make a covariance.

    .. math::
        m = \mathcal X_0 + \sum_{j \neq 0} W_j \delta_j, \quad
        P = \sum_{j \neq 0} W_j \delta_j \delta_j^\top + (\beta - \alpha^2) (\mathcal X_0 - m)(\mathcal X_0 - m)^\top,
        \quad \delta_j = \mathcal X_j - \mathcal X_0

    These are the sums of :class:`Unscented`, reordered: there, weights of the size of 1/alpha² nearly cancel.

    Parameters
    ----------
    X : ndarray, shape (..., 2n+1, m)
        Sigma points, or what a function made of them.
    transform : Unscented
    n : int
        Dimension the points span.

    Returns
    -------
    mean : ndarray, shape (..., m)
    d : ndarray, shape (..., 2n+1, m)
        First the deviation of the central point from the mean, then those of the others from the central point.
    weights : ndarray, shape (2n+1,)

    Examples
    --------
    >>> from pfedu.unscented import Unscented, centred
    >>> mean, d, W = centred(np.array([[0.0], [1.0], [-1.0]]) ** 2, Unscented(), 1)
    >>> mean.tolist(), (W @ d**2).tolist()  # the mean of a squared N(0, 1), and its variance
    ([1.0], [2.0])
    """
    weights = transform.weights(n)[0]
    d = X - X[..., :1, :]
    mean = X[..., 0, :] + weights @ d
    d[..., 0, :] = X[..., 0, :] - mean
    weights[0] = transform.beta - transform.alpha**2
    return mean, d, weights


def by_points(model, k, m, y, X, transform, n):
    r"""Correct a Gaussian of mean m by a measurement that is predicted from its points X.

    .. math:: P \leftarrow \sum_j W_j (d_j - K e_j)(d_j - K e_j)^\top + K R K^\top

    Parameters
    ----------
    model : AdditiveGaussian
    k : int
    m : ndarray, shape (..., n_x)
        Mean a priori.
    y : ndarray, shape (..., n_y)
    X : ndarray, shape (..., 2n+1, n_x)
    transform : Unscented
    n : int
        Dimension the points span.

    Returns
    -------
    m, P : ndarray
        Mean and covariance a posteriori.
    log_likelihood : ndarray, shape (...)

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.unscented import Unscented, by_points
    >>> m, P, ut = np.zeros(1), np.ones((1, 1)), Unscented()
    >>> model = pfedu.models.random_walk(r=1.0)
    >>> by_points(model, 1, m, np.ones(1), ut.points(m, P), ut, 1)[0].round(12).tolist()
    [0.5]
    """
    (y_mean, e, W), (_, d, _) = (centred(points, transform, n) for points in (model.h(k, X), X))
    S = np.swapaxes(e * W[:, None], -1, -2) @ e + model.R
    try:
        K = np.swapaxes(solve(S, np.swapaxes(e * W[:, None], -1, -2) @ d), -1, -2)
    except np.linalg.LinAlgError as error:
        raise ValueError(f"step {k}: S is singular, a measurement without noise of something known") from error
    left = d - e @ np.swapaxes(K, -1, -2)  # as in Joseph's form: a difference of covariances loses digits
    P_new = np.swapaxes(left * W[:, None], -1, -2) @ left + K @ model.R @ np.swapaxes(K, -1, -2)
    return m + (K @ (y - y_mean)[..., None])[..., 0], P_new, log_density(y, y_mean, S)
