"""The online object: a particle filter driven by hand, one measurement at a time. Chapter 5.

A batch filter is given a whole record. Where measurements arrive one by one, at times of their own, with inputs
that are known only now, the same steps are called by hand: :meth:`ParticleFilter.initialize`, then
:meth:`~ParticleFilter.predict` and :meth:`~ParticleFilter.correct` in the order in which things happen.

The object has the parts of MATLAB's ``particleFilter`` under Python's names:

============================== ==========================================================
``StateTransitionFcn``         ``transition(particles, rng, *args)``
``MeasurementLikelihoodFcn``   ``likelihood(particles, y, *args)``
``initialize(pf, N, m, P)``    ``pf.initialize(N, m, P)``
``initialize(pf, N, bounds)``  ``pf.initialize(N, bounds=bounds)``
``correct``, ``predict``       ``pf.correct(y, *args)``, ``pf.predict(*args)``
``getStateEstimate``           ``pf.state``, ``pf.covariance``
``clone``                      ``pf.clone()``
``Particles``, ``Weights``     ``pf.particles``, ``pf.weights``
``NumParticles``               ``pf.n_particles``
``NumStateVariables``          ``pf.n_x``
``IsStateVariableCircular``    ``pf.circular``
``StateOrientation``           ``pf.orientation``: ``"row"`` by default, not ``"column"``
``StateEstimationMethod``      ``pf.estimate_method``
``ResamplingMethod``           ``pf.resampling``: ``"systematic"`` by default, not ``"multinomial"``
``ResamplingPolicy``           ``pf.policy``: ``ratio(0.5)``, ``interval(n)`` of :mod:`pfedu.resampling`
============================== ==========================================================
"""

import contextlib
import copy
import json
import pickle
from dataclasses import dataclass, fields, replace

import numpy as np

from pfedu.filters.loop import resample, reweight
from pfedu.gaussian import Gaussian
from pfedu.models import read_only, streams
from pfedu.resampling import ratio, scheme
from pfedu.weights import (
    ZeroLikelihoodError,
    as_circular,
    effective_number,
    normalize,
    weighted_moments,
    wrap,
)

ORIENTATIONS = ("row", "column")
ESTIMATE_METHODS = ("mean", "maxweight")
LOG_WEIGHTS = ("log_w", "log_w_weighed")
LOWEST = np.finfo(float).min  # stands for -inf in a snapshot: JSON has no infinite numbers


@dataclass(frozen=True)
class _Belief:
    """All that a step replaces. It is replaced whole or not at all, so that a failed call changes nothing."""

    x: np.ndarray  # (N, n_x), whatever the orientation
    log_w: np.ndarray  # (N,), normalised
    x_weighed: np.ndarray  # the two of the latest estimate, before it was resampled
    log_w_weighed: np.ndarray
    orientation: str
    circular: np.ndarray  # (n_x,)
    k: int = 0  # predictions so far: the time of the particles
    corrections: int = 0
    log_likelihood: float = 0.0
    resampled: bool = False

    def moved(self, x, log_w, **changes):
        """The belief with other particles, which are the estimate too."""
        return replace(self, x=x, log_w=log_w, x_weighed=x, log_w_weighed=log_w, resampled=False, **changes)


class ParticleFilter:
    r"""A bootstrap filter driven by hand: initialize once, then predict and correct as measurements come.

    .. math::
        \text{predict: } x_k^{(i)} \sim p(x_k \mid x_{k-1}^{(i)}), \qquad
        \text{correct: } w_k^{(i)} \propto w_{k-1}^{(i)} \, p(y_k \mid x_k^{(i)})

    These are the steps of :func:`~pfedu.bootstrap_filter`. Driven over a record with ``correct(y_0)``, then
    ``predict()``, ``correct(y_k)`` and so on, it gives the same numbers, bit for bit; a measurement that is missing
    is a ``predict`` without a ``correct``.

    The estimate is taken **before** resampling, which only adds noise to it: after ``correct``, ``state`` and
    ``covariance`` are what it returned, although ``particles`` and ``weights`` may be resampled already. A call that
    fails changes nothing, random numbers included.

    Sources: Gordon, Salmond and Smith (1993); the documentation of MATLAB's ``particleFilter``.

    Parameters
    ----------
    transition : callable
        ``(particles, rng, *args) -> particles``: a new array of the same shape, moved to the next time, process
        noise included, drawn from ``rng`` alone.
    likelihood : callable
        ``(particles, y, *args) -> (N,)``: p(y | x) of each particle, up to a common factor.
    rng : numpy.random.Generator
        Two generators are spawned off it, one that moves particles and one that picks them.
    log : bool
        Whether ``likelihood`` gives logarithms. They neither underflow nor overflow.
    orientation : str
        ``"row"``: particles (N, n_x), weights (N, 1), state (1, n_x); ``"column"``: the transposes. Functions are
        given particles in the same orientation.
    resampling : str or callable
        ``"multinomial"``, ``"residual"``, ``"stratified"``, ``"systematic"``, or a function
        ``(weights, rng, size=None) -> ancestors``.
    policy : callable
        When to resample: ``ratio(share)``, ``interval(n)``, ``always`` or ``never`` of :mod:`pfedu.resampling`.
    estimate_method : str
        ``"mean"``: the weighted mean and covariance, of a circular state as
        :func:`~pfedu.weights.weighted_mean` has them. ``"maxweight"``: the heaviest particle, the first of them if
        there are several; it has no covariance (None). Where all weights are equal, as in a prediction after
        resampling, that is merely the first particle.

    Attributes
    ----------
    n_particles, n_x : int
        N and the number of states; read-only, as all that follows but ``particles`` and ``weights``.
    circular : ndarray of bool, shape (n_x,)
        Which states are angles.
    particles, weights : ndarray
        The cloud as it is now. Settable: weights are normalised, shapes must stay.
    state, covariance : ndarray
        The estimate; ``covariance`` is (n_x, n_x) in both orientations, or None.
    n_eff : float
        Effective number of particles of the estimate, that is before resampling.
    resampled : bool
        Whether particles were resampled after the estimate.
    log_likelihood : float
        Log of the probability density of all measurements since ``initialize``, estimated; meaningful if
        ``likelihood`` leaves out no factor.

    Raises
    ------
    TypeError, ValueError
        If an argument is not what it should be.
    RuntimeError
        If anything but ``initialize`` is used before it.

    Examples
    --------
    A random walk, N(0, 1) a step, measured with noise N(0, 0.1):

    >>> import numpy as np
    >>> import pfedu
    >>> pf = pfedu.ParticleFilter(
    ...     transition=lambda x, rng: x + rng.standard_normal(x.shape),
    ...     likelihood=lambda x, y: np.exp(-((y - x) ** 2) / (2 * 0.1)),
    ...     rng=np.random.default_rng(1))
    >>> pf.initialize(1000, mean=0.0, cov=5.0)
    >>> state, covariance = pf.correct(2.0)
    >>> state.shape, covariance.shape
    ((1, 1), (1, 1))
    >>> bool(abs(state[0, 0] - 2.0 * 5.0 / 5.1) < 0.1)  # the Kalman filter's answer
    True
    >>> bool(pf.predict()[1] > covariance)
    True
    """

    def __init__(
        self, transition, likelihood, *, rng, log=False, orientation="row", resampling="systematic",
        policy=ratio(0.5), estimate_method="mean",
    ):  # fmt: skip
        for name, function in {"transition": transition, "likelihood": likelihood}.items():
            if not callable(function):
                raise TypeError(f"{name} must be a function, got {function!r}")
        self.transition, self.likelihood, self.log = transition, likelihood, log
        self.resampling, self.policy, self.estimate_method = resampling, policy, estimate_method
        self._orientation = _one_of(ORIENTATIONS, "orientation", orientation)
        self._rng_move, self._rng_pick = streams(rng, 2)
        self._now = None

    def initialize(self, n_particles, mean=None, cov=None, *, bounds=None, circular=None, orientation=None):
        r"""Draw particles from a Gaussian :math:`N(m, P)` or uniformly between bounds, all with weight 1/N.

        Parameters
        ----------
        n_particles : int
            Their number, N.
        mean : array_like, shape (n_x,), optional
            A row or a column will do.
        cov : array_like, shape (), (n_x,) or (n_x, n_x), optional
            Covariance; a scalar or a vector of variances is a diagonal.
        bounds : array_like, shape (n_x, 2), optional
            Lower and upper bound of each state, instead of ``mean`` and ``cov``. For an angle they may lie beyond
            :math:`\pm\pi`: (3, 4) is an arc across the seam.
        circular : array_like of bool, shape (n_x,), optional
            Which states are angles. They are kept in :math:`[-\pi, \pi]`, here and after each prediction.
        orientation : str, optional
            ``"row"`` or ``"column"``; by default what it was.

        Raises
        ------
        TypeError
            If neither ``mean`` with ``cov`` nor ``bounds`` is given, or both.
        ValueError
            If a shape or a value does not fit.

        Examples
        --------
        >>> import pfedu
        >>> pf = pfedu.ParticleFilter(lambda x, rng: x, lambda x, y: x[:, 0], rng=np.random.default_rng(1))
        >>> pf.initialize(100, bounds=[[0.0, 10.0], [3.0, 4.0]], circular=[False, True])
        >>> pf.particles.shape, bool(np.all(np.abs(pf.particles[:, 1]) <= np.pi))
        ((100, 2), True)
        """
        if not (1 <= n_particles < np.inf and n_particles == int(n_particles)):
            raise ValueError(f"n_particles must be a whole number of at least 1, got {n_particles}")
        if (mean is None, cov is None, bounds is None) not in {(False, False, True), (True, True, False)}:
            raise TypeError("initialize needs either mean and cov, or bounds")
        orientation = self._orientation if orientation is None else orientation
        _one_of(ORIENTATIONS, "orientation", orientation)
        n = int(n_particles)
        if bounds is None:
            mean, noise = _gaussian(mean, cov)
            circular = as_circular(circular, mean.size)
            x = mean + noise.sample((n,), self._rng_move)
        else:
            low, high = _box(bounds)
            circular = as_circular(circular, low.size)
            if (circular & (high - low > 2 * np.pi)).any():
                raise ValueError(f"the bounds of a circular state span at most 2 pi, got {np.asarray(bounds).tolist()}")
            x = low + (high - low) * self._rng_move.random((n, low.size))
        x, log_w = wrap(x, circular), np.full(n, -np.log(n))
        self._now, self._orientation = _Belief(x, log_w, x, log_w, orientation, circular), orientation

    def predict(self, *args, **kwargs):
        r"""Move the particles to the next time: :math:`x_k^{(i)} \sim p(x_k \mid x_{k-1}^{(i)})`.

        Weights stay as they are.

        Parameters
        ----------
        *args, **kwargs
            Passed on to ``transition``.

        Returns
        -------
        state : ndarray, shape (1, n_x) or (n_x, 1)
            The a priori estimate of the new time.
        covariance : ndarray, shape (n_x, n_x), or None

        Raises
        ------
        RuntimeError
            Before ``initialize``.
        ValueError
            If ``transition`` gives the wrong shape, or a state that is not finite.

        Examples
        --------
        >>> import pfedu
        >>> pf = pfedu.ParticleFilter(lambda x, rng, u: x + u, lambda x, y: x[:, 0], rng=np.random.default_rng(1))
        >>> pf.initialize(3, mean=[1.0], cov=0.0)
        >>> pf.predict(0.5)[0].tolist()
        [[1.5]]
        """
        now = self._initialized()
        with self._undone_on_error("_rng_move"):
            x = self.transition(self._turn(read_only(now.x)), self._rng_move, *args, **kwargs)
            self._now = now.moved(self._states(x, "transition gave"), now.log_w, k=now.k + 1)
        return self._estimate()

    def correct(self, y, *args, **kwargs):
        r"""Weigh the particles by a measurement, estimate, then resample if the policy says so.

        .. math:: w_k^{(i)} \propto w_{k-1}^{(i)} \, p(y_k \mid x_k^{(i)})

        Several measurements of one time, of several sensors, are several calls without a ``predict`` between them.

        Parameters
        ----------
        y
            The measurement, handed to ``likelihood`` as it is. One that is missing is no call at all.
        *args, **kwargs
            Passed on to ``likelihood``.

        Returns
        -------
        state : ndarray, shape (1, n_x) or (n_x, 1)
            The a posteriori estimate, taken before resampling.
        covariance : ndarray, shape (n_x, n_x), or None

        Raises
        ------
        RuntimeError
            Before ``initialize``.
        ValueError
            If ``likelihood`` gives the wrong shape, or a value that is no likelihood.
        ZeroLikelihoodError
            If every particle has likelihood zero.

        Examples
        --------
        Two particles at 0 and 10 with likelihoods 1 and 3:

        >>> import pfedu
        >>> pf = pfedu.ParticleFilter(lambda x, rng: x, lambda x, y: [1.0, 3.0], rng=np.random.default_rng(1))
        >>> pf.initialize(2, mean=[0.0], cov=1.0)
        >>> pf.particles = [[0.0], [10.0]]
        >>> pf.correct("any")[0].tolist()
        [[7.5]]
        """
        now = self._initialized()
        with self._undone_on_error("_rng_pick"):
            # Weigh
            log_g = self._log_likelihoods(self.likelihood(self._turn(read_only(now.x)), y, *args, **kwargs))
            log_w, increment = self._reweight(now, log_g)
            # The estimate is that of these weights; resample for the steps to come
            count = now.corrections + 1
            due = np.asarray(bool(self.policy(effective_number(np.exp(log_w)), log_w.size, count)))
            x, log_w_next, _ = resample(now.x, log_w, due, scheme(self.resampling), self._rng_pick)
            self._now = replace(
                now, x=x, log_w=log_w_next, x_weighed=now.x, log_w_weighed=log_w, corrections=count,
                log_likelihood=now.log_likelihood + float(increment), resampled=bool(due),
            )  # fmt: skip
        return self._estimate()

    def clone(self):
        """Copy the filter, random numbers included; neither affects the other from then on.

        The copy goes on with the very numbers with which the original would. What the functions carry with them
        is copied too if they are methods or callable objects; plain functions are shared.

        Returns
        -------
        ParticleFilter

        Examples
        --------
        >>> import pfedu
        >>> pf = pfedu.ParticleFilter(
        ...     lambda x, rng: x + rng.standard_normal(x.shape), lambda x, y: x[:, 0], rng=np.random.default_rng(1))
        >>> pf.initialize(10, mean=[0.0], cov=1.0)
        >>> twin = pf.clone()
        >>> bool(twin.predict()[0] == pf.predict()[0])
        True
        """
        return copy.deepcopy(self)

    def snapshot(self):
        """Everything that the steps have made of the filter, as plain values.

        A dictionary of finite numbers, strings and lists that survives ``json.dump`` (also with ``allow_nan=False``)
        and ``numpy.savez(file, **snapshot)``. The logarithm of a weight of zero is written as the lowest double.
        What the constructor was told (functions, resampling, policy, estimate method) is not in it.

        Returns
        -------
        dict

        Raises
        ------
        RuntimeError
            Before ``initialize``.
        TypeError
            If the random numbers come from a generator that is not numpy's own.

        Examples
        --------
        >>> import json
        >>> import pfedu
        >>> def new():
        ...     return pfedu.ParticleFilter(
        ...         lambda x, rng: x + rng.standard_normal(x.shape), lambda x, y: x[:, 0], rng=np.random.default_rng(1))
        >>> pf = new()
        >>> pf.initialize(10, mean=[0.0], cov=1.0)
        >>> text = json.dumps(pf.snapshot())
        >>> later = new()
        >>> later.restore(json.loads(text))
        >>> bool(later.predict()[0] == pf.predict()[0])
        True
        """
        values = {f.name: getattr(self._initialized(), f.name) for f in fields(_Belief)}
        values |= {name: np.maximum(values[name], LOWEST) for name in LOG_WEIGHTS}
        plain = {name: v.tolist() if isinstance(v, np.ndarray) else v for name, v in values.items()}
        return plain | {"rng_move": _generator_to_text(self._rng_move), "rng_pick": _generator_to_text(self._rng_pick)}

    def restore(self, snapshot):
        """Go on where a snapshot was taken, with the same random numbers.

        The filter must have been made with the same functions and settings; then what follows is the same, bit for
        bit.

        Parameters
        ----------
        snapshot : mapping
            From :meth:`snapshot`, directly, by way of JSON, or as ``numpy.load`` opens what ``numpy.savez`` wrote.

        Raises
        ------
        ValueError
            If it is not a whole snapshot, or a value in it cannot be. The filter then stays as it was.

        Examples
        --------
        >>> import pfedu
        >>> pf = pfedu.ParticleFilter(lambda x, rng: x + 1, lambda x, y: x[:, 0], rng=np.random.default_rng(1))
        >>> pf.initialize(10, mean=[0.0], cov=0.0)
        >>> start = pf.snapshot()
        >>> pf.predict()[0].round(6).tolist()
        [[1.0]]
        >>> pf.restore(start)
        >>> pf.state.tolist()
        [[0.0]]
        """
        names = [f.name for f in fields(_Belief)]
        lost = [name for name in (*names, "rng_move", "rng_pick") if name not in snapshot]
        if lost:
            raise ValueError(f"the snapshot lacks {', '.join(lost)}")
        values = {name: np.asarray(snapshot[name]) for name in names}
        belief = _Belief(**{name: v if v.ndim else v.item() for name, v in values.items()})
        _check_belief(belief)
        numbers = {name: values[name].astype(float) for name in ("x", "x_weighed", *LOG_WEIGHTS)}
        numbers |= {name: np.where(numbers[name] == LOWEST, -np.inf, numbers[name]) for name in LOG_WEIGHTS}
        belief = replace(belief, **numbers)
        generators = [_generator_from_text(str(snapshot[name])) for name in ("rng_move", "rng_pick")]
        (self._rng_move, self._rng_pick), self._now, self._orientation = generators, belief, belief.orientation

    @property
    def resampling(self):
        """Resampling scheme, a name or a function; settable."""
        return self._resampling

    @resampling.setter
    def resampling(self, resampling):
        scheme(resampling)
        self._resampling = resampling

    @property
    def policy(self):
        """When to resample; settable."""
        return self._policy

    @policy.setter
    def policy(self, policy):
        if not callable(policy):
            raise TypeError(
                f"policy must be ratio(share), interval(n), always or never of pfedu.resampling, got {policy!r}"
            )
        self._policy = policy

    @property
    def estimate_method(self):
        """``"mean"`` or ``"maxweight"``; settable, ``state`` and ``covariance`` follow at once."""
        return self._estimate_method

    @estimate_method.setter
    def estimate_method(self, method):
        self._estimate_method = _one_of(ESTIMATE_METHODS, "estimate_method", method)

    @property
    def orientation(self):
        """``"row"`` or ``"column"``."""
        return self._orientation

    @property
    def n_particles(self):
        """Number of particles N."""
        return self._initialized().x.shape[0]

    @property
    def n_x(self):
        """Number of states."""
        return self._initialized().x.shape[1]

    @property
    def circular(self):
        """Which states are angles: (n_x,)."""
        return read_only(self._initialized().circular)

    @property
    def particles(self):
        """Particles as they are now: (N, n_x), or (n_x, N) by columns; settable, but only as a whole."""
        return self._turn(read_only(self._initialized().x))

    @particles.setter
    def particles(self, particles):
        now = self._initialized()
        self._now = now.moved(self._states(particles, "particles were given as"), now.log_w)

    @property
    def weights(self):
        """Normalised weights as they are now: (N, 1), or (1, N) by columns; settable, but only as a whole."""
        return self._turn(read_only(np.exp(self._initialized().log_w)[:, None]))

    @weights.setter
    def weights(self, weights):
        log_w = _logarithms(self._one_each(weights, "weights were given as"), "weight")
        if (log_w == -np.inf).all():
            raise ValueError("all weights are zero: at least one must be positive")
        self._now = self._now.moved(self._now.x, normalize(log_w)[0])

    @property
    def state(self):
        """The estimate: (1, n_x), or (n_x, 1) by columns."""
        return self._estimate()[0]

    @property
    def covariance(self):
        """Covariance of the estimate: (n_x, n_x); None with ``"maxweight"``."""
        return self._estimate()[1]

    @property
    def n_eff(self):
        """Effective number of particles of the estimate, before resampling."""
        return float(effective_number(np.exp(self._initialized().log_w_weighed)))

    @property
    def resampled(self):
        """Whether particles were resampled after the estimate."""
        return self._initialized().resampled

    @property
    def log_likelihood(self):
        """Log-likelihood of all measurements since ``initialize``."""
        return self._initialized().log_likelihood

    @contextlib.contextmanager
    def _undone_on_error(self, name):
        """Put a generator back as it was if the block fails, whatever its functions drew or spawned."""
        bits = getattr(self, name).bit_generator
        state, children = bits.state, bits.seed_seq.n_children_spawned
        try:
            yield
        except BaseException:
            if bits.seed_seq.n_children_spawned > children:  # no generator counts back: make another
                bits = type(bits)(np.random.SeedSequence(**bits.seed_seq.state | {"n_children_spawned": children}))
                setattr(self, name, np.random.Generator(bits))
            bits.state = state
            raise

    def _initialized(self):
        if self._now is None:
            raise RuntimeError("the filter has no particles yet: call initialize(n, mean, cov) or "
                               "initialize(n, bounds=...) first")  # fmt: skip
        return self._now

    def _estimate(self):
        """State and covariance of the latest weighing: what resampling makes of it is for the steps to come."""
        now = self._initialized()
        if self.estimate_method == "maxweight":
            return self._turn(now.x_weighed[[np.argmax(now.log_w_weighed)]]), None
        mean, cov = weighted_moments(now.x_weighed, now.log_w_weighed, now.circular)
        return self._turn(mean[None, :]), cov

    def _turn(self, array):
        """From rows to the chosen orientation, and back."""
        return array.T if self._orientation == "column" else array

    def _states(self, x, what):
        """Particles from outside as rows (N, n_x), checked and wrapped."""
        shape = self.particles.shape
        if x is None or np.shape(x) != shape:
            raise ValueError(f"{what} {_shape(x)}: particles must keep the shape {shape} ({self._orientation}s)")
        x = np.array(self._turn(np.asarray(x)), dtype=float, order="C")  # a copy, laid out alike for both orientations
        bad = ~np.isfinite(x).all(axis=1)
        if bad.any():
            i = int(np.argmax(bad))
            raise ValueError(f"{what} {x[i].tolist()} for particle {i}: states must be finite; one that runs away may "
                             "be put at a large number, where the likelihood is zero")  # fmt: skip
        return wrap(x, self._now.circular)

    def _one_each(self, values, what):
        """N values from outside, as a vector or as weights are laid out: (N,)."""
        shape = self.weights.shape
        if values is None or np.shape(values) not in {shape, (max(shape),)}:
            raise ValueError(
                f"{what} {_shape(values)}: one value a particle is needed, shape ({max(shape)},) or {shape}"
            )
        return np.array(values, dtype=float).ravel()

    def _log_likelihoods(self, g):
        """What ``likelihood`` gave, checked, as logarithms: (N,)."""
        g = self._one_each(g, "likelihood gave")
        if not self.log:
            return _logarithms(g, "likelihood")
        bad = ~(g < np.inf)  # true for NaN too
        if bad.any():
            i = int(np.argmax(bad))
            raise ValueError(f"log-likelihood {g[i]} of particle {i}: a logarithm is finite, or -inf for a likelihood "
                             "of zero; a missing measurement is a predict without a correct")  # fmt: skip
        return g

    def _reweight(self, now, log_g):
        try:
            return reweight(now.log_w, log_g, now.k)
        except ZeroLikelihoodError as error:
            if not self.log:
                error.add_note("A likelihood below 1e-308 is zero to the computer: with log=True, give its logarithm.")
            raise

    def __repr__(self):
        if self._now is None:
            return "ParticleFilter(not initialized)"
        return f"ParticleFilter(n_particles={self.n_particles}, n_x={self.n_x}, n_eff={self.n_eff:.1f})"

    def __copy__(self):
        return copy.deepcopy(self)  # a shallow copy would draw from the same generators

    def __deepcopy__(self, memo):
        new = type(self).__new__(type(self))
        new.__dict__.update(copy.deepcopy(self.__dict__, memo))
        return new

    def __getstate__(self):
        for name in ("transition", "likelihood", "resampling", "policy"):
            try:
                pickle.dumps(getattr(self, name))
            except Exception as error:
                raise pickle.PicklingError(
                    f"{name} {getattr(self, name)!r} cannot be pickled ({error}): define it at the top of a module, "
                    "or keep snapshot(), which leaves functions out"
                ) from error
        return self.__dict__


def _one_of(choices, name, value):
    if value not in choices:
        raise ValueError(f"{name} must be {' or '.join(map(repr, choices))}, got {value!r}")
    return value


def _shape(values):
    return "nothing (is its return missing?)" if values is None else f"the shape {np.shape(values)}"


def _gaussian(mean, cov):
    """Mean (n_x,) and noise of the initial particles."""
    mean = np.asarray(mean, dtype=float)
    if mean.size == 0 or mean.size != max(mean.shape, default=1) or not np.isfinite(mean).all():
        raise ValueError(f"mean must be a vector (n_x,) of finite numbers, got {mean.tolist()}")
    cov = np.asarray(cov, dtype=float)
    noise = Gaussian(np.full(mean.size, cov) if cov.ndim == 0 else cov)
    if noise.n != mean.size:
        raise ValueError(f"cov is {noise.n} x {noise.n}, but mean has {mean.size} states")
    return mean.ravel(), noise


def _box(bounds):
    """Lower and upper bounds, each (n_x,)."""
    bounds = np.asarray(bounds, dtype=float)
    if bounds.ndim != 2 or bounds.shape[1] != 2 or len(bounds) == 0:
        raise ValueError(f"bounds must have shape (n_x, 2), one row (lower, upper) a state; got {bounds.shape}")
    if not (np.isfinite(bounds).all() and (bounds[:, 0] <= bounds[:, 1]).all()):
        raise ValueError(f"bounds must be finite, the lower one first, got {bounds.tolist()}")
    return bounds.T


def _logarithms(values, name):
    """Logarithms of numbers that must be finite and not negative; the first that is not is named."""
    bad = ~((values >= 0) & (values < np.inf))  # true for NaN too
    if bad.any():
        i = int(np.argmax(bad))
        hint = "; a missing measurement is a predict without a correct" if np.isnan(values[i]) else ""
        raise ValueError(f"{name} {values[i]} of particle {i}: a {name} is finite and not negative{hint}")
    with np.errstate(divide="ignore"):
        return np.log(values)


@np.errstate(over="ignore")
def _check_belief(belief):
    """Raise if what a file holds does not fit together, or is nothing that a filter can have come to."""
    shape = np.shape(belief.x)
    wanted = {"x": shape, "x_weighed": shape, "log_w": shape[:1], "log_w_weighed": shape[:1], "circular": shape[1:]}
    for name, size in wanted.items():
        if len(shape) != 2 or np.shape(getattr(belief, name)) != size:
            raise ValueError(f"the snapshot's {name} does not fit its particles x {shape}")
    for name, numbers in ((name, getattr(belief, name)) for name in ("x", "x_weighed", *LOG_WEIGHTS)):
        if numbers.dtype.kind not in "fi" or not np.isfinite(np.exp(numbers) if name in LOG_WEIGHTS else numbers).all():
            raise ValueError(f"the snapshot's {name} holds what is no finite number")
        if name in LOG_WEIGHTS and abs(np.exp(numbers).sum() - 1.0) > 1e-9:
            raise ValueError(f"the snapshot's {name} is not normalised: its weights sum to {np.exp(numbers).sum():.6g}")
    as_circular(belief.circular, shape[1])
    for name, kinds in {"k": [int], "corrections": [int], "log_likelihood": [int, float], "resampled": [bool]}.items():
        value = getattr(belief, name)
        if type(value) not in kinds or not np.isfinite(value) or (name != "log_likelihood" and value < 0):
            raise ValueError(f"the snapshot's {name} cannot be {value!r}")
    _one_of(ORIENTATIONS, "the snapshot's orientation", belief.orientation)


def _generator_to_text(rng):
    """A generator as JSON: where it is, and the seed that its children come from."""
    bits = rng.bit_generator
    if getattr(np.random, type(bits).__name__, None) is not type(bits):
        raise TypeError(f"a snapshot holds the state of numpy's own bit generators, not of {type(bits).__name__}")
    state = {"kind": type(bits).__name__, "bits": bits.state, "seed": bits.seed_seq.state}
    return json.dumps(state, default=lambda array: array.tolist())


def _generator_from_text(text):
    try:
        state = json.loads(text)
        bits = getattr(np.random, state["kind"])(np.random.SeedSequence(**state["seed"]))
        bits.state = state["bits"]
        return np.random.Generator(bits)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"the snapshot's generator is damaged ({error}): {text[:80]}") from error
