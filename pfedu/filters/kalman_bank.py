"""A bank of Kalman filters, one a particle, with resampling: as it is often told, and as it is right. Chapter 8."""

import numpy as np

from pfedu.filters.loop import Algorithm, particle_filter
from pfedu.kalman import linearised, require_gaussian
from pfedu.resampling import always
from pfedu.unscented import Unscented, sampled
from pfedu.weights import weighted_moments

FILTERS = ("ekf", "ukf")


def kalman_bank_filter(model, y, n_particles, *, rng, kalman="ekf", use_twice=False, resampling="systematic",
                       policy=always, keep=False, n_runs=None):  # fmt: skip
    r"""Run a Kalman filter for each particle and resample the bank.

    Each particle is a Gaussian, :math:`N(m^{(i)}, P^{(i)})`, that starts as a point drawn from the prior, and

    .. math::
        w_k^{(i)} \propto w_{k-1}^{(i)} N(y_k; h(m_k^{-(i)}), S_k^{(i)}),

    the evidence that its own filter finds for the measurement *before* it is corrected by it. The posterior is the
    mixture of these Gaussians: exact in the limit of many particles for a linear model, for others as good as the
    linearisation. It is a Gaussian sum filter (Alspach and Sorenson 1972) that resamples.

    With ``use_twice=True`` it is the filter of the chapter after Simon: particles are moved with process noise,
    weighed by the likelihood where they are, *and* moved towards the measurement by their Kalman filter. The same
    measurement then counts twice, and no number of particles mends that.

    Parameters
    ----------
    model : AdditiveGaussian
    kalman : str
        ``"ekf"`` or ``"ukf"`` (alpha 1, beta 2, kappa 0).
    use_twice : bool
        The form that uses each measurement twice, to see what it does.
    policy : callable
        Always, by default, as in the chapter.
    y, n_particles, rng, resampling, keep, n_runs
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`; kept particles are the means.

    Returns
    -------
    Track

    Raises
    ------
    MissingPieceError
        If the model has no functions f and h with Gaussian noise.
    ValueError
        If ``kalman`` is none of these, or ``"ukf"`` where noise is not simply added; and as in
        :func:`~pfedu.filters.bootstrap.bootstrap_filter`.
    ZeroLikelihoodError
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`.

    Examples
    --------
    >>> import pfedu
    >>> model = pfedu.models.random_walk()
    >>> x, y = model.simulate(20, np.random.default_rng(1))
    >>> bank = pfedu.kalman_bank_filter(model, y, 100, rng=np.random.default_rng(2))
    >>> bool(np.abs(bank.mean - pfedu.kalman_filter(model, y).mean)[5:].max() < 1e-3)
    True
    """
    require_gaussian(model, "a bank of Kalman filters")
    if kalman not in FILTERS:
        raise ValueError(f"kalman must be one of {', '.join(FILTERS)}, got {kalman!r}")
    if kalman == "ukf" and not model.noise_is_additive:
        raise ValueError(f"the noise of {type(model).__name__} is not simply added: use kalman='ekf'")
    predict, correct = linearised(model) if kalman == "ekf" else sampled(model, Unscented())

    def start(runs, n, rng):
        m = model.sample_initial(int(np.prod(runs)) * n, rng).reshape(*runs, n, model.n_x)
        return m, np.zeros((*m.shape, model.n_x))

    def blind(k, bank, rng):
        m, P = predict(k, *bank)
        return (model.propagate(k, bank[0], rng) if use_twice else m), P

    def weigh(k, y, bank):
        m, P, evidence = correct(k, *bank, y)
        return (m, P), model.log_likelihood(k, y, bank[0]) if use_twice else evidence

    algorithm = Algorithm(
        propose=lambda k, y, bank, rng: weigh(k, y, blind(k, bank, rng)),
        start=start,
        first=lambda y, bank: weigh(0, y, bank),
        predict=blind,
        moments=(lambda bank, log_w: weighted_moments(bank[0], log_w)) if use_twice else mixture_moments,
    )
    return particle_filter(
        algorithm, model, y, n_particles, rng=rng, resampling=resampling, policy=policy, keep=keep, n_runs=n_runs
    )


def mixture_moments(bank, log_w):
    r"""Mean and covariance of a mixture of Gaussians.

    .. math:: m = \sum_i w^{(i)} m^{(i)}, \qquad
        P = \sum_i w^{(i)} \left(P^{(i)} + (m^{(i)} - m)(m^{(i)} - m)^\top\right)

    Parameters
    ----------
    bank : tuple of ndarray
        Means (..., N, n_x) and covariances (..., N, n_x, n_x), or one covariance for all (..., 1, n_x, n_x).
    log_w : ndarray, shape (..., N)
        Normalised log weights.

    Returns
    -------
    mean : ndarray, shape (..., n_x)
    cov : ndarray, shape (..., n_x, n_x)

    Examples
    --------
    >>> from pfedu.filters.kalman_bank import mixture_moments
    >>> bank = np.array([[-1.0], [1.0]]), np.array([[[2.0]]])  # two Gaussians of variance 2
    >>> mixture_moments(bank, np.log([0.5, 0.5]))[1].tolist()
    [[3.0]]
    """
    m, P = bank
    mean, cov = weighted_moments(m, log_w)
    within = P[..., 0, :, :] if P.shape[-3] == 1 else np.einsum("...i,...ijk->...jk", np.exp(log_w), P)
    return mean, cov + within
