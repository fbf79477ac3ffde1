"""Gaussian noise: square roots of covariances, sampling and log density.

A covariance may be given as a scalar variance, a vector of variances (a diagonal) or a matrix.
N(m, P) always states a *variance*, never a standard deviation.
"""

import numpy as np

_LOG_2PI = np.log(2.0 * np.pi)


def as_cov(cov, name="cov"):
    """Covariance matrix from a scalar, a vector of variances or a matrix.

    Parameters
    ----------
    cov : array_like, shape (), (n,) or (..., n, n)
        Variances in squared units of the variable.
    name : str
        What to call it in an error.

    Returns
    -------
    ndarray, shape (n, n) or (..., n, n)

    Raises
    ------
    ValueError
        If it is not square, not finite or not symmetric.

    Examples
    --------
    >>> from pfedu.gaussian import as_cov
    >>> as_cov([1.0, 4.0]).tolist()
    [[1.0, 0.0], [0.0, 4.0]]
    """
    cov = np.array(cov, dtype=float)  # a copy: what the caller does to his array later changes no model
    if cov.ndim < 2:
        cov = np.diag(np.atleast_1d(cov))
    if cov.shape[-1] != cov.shape[-2]:
        raise ValueError(f"{name} must be a scalar, a vector of variances or a square matrix, got shape {cov.shape}")
    if not np.isfinite(cov).all():
        raise ValueError(f"{name} has an entry that is not finite: {_first(cov, ~np.isfinite(cov).all((-2, -1)))}")
    sd = np.sqrt(np.abs(np.diagonal(cov, axis1=-2, axis2=-1)))
    skew = np.abs(cov - np.swapaxes(cov, -1, -2)) > 1e-8 * sd[..., None] * sd[..., None, :]
    if skew.any():
        raise ValueError(f"{name} is not symmetric: {_first(cov, skew.any((-2, -1)))}")
    return cov


def _first(cov, bad):
    """The first bad matrix of a stack, for a message: one a particle would fill the screen."""
    return cov[bad][0].tolist()


def cholesky(cov):
    """Cholesky factor; raises wherever numpy runs, while in the page numpy itself gives NaN.

    Parameters
    ----------
    cov : ndarray, shape (..., n, n)

    Returns
    -------
    ndarray, shape (..., n, n)
        Lower triangular.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a matrix is not positive definite.

    Examples
    --------
    >>> from pfedu.gaussian import cholesky
    >>> cholesky(np.array([[4.0]])).tolist()
    [[2.0]]
    """
    return _or_raise(np.linalg.cholesky(cov), cov)


def solve(A, B):
    """Solution X of A X = B; raises wherever numpy runs, while in the page numpy itself gives NaN.

    Parameters
    ----------
    A : ndarray, shape (..., n, n)
    B : ndarray, shape (..., n, m)

    Returns
    -------
    ndarray, shape (..., n, m)

    Raises
    ------
    numpy.linalg.LinAlgError
        If a matrix A is singular.

    Examples
    --------
    >>> from pfedu.gaussian import solve
    >>> solve(np.array([[4.0]]), np.array([[2.0]])).tolist()
    [[0.5]]
    """
    return _or_raise(np.linalg.solve(A, B), A, B)


def _or_raise(result, *given):
    if not np.isfinite(result).all() and all(np.isfinite(array).all() for array in given):
        raise np.linalg.LinAlgError("a singular matrix, or one that is not positive definite")
    return result


def sqrt_cov(cov, name="cov"):
    r"""A matrix S with :math:`S S^\top = P`, also for a singular P.

    The Cholesky factor where there is one, else the eigenvector root, so that a state known exactly
    (variance zero) needs no special case. In a stack, one matrix without a Cholesky factor gives all
    of them the eigenvector root.

    Parameters
    ----------
    cov : array_like, shape (), (n,) or (..., n, n)
        Covariance, positive semi-definite.
    name : str
        What to call it in an error.

    Returns
    -------
    ndarray, shape (..., n, n)

    Raises
    ------
    ValueError
        If a variance is negative, or zero beside a covariance that is not, or an eigenvalue of the
        correlations is negative beyond rounding.

    Examples
    --------
    >>> from pfedu.gaussian import sqrt_cov
    >>> sqrt_cov([9.0, 0.0]).tolist()
    [[3.0, 0.0], [0.0, 0.0]]
    """
    cov = as_cov(cov, name)
    try:
        return cholesky(cov)
    except np.linalg.LinAlgError:
        variances = np.diagonal(cov, axis1=-2, axis2=-1)  # (..., n)
    if (variances < 0).any():
        raise ValueError(f"{name} is not positive semi-definite: it has the variance {variances.min():.3g}")
    tiny = np.sqrt(np.finfo(float).tiny)  # a standard deviation below it may be zero because its square underflows
    lost = (variances == 0)[..., None] & (np.abs(cov) > tiny * np.maximum(np.sqrt(variances), tiny)[..., None, :])
    if lost.any():
        raise ValueError(f"{name} is not positive semi-definite: a variance of zero has the covariance "
                         f"{cov[lost][0]:.3g}")  # fmt: skip
    if not (cov * (1.0 - np.eye(cov.shape[-1]))).any():  # diagonal: keep it readable
        return np.sqrt(cov)
    sd = np.sqrt(np.where(variances > 0, variances, 1.0))[..., None]  # (..., n, 1)
    values, vectors = np.linalg.eigh(cov / (sd * np.swapaxes(sd, -1, -2)))  # of correlations: units do not matter
    if (values < -1e-10).any():
        raise ValueError(
            f"{name} is not positive semi-definite: its correlations have the eigenvalue {values.min():.3g}"
        )
    return sd * vectors * np.sqrt(np.clip(values, 0.0, None))[..., None, :]


class Gaussian:
    r"""Zero-mean Gaussian noise N(0, P), factored once and then used at every step.

    Parameters
    ----------
    cov : array_like, shape (), (n,) or (n, n)
        Covariance P, positive semi-definite, in squared units of the variable.
    name : str
        What to call it in an error.

    Raises
    ------
    ValueError
        If the covariance is not positive semi-definite.

    Examples
    --------
    >>> from pfedu.gaussian import Gaussian
    >>> noise = Gaussian(4.0)
    >>> noise.sample((3,), np.random.default_rng(1)).shape
    (3, 1)
    >>> round(float(noise.log_density(np.array([2.0]))), 4)
    -2.1121
    """

    def __init__(self, cov, name="cov"):
        self.name = name
        self.cov = as_cov(cov, name)
        if self.cov.ndim != 2:
            raise ValueError(f"{name} must be one matrix (n, n), got shape {self.cov.shape}")
        self.n = self.cov.shape[-1]
        self.root = sqrt_cov(self.cov, name)
        diagonal, sd = np.diag(self.root), np.sqrt(np.diag(self.cov))
        # what is left of each standard deviation once the others are known: rounding alone leaves about 1e-8
        self.is_singular = not np.array_equal(self.root, np.tril(self.root)) or (diagonal <= 1e-6 * sd).any()
        if not self.is_singular:
            self._whiten = np.linalg.inv(self.root)
            self._log_norm = -0.5 * self.n * _LOG_2PI - np.log(diagonal).sum()

    def sample(self, shape, rng):
        """Draw noise.

        Parameters
        ----------
        shape : tuple of int
            Leading axes, one vector for each.
        rng : numpy.random.Generator

        Returns
        -------
        ndarray, shape (..., n)
        """
        z = rng.standard_normal((*shape, self.n))
        if self.n > 1:
            return z @ self.root.T
        z *= self.root[0, 0]
        return z

    def log_density(self, d):
        """Log density at deviation ``d`` from the mean.

        Parameters
        ----------
        d : ndarray, shape (..., n)

        Returns
        -------
        ndarray, shape (...)

        Raises
        ------
        ValueError
            If the covariance is singular: it then has no density.
        """
        if self.is_singular:
            raise ValueError(f"{self.name} is singular and has no density: {self.cov.tolist()}")
        if self.n == 1:
            z = d[..., 0] * (self._whiten[0, 0] * np.sqrt(0.5))
            z *= z  # in place: at 100 000 particles, time goes into fresh memory
            return np.subtract(self._log_norm, z, out=z if np.ndim(z) else None)
        z = d @ self._whiten.T
        return self._log_norm - 0.5 * np.sum(z * z, axis=-1)


def log_density(x, mean, cov, name="cov"):
    r"""Log of the Gaussian density N(x; m, P), one or many at a time.

    Parameters
    ----------
    x, mean : array_like, shape (..., n)
        Point and mean, in the same units.
    cov : array_like, shape (), (n,) or (..., n, n)
        Covariance, positive definite.
    name : str
        What to call it in an error.

    Returns
    -------
    ndarray, shape (...)

    Raises
    ------
    ValueError
        If the covariance is not positive definite or its size does not fit.

    Examples
    --------
    >>> from pfedu.gaussian import log_density
    >>> round(float(log_density([1.0], [0.0], 1.0)), 4)
    -1.4189
    """
    d = np.atleast_1d(np.asarray(x, dtype=float) - np.asarray(mean, dtype=float))
    cov = as_cov(cov, name)
    if d.shape[-1] != cov.shape[-1]:
        raise ValueError(f"points of {d.shape[-1]} components do not fit a covariance of shape {cov.shape}")
    try:
        root = cholesky(cov)
    except np.linalg.LinAlgError as error:
        smallest = np.linalg.eigvalsh(cov)[..., 0]
        raise ValueError(f"{name} is not positive definite: {_first(cov, smallest == smallest.min())}") from error
    z = np.linalg.solve(root, d[..., None])[..., 0]
    log_det = np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=-1)
    return -0.5 * np.sum(z * z, axis=-1) - log_det - 0.5 * d.shape[-1] * _LOG_2PI
