r"""The curse of dimensionality, in closed form where there is one. Chapter 10.

The setting is the simplest in which the curse can be seen: n_x independent coordinates, each Gaussian a
priori and measured on its own with Gaussian noise. The exact answer is a Kalman filter a coordinate; the
particle filter puts all coordinates into one particle and multiplies their weights.

Everything is said by one number, the gain K of the weighing: the share of the variance of the innovation
that comes from the spread of the particles. Measured in units of the innovation's standard deviation the
particles have variance K, the noise 1 - K, the posterior K (1 - K), and z is the scaled innovation, N(0, 1).
(In terms of rho, noise over prior variance, K = 1 / (1 + rho).)
"""

from dataclasses import dataclass

import numpy as np

from pfedu.models import streams
from pfedu.weights import effective_sample_size, normalize


def steady_state(q=1.0, r=1.0):
    r"""Variances of a measured random walk once they have settled.

    A step and a measurement change the variance by :math:`P^- = P + q` and
    :math:`P = P^- r / (P^- + r)`; what stays the same solves
    :math:`(P^-)^2 - q P^- - q r = 0`, so that

    .. math:: P^- = \tfrac12 \left(q + \sqrt{q^2 + 4 q r}\right), \qquad P = P^- - q

    Source: the scalar Riccati equation; Simon, *Optimal State Estimation* (2006), section 7.3.

    Parameters
    ----------
    q, r : float
        Variances of process and measurement noise, above zero.

    Returns
    -------
    P_minus, P : float
        A priori and a posteriori variance.

    Raises
    ------
    ValueError
        If a variance is not above zero.

    Examples
    --------
    >>> from pfedu.dimension import steady_state
    >>> [round(float(P), 4) for P in steady_state(q=1, r=1)]
    [1.618, 0.618]
    """
    if not (0 < q < np.inf and 0 < r < np.inf):
        raise ValueError(f"q and r are variances above zero, got q = {q} and r = {r}")
    P_minus = 0.5 * (q + np.sqrt(q * q + 4.0 * q * r))
    return P_minus, P_minus * r / (P_minus + r)  # not P_minus - q, which cancels for large q


@dataclass(frozen=True)
class Proposal:
    r"""How well one coordinate's importance density fits, and what that costs in many coordinates.

    Made by :func:`bootstrap` and :func:`optimal`. ``Proposal(0.0)`` is the perfect one, independent draws
    from the posterior; ``Proposal(P / (P + r))`` weighs draws from N(0, P) by a likelihood of variance r.

    Parameters
    ----------
    K : float
        Gain of the weighing, from 0 (all weights equal) to below 1.
    fresh : float
        Share of the posterior variance that is drawn after, and independently of, the weights.

    Raises
    ------
    ValueError
        If K or fresh is out of range.

    Examples
    --------
    >>> from pfedu.dimension import Proposal
    >>> fair = Proposal(K=0.5)  # prior as wide as the likelihood
    >>> round(float(fair.growth()), 4), round(float(fair.growth() ** 10), 1)
    (1.6115, 118.1)
    """

    K: float
    fresh: float = 0.0

    def __post_init__(self):
        if not 0 <= self.K < 1:
            raise ValueError(f"the gain K must be at least 0 and below 1, got {self.K}")
        if not 0 <= self.fresh <= 1:
            raise ValueError(f"fresh is a share, from 0 to 1, got {self.fresh}")

    def factor(self, z=1.0):
        r"""What one coordinate divides N_eff by, for a scaled innovation z.

        .. math:: \kappa(z) = \frac{E[w^2]}{E[w]^2} = \frac{1}{\sqrt{1 - K^2}} \exp\left(\frac{K z^2}{1 + K}\right)

        In units of the innovation, w = N(z; x, 1-K) with x from N(0, K): E[w] is N(z; 0, 1), and
        w^2 is N(z; x, (1-K)/2) over the root of 4 pi (1-K), so that E[w^2] is N(z; 0, (1+K)/2) over the
        same root. Coordinates multiply, and :math:`N_\text{eff} \to N / \prod_j \kappa(z_j)`.

        Parameters
        ----------
        z : array_like
            Scaled innovation, in standard deviations; 1 is the typical one, since log kappa is linear
            in z^2 and the mean of z^2 is 1.

        Returns
        -------
        ndarray, shape of z

        Examples
        --------
        >>> from pfedu.dimension import Proposal
        >>> Proposal(0.6).factor([0.0, 1.0, 3.0]).round(2).tolist()
        [1.25, 1.82, 36.53]
        """
        return np.exp(self.K / (1.0 + self.K) * np.square(z)) / np.sqrt(1.0 - self.K**2)

    def growth(self, power=0.0):
        r"""Growth of N per dimension: the power mean over measurements of :meth:`factor`.

        .. math:: E[\kappa^p]^{1/p} = \frac{1}{\sqrt{1 - K^2}} \left(1 - \frac{2 p K}{1 + K}\right)^{-1/(2p)}, \qquad
            p \to 0: \ \frac{1}{\sqrt{1 - K^2}} \exp\left(\frac{K}{1 + K}\right)

        p = 0, the geometric mean, is the typical record: in the logarithm coordinates add, and their sum
        is close to its mean. p = -1 averages N_eff over measurements, p = 1 averages 1 / N_eff and the
        squared error: it is 1 / (1 - K), prior over posterior variance, and rests on records so rare and
        bad that a filter of any affordable N is past the end of the formula there.

        Parameters
        ----------
        power : float
            p.

        Returns
        -------
        float
            ``inf`` where the mean does not exist.

        Raises
        ------
        ValueError
            If the power is not finite.

        Examples
        --------
        >>> from pfedu.dimension import Proposal
        >>> [round(float(Proposal(0.5).growth(power)), 2) for power in (-1, 0, 1)]
        [1.49, 1.61, 2.0]
        """
        if not np.isfinite(power):
            raise ValueError(f"the power must be a finite number, got {power}")
        c = self.K / (1.0 + self.K)
        if abs(power) < 1e-17:  # the limit, to the last digit
            return self.factor(1.0)
        if 2.0 * power * c >= 1.0:
            return np.inf
        return np.exp(-0.5 / power * np.log1p(-2.0 * power * c)) / np.sqrt(1.0 - self.K**2)

    def log_weight_variance(self, z=1.0):
        r"""Variance of the log weight that one coordinate adds, for a scaled innovation z.

        .. math:: \tau^2 / n_x = \frac{K^2 / 2 + K z^2}{(1 - K)^2}

        The log weight is :math:`-(z - x)^2 / (2 (1 - K))` with x from N(0, K). Coordinates add.
        Source: Snyder, Bengtsson, Bickel and Anderson (2008).

        Parameters
        ----------
        z : array_like
            Scaled innovation; 1, the default, gives the mean over measurements.

        Returns
        -------
        ndarray, shape of z

        Examples
        --------
        >>> from pfedu.dimension import Proposal
        >>> float(Proposal(0.5).log_weight_variance())
        2.5
        """
        return (0.5 * self.K**2 + self.K * np.square(z)) / (1.0 - self.K) ** 2

    def divergence(self, z=1.0):
        r"""Kullback-Leibler divergence of the posterior from the proposal, one coordinate.

        .. math:: D = \tfrac12 \left(K (z^2 - 1) - \log(1 - K)\right)

        Coordinates add, and the edge of collapse is :math:`N \approx \exp(n_x D)`: with far fewer draws
        none lies where the posterior is, and a few carry all the weight, with far more the mean settles
        (Chatterjee and Diaconis 2018). A small error needs the larger N of :meth:`growth`.

        Parameters
        ----------
        z : array_like
            Scaled innovation; 1, the default, gives the mean over measurements.

        Returns
        -------
        ndarray, shape of z

        Examples
        --------
        >>> from pfedu.dimension import Proposal
        >>> round(float(np.exp(Proposal(0.75).divergence())), 4)
        2.0
        """
        return 0.5 * (self.K * (np.square(z) - 1.0) - np.log1p(-self.K))

    def error_factor(self, z):
        r"""N times the expected squared error a coordinate, in posterior variances, for given innovations.

        .. math:: \frac{N \, E|\widehat m - m|^2}{n_x P} \to \prod_j \kappa(z_j) \cdot
            \left[ f + (1 - f) \, \frac{1}{n_x} \sum_j \left( \frac{1}{1 + K} +
            \frac{K (1 - K) z_j^2}{(1 + K)^2} \right) \right]

        with f the fresh share. The delta method asks for :math:`E[w^2 (x - m)^2] / E[w]^2`. Under the
        squared weight x is Gaussian with variance K (1-K) / (1+K) and mean 2 K z / (1+K), where the
        posterior has variance K (1-K) and mean K z; the fresh part keeps its variance. Averaged over
        measurements too, the error is :math:`(1 - K)^{-n_x}`, ``growth(power=1) ** n_x``.

        Parameters
        ----------
        z : array_like, shape (..., n_x)
            Scaled innovations of all coordinates.

        Returns
        -------
        ndarray, shape (...)

        Examples
        --------
        >>> from pfedu.dimension import Proposal
        >>> Proposal(0.5).error_factor([[1.0, 1.0], [3.0, 3.0]]).round(1).tolist()
        [2.0, 896.5]
        """
        z = np.atleast_1d(np.asarray(z, dtype=float))
        spread = 1.0 / (1.0 + self.K) + self.K * (1.0 - self.K) / (1.0 + self.K) ** 2 * np.mean(z * z, axis=-1)
        return np.prod(self.factor(z), axis=-1) * (self.fresh + (1.0 - self.fresh) * spread)

    def n_eff_share(self, n_x, power=0.0):
        """N_eff / N in the limit of large N, ``growth(power) ** -n_x``.

        It holds while N is much larger than ``growth(power) ** n_x``, that is while the N_eff that it
        gives is itself large. An N_eff near or below 1 says only that the limit is out of reach; then
        ask :func:`simulate_weights`.

        Parameters
        ----------
        n_x : array_like of int
            Number of coordinates.
        power : float
            0 for the typical record, -1 for the mean of N_eff over measurements; see :meth:`growth`.

        Returns
        -------
        ndarray, shape of n_x
            Between 0 and 1.

        Examples
        --------
        >>> from pfedu.dimension import Proposal
        >>> Proposal(0.5).n_eff_share([1, 2, 10]).round(3).tolist()
        [0.621, 0.385, 0.008]
        """
        return self.growth(power) ** -_at_least(1, n_x=n_x)

    def particles_for_n_eff(self, n_eff, n_x):
        """N that a typical record needs for a given N_eff, ``n_eff * growth() ** n_x``.

        Parameters
        ----------
        n_eff : array_like
            Wanted effective number, well above 1 (see :meth:`n_eff_share`).
        n_x : array_like of int
            Number of coordinates.

        Returns
        -------
        ndarray
            Not rounded; ``inf`` where it is beyond the largest double.

        Examples
        --------
        >>> from pfedu.dimension import Proposal
        >>> Proposal(0.5).particles_for_n_eff(100, [1, 10]).round().tolist()
        [161.0, 11813.0]
        """
        with np.errstate(over="ignore"):
            return _at_least(1, n_eff=n_eff) * self.growth() ** _at_least(1, n_x=n_x)

    def particles_for_error(self, error, n_x, total=False):
        r"""N that a typical record needs for a given squared error of the mean.

        :meth:`error_factor` at z = 1, divided by the error. For independent draws from the posterior
        (K = 0) the mean of N draws has the variance P / N a coordinate, n_x P / N in all:

        .. math:: \text{per coordinate: } N = \frac{1}{\varepsilon}, \qquad \text{in all: } N = \frac{n_x}{\varepsilon}

        The second is the law N = c n of Daum and Huang (2003) for a good proposal, linear in the dimension
        because the error that is held fixed is the total one. It lasts while ``growth() ** n_x`` is near one,
        that is for n_x well below 1 / K: afterwards every proposal with K > 0 meets the exponential.

        For averages over measurements the formula gives the growth but not the last digit: with q = r = 1
        and an error of 0.05, one exact step of 10 coordinates needs 11 600 bootstrap particles
        (formula: 7200) and 170 optimal ones (177).

        Parameters
        ----------
        error : array_like
            :math:`\varepsilon`, wanted :math:`E|\widehat m - m|^2` in units of the posterior variance P
            of a coordinate.
        n_x : array_like of int
            Number of coordinates.
        total : bool
            Whether the error is that of all coordinates together instead of their mean.

        Returns
        -------
        ndarray
            Not rounded; ``inf`` where it is beyond the largest double.

        Raises
        ------
        ValueError
            If the error is not above zero, or n_x below 1.

        Examples
        --------
        >>> from pfedu.dimension import Proposal
        >>> Proposal(0.0).particles_for_error(0.05, [1, 10], total=True).tolist()
        [20.0, 200.0]
        >>> Proposal(0.5).particles_for_error(0.05, [1, 10]).round().tolist()
        [25.0, 1838.0]
        """
        error, n_x = np.asarray(error, dtype=float), _at_least(1, n_x=n_x)
        if not (error > 0).all():
            raise ValueError(f"the error must be above zero, got {error.min()}")
        one = self.error_factor(np.ones(1)) / self.factor()
        with np.errstate(over="ignore"):
            return one * self.growth() ** n_x / error * (n_x if total else 1.0)


def bootstrap(q=1.0, r=1.0):
    r"""Proposal of the bootstrap filter for a random walk in steady state.

    Particles have the variance :math:`P^-` and are weighed by the measurement, whose variance is r, so
    :math:`K = P^- / (P^- + r)`, the gain of the Kalman filter.

    Parameters
    ----------
    q, r : float
        Variances of process and measurement noise.

    Returns
    -------
    Proposal

    Raises
    ------
    ValueError
        If a variance is not above zero.

    Examples
    --------
    >>> from pfedu.dimension import bootstrap
    >>> round(float(bootstrap(q=1, r=1).growth()), 3)
    1.864
    """
    P_minus, _ = steady_state(q, r)
    return Proposal(float(P_minus / (P_minus + r)))


def optimal(q=1.0, r=1.0):
    r"""Proposal of the optimal importance density for a random walk in steady state.

    A particle is weighed *before* it moves, by :math:`p(y_k \mid x_{k-1})`: particles have the variance P
    of the last posterior, the measurement of them the variance q + r, so :math:`K = P / (P + q + r)`.
    The move is then drawn with the measurement known, with variance q r / (q + r): that part of the
    posterior variance is fresh.

    Parameters
    ----------
    q, r : float
        Variances of process and measurement noise.

    Returns
    -------
    Proposal

    Raises
    ------
    ValueError
        If a variance is not above zero.

    Examples
    --------
    >>> from pfedu.dimension import optimal
    >>> round(float(optimal(q=1, r=1).growth()), 3)
    1.246
    """
    _, P = steady_state(q, r)
    return Proposal(float(P / (P + q + r)), fresh=float(min(q * r / (q + r) / P, 1.0)))


def largest_weight(log_variance, n_particles):
    r"""Asymptotic law of the largest of N weights when few carry all.

    .. math:: E\left[\frac{1}{w_\text{max}}\right] \approx 1 + \frac{\sqrt{2 \log N}}{\tau}

    Let the log weights be :math:`\tau` times standard Gaussians. Given the largest Gaussian, M, the
    others lie below it with a density close to N times the Gaussian one, and each adds
    :math:`\exp(-\tau u)` to :math:`1 / w_\text{max}` if it is u below. For large :math:`\tau` only the
    density at u = 0 counts, and

    .. math:: E\left[\frac{1}{w_\text{max}}\right] - 1 \to \frac{1}{\tau} N (N-1) \int \phi^2 \Phi^{N-2}
        = \frac{E[M]}{\tau}

    by parts. Put :math:`\sqrt{2 \log N}`, the leading term of E[M], for it. Source: Bengtsson, Bickel
    and Li (2008); Snyder, Bengtsson, Bickel and Anderson (2008).

    No closed form is right in all regimes. This one holds when :math:`\tau^2` is much larger than log N
    *and* the log weights are nearly Gaussian that far out, which for a sum over coordinates takes many
    of them. Below that it overstates the collapse, without limit: a Gaussian likelihood has an upper end
    that a Gaussian log weight has not. :func:`simulate_weights` is right everywhere.

    Parameters
    ----------
    log_variance : array_like
        :math:`\tau^2`, variance of the log weight; ``n_x * proposal.log_weight_variance()``.
    n_particles : array_like of int
        Their number, N.

    Returns
    -------
    ndarray
        :math:`1 / E[1 / w_\text{max}]`, a little below the mean of the largest weight.

    Raises
    ------
    ValueError
        If the variance is not above zero, or N is below 1.

    Examples
    --------
    >>> from pfedu.dimension import bootstrap, largest_weight
    >>> tau2 = 400 * bootstrap(q=1, r=1).log_weight_variance()
    >>> round(float(largest_weight(tau2, 1000)), 2)
    0.93
    """
    log_variance = np.asarray(log_variance, dtype=float)
    if not (log_variance > 0).all():
        raise ValueError(f"the variance of the log weights must be above zero, got {log_variance.min()}")
    return 1.0 / (1.0 + np.sqrt(2.0 * np.log(_at_least(1, n_particles=n_particles)) / log_variance))


@dataclass(frozen=True)
class Weighing:
    """What one weighing of simulated particles came to; leading axes are independent runs.

    Attributes
    ----------
    log_weights : ndarray, shape (..., N)
        Normalised log weights.
    squared_error : ndarray, shape (...)
        Squared deviation of the weighted mean from the exact one, a coordinate, in posterior variances;
        averaged over the directions of what is drawn at right angles to the innovation.
    log_z_error : ndarray, shape (...)
        Error of the log-likelihood of the measurement.

    Examples
    --------
    >>> from pfedu.dimension import Weighing
    >>> float(Weighing(np.log([0.25, 0.75]), squared_error=0.1, log_z_error=0.0).largest_weight)
    0.75
    """

    log_weights: np.ndarray
    squared_error: np.ndarray
    log_z_error: np.ndarray

    @property
    def n_eff(self):
        """Effective number of particles: (...)."""
        return effective_sample_size(self.log_weights)

    @property
    def largest_weight(self):
        """Largest normalised weight: (...)."""
        return np.exp(self.log_weights.max(axis=-1))


def simulate_weights(proposal, n_x, n_particles, *, rng, n_runs=None, z=None):
    r"""Weigh particles of n_x coordinates once, at a cost that does not depend on n_x.

    .. math:: \log w = -\frac{(|z| - \sqrt K u)^2 + K c}{2 (1 - K)}, \qquad u \sim N(0, 1), \quad
        c \sim \chi^2_{n_x - 1}

    All coordinates being alike, the weight depends only on the distance of particle and measurement: turn
    the axes until the first lies along the innovation, and the others together give one chi-square. The
    particles are drawn from the exact density a priori, so this is one step of a filter that made no
    error before; one that carries the errors of its past needs more.

    Parameters
    ----------
    proposal : Proposal
    n_x, n_particles : int
        Number of coordinates and of particles.
    rng : numpy.random.Generator
        Three generators are spawned off it: innovations, and particles along and across them.
    n_runs : int, optional
        Do it that many times, independently, as one array.
    z : array_like, shape (n_x,) or (n_runs, n_x), optional
        Scaled innovations; drawn from N(0, 1) for each run by default.

    Returns
    -------
    Weighing

    Raises
    ------
    ValueError
        If a number is below 1 or not whole, or z has the wrong shape.

    Examples
    --------
    >>> from pfedu.dimension import bootstrap, simulate_weights
    >>> for n_x in (1, 10, 100):
    ...     runs = simulate_weights(bootstrap(), n_x, 1000, rng=np.random.default_rng(1), n_runs=400)
    ...     print(n_x, round(float(runs.largest_weight.mean()), 2))
    1 0.0
    10 0.31
    100 0.88
    """
    for name, number in {"n_x": n_x, "n_particles": n_particles, "n_runs": 1 if n_runs is None else n_runs}.items():
        if not isinstance(number, int | np.integer) or number < 1:
            raise ValueError(f"{name} must be a whole number of at least 1, got {number!r}")
    rng_z, rng_along, rng_across = streams(rng, 3)
    runs = () if n_runs is None else (n_runs,)
    K, fresh = proposal.K, proposal.fresh
    length = _length(rng_z.standard_normal((*runs, n_x)) if z is None else z, runs, n_x)[..., None]
    u = rng_along.standard_normal((*runs, n_particles))
    c = 2.0 * rng_across.standard_gamma((n_x - 1) / 2.0, u.shape)  # chi-square, also with no degree of freedom
    log_w, log_sum = normalize(-0.5 * ((length - np.sqrt(K) * u) ** 2 + K * c) / (1.0 - K))
    log_z = 0.5 * (n_x * np.log1p(-K) - length[..., 0] ** 2)
    w, w2 = np.exp(log_w), np.exp(2.0 * log_w)
    along = (np.sum(w * u, axis=-1) - np.sqrt(K) * length[..., 0]) ** 2
    weighed = (along + np.sum(w2 * c, axis=-1)) / (n_x * (1.0 - K))
    squared_error = fresh * np.sum(w2, axis=-1) + (1.0 - fresh) * weighed
    return Weighing(log_w, squared_error, log_sum - np.log(n_particles) - log_z)


def _length(z, runs, n_x):
    """Length of the innovation: (...), one a run."""
    z = np.asarray(z, dtype=float)
    if z.shape not in {(n_x,), (*runs, n_x)}:
        raise ValueError(f"z must have shape {(n_x,)} or {(*runs, n_x)}, got {z.shape}")
    if not np.isfinite(z).all():
        raise ValueError("z has an entry that is not finite")
    return np.broadcast_to(np.sqrt(np.sum(z * z, axis=-1)), runs)


def _at_least(least, **number):
    ((name, value),) = number.items()
    value = np.asarray(value, dtype=float)
    if not (value >= least).all():
        raise ValueError(f"{name} must be at least {least}, got {value.min()}")
    return value
