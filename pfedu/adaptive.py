r"""How many particles are enough, decided while filtering: KLD-sampling. Chapter 14."""

import numpy as np

from pfedu.filters.loop import Algorithm, advance, reweight
from pfedu.models import require, streams
from pfedu.resampling import scheme
from pfedu.track import Track, read_record
from pfedu.weights import effective_number


def kld_number(n_bins, epsilon=0.05, z=2.326):
    r"""How many draws from a histogram of so many bins bring the drawn one within epsilon of it.

    .. math::
        N = \frac{b - 1}{2 \varepsilon} \left(1 - \frac{2}{9 (b - 1)} + z \sqrt{\frac{2}{9 (b - 1)}}\right)^3

    If b bins have any probability, 2 N times the Kullback-Leibler divergence of the frequencies of N draws from the
    probabilities is nearly chi-square with b - 1 degrees of freedom. The bracket is Wilson and Hilferty's formula
    for its quantile at the probability where a standard normal has z. Source: Fox, *Adapting the sample size in
    particle filters through KLD-sampling* (2003).

    Parameters
    ----------
    n_bins : int or array_like of int
        b, at least 1; a single bin needs a single draw.
    epsilon : float
        Divergence that is allowed, positive.
    z : float
        Quantile of the standard normal: 2.326 allows it to be exceeded once in a hundred times, 1.645 once in twenty.

    Returns
    -------
    int, or ndarray of int
        Rounded up.

    Raises
    ------
    ValueError
        If there are no bins, or epsilon is not positive or asks for more than can be counted, or z not finite.

    Examples
    --------
    >>> from pfedu.adaptive import kld_number
    >>> kld_number([1, 2, 10, 100]).tolist()
    [1, 66, 217, 1347]
    """
    b = np.asarray(n_bins)
    if b.dtype.kind not in "iu" or b.size == 0 or (b < 1).any():
        raise ValueError(f"n_bins must be whole numbers of at least 1, got {n_bins}")
    if not 0 < epsilon < np.inf:
        raise ValueError(f"epsilon is a divergence and must be positive, got {epsilon}")
    if not np.isfinite(z):
        raise ValueError(f"z must be a quantile of the standard normal, a finite number, got {z}")
    degrees = np.maximum(b - 1, 1)
    c = 2.0 / (9.0 * degrees)
    n = np.ceil(degrees / (2.0 * epsilon) * np.maximum(1.0 - c + z * np.sqrt(c), 0.0) ** 3)
    if not (n < 2.0**62).all():
        raise ValueError(f"epsilon = {epsilon} asks for {n.max():.3g} draws, more than can be counted: allow more")
    n = np.where(b > 1, np.maximum(n, 1), 1).astype(int)
    return n if n.ndim else int(n)


def occupied_bins(x, bin_width):
    """How many cells of a lattice hold at least one particle; one that is nowhere (NaN or infinite) is in none.

    Parameters
    ----------
    x : ndarray, shape (N, n_x)
    bin_width : array_like, shape () or (n_x,)
        Side of a cell, in the units of the state; the lattice has a corner at zero.

    Returns
    -------
    int

    Raises
    ------
    ValueError
        If the width does not fit the state, or is not positive.

    Examples
    --------
    >>> from pfedu.adaptive import occupied_bins
    >>> occupied_bins(np.array([[0.1], [0.9], [1.1], [-0.1]]), bin_width=1.0)
    3
    """
    width = np.asarray(bin_width, dtype=float)
    if width.shape not in {(), x.shape[-1:]} or not ((width > 0) & (width < np.inf)).all():
        raise ValueError(f"bin_width must be positive, one number or one a state ({x.shape[-1]}), got {bin_width}")
    x = x[np.isfinite(x).all(axis=-1)]
    return len(np.unique(np.floor(x / width), axis=0))


def kld_filter(
    model, y, *, bin_width, rng, epsilon=0.05, z=2.326, least=20, most=100_000, resampling="systematic"
):  # fmt: skip
    r"""Bootstrap filter that chooses how many particles it takes on: many where they spread, few where they agree.

    The particles of step k, moved and not yet weighed, are counted by the cells of a lattice that they occupy, b;
    then :func:`kld_number` of b are drawn from them for step k + 1. Fox (2003) draws one particle after the other
    and stops in the same step as soon as there are enough. Here the number of a step is fixed before its particles
    are drawn: it follows one step late, and in return the estimate of the likelihood stays unbiased, as a number
    that depends on the past alone does not disturb the argument, where a rule of stopping that looks at the draws does.

    Parameters
    ----------
    model : StateSpaceModel
        With ``sample_initial``, ``propagate`` and ``log_likelihood``.
    y : array_like, shape (T+1, n_y)
        One record: numbers of particles differ from run to run, so that runs are not one array. A row of NaN is
        missing.
    bin_width : array_like, shape () or (n_x,)
        Side of a cell, in the units of the state.
    rng : numpy.random.Generator
        Two are spawned off it, one that moves particles and one that picks them.
    epsilon, z : float
        Divergence that is allowed, and with which certainty: see :func:`kld_number`.
    least, most : int
        Bounds of the number. The filter begins with ``most``: nobody has counted yet.
    resampling : str or callable
        A scheme of :mod:`pfedu.resampling`; particles are resampled after every step.

    Returns
    -------
    track : Track
    n_particles : ndarray of int, shape (T+1,)
        How many particles carried each step.

    Raises
    ------
    MissingPieceError
        If the model lacks a function.
    ValueError
        If an argument or a function of the model has the wrong shape or value.
    ZeroLikelihoodError
        If every particle has likelihood zero at some step.

    Examples
    --------
    >>> import pfedu
    >>> model = pfedu.models.random_walk(q=0.1, p0=100.0)
    >>> x, y = model.simulate(20, np.random.default_rng(1))
    >>> track, n = pfedu.kld_filter(model, y, bin_width=0.5, most=2000, rng=np.random.default_rng(2))
    >>> int(n[0]), bool(n[5:].max() < 500)
    (2000, True)
    """
    for piece in ("sample_initial", "propagate", "log_likelihood"):
        require(model, piece, "a particle filter")
    y, missing = read_record(y, model.n_y)
    _check(y, least, most)
    pick, (rng_move, rng_pick) = scheme(resampling), streams(rng, 2)
    x, algorithm, steps = np.asarray(model.sample_initial(most, rng_move), dtype=float), _bootstrap(model), []
    if x.shape != (most, model.n_x):
        raise ValueError(f"sample_initial({most}, rng) must give shape ({most}, {model.n_x}), it gave {x.shape}")
    for k in range(len(y)):
        n = len(x)
        # Propose and weigh
        x, log_g = advance(algorithm, model, k, y[k], missing[k], x, (n,), rng_move)
        log_w, increment = reweight(np.full(n, -np.log(n)), log_g, k)
        # Estimate
        w = np.exp(log_w)
        steps.append((*algorithm.estimate(x, log_w, w), 0.0 if missing[k] else increment, effective_number(w), True, n))
        # Count, and resample as many as the count asks for
        n = int(np.clip(kld_number(max(1, occupied_bins(x, bin_width)), epsilon, z), least, most))
        x = x[pick(w, rng_pick, size=n)]
    *columns, n_particles = (np.stack(column) for column in zip(*steps, strict=True))
    return Track(*columns), n_particles


def _bootstrap(model):
    def propose(k, y, x, rng):
        x = model.propagate(k, x, rng)
        return x, model.log_likelihood(k, y, x)

    return Algorithm(propose)


def _check(y, least, most):
    if y.ndim != 2:
        raise ValueError(f"the record must have shape (T+1, n_y): this filter takes one at a time, got {y.shape}")
    for name, value in (("least", least), ("most", most)):
        if not isinstance(value, int | np.integer) or value < 1:
            raise ValueError(f"{name} must be a whole number of at least 1, got {value}")
    if least > most:
        raise ValueError(f"least must not be more than most, got {least} and {most}")
