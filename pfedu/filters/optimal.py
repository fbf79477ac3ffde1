"""The optimal importance density, where it can be had: a linear measurement. Chapter 6."""

import numpy as np

from pfedu.filters.loop import Algorithm, particle_filter
from pfedu.gaussian import Gaussian
from pfedu.models import require
from pfedu.resampling import ratio


def optimal_filter(model, y, n_particles, *, rng, resampling="systematic", policy=ratio(0.5), keep=False, n_runs=None):
    r"""Draw particles where the measurement says they are, and weigh where they came from.

    .. math::
        x_k^{(i)} \sim p(x_k \mid x_{k-1}^{(i)}, y_k), \qquad
        w_k^{(i)} \propto w_{k-1}^{(i)} \, p(y_k \mid x_{k-1}^{(i)})

    No other density that uses the same particle and measurement gives weights of smaller variance: given
    :math:`x_{k-1}^{(i)}` the weight does not depend on where the particle lands, and could be computed before
    it moves. Sources: Doucet, Godsill and Andrieu (2000), proposition 2 and section II-D; Crassidis, lecture 19.

    Parameters
    ----------
    model : AdditiveGaussian
        With a matrix H: additive Gaussian noise and a linear measurement.
    y, n_particles, rng, resampling, policy, keep, n_runs
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`. The first measurement weighs draws from the prior.

    Returns
    -------
    Track

    Raises
    ------
    MissingPieceError
        If the measurement of the model is not stated as linear (it has no H).
    ValueError, ZeroLikelihoodError
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`.

    Examples
    --------
    >>> import pfedu
    >>> model = pfedu.models.ratio(q=1.0, r=0.01)
    >>> x, y = model.simulate(50, np.random.default_rng(1))
    >>> best = pfedu.optimal_filter(model, y, 500, rng=np.random.default_rng(2))
    >>> blind = pfedu.bootstrap_filter(model, y, 500, rng=np.random.default_rng(2))
    >>> bool(np.median(best.n_eff) > 5 * np.median(blind.n_eff))
    True
    """
    move, evidence = conditioned(model, "the optimal importance density")

    def propose(k, y, x, rng):
        f = model.f(k, x)
        return move(y, f, rng), evidence(y, f)

    return particle_filter(
        Algorithm(propose), model, y, n_particles, rng=rng, resampling=resampling, policy=policy, keep=keep,
        n_runs=n_runs,
    )  # fmt: skip


def conditioned(model, purpose):
    r"""The two densities into which a step and a linear measurement fall apart.

    .. math::
        p(x_k, y_k \mid x_{k-1}) = \underbrace{N(y_k; H f, S)}_{\text{evidence}} \;
        \underbrace{N(x_k; f + K (y_k - H f), \Sigma)}_{\text{move}}, \qquad
        S = H Q H^\top + R, \quad K = Q H^\top S^{-1}, \quad \Sigma = Q - K H Q

    with :math:`f = f(k, x_{k-1})`. All three matrices are the same for every particle.

    Parameters
    ----------
    model : AdditiveGaussian
        With H.
    purpose : str
        What asks for it, for the message.

    Returns
    -------
    move : callable
        ``(y, f, rng) -> x``, draws (..., N, n_x) about f (..., N, n_x).
    evidence : callable
        ``(y, f) -> (..., N)``, log density of y given the particle of time k-1.

    Raises
    ------
    MissingPieceError
        If the model has no H.
    ValueError
        If S is singular, or the process noise is not simply added.

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.filters.optimal import conditioned
    >>> move, evidence = conditioned(pfedu.models.random_walk(q=1.0, r=1e-8), "an example")
    >>> move(np.array([5.0]), np.zeros((2, 1)), np.random.default_rng(1)).round(2).ravel().tolist()
    [5.0, 5.0]
    """
    for piece in ("f", "Q", "H", "R"):
        require(model, piece, purpose)
    if not model.noise_is_additive:
        raise ValueError(f"the noise of {type(model).__name__} is not simply added, which {purpose} needs")
    H, Q = model.H, model.Q
    S = Gaussian(H @ Q @ H.T + model.R, "S = H Q H' + R")
    if S.is_singular:
        raise ValueError(f"{S.name} is singular: a measurement without noise of what the process noise does not move")
    K = np.linalg.solve(S.cov, H @ Q).T
    A = np.eye(model.n_x) - K @ H
    Sigma = Gaussian(A @ Q @ A.T + K @ model.R @ K.T, "Sigma")

    def move(y, f, rng):
        return f + (y - f @ H.T) @ K.T + Sigma.sample(f.shape[:-1], rng)

    def evidence(y, f):
        return S.log_density(y - f @ H.T)

    return move, evidence
