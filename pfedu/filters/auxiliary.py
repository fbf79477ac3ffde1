"""The auxiliary particle filter: ask the next measurement whom to copy. Chapter 7."""

from pfedu.filters.loop import Algorithm, particle_filter
from pfedu.filters.optimal import conditioned
from pfedu.models import require
from pfedu.resampling import always


def auxiliary_filter(model, y, n_particles, *, rng, look_ahead="mean", resampling="systematic", policy=always,
                     keep=False, n_runs=None):  # fmt: skip
    r"""Resample with a look ahead at the next measurement, then move and weigh.

    .. math::
        \eta^{(i)} = p(y_k \mid \mu_k^{(i)}), \qquad P(a = i) \propto w_{k-1}^{(i)} \eta^{(i)}, \qquad
        x_k \sim p(x_k \mid x_{k-1}^{(a)}), \qquad w_k \propto \frac{p(y_k \mid x_k)}{p(y_k \mid \mu_k^{(a)})}

    where :math:`\mu_k^{(i)}` is a point that stands for where particle i may go. First-stage weights carry
    :math:`w_{k-1}` (nothing is lost where a step does not resample), the second-stage weight takes back what the
    look ahead preferred, and the likelihood estimate is

    .. math:: \hat p(y_k \mid Y_{k-1}) = \Big(\sum_i w_{k-1}^{(i)} \eta^{(i)}\Big)
        \Big(\frac{1}{N} \sum_j \frac{p(y_k \mid x_k^{(j)})}{\eta^{(a_j)}}\Big),

    whose product over the steps is unbiased. That is no promise of a small variance. Where the process noise is large
    against the measurement noise, :math:`\eta` has thinner tails than what it stands for, and a few particles that it
    all but ruled out carry the weight when they are drawn, which is seldom: N_eff looks better than it is, and the
    variance of the likelihood estimate can be infinite. And a particle whose point has likelihood zero is never
    copied, wherever it might have gone. The exact look ahead has neither fault. Sources: Pitt and Shephard (1999);
    Crassidis, lecture 19 ("Auxiliary SIR filter"); Pitt et al. (2012), for the likelihood.

    Parameters
    ----------
    model : StateSpaceModel
        With what the bootstrap filter needs, and what the look ahead needs.
    look_ahead : str or callable
        ``"mean"``: :math:`\mu = f(k, x)`, the model's f. ``"draw"``: one draw of the transition. A function
        ``(k, x) -> mu`` of states (..., n_x): any other point. ``"exact"``: the fully adapted filter, which looks
        ahead by :math:`p(y_k \mid x_{k-1})` itself and then draws from the optimal importance density, so that all
        second-stage weights are equal; it needs additive Gaussian noise and a matrix H.
    policy : callable
        Always, by default; a look ahead acts only where one resamples. It is asked with the first-stage weights.
    y, n_particles, rng, resampling, keep, n_runs
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`.

    Returns
    -------
    Track
        ``resampled[k]``: whether particles of time k were resampled for the step to k+1.

    Raises
    ------
    MissingPieceError
        If the model lacks what the look ahead needs.
    ValueError, ZeroLikelihoodError
        As in :func:`~pfedu.filters.bootstrap.bootstrap_filter`.

    Examples
    --------
    >>> import numpy as np
    >>> import pfedu
    >>> model = pfedu.models.random_walk(q=0.1)
    >>> x, y = model.simulate(50, np.random.default_rng(1))
    >>> ahead = pfedu.auxiliary_filter(model, y, 500, rng=np.random.default_rng(2))
    >>> blind = pfedu.bootstrap_filter(model, y, 500, rng=np.random.default_rng(2))
    >>> bool(ahead.n_eff[1:].mean() > blind.n_eff[1:].mean())
    True
    """
    algorithm = _fully_adapted(model) if look_ahead == "exact" else _with_point(model, look_ahead)
    return particle_filter(
        algorithm, model, y, n_particles, rng=rng, resampling=resampling, policy=policy, keep=keep, n_runs=n_runs
    )


def _with_point(model, look_ahead):
    point = _point(model, look_ahead)

    def first_stage(k, y, x, rng):
        return model.log_likelihood(k, y, point(k, x, rng))

    def propose(k, y, x, rng):
        x = model.propagate(k, x, rng)
        return x, model.log_likelihood(k, y, x)

    return Algorithm(propose, look_ahead=first_stage)


def _point(model, look_ahead):
    if callable(look_ahead):
        return lambda k, x, rng: look_ahead(k, x)
    if look_ahead == "mean":
        require(model, "f", "looking ahead by the mean")
        return lambda k, x, rng: model.f(k, x)
    if look_ahead == "draw":
        return model.propagate
    raise ValueError(f"look_ahead must be 'mean', 'draw', 'exact' or a function (k, x) -> point, got {look_ahead!r}")


def _fully_adapted(model):
    move, evidence = conditioned(model, "the fully adapted filter")

    def first_stage(k, y, x, rng):
        return evidence(y, model.f(k, x))

    def propose(k, y, x, rng):
        f = model.f(k, x)
        return move(y, f, rng), evidence(y, f)

    return Algorithm(propose, look_ahead=first_stage)
