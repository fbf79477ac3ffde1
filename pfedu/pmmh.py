r"""Parameters of a model from its particle filter: particle marginal Metropolis-Hastings. Chapter 14."""

from dataclasses import dataclass, replace

import numpy as np

from pfedu.filters import bootstrap_filter
from pfedu.gaussian import Gaussian
from pfedu.models import read_only, streams
from pfedu.weights import ZeroLikelihoodError


@dataclass(frozen=True)
class Chain:
    """Draws of the parameters, each depending on the one before.

    Leading axes ``...`` are independent chains; step 0 is the start.

    Attributes
    ----------
    theta : ndarray, shape (..., K, d)
        Parameters at each step; one that was rejected leaves the old ones standing once more.
    log_likelihood : ndarray, shape (..., K)
        The estimate of log p(Y_T | theta) that was kept with them.
    accepted : ndarray of bool, shape (..., K)
        Whether the step moved.

    Examples
    --------
    >>> from pfedu.pmmh import Chain
    >>> chain = Chain(np.arange(8.0)[:, None], np.zeros(8), np.arange(8) % 2 == 1)
    >>> chain.after(4).mean.tolist(), float(chain.after(4).acceptance)
    ([5.5], 0.5)
    """

    theta: np.ndarray
    log_likelihood: np.ndarray
    accepted: np.ndarray

    @property
    def mean(self):
        """Mean of the parameters over the steps: (..., d)."""
        return self.theta.mean(axis=-2)

    @property
    def acceptance(self):
        """Share of the steps that moved, the start being one that did not: (...)."""
        return self.accepted.mean(axis=-1)

    def after(self, n):
        """The chain without its first n steps, which remember the start.

        Parameters
        ----------
        n : int
            Fewer than it has.

        Returns
        -------
        Chain

        Raises
        ------
        ValueError
            If nothing would be left.
        """
        steps = self.accepted.shape[-1]
        if not 0 <= n < steps:
            raise ValueError(f"the chain has {steps} steps, of which {n} cannot be left out")
        return replace(self, theta=self.theta[..., n:, :], log_likelihood=self.log_likelihood[..., n:],
                       accepted=self.accepted[..., n:])  # fmt: skip

    def standard_error(self, n_batches=20):
        """Standard error of the mean, from the means of batches of consecutive steps.

        Steps depend on each other, so that their own scatter says too little; batches much longer than that
        dependence lasts are nearly independent. Source: Geyer, *Practical Markov chain Monte Carlo* (1992),
        section 3.2.

        Parameters
        ----------
        n_batches : int
            At least 2; steps that do not fill a batch are left out at the beginning.

        Returns
        -------
        ndarray, shape (..., d)

        Raises
        ------
        ValueError
            If there are fewer steps than batches, or fewer than two batches.
        """
        steps, d = self.theta.shape[-2:]
        if not (2 <= n_batches <= steps and n_batches == int(n_batches)):
            raise ValueError(
                f"n_batches must be a whole number from 2 to the {steps} steps of the chain, got {n_batches}"
            )
        n_batches = int(n_batches)
        length = steps // n_batches
        rest = self.theta[..., steps - n_batches * length :, :]
        means = rest.reshape(*rest.shape[:-2], n_batches, length, d).mean(axis=-2)  # (..., batches, d)
        return means.std(axis=-2, ddof=1) / np.sqrt(n_batches)


def particle_metropolis_hastings(
    model_of, y, n_particles, *, log_prior, start, step_cov, n_steps, rng, filter=bootstrap_filter
):
    r"""Draw parameters from their posterior by a random walk that a particle filter judges.

    .. math::
        \theta' \sim N(\theta, \Sigma), \qquad
        \text{accept with probability }
        \min\left(1, \frac{\widehat Z(\theta')\, p(\theta')}{\widehat Z(\theta)\, p(\theta)}\right)

    :math:`\widehat Z(\theta)` is the estimate that was made when :math:`\theta` was accepted; it is kept, never made
    anew. As it is unbiased, the chain has the exact posterior :math:`p(\theta \mid Y_T)` for every number of particles;
    a small N costs acceptances, not correctness. Source: Andrieu, Doucet and Holenstein, *Particle Markov chain
    Monte Carlo methods* (2010), section 2.4.2.

    Parameters
    ----------
    model_of : callable
        ``(theta) -> StateSpaceModel``, for theta (d,) where the prior is positive. With several chains theta is
        (n_chains, d), and the functions of the model must take states (n_chains, N, n_x); a model of ``theta[0]``
        would give all chains the parameters of the first.
    y : array_like, shape (T+1, n_y)
        Measurements, row k is time k. A row of NaN is missing.
    n_particles : int
        N.
    log_prior : callable
        ``(theta (..., d)) -> (...)``, log p(theta) up to a constant; -inf where theta cannot be.
    start : array_like, shape (d,) or (n_chains, d)
        Where the chain, or each of several independent chains, begins.
    step_cov : array_like, shape (), (d,) or (d, d)
        Covariance of the random walk's step; a scalar or a vector of variances is a diagonal.
    n_steps : int
        K: the chain has one more element, its start.
    rng : numpy.random.Generator
        Three generators are spawned off it: for the filters, the steps and the decisions.
    filter : callable
        ``(model, y, n_particles, rng=rng) -> Track`` whose likelihood is unbiased: any particle filter, with options
        fixed by ``functools.partial``.

    Returns
    -------
    Chain
        With theta (K+1, d) or (n_chains, K+1, d).

    Raises
    ------
    ValueError
        If a shape or a value does not fit, or the prior is zero where a chain starts.
    ZeroLikelihoodError
        If no particle explains the record at the start. Later on, in a single chain, that is an estimate of zero,
        and rejected; of several chains it stops all, as it cannot be told which the others were (a filter of one's
        own may give -inf for the one).

    Examples
    --------
    How strongly does a state return to zero? The prior is uniform between 0 and 1:

    >>> import pfedu
    >>> def model_of(theta):
    ...     return pfedu.models.LinearGaussian(F=theta[0], H=1.0, Q=1.0, R=1.0, m0=0.0, P0=1.0)
    >>> x, y = model_of([0.5]).simulate(20, np.random.default_rng(1))
    >>> chain = pfedu.particle_metropolis_hastings(
    ...     model_of, y, 30, log_prior=lambda theta: np.where((theta[0] > 0) & (theta[0] < 1), 0.0, -np.inf),
    ...     start=[0.5], step_cov=0.1, n_steps=100, rng=np.random.default_rng(2))
    >>> chain.theta.shape, bool(0 < chain.mean[0] < 1)
    ((101, 1), True)
    """
    theta, step, n_steps = _checked(start, step_cov, n_steps)
    y = np.asarray(y, dtype=float)
    y = y[:, None] if y.ndim == 1 else y
    rng_filter, rng_step, rng_decide = streams(rng, 3)
    records = np.broadcast_to(y, (*theta.shape[:-1], *y.shape))
    log_p = _log_prior(log_prior, theta)
    _start_there(theta, log_p, "the prior", ValueError)
    log_z = _log_likelihood(filter, model_of, theta, records, n_particles, rng_filter)
    _start_there(theta, log_z, "the estimate of the likelihood", ZeroLikelihoodError)
    states = [(theta, log_z, np.zeros(log_p.shape, dtype=bool))]
    for _ in range(n_steps):
        # Propose, and judge only what the prior allows
        proposed = theta + step.sample(theta.shape[:-1], rng_step)
        log_p_new = _log_prior(log_prior, proposed)
        inside = log_p_new > -np.inf
        log_z_new = np.full(log_p.shape, -np.inf)
        if inside.any():
            there = np.where(inside[..., None], proposed, theta)
            try:
                log_z_new = _log_likelihood(filter, model_of, there, records, n_particles, rng_filter)
            except ZeroLikelihoodError:
                if theta.ndim > 1:
                    raise
        # Accept or stay; the estimate stays with its parameters
        odds = np.where(inside, log_z_new + log_p_new - log_z - log_p, -np.inf)
        moved = -rng_decide.standard_exponential(log_p.shape) < odds
        theta = np.where(moved[..., None], proposed, theta)
        log_z, log_p = np.where(moved, log_z_new, log_z), np.where(moved, log_p_new, log_p)
        states.append((theta, log_z, moved))
    theta, log_z, moved = zip(*states, strict=True)
    return Chain(np.stack(theta, -2), np.stack(log_z, -1), np.stack(moved, -1))


def _checked(start, step_cov, n_steps):
    theta = np.array(start, dtype=float)
    if theta.ndim not in (1, 2) or theta.size == 0 or not np.isfinite(theta).all():
        raise ValueError(f"start must be finite parameters (d,), or one row a chain (n_chains, d); got {start!r}")
    if not (1 <= n_steps < np.inf and n_steps == int(n_steps)):
        raise ValueError(f"n_steps must be a whole number of at least 1, got {n_steps}")
    if np.ndim(step_cov) == 0:
        step_cov = np.full(theta.shape[-1], step_cov)
    step = Gaussian(step_cov, "step_cov")
    if step.n != theta.shape[-1]:
        raise ValueError(f"step_cov is {step.n} x {step.n}, but there are {theta.shape[-1]} parameters")
    return theta, step, int(n_steps)


def _start_there(theta, log_p, what, error):
    """A start where something is zero is an error, which names the first such."""
    zero = np.atleast_1d(np.isneginf(log_p))
    if zero.any():
        raise error(f"{what} is zero at the start {np.atleast_2d(theta)[zero][0].tolist()}: start where it is not")


def _log_prior(log_prior, theta):
    log_p = np.asarray(log_prior(read_only(theta)), dtype=float)
    if log_p.shape != theta.shape[:-1]:
        raise ValueError(f"log_prior must give shape {theta.shape[:-1]} for theta {theta.shape}, it gave {log_p.shape}")
    if not (log_p < np.inf).all():  # false for NaN too
        raise ValueError(f"log_prior must be finite or -inf, it is {log_p[~(log_p < np.inf)][0]} somewhere")
    return log_p


def _log_likelihood(filter, model_of, theta, records, n_particles, rng):
    log_z = filter(model_of(read_only(theta)), records, n_particles, rng=rng).log_likelihood
    if np.shape(log_z) != theta.shape[:-1] or not np.less(log_z, np.inf).all():  # false for NaN too
        raise ValueError(
            f"the filter must give one log-likelihood a chain, shape {theta.shape[:-1]}, and no NaN or inf; got {log_z}"
        )
    return log_z
