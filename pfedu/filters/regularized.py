"""The regularised particle filter: copies are spread by a kernel. Chapter 9."""

from math import exp, lgamma, log, pi, sqrt

import numpy as np

from pfedu.filters.loop import Algorithm, particle_filter
from pfedu.gaussian import sqrt_cov
from pfedu.resampling import ratio
from pfedu.weights import weighted_moments

KERNELS = ("epanechnikov", "gaussian")


def regularized_filter(model, y, n_particles, *, rng, kernel="epanechnikov", bandwidth=None, shrink=False,
                       resampling="systematic", policy=ratio(0.5), keep=False, n_runs=None):  # fmt: skip
    r"""Bootstrap filter that draws from a smooth density instead of copying points.

    .. math::
        x \leftarrow x + h D \varepsilon, \qquad D D^\top = \operatorname{cov}(x), \qquad \varepsilon \sim K

    after each resampling and only then, with the covariance of the weighted particles before it. Copies of one
    particle part again, also where the process noise is too small to part them. The price is a cloud that is
    wider by the variance of the kernel; with ``shrink=True`` particles are first drawn together,

    .. math:: x \leftarrow m + a (x - m) + h D \varepsilon, \qquad a = \sqrt{1 - h^2 \sigma_K^2},

    which leaves mean and covariance as they were. Either way the estimate is no longer exact in the limit of many
    particles for a fixed h; the optimal h vanishes with N. Sources: Musso, Oudjane and Le Gland (2001); Liu and
    West (2001) for shrinkage; Crassidis, lecture 19 ("Regularization").

    Parameters
    ----------
    model : StateSpaceModel
        As for the bootstrap filter.
    kernel : str
        ``"epanechnikov"`` or ``"gaussian"``.
    bandwidth : float, optional
        h, in standard deviations of the cloud; :func:`optimal_bandwidth` by default. 0 is no kernel: the bootstrap
        filter, bit for bit.
    shrink : bool
        Whether to draw the cloud together first.
    y, n_particles, rng, resampling, policy, keep, n_runs
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`.

    Returns
    -------
    Track

    Raises
    ------
    ValueError
        If the kernel is unknown, the bandwidth negative, infinite, or too large to shrink by; and as in
        :func:`~pfedu.filters.bootstrap.bootstrap_filter`.
    ZeroLikelihoodError
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`.

    Examples
    --------
    A parameter that does not move: copies of it stay copies in the bootstrap filter, and part in this one.

    >>> import pfedu
    >>> model, y = pfedu.models.random_walk(q=0.0, r=1.0, p0=1.0), np.zeros((51, 1))
    >>> smooth = pfedu.regularized_filter(model, y, 500, rng=np.random.default_rng(1), keep=True)
    >>> blind = pfedu.bootstrap_filter(model, y, 500, rng=np.random.default_rng(1), keep=True)
    >>> len(np.unique(smooth.particles[-1])), bool(len(np.unique(blind.particles[-1])) < 400)
    (500, True)
    """
    _require_kernel(kernel)
    h = optimal_bandwidth(n_particles, model.n_x, kernel) if bandwidth is None else float(bandwidth)
    spread = h * h * (1.0 if kernel == "gaussian" else 1.0 / (model.n_x + 4))  # variance that the kernel adds
    if not 0 <= h < np.inf:
        raise ValueError(f"bandwidth must be a number of at least 0, got {h}")
    if shrink and spread >= 1:
        raise ValueError(f"to shrink a cloud the kernel must be narrower than it: with bandwidth {h:.3g} its variance "
                         f"is {spread:.3g} times that of the cloud; use a smaller one or more particles")  # fmt: skip

    def perturb(x, before, log_w, rng):
        mean, cov = weighted_moments(before, log_w)
        if shrink:
            m = mean[..., None, :]
            x = m + np.sqrt(1.0 - spread) * (x - m)
        D = sqrt_cov(cov, "the covariance of the particles")
        return x + h * draw_kernel(kernel, x.shape, rng) @ np.swapaxes(D, -1, -2)

    def propose(k, y, x, rng):
        x = model.propagate(k, x, rng)
        return x, model.log_likelihood(k, y, x)

    return particle_filter(
        Algorithm(propose, perturb=perturb if h > 0 else None), model, y, n_particles, rng=rng,
        resampling=resampling, policy=policy, keep=keep, n_runs=n_runs,
    )  # fmt: skip


def optimal_bandwidth(n_particles, n_x, kernel="epanechnikov"):
    r"""Bandwidth of the least mean integrated square error that many particles allow, if the density is Gaussian.

    .. math::
        h = \left(\frac{4}{n_x + 2}\right)^{\frac{1}{n_x + 4}} N^{-\frac{1}{n_x + 4}} \text{ (Gaussian)}, \qquad
        h = \left(8 c_{n_x}^{-1} (n_x + 4) (2 \sqrt\pi)^{n_x}\right)^{\frac{1}{n_x + 4}} N^{-\frac{1}{n_x + 4}}
        \text{ (Epanechnikov)}

    with :math:`c_n` the volume of the unit ball in n dimensions. Sources: Silverman (1986), section 4.3; Musso,
    Oudjane and Le Gland (2001).

    Parameters
    ----------
    n_particles : int
        Their number, N.
    n_x : int
        Dimension of the state.
    kernel : str
        ``"epanechnikov"`` or ``"gaussian"``.

    Returns
    -------
    float
        In standard deviations of the density.

    Raises
    ------
    ValueError
        If a number is not a whole one of at least 1, or the kernel unknown.

    Examples
    --------
    >>> from pfedu.filters.regularized import optimal_bandwidth
    >>> round(optimal_bandwidth(500, 3, "gaussian"), 4), round(optimal_bandwidth(500, 3), 4)
    (0.3986, 1.0253)
    """
    _require_kernel(kernel)
    for name, value in {"n_particles": n_particles, "n_x": n_x}.items():
        if not (value >= 1 and value == int(value)):
            raise ValueError(f"{name} must be a whole number of at least 1, got {value}")
    if kernel == "gaussian":
        log_constant = log(4.0 / (n_x + 2))
    else:
        log_ball = n_x / 2 * log(pi) - lgamma(n_x / 2 + 1)
        log_constant = log(8.0 * (n_x + 4)) - log_ball + n_x * log(2.0 * sqrt(pi))
    return exp((log_constant - log(n_particles)) / (n_x + 4))


def draw_kernel(kernel, shape, rng):
    r"""Draw from a kernel in whitened coordinates.

    The Gaussian kernel is N(0, I). The Epanechnikov kernel has the density
    :math:`\propto 1 - |\varepsilon|^2` in the unit ball: a direction at random, and a radius whose square is
    distributed as Beta(n/2, 2); its covariance is :math:`I / (n + 4)`.

    Parameters
    ----------
    kernel : str
        ``"epanechnikov"`` or ``"gaussian"``.
    shape : tuple of int
        (..., n).
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (..., n)

    Raises
    ------
    ValueError
        If the kernel is unknown.

    Examples
    --------
    >>> from pfedu.filters.regularized import draw_kernel
    >>> draws = draw_kernel("epanechnikov", (10_000, 2), np.random.default_rng(1))
    >>> bool((np.linalg.norm(draws, axis=-1) < 1).all()), bool(np.allclose(np.cov(draws.T), np.eye(2) / 6, atol=0.01))
    (True, True)
    """
    _require_kernel(kernel)
    z = rng.standard_normal(shape)
    if kernel == "gaussian":
        return z
    radius = np.sqrt(rng.beta(shape[-1] / 2, 2.0, size=shape[:-1]))
    return z * (radius / np.linalg.norm(z, axis=-1))[..., None]


def _require_kernel(kernel):
    if kernel not in KERNELS:
        raise ValueError(f"kernel must be one of {', '.join(KERNELS)}, got {kernel!r}")
