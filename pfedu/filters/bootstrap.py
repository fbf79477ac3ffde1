"""The bootstrap filter: sampling importance resampling (SIR). Chapter 3."""

from pfedu.filters.loop import particle_filter
from pfedu.resampling import ratio


def bootstrap_filter(
    model, y, n_particles, *, rng, resampling="systematic", policy=ratio(0.5), keep=False, n_runs=None
):
    r"""Move particles by the model, weigh them by the likelihood, resample.

    .. math:: x_k^{(i)} \sim p(x_k \mid x_{k-1}^{(i)}), \qquad w_k^{(i)} \propto w_{k-1}^{(i)} \, p(y_k \mid x_k^{(i)})

    Sources: Gordon, Salmond and Smith (1993); Simon, *Optimal State Estimation* (2006), section 15.2;
    Crassidis, lecture 19 ("SIR"). Estimates are taken before resampling, and weights that are not
    resampled are carried on.

    Parameters
    ----------
    model : StateSpaceModel
        With ``sample_initial``, ``propagate`` and ``log_likelihood``.
    y : array_like, shape (..., T+1, n_y)
        Measurements, row k is time k; leading axes are independent records. A row of NaN is missing:
        predicted over, not corrected, not resampled.
    n_particles : int
        Their number, N.
    rng : numpy.random.Generator
        A generator freshly made from the same seed gives the same bits. (Two are spawned off it at
        each call, so that restoring the state of its bit generator alone does not.)
    resampling : str or callable
        ``"multinomial"``, ``"residual"``, ``"stratified"``, ``"systematic"``, or a function
        ``(weights, rng, size=None) -> ancestors``.
    policy : callable
        ``ratio(share)``, ``interval(n)``, ``always`` or ``never`` of :mod:`pfedu.resampling`.
    keep : bool
        Keep particles, log weights and ancestors of each step.
    n_runs : int, optional
        Filter the same record that many times, independently, as one array.

    Returns
    -------
    Track

    Raises
    ------
    ValueError
        If an argument or a function of the model has the wrong shape or value.
    ZeroLikelihoodError
        If every particle has likelihood zero at some step.

    Examples
    --------
    >>> import numpy as np
    >>> import pfedu
    >>> model = pfedu.models.random_walk()
    >>> x, y = model.simulate(50, np.random.default_rng(1))
    >>> track = pfedu.bootstrap_filter(model, y, 1000, rng=np.random.default_rng(2))
    >>> exact = pfedu.kalman_filter(model, y)
    >>> bool(np.sqrt(np.mean((track.mean - exact.mean) ** 2)) < 0.1)
    True
    """

    def propose(k, y, x, rng):
        x = model.propagate(k, x, rng)
        return x, model.log_likelihood(k, y, x)

    return particle_filter(
        propose, model, y, n_particles, rng=rng, resampling=resampling, policy=policy, keep=keep, n_runs=n_runs
    )
