"""Scalar systems: the worked examples of the foundations, and of half the book."""

import numpy as np

from pfedu.models.additive import AdditiveGaussian, AdditiveProcess, LinearGaussian


def random_walk(q=10.0, r=1.0, m0=0.0, p0=5.0):
    r"""The linear example of the lecture: a random walk measured with noise.

    .. math:: x_k = x_{k-1} + N(0, q), \qquad y_k = x_k + N(0, r), \qquad x_0 \sim N(m_0, p_0)

    Source: Crassidis, *Particle Filtering: Part II* (lecture 19), with q = 10, r = 1, p0 = 5.

    Parameters
    ----------
    q, r, p0 : float
        Variances.
    m0 : float
        Mean of the initial state.

    Returns
    -------
    LinearGaussian

    Examples
    --------
    >>> from pfedu.models import random_walk
    >>> random_walk().Q.tolist()
    [[10.0]]
    """
    return LinearGaussian(F=1.0, H=1.0, Q=q, R=r, m0=m0, P0=p0)


def local_level(y0, q, r):
    r"""A random walk that starts at the first measurement: the local level model.

    With nothing known before the first measurement (a flat prior), what is known after it is
    :math:`x_0 \sim N(y_0, r)`. A record filtered with this model must therefore not use its first
    row again: replace it by NaN. Source: Durbin and Koopman, *Time Series Analysis by State Space
    Methods*, chapter 2.

    Parameters
    ----------
    y0 : float
        First measurement.
    q, r : float
        Variances of the level's step and of the measurement.

    Returns
    -------
    LinearGaussian

    Examples
    --------
    >>> from pfedu.models import local_level
    >>> model = local_level(1120.0, q=1469.1, r=15099.0)
    >>> model.m0.tolist(), model.P0.tolist()
    ([1120.0], [[15099.0]])
    """
    return random_walk(q=q, r=r, m0=y0, p0=r)


def growth(q=10.0, r=1.0, p0=5.0, phase=0):
    r"""The univariate nonstationary growth model, whose posterior has several peaks.

    .. math::
        x_k = \frac{x_{k-1}}{2} + \frac{25 x_{k-1}}{1 + x_{k-1}^2} + 8\cos(1.2 (k - \text{phase})) + N(0, q),
        \qquad y_k = \frac{x_k^2}{20} + N(0, r)

    Sources: Gordon, Salmond and Smith (1993) print the cosine with the index of the old state
    (``phase=1``); the code of Crassidis' lecture 19 uses that of the new one (``phase=0``). A filter
    must use the phase its record was made with.

    Parameters
    ----------
    q, r, p0 : float
        Variances of process noise, measurement noise and initial state (mean zero).
    phase : int
        By how many steps the cosine lags behind the index of the new state.

    Returns
    -------
    AdditiveGaussian

    Examples
    --------
    >>> from pfedu.models import growth
    >>> growth().f(1, np.array([0.0])).round(4).tolist()
    [2.8989]
    """

    def f(k, x):
        return x * (0.5 + 25 / (1 + x * x)) + 8 * np.cos(1.2 * (k - phase))

    def slope(k, x):
        return (0.5 + 25 * (1 - x * x) / (1 + x * x) ** 2)[..., None]

    return AdditiveGaussian(f=f, h=lambda k, x: x * x / 20, Q=q, R=r, m0=0.0, P0=p0,
                            jacobian_f=slope, jacobian_h=lambda k, x: x[..., None] / 10)  # fmt: skip


def ratio(q=0.1, r=1.0, p0=10.0, power=3):
    r"""The lecture's example of the optimal importance density, and its tame sister.

    .. math:: x_k = \frac{x_{k-1}^2}{1 + x_{k-1}^n} + N(0, q), \qquad y_k = x_k + N(0, r), \qquad x_0 \sim N(0, p_0)

    With n = 3 the motion has a pole at -1: a particle that comes near it is thrown far away, from where it
    comes back to 0. With n = 2 it has none. The lecture prints one where its code has the other (Crassidis,
    lecture 19, "Example").

    Parameters
    ----------
    q, r, p0 : float
        Variances of process noise, measurement noise and initial state.
    power : int
        The n of the denominator: 3, or 2 for the sister without a pole.

    Returns
    -------
    AdditiveGaussian
        With H, as the measurement is linear.

    Raises
    ------
    ValueError
        If the power is neither 2 nor 3.

    Examples
    --------
    >>> from pfedu.models import ratio
    >>> ratio().f(1, np.array([2.0])).round(4).tolist(), ratio(power=2).f(1, np.array([2.0])).tolist()
    ([0.4444], [0.8])
    """
    if power not in (2, 3):
        raise ValueError(f"the denominator is 1 + x^3, or 1 + x^2 without a pole: power must be 3 or 2, got {power}")

    def f(k, x):
        far, near = split(x)
        with np.errstate(divide="ignore"):  # at the pole itself: infinitely far, where nothing is ever measured
            return np.where(far, np.where(far, x, 1.0) ** (2.0 - power), near * near / (1 + near**power))

    def slope(k, x):
        far, x = split(x)
        with np.errstate(divide="ignore"):
            return np.where(far, 0.0, (2 * x + (2 - power) * x ** (power + 1)) / (1 + x**power) ** 2)[..., None]

    def split(x):
        """Where a particle is so far away that powers overflow, although their ratio has a limit, and the others."""
        far = np.abs(x) > 1e50
        return far, np.where(far, 0.0, x)

    return AdditiveGaussian(f=f, h=1.0, Q=q, R=r, m0=0.0, P0=p0, jacobian_f=slope)


def stochastic_volatility(mu=-1.0, phi=0.97, q=0.04):
    r"""Returns whose variance wanders: the measurement says nothing of the sign, and little of the size.

    .. math::
        x_k = \mu + \varphi (x_{k-1} - \mu) + N(0, q), \qquad y_k = e^{x_k / 2} N(0, 1), \qquad
        x_0 \sim N\left(\mu, \frac{q}{1 - \varphi^2}\right)

    The state is the logarithm of the variance of a return, and starts where it wanders in the long run.
    Source: Kim, Shephard and Chib, *Stochastic volatility: likelihood inference and comparison with ARCH
    models* (1998), equation 1.

    Parameters
    ----------
    mu : float
        Mean of the log variance.
    phi : float
        How much of a deviation is left one step later; between -1 and 1.
    q : float
        Variance of the process noise.

    Returns
    -------
    AdditiveProcess

    Raises
    ------
    ValueError
        If phi is not between -1 and 1: the log variance then has no long run.

    Examples
    --------
    >>> from pfedu.models import stochastic_volatility
    >>> x, y = stochastic_volatility().simulate(100, np.random.default_rng(1))
    >>> y.shape
    (101, 1)
    """
    if not -1 < phi < 1:
        raise ValueError(f"phi must lie between -1 and 1, so that the log variance settles; got {phi}")

    def log_likelihood(k, y, x):
        return -0.5 * (np.log(2 * np.pi) + x + y * y * np.exp(-x))[..., 0]

    def measure(k, x, rng):
        return np.exp(x / 2) * rng.standard_normal(x.shape)

    return AdditiveProcess(lambda k, x: mu + phi * (x - mu), log_likelihood, Q=q, m0=mu, P0=q / (1 - phi**2),
                           measure=measure, jacobian_f=lambda k, x: np.full((*x.shape, 1), phi))  # fmt: skip
