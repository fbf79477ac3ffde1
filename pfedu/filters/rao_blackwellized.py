"""The Rao-Blackwellised particle filter: particles for what is not linear, Kalman filters for the rest. Chapter 11."""

import numpy as np

from pfedu.filters.kalman_bank import mixture_moments
from pfedu.filters.loop import Algorithm, particle_filter
from pfedu.gaussian import sqrt_cov
from pfedu.kalman import update
from pfedu.models import ConditionallyLinear, JumpMarkov, MissingPieceError
from pfedu.resampling import ratio


def rao_blackwellized_filter(model, y, n_particles, *, rng, resampling="systematic", policy=ratio(0.5), keep=False,
                             n_runs=None):  # fmt: skip
    r"""Draw only what must be drawn, and know the rest exactly.

    Each particle is a path of u (the nonlinear part of the state, or the mode) and the Gaussian that a Kalman filter
    makes of z along that path,

    .. math::
        u_k^{(i)} \sim p(u_k \mid u_{0:k-1}^{(i)}, Y_{k-1}), \qquad
        w_k^{(i)} \propto w_{k-1}^{(i)}\, N(y_k; \hat y_k^{(i)}, S_k^{(i)}), \qquad
        p(z_k \mid u_{0:k}^{(i)}, Y_k) = N(m_k^{(i)}, P_k^{(i)})

    Averages over z are then integrals, not sums over draws, which never increases the variance (Rao-Blackwell).
    Where no matrix of the model depends on u, all particles share one covariance. Sources: Schön, Gustafsson and
    Nordlund (2005); Doucet, Gordon and Krishnamurthy (2001) for jump-Markov systems; Crassidis, lecture 19.

    Parameters
    ----------
    model : ConditionallyLinear or JumpMarkov
    y, n_particles, rng, resampling, policy, keep, n_runs
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`; kept particles are (u, m).

    Returns
    -------
    Track
        Of the whole state (u, z): the mean of a mode is its expected number, for two modes the probability of
        mode 1.

    Raises
    ------
    MissingPieceError
        If the model states no linear part.
    ValueError, ZeroLikelihoodError
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`.

    Examples
    --------
    >>> import pfedu
    >>> model = pfedu.models.positioning()
    >>> x, y = model.simulate(20, np.random.default_rng(1))
    >>> track = pfedu.rao_blackwellized_filter(model, y, 500, rng=np.random.default_rng(2))
    >>> track.mean.shape
    (21, 6)
    """
    if isinstance(model, ConditionallyLinear):
        start, predict, predicted_measurement = _mixed(model)
    elif isinstance(model, JumpMarkov):
        start, predict, predicted_measurement = _jumping(model)
    else:
        raise MissingPieceError(
            f"{type(model).__name__} states no linear part, which Rao-Blackwellisation needs: use "
            "pfedu.models.ConditionallyLinear or JumpMarkov"
        )

    def weigh(k, y, particles):
        u, m, P = particles
        y_hat, C, R = predicted_measurement(k, u, m)
        m, P, log_g = update(m, P, y - y_hat, C, R)
        return (u, m, P), np.broadcast_to(log_g, u.shape[:-1])

    algorithm = Algorithm(
        propose=lambda k, y, particles, rng: weigh(k, y, predict(k, particles, rng)),
        start=start,
        first=lambda y, particles: weigh(0, y, particles),
        predict=predict,
        state=lambda particles: np.concatenate(particles[:2], axis=-1),
        moments=_moments,
    )
    return particle_filter(
        algorithm, model, y, n_particles, rng=rng, resampling=resampling, policy=policy, keep=keep, n_runs=n_runs
    )


def _moments(particles, log_w):
    """Of the whole state: u is a point in each particle, z a Gaussian."""
    u, m, P = particles
    whole = np.zeros((*P.shape[:-2], u.shape[-1] + m.shape[-1], u.shape[-1] + m.shape[-1]))
    whole[..., u.shape[-1] :, u.shape[-1] :] = P
    return mixture_moments((np.concatenate([u, m], axis=-1), whole), log_w)


def _mixed(model):
    """The steps of a conditionally linear model."""
    n = model.n_u

    def start(runs, count, rng):
        return _draw_part(np.broadcast_to(model.m0, (*runs, count, model.n_x)), model.P0, n, rng)

    def predict(k, particles, rng):
        # (u, z) of time k is jointly Gaussian given u of time k-1: draw u, and condition z on it
        u, m, P = particles
        A = model.A(k, u)
        mean = model.f_u(k, u) + (A @ m[..., None])[..., 0]
        return _draw_part(mean, A @ P @ np.swapaxes(A, -1, -2) + model.Q, n, rng)

    def predicted_measurement(k, u, m):
        C = model.C(k, u)
        return model.h_u(k, u) + (C @ m[..., None])[..., 0], C, model.R

    return start, predict, predicted_measurement


def _draw_part(mean, cov, n, rng):
    r"""Draw the first n components of N(mean, cov); condition the others on the draw.

    .. math:: u \sim N(\mu_u, \Sigma_{uu}), \quad G = \Sigma_{zu} \Sigma_{uu}^{-1}, \quad
        z \mid u \sim N(\mu_z + G (u - \mu_u), \Sigma_{zz} - G \Sigma_{uz})
    """
    cov = np.broadcast_to(cov, (*mean.shape[:-2], *((1,) if cov.ndim == 2 else cov.shape[-3:-2]), *cov.shape[-2:]))
    uu, uz = cov[..., :n, :n], cov[..., :n, n:]
    d = (sqrt_cov(uu, "the covariance of u") @ rng.standard_normal((*mean.shape[:-1], n, 1)))[..., 0]
    G = _regression(uu, uz)
    # what is left of z: as the square of a root, which rounding cannot make negative as it can a difference
    root = sqrt_cov(cov, "the covariance of (u, z)")
    left = root[..., n:, :] - G @ root[..., :n, :]
    return mean[..., :n] + d, mean[..., n:] + (G @ d[..., None])[..., 0], left @ np.swapaxes(left, -1, -2)


def _regression(uu, uz):
    """The factor G by which z follows u; a component of u without noise tells nothing and is left out."""
    sd = np.sqrt(np.diagonal(uu, axis1=-2, axis2=-1))
    sd = np.where(sd > 0, sd, 1.0)[..., None]
    # of correlations: units do not matter
    correlations = uu / (sd * np.swapaxes(sd, -1, -2))
    return np.swapaxes(np.linalg.pinv(correlations, 1e-12, hermitian=True) @ (uz / sd) / sd, -1, -2)


def _jumping(model):
    """The steps of a jump-Markov linear system."""

    def start(runs, count, rng):
        s = model.draw_modes(np.broadcast_to(model.p0, (*runs, count, model.n_modes)), rng)
        m = np.broadcast_to(model.m0, (*runs, count, model.n_z))
        return s[..., None], m, np.broadcast_to(model.P0, (*m.shape, model.n_z))

    def predict(k, particles, rng):
        s, m, P = particles
        s = model.draw_modes(model.Pi[s[..., 0].astype(int)], rng)
        A, Q = model.A[s.astype(int)], model.Q[s.astype(int)]
        return s[..., None], (A @ m[..., None])[..., 0], A @ P @ np.swapaxes(A, -1, -2) + Q

    def predicted_measurement(k, s, m):
        i = s[..., 0].astype(int)
        return (model.C[i] @ m[..., None])[..., 0], model.C[i], model.R[i]

    return start, predict, predicted_measurement
