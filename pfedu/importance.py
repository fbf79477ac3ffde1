"""Importance sampling on its own: draw from a density one can draw from, and weigh. Chapter 2."""

from dataclasses import dataclass

import numpy as np

from pfedu.models import read_only, streams
from pfedu.weights import ZeroLikelihoodError, effective_sample_size, normalize, weighted_mean


@dataclass(frozen=True)
class Sample:
    r"""Weighted draws, and what they say about the target density.

    With :math:`W^{(i)} = \gamma(x^{(i)}) / q(x^{(i)})` for draws from q, and w the same normalised to
    sum to one. Leading axes ``...`` are independent runs.

    Attributes
    ----------
    x : ndarray, shape (..., N, n_x)
        Draws from the proposal.
    log_weights : ndarray, shape (..., N)
        Normalised log weights, log w.
    log_z : ndarray, shape (...)
        :math:`\log \widehat Z`, with :math:`\widehat Z = \frac1N \sum_i W^{(i)}`; :math:`\widehat Z`
        itself is unbiased for every N, its logarithm is too low on average.

    Examples
    --------
    >>> from pfedu.importance import Sample
    >>> sample = Sample(x=np.array([[0.0], [10.0]]), log_weights=np.log([0.25, 0.75]), log_z=np.array(0.0))
    >>> sample.mean().tolist(), float(sample.largest_weight)
    ([7.5], 0.75)
    """

    x: np.ndarray
    log_weights: np.ndarray
    log_z: np.ndarray

    @property
    def n_eff(self):
        """Effective number of draws, 1 / sum w^2: (...)."""
        return effective_sample_size(self.log_weights)

    @property
    def largest_weight(self):
        """Largest normalised weight: (...)."""
        return np.exp(self.log_weights.max(axis=-1))

    @property
    def z_relative_error(self):
        r"""Standard error of Zhat divided by Zhat, to first order that of log Zhat: (...).

        .. math:: \frac{s}{\sqrt N \, \widehat Z} = \sqrt{\frac{N / N_\text{eff} - 1}{N - 1}}

        with s the standard deviation of the :math:`W^{(i)}`.
        """
        n = self.x.shape[-2]
        return np.sqrt((n / self.n_eff - 1.0) / (n - 1.0))

    def mean(self, phi=None):
        r"""Self-normalised estimate of the mean of a function under the target.

        .. math:: \widehat m = \sum_i w^{(i)} \varphi(x^{(i)})

        Needs no constant of the target, and pays with a bias of order 1/N.

        Parameters
        ----------
        phi : callable, optional
            ``(x (..., N, n_x)) -> (..., N)`` or ``(..., N, m)``; by default x itself. Where the weight
            is zero its value counts for nothing, even if it is not finite.

        Returns
        -------
        ndarray, shape (...) or (..., m)

        Raises
        ------
        ValueError
            If phi gives the wrong shape, or is not finite at a draw with a weight.

        Examples
        --------
        >>> from pfedu.importance import Sample
        >>> sample = Sample(np.array([[0.0], [10.0]]), np.log([0.25, 0.75]), np.array(0.0))
        >>> float(sample.mean(lambda x: x[..., 0] > 5))
        0.75
        """
        values, shape = self._values(phi)
        return weighted_mean(values, self.log_weights).reshape(shape)

    def standard_error(self, phi=None):
        r"""Standard error of :meth:`mean`, as the sample itself sees it.

        .. math:: \sqrt{\sum_i (w^{(i)})^2 \, (\varphi(x^{(i)}) - \widehat m)^2}

        From the delta method for a ratio of two means (Geweke 1989). It is no better than the sample:
        where the tails of the proposal are too thin, what would show the error was never drawn.

        Parameters
        ----------
        phi : callable, optional
            As in :meth:`mean`.

        Returns
        -------
        ndarray, shape (...) or (..., m)

        Raises
        ------
        ValueError
            As :meth:`mean`.

        Examples
        --------
        >>> from pfedu.importance import Sample
        >>> sample = Sample(np.array([[0.0], [10.0]]), np.log([0.25, 0.75]), np.array(0.0))
        >>> sample.standard_error().round(2).tolist()
        [2.65]
        """
        values, shape = self._values(phi)
        d = values - weighted_mean(values, self.log_weights)[..., None, :]  # (..., N, m)
        return np.sqrt(np.sum((np.exp(self.log_weights)[..., None] * d) ** 2, axis=-2)).reshape(shape)

    def plain_mean(self, phi=None):
        r"""Plain estimate, :math:`\frac1N \sum_i W^{(i)} \varphi(x^{(i)})`: unbiased, for a normalised target.

        For a target known up to its constant Z it estimates Z times the mean.

        Parameters
        ----------
        phi : callable, optional
            As in :meth:`mean`.

        Returns
        -------
        ndarray, shape (...) or (..., m)

        Raises
        ------
        ValueError
            As :meth:`mean`.

        Examples
        --------
        >>> from pfedu.importance import Sample
        >>> sample = Sample(np.array([[0.0], [10.0]]), np.log([0.25, 0.75]), np.array(0.0))
        >>> sample.plain_mean().tolist()
        [7.5]
        """
        terms, shape = self._plain_terms(phi)
        return terms.mean(axis=-2).reshape(shape)

    def plain_standard_error(self, phi=None):
        r"""Standard error of :meth:`plain_mean`: :math:`s / \sqrt N`, s that of the terms :math:`W \varphi`.

        Parameters
        ----------
        phi : callable, optional
            As in :meth:`mean`.

        Returns
        -------
        ndarray, shape (...) or (..., m)

        Raises
        ------
        ValueError
            As :meth:`mean`.

        Examples
        --------
        >>> from pfedu.importance import Sample
        >>> sample = Sample(np.array([[0.0], [10.0]]), np.log([0.25, 0.75]), np.array(0.0))
        >>> sample.plain_standard_error().tolist()
        [7.5]
        """
        terms, shape = self._plain_terms(phi)
        return (terms.std(axis=-2, ddof=1) / np.sqrt(terms.shape[-2])).reshape(shape)

    def _plain_terms(self, phi):
        values, shape = self._values(phi)
        log_big_w = self.log_weights + self.log_z[..., None] + np.log(values.shape[-2])
        return np.exp(log_big_w)[..., None] * values, shape  # (..., N, m)

    def _values(self, phi):
        """phi at the draws as (..., N, m), and the shape that its mean is to have."""
        values = self.x if phi is None else np.asarray(phi(read_only(self.x)), dtype=float)
        draws = self.log_weights.shape
        if values.ndim not in (len(draws), len(draws) + 1) or values.shape[: len(draws)] != draws:
            raise ValueError(f"phi must give shape {draws} or {(*draws, 'm')} for these draws, it gave {values.shape}")
        shape = draws[:-1] + values.shape[len(draws) :]
        values = values.reshape(*draws, -1)
        weighted = np.exp(self.log_weights)[..., None] > 0
        if (weighted & ~np.isfinite(values)).any():
            where = tuple(np.argwhere(weighted & ~np.isfinite(values))[0])
            raise ValueError(f"phi gave {values[where]} at x = {self.x[where[:-1]].tolist()}, which has a weight")
        return np.where(weighted, values, 0.0), shape


def importance_sample(log_target, sample, log_proposal, n_particles, *, rng, n_runs=None):
    r"""Draw from a proposal q and weigh by the target over the proposal.

    .. math:: x^{(i)} \sim q, \qquad W^{(i)} = \frac{\gamma(x^{(i)})}{q(x^{(i)})}, \qquad
        w^{(i)} = \frac{W^{(i)}}{\sum_j W^{(j)}}

    For large N the effective number tends to :math:`N_\text{eff} \to N / (1 + \chi^2)`, where
    :math:`1 + \chi^2 = E_q[W^2] / E_q[W]^2`; if that is infinite (tails of q too thin), no number in
    the result can be trusted. Sources: Geweke (1989); Kong, Liu and Wong (1994).

    Parameters
    ----------
    log_target : callable
        ``(x (..., N, n_x)) -> (..., N)``, :math:`\log \gamma(x) = \log Z + \log p(x)`: the log density,
        known up to a constant or not; ``-inf`` where it is zero.
    sample : callable
        ``(n, rng) -> x (n, n_x)``, n independent draws from q; the ``sample_initial`` of a model fits.
    log_proposal : callable
        ``(x (..., N, n_x)) -> (..., N)``, log q(x), normalised; the ``log_initial`` of a model fits.
    n_particles : int
        N, at least 2: one draw has no standard error.
    rng : numpy.random.Generator
        A generator freshly made from the same seed gives the same bits.
    n_runs : int, optional
        Do it that many times, independently, as one array.

    Returns
    -------
    Sample

    Raises
    ------
    ValueError
        If a function gives the wrong shape or a value that is no log density; if the proposal has
        density zero at its own draws.
    ZeroLikelihoodError
        If the target is zero at every draw of a run.

    Examples
    --------
    The posterior of a state with prior N(0, 1) after a measurement of 2 with variance 1, drawn from the
    prior: the exact mean is 1, and the exact log Z is that of N(2; 0, 2), -2.27.

    >>> from pfedu.gaussian import log_density
    >>> from pfedu.importance import importance_sample
    >>> prior = lambda x: log_density(x, 0.0, 1.0)
    >>> posterior = importance_sample(
    ...     lambda x: prior(x) + log_density(2.0, x, 1.0),
    ...     lambda n, rng: rng.standard_normal((n, 1)), prior, 10_000, rng=np.random.default_rng(1))
    >>> bool(abs(posterior.mean() - 1.0)[0] < 4 * posterior.standard_error()[0])
    True
    >>> bool(abs(posterior.log_z + 2.27) < 0.05)
    True
    """
    for name, number, least in (("n_particles", n_particles, 2), ("n_runs", n_runs, 1)):
        if number is not None and (not isinstance(number, int | np.integer) or number < least):
            raise ValueError(f"{name} must be a whole number of at least {least}, got {number!r}")
    (rng,) = streams(rng, 1)
    x = _draw(sample, n_particles, n_runs, rng)
    log_q = _log_values("log_proposal", log_proposal, x)
    if (log_q == -np.inf).any():
        where = tuple(np.argwhere(log_q == -np.inf)[0])
        raise ValueError(
            f"log_proposal is -inf at x = {x[where].tolist()}, which sample has drawn: the two do not belong together"
        )
    log_w = _log_values("log_target", log_target, x) - log_q
    if (log_w.max(axis=-1) == -np.inf).any():
        raise ZeroLikelihoodError(
            f"the target is zero at all {n_particles} draws of a run: the proposal misses it, widen or move it"
        )
    log_w, log_sum = normalize(log_w)
    return Sample(x, log_w, log_sum - np.log(n_particles))


def _draw(sample, n_particles, n_runs, rng):
    """All draws of all runs at once: (N, n_x) or (n_runs, N, n_x)."""
    n = n_particles * (n_runs or 1)
    x = np.asarray(sample(n, rng), dtype=float)
    if x.ndim != 2 or len(x) != n or x.shape[-1] == 0:
        raise ValueError(f"sample(n, rng) must give draws of shape (n, n_x), here ({n}, n_x); it gave {x.shape}")
    if not np.isfinite(x).all():
        raise ValueError(f"sample gave a draw that is not finite: {x[~np.isfinite(x).all(axis=-1)][0].tolist()}")
    return x.reshape(n_runs, n_particles, -1) if n_runs else x


def _log_values(name, log_density, x):
    """One logarithm a draw, finite or -inf."""
    values = np.asarray(log_density(read_only(x)), dtype=float)
    if values.shape != x.shape[:-1]:
        raise ValueError(f"{name} must give shape {x.shape[:-1]} for draws {x.shape}, it gave {values.shape}")
    bad = ~(values < np.inf)  # true for NaN too
    if bad.any():
        where = tuple(np.argwhere(bad)[0])
        raise ValueError(
            f"{name} gave {values[where]} at x = {x[where].tolist()}: a log density is a finite number, "
            "or -inf where the density is zero"
        )
    return values
