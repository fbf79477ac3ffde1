r"""State-space models: how the state moves and what is measured of it.

.. math:: x_k = f(k, x_{k-1}, w_k), \qquad y_k = h(k, x_k, v_k)

Step k always means the step *to* time k: ``propagate(k, x, rng)`` takes states of time k-1 to time k.
States have shape (..., n_x) and measurements (..., n_y); leading axes are particles and runs.
"""

import numpy as np

from pfedu.gaussian import Gaussian


class MissingPieceError(TypeError):
    """The model lacks a piece that the algorithm needs; the message names it."""


class StateSpaceModel:
    """A model stated by its functions.

    Give what your algorithm needs: the bootstrap filter lives on the first three, ``simulate`` needs
    ``measure`` as well, the grid filter ``log_initial`` and ``log_transition``.

    Parameters
    ----------
    sample_initial : callable
        ``(n, rng) -> x (n, n_x)``, draws from p(x_0).
    propagate : callable
        ``(k, x, rng) -> x``, draws from p(x_k | x_{k-1}) for each state; same shape out as in.
    log_likelihood : callable
        ``(k, y, x) -> (...)``, log p(y_k | x_k) for y (..., n_y) against x (..., n_x).
    measure : callable, optional
        ``(k, x, rng) -> y (..., n_y)``, draws from p(y_k | x_k).
    log_initial : callable, optional
        ``(x) -> (...)``, log p(x_0).
    log_transition : callable, optional
        ``(k, x_new, x) -> (...)``, log p(x_k | x_{k-1}).
    n_x, n_y : int
        Number of states and of measured quantities.

    Raises
    ------
    MissingPieceError
        When an algorithm asks for a function that was not given.

    Examples
    --------
    >>> from pfedu.models import StateSpaceModel
    >>> walk = StateSpaceModel(
    ...     sample_initial=lambda n, rng: rng.standard_normal((n, 1)),
    ...     propagate=lambda k, x, rng: x + rng.standard_normal(x.shape),
    ...     log_likelihood=lambda k, y, x: -np.abs(y - x)[..., 0])
    >>> walk.propagate(1, np.zeros((4, 1)), np.random.default_rng(1)).shape
    (4, 1)
    """

    def __init__(self, sample_initial, propagate, log_likelihood, *, measure=None,
                 log_initial=None, log_transition=None, n_x=1, n_y=1):  # fmt: skip
        self.n_x, self.n_y = n_x, n_y
        given = dict(sample_initial=sample_initial, propagate=propagate, log_likelihood=log_likelihood,
                     measure=measure, log_initial=log_initial, log_transition=log_transition)  # fmt: skip
        for name, function in given.items():
            if function is not None and not callable(function):
                raise TypeError(f"{name} must be a function, got {function!r}")
            setattr(self, name, function)

    def simulate(self, n_steps, rng, n_runs=None):
        """Draw a truth and its measurements.

        Process noise and measurement noise come from two generators spawned off ``rng``, so that
        with the same seed another noise level scales the same draws.

        Parameters
        ----------
        n_steps : int
            T; times run from 0 to T.
        rng : numpy.random.Generator
        n_runs : int, optional
            Draw that many independent runs at once.

        Returns
        -------
        x : ndarray, shape (T+1, n_x) or (n_runs, T+1, n_x)
            States, row k is time k.
        y : ndarray, shape (T+1, n_y) or (n_runs, T+1, n_y)
            Measurements.

        Raises
        ------
        MissingPieceError
            If the model has no ``measure``.
        """
        require(self, "measure", "simulating measurements")
        if n_steps < 0 or (n_runs is not None and n_runs < 1):
            raise ValueError(f"n_steps must be at least 0 and n_runs at least 1, got {n_steps} and {n_runs}")
        rng_x, rng_y = streams(rng, 2)
        x = [self.sample_initial(n_runs or 1, rng_x)]  # each (runs, n_x)
        for k in range(1, n_steps + 1):
            x.append(self.propagate(k, read_only(x[-1]), rng_x))
        y = [self.measure(k, x_k, rng_y) for k, x_k in enumerate(x)]
        x, y = np.stack(x, axis=1), np.stack(y, axis=1)  # (runs, T+1, n)
        return (x, y) if n_runs else (x[0], y[0])


def require(model, piece, purpose):
    """Raise a clear error unless the model has that piece.

    Parameters
    ----------
    model : StateSpaceModel
    piece : str
        Name of the method or attribute.
    purpose : str
        What asks for it, for the message.

    Raises
    ------
    MissingPieceError
        Naming the model, the piece and what asked for it.

    Examples
    --------
    >>> from pfedu.models import growth, require
    >>> require(growth(), "F", "the Kalman filter")
    Traceback (most recent call last):
        ...
    pfedu.models.MissingPieceError: AdditiveGaussian has no F, which the Kalman filter needs
    """
    if getattr(model, piece, None) is None:
        raise MissingPieceError(f"{type(model).__name__} has no {piece}, which {purpose} needs")


def read_only(x):
    """Give a view of an array that a model's function cannot change by mistake.

    Parameters
    ----------
    x : ndarray

    Returns
    -------
    ndarray
        The same numbers; writing to them is an error.

    Examples
    --------
    >>> from pfedu.models import read_only
    >>> read_only(np.zeros(2)).flags.writeable
    False
    """
    x = x.view()
    x.flags.writeable = False
    return x


def streams(rng, n):
    """Spawn n independent generators, so that what draws from one does not shift the other.

    Parameters
    ----------
    rng : numpy.random.Generator
    n : int

    Returns
    -------
    list of numpy.random.Generator

    Raises
    ------
    TypeError
        If ``rng`` is anything else, such as a seed.

    Examples
    --------
    >>> from pfedu.models import streams
    >>> len(streams(np.random.default_rng(1), 2))
    2
    """
    if not isinstance(rng, np.random.Generator):
        raise TypeError(f"rng must be a numpy.random.Generator, e.g. numpy.random.default_rng(1); got {rng!r}")
    return rng.spawn(n)


class AdditiveGaussian(StateSpaceModel):
    r"""A model with additive Gaussian noise, stated in one line each.

    .. math:: x_k = f(k, x_{k-1}) + N(0, Q), \quad y_k = h(k, x_k) + N(0, R), \quad x_0 \sim N(m_0, P_0)

    Parameters
    ----------
    f, h : callable
        ``f(k, x)`` and ``h(k, x)`` for x of shape (..., n_x), giving (..., n_x) and (..., n_y).
    Q, R, P0 : array_like, shape (), (n,) or (n, n)
        Covariances (variances, not standard deviations) of process noise, measurement noise and
        initial state.
    m0 : array_like, shape () or (n_x,)
        Mean of the initial state.

    Raises
    ------
    ValueError
        If a covariance is not positive semi-definite or its size does not fit ``m0``.

    Examples
    --------
    A model of one's own in five lines:

    >>> from pfedu.models import AdditiveGaussian
    >>> model = AdditiveGaussian(
    ...     f=lambda k, x: 0.9 * x,
    ...     h=lambda k, x: x**2 / 20,
    ...     Q=1.0, R=0.1, m0=0.0, P0=5.0)
    >>> x, y = model.simulate(50, np.random.default_rng(1))
    >>> x.shape, y.shape
    ((51, 1), (51, 1))
    """

    def __init__(self, f, h, Q, R, m0, P0):
        self.m0 = np.atleast_1d(np.array(m0, dtype=float))  # (n_x,)
        if self.m0.ndim != 1 or not np.isfinite(self.m0).all():
            raise ValueError(f"m0 must be a vector (n_x,) of finite numbers, got {np.asarray(m0).tolist()}")
        self.w, self.v, self.x0 = Gaussian(Q, "Q"), Gaussian(R, "R"), Gaussian(P0, "P0")
        self.Q, self.R, self.P0 = self.w.cov, self.v.cov, self.x0.cov
        self.n_x, self.n_y = self.m0.size, self.v.n
        self.f, self.h = _checked("f", f, self.n_x), _checked("h", h, self.n_y)
        for name, noise in (("Q", self.w), ("P0", self.x0)):
            if noise.n != self.n_x:
                raise ValueError(f"{name} is {noise.n} x {noise.n}, but m0 has {self.n_x} states")

    def sample_initial(self, n, rng):
        """Draw n states from N(m0, P0): (n, n_x)."""
        return self.m0 + self.x0.sample((n,), rng)

    def propagate(self, k, x, rng):
        """Draw the states of time k from those of time k-1; shape of x."""
        return self.f(k, x) + self.w.sample(x.shape[:-1], rng)

    def measure(self, k, x, rng):
        """Draw a measurement of each state: (..., n_y)."""
        return self.h(k, x) + self.v.sample(x.shape[:-1], rng)

    def log_initial(self, x):
        """Log density of N(m0, P0) at x: (...)."""
        return self.x0.log_density(x - self.m0)

    def log_transition(self, k, x_new, x):
        """Log density of moving from x (time k-1) to x_new (time k): (...)."""
        return self.w.log_density(x_new - self.f(k, x))

    def log_likelihood(self, k, y, x):
        """Log density of the measurement y_k given the states: (...)."""
        return self.v.log_density(y - self.h(k, x))


def _checked(name, function, n):
    """The function, with its shape checked at each call: broadcasting would hide a lost component."""

    def checked(k, x):
        out = function(k, x)
        if np.shape(out) != (*x.shape[:-1], n):
            raise ValueError(f"{name}(k, x) must give shape {(*x.shape[:-1], n)} for x {x.shape}, got {np.shape(out)}")
        return out

    return checked


class LinearGaussian(AdditiveGaussian):
    r"""Linear model with Gaussian noise, which the Kalman filter solves exactly.

    .. math:: x_k = F x_{k-1} + N(0, Q), \quad y_k = H x_k + N(0, R), \quad x_0 \sim N(m_0, P_0)

    Parameters
    ----------
    F : array_like, shape () or (n_x, n_x)
        Transition matrix.
    H : array_like, shape () or (n_y, n_x)
        Measurement matrix.
    Q, R, m0, P0
        As in :class:`AdditiveGaussian`.

    Raises
    ------
    ValueError
        If the shapes do not fit together.

    Examples
    --------
    >>> from pfedu.models import LinearGaussian
    >>> track = LinearGaussian(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=[0.0, 0.1], R=1.0, m0=[0, 1], P0=[1, 1])
    >>> track.n_x, track.n_y
    (2, 1)
    """

    def __init__(self, F, H, Q, R, m0, P0):
        self.F, self.H = (np.atleast_2d(np.array(a, dtype=float)) for a in (F, H))
        super().__init__(lambda k, x: _apply(self.F, x), lambda k, x: _apply(self.H, x), Q, R, m0, P0)
        wanted = {"F": (self.n_x, self.n_x), "H": (self.n_y, self.n_x)}
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must be {shape} to fit m0 and R, got {getattr(self, name).shape}")


def _apply(A, x):
    return x * A[0, 0] if A.size == 1 else x @ A.T


def random_walk(q=10.0, r=1.0, m0=0.0, p0=5.0):
    r"""The linear example of the lecture: a random walk measured with noise.

    .. math:: x_k = x_{k-1} + N(0, q), \qquad y_k = x_k + N(0, r), \qquad x_0 \sim N(m_0, p_0)

    Source: Crassidis, *Particle Filtering: Part II* (lecture 19), with q = 10, r = 1, p0 = 5.

    Parameters
    ----------
    q, r, p0 : float
        Variances.
    m0 : float
        Mean of the initial state.

    Returns
    -------
    LinearGaussian

    Examples
    --------
    >>> from pfedu.models import random_walk
    >>> random_walk().Q.tolist()
    [[10.0]]
    """
    return LinearGaussian(F=1.0, H=1.0, Q=q, R=r, m0=m0, P0=p0)


def local_level(y0, q, r):
    r"""A random walk that starts at the first measurement: the local level model.

    With nothing known before the first measurement (a flat prior), what is known after it is
    :math:`x_0 \sim N(y_0, r)`. A record filtered with this model must therefore not use its first
    row again: replace it by NaN. Source: Durbin and Koopman, *Time Series Analysis by State Space
    Methods*, chapter 2.

    Parameters
    ----------
    y0 : float
        First measurement.
    q, r : float
        Variances of the level's step and of the measurement.

    Returns
    -------
    LinearGaussian

    Examples
    --------
    >>> from pfedu.models import local_level
    >>> model = local_level(1120.0, q=1469.1, r=15099.0)
    >>> model.m0.tolist(), model.P0.tolist()
    ([1120.0], [[15099.0]])
    """
    return random_walk(q=q, r=r, m0=y0, p0=r)


def growth(q=10.0, r=1.0, p0=5.0, phase=0):
    r"""The univariate nonstationary growth model, whose posterior has several peaks.

    .. math::
        x_k = \frac{x_{k-1}}{2} + \frac{25 x_{k-1}}{1 + x_{k-1}^2} + 8\cos(1.2 (k - \text{phase})) + N(0, q),
        \qquad y_k = \frac{x_k^2}{20} + N(0, r)

    Sources: Gordon, Salmond and Smith (1993) print the cosine with the index of the old state
    (``phase=1``); the code of Crassidis' lecture 19 uses that of the new one (``phase=0``). A filter
    must use the phase its record was made with.

    Parameters
    ----------
    q, r, p0 : float
        Variances of process noise, measurement noise and initial state (mean zero).
    phase : int
        By how many steps the cosine lags behind the index of the new state.

    Returns
    -------
    AdditiveGaussian

    Examples
    --------
    >>> from pfedu.models import growth
    >>> growth().f(1, np.array([0.0])).round(4).tolist()
    [2.8989]
    """

    def f(k, x):
        return x / 2 + 25 * x / (1 + x * x) + 8 * np.cos(1.2 * (k - phase))

    return AdditiveGaussian(f=f, h=lambda k, x: x * x / 20, Q=q, R=r, m0=0.0, P0=p0)
