"""Local linearisation: one small Kalman filter inside every particle proposes where it goes. Chapter 8."""

import numpy as np

from pfedu.filters.loop import Algorithm, particle_filter
from pfedu.gaussian import log_density, sqrt_cov
from pfedu.kalman import linearised, require_gaussian
from pfedu.models import require
from pfedu.resampling import ratio
from pfedu.unscented import Unscented, sampled

PROPOSALS = ("ekf", "ukf")


def local_linear_filter(model, y, n_particles, *, rng, proposal="ekf", carry=False, defensive=0.0,
                        resampling="systematic", policy=ratio(0.5), keep=False, n_runs=None):  # fmt: skip
    r"""Draw each particle from the Gaussian that its own Kalman filter makes of the measurement.

    .. math::
        (m^{(i)}, P^{(i)}) = \text{EKF or UKF}(x_{k-1}^{(i)}, P_{k-1}^{(i)}, y_k), \qquad
        x_k^{(i)} \sim N(m^{(i)}, P^{(i)}), \qquad
        w_k^{(i)} \propto w_{k-1}^{(i)} \frac{p(y_k \mid x_k^{(i)})\, p(x_k^{(i)} \mid x_{k-1}^{(i)})}
        {N(x_k^{(i)}; m^{(i)}, P^{(i)})}

    The weight makes the filter right however rough the Gaussian is, as long as its tails are not thinner than those
    of the density it stands for; the defensive mixture sees to that. Sources: van der Merwe et al. (2000);
    Crassidis, lecture 19 ("Local linearized particle filter"); Hesterberg (1995) for the mixture.

    Parameters
    ----------
    model : AdditiveGaussian
        With a transition density: additive noise and a regular Q.
    proposal : str
        ``"ekf"`` (tangents) or ``"ukf"`` (sigma points: alpha 1, beta 2, kappa 0).
    carry : bool
        Whether each particle carries the covariance of its filter on to the next step, as the lecture has it. The
        transition density knows :math:`x_{k-1}^{(i)}` as a point, whose covariance is zero: that is the default.
    defensive : float
        Share of particles, from 0 to 1, that are drawn from the transition instead; all are weighed against the
        mixture of both, so that no weight exceeds the likelihood over this share.
    y, n_particles, rng, resampling, policy, keep, n_runs
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`. The first measurement weighs draws from the prior.

    Returns
    -------
    Track

    Raises
    ------
    MissingPieceError
        If the model has no functions f and h with Gaussian noise, or no transition density.
    ValueError
        If an option is none of these, or Q or R is singular; and as in
        :func:`~pfedu.filters.bootstrap.bootstrap_filter`.
    ZeroLikelihoodError
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`.

    Examples
    --------
    >>> import pfedu
    >>> model = pfedu.models.growth()
    >>> x, y = model.simulate(50, np.random.default_rng(1))
    >>> track = pfedu.local_linear_filter(model, y, 200, proposal="ukf", rng=np.random.default_rng(2))
    >>> track.mean.shape
    (51, 1)
    """
    predict, correct = _updates(model, proposal, defensive)
    n = model.n_x

    def start(runs, count, rng):
        x = model.sample_initial(int(np.prod(runs)) * count, rng).reshape(*runs, count, n)
        return x, np.zeros((*x.shape, n) if carry else (*x.shape[:-2], 1, n, n))

    def first(y, particles):
        return particles, model.log_likelihood(0, y, particles[0])

    def blind(k, particles, rng):
        x, P = particles
        return model.propagate(k, x, rng), predict(k, x, P)[1] if carry else P

    def propose(k, y, particles, rng):
        x, P = particles
        f, prior = predict(k, x, P) if carry else (model.f(k, x), np.broadcast_to(model.Q, (*x.shape, n)))
        m, cov, _ = correct(k, f, prior, y)
        new = m + (sqrt_cov(cov, "the proposal") @ rng.standard_normal((*x.shape, 1)))[..., 0]
        new, log_q = _defended(model, k, x, new, m, cov, defensive, rng)
        log_g = model.log_likelihood(k, y, new) + model.log_transition(k, new, x) - log_q
        return (new, cov if carry else P), log_g

    return particle_filter(
        Algorithm(propose, start, first, blind), model, y, n_particles, rng=rng, resampling=resampling, policy=policy,
        keep=keep, n_runs=n_runs,
    )  # fmt: skip


def _updates(model, proposal, defensive):
    require_gaussian(model, "local linearisation")
    require(model, "log_transition", "local linearisation")
    if model.w.is_singular:
        raise ValueError(f"Q is singular, so that the step has no density to weigh by: {model.Q.tolist()}")
    if model.v.is_singular:
        raise ValueError(f"R is singular, the proposal has no density to weigh by: {model.R.tolist()}")
    if proposal not in PROPOSALS:
        raise ValueError(f"proposal must be one of {', '.join(PROPOSALS)}, got {proposal!r}")
    if not 0 <= defensive <= 1:
        raise ValueError(f"defensive is a share between 0 and 1, got {defensive}")
    return linearised(model) if proposal == "ekf" else sampled(model, Unscented())


def _defended(model, k, x, new, m, cov, share, rng):
    """Replace a share of the draws by draws of the transition; log density of the mixture at all of them."""
    if share == 0:
        return new, log_density(new, m, cov, "the proposal")
    swap = rng.random(x.shape[:-1]) < share
    new = np.where(swap[..., None], model.propagate(k, x, rng), new)
    # a share of one leaves log 0 to the proposal; a run whose measurement is missing has no proposal, but NaN
    with np.errstate(divide="ignore", invalid="ignore"):
        log_proposal = np.log1p(-share) + log_density(new, m, cov, "the proposal")
        return new, np.logaddexp(log_proposal, np.log(share) + model.log_transition(k, new, x))
