"""Models whose noise is Gaussian and added, stated in one line each; the linear ones among them."""

import numpy as np

from pfedu.gaussian import Gaussian
from pfedu.models.jacobian import jacobian
from pfedu.models.state_space import StateSpaceModel, require


class AdditiveProcess(StateSpaceModel):
    r"""A state driven by added Gaussian noise, and a measurement of any kind.

    .. math:: x_k = f(k, x_{k-1}) + N(0, Q), \quad x_0 \sim N(m_0, P_0), \quad y_k \sim p(y_k \mid x_k)

    Parameters
    ----------
    f : callable or array_like, shape () or (n_x, n_x)
        ``f(k, x)`` for x of shape (..., n_x), giving (..., n_x); or a matrix F, for f(k, x) = F x.
    log_likelihood : callable
        ``(k, y, x) -> (...)``, log p(y_k | x_k).
    Q, P0 : array_like, shape (), (n_x,) or (n_x, n_x)
        Covariances (variances, not standard deviations) of process noise and initial state.
    m0 : array_like, shape () or (n_x,)
        Mean of the initial state.
    measure : callable, optional
        ``(k, x, rng) -> y (..., n_y)``, draws from p(y_k | x_k).
    n_y : int
        Number of measured quantities.
    jacobian_f : callable, optional
        ``(k, x) -> (..., n_x, n_x)``, derivative of f. Differences of f stand in for it.

    Attributes
    ----------
    F : ndarray, shape (n_x, n_x)
        Only where f was given as a matrix.

    Raises
    ------
    ValueError
        If a covariance is not positive semi-definite or its size does not fit ``m0``.

    Examples
    --------
    A count that says how high an unseen level stands:

    >>> from pfedu.models import AdditiveProcess
    >>> model = AdditiveProcess(
    ...     f=0.9, log_likelihood=lambda k, y, x: (y * x - np.exp(x))[..., 0],
    ...     Q=0.1, m0=0.0, P0=1.0, measure=lambda k, x, rng: rng.poisson(np.exp(x)))
    >>> model.simulate(3, np.random.default_rng(1))[1].shape
    (4, 1)
    """

    noise_is_additive = True  # else the density of the transition is unknown, and an EKF must differentiate by w

    def __init__(self, f, log_likelihood, Q, m0, P0, *, measure=None, n_y=1, jacobian_f=None):
        self._state(f, Q, m0, P0, jacobian_f)
        self.n_y, self.log_likelihood, self.measure = n_y, log_likelihood, measure

    def _state(self, f, Q, m0, P0, jacobian_f):
        self.m0 = np.atleast_1d(np.array(m0, dtype=float))  # (n_x,)
        if self.m0.ndim != 1 or not np.isfinite(self.m0).all():
            raise ValueError(f"m0 must be a vector (n_x,) of finite numbers, got {np.asarray(m0).tolist()}")
        self.n_x = self.m0.size
        self.w, self.x0 = Gaussian(Q, "Q"), Gaussian(P0, "P0")
        self.Q, self.P0 = self.w.cov, self.x0.cov
        for name, noise in (("Q", self.w), ("P0", self.x0)):
            if noise.n != self.n_x:
                raise ValueError(f"{name} is {noise.n} x {noise.n}, but m0 has {self.n_x} states")
        self.f, self._jacobian_f = self._function("f", f, self.n_x, jacobian_f)

    def _function(self, name, function, n, derivative):
        """A function of the state with its derivative, each checked at each call; a matrix is kept by its name."""
        if not callable(function):
            matrix = _matrix(name.translate({ord("f"): "F", ord("h"): "H"}), function, (n, self.n_x))
            setattr(self, name.translate({ord("f"): "F", ord("h"): "H"}), matrix)
            function, derivative = (lambda k, x: _apply(matrix, x)), lambda k, x: _as_many(matrix, x)
        if derivative is None:
            scale = np.sqrt(np.diag(self.P0) + np.diag(self.Q))  # how far states of this model lie apart
            derivative = lambda k, x: jacobian(lambda z: checked(k, z), x, scale)  # noqa: E731
        checked = _checked(name, function, (n,))
        return checked, _checked(f"jacobian_{name}", derivative, (n, self.n_x))

    def sample_initial(self, n, rng):
        """Draw n states from N(m0, P0): (n, n_x)."""
        return self.m0 + self.x0.sample((n,), rng)

    def step(self, k, x, w):
        """The state of time k from that of time k-1 and the noise of the step; shape of x."""
        return self.f(k, x) + w

    def propagate(self, k, x, rng):
        """Draw the states of time k from those of time k-1; shape of x."""
        return self.step(k, x, self.w.sample(x.shape[:-1], rng))

    def log_initial(self, x):
        """Log density of N(m0, P0) at x: (...)."""
        return self.x0.log_density(x - self.m0)

    def log_transition(self, k, x_new, x):
        """Log density of moving from x (time k-1) to x_new (time k): (...)."""
        return self.w.log_density(x_new - self.f(k, x))

    def jacobian_f(self, k, x):
        """Derivative of the step by the state, where the noise is zero: (..., n_x, n_x)."""
        return self._jacobian_f(k, x)

    def jacobian_w(self, k, x):
        """Derivative of the step by its noise, where the noise is zero: (..., n_x, n_x)."""
        if self.noise_is_additive:
            return _as_many(np.eye(self.n_x), x)
        return jacobian(lambda w: self.step(k, x[..., None, :], w), np.zeros(x.shape), np.sqrt(np.diag(self.Q)))


class AdditiveGaussian(AdditiveProcess):
    r"""A model with additive Gaussian noise, stated in one line each.

    .. math:: x_k = f(k, x_{k-1}) + N(0, Q), \quad y_k = h(k, x_k) + N(0, R), \quad x_0 \sim N(m_0, P_0)

    Parameters
    ----------
    f, h : callable or array_like
        ``f(k, x)`` and ``h(k, x)`` for x of shape (..., n_x), giving (..., n_x) and (..., n_y); or a
        matrix F or H in place of a function, which states that this one is linear.
    Q, R, P0 : array_like, shape (), (n,) or (n, n)
        Covariances (variances, not standard deviations) of process noise, measurement noise and
        initial state.
    m0 : array_like, shape () or (n_x,)
        Mean of the initial state.
    jacobian_f, jacobian_h : callable, optional
        ``(k, x) -> (..., n_x, n_x)`` and ``(..., n_y, n_x)``, derivatives of f and h. Differences
        stand in for what is not given.

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

    def __init__(self, f, h, Q, R, m0, P0, *, jacobian_f=None, jacobian_h=None):
        self._state(f, Q, m0, P0, jacobian_f)
        self.v = Gaussian(R, "R")
        self.R, self.n_y = self.v.cov, self.v.n
        self.h, self._jacobian_h = self._function("h", h, self.n_y, jacobian_h)

    def measure(self, k, x, rng):
        """Draw a measurement of each state: (..., n_y)."""
        return self.h(k, x) + self.v.sample(x.shape[:-1], rng)

    def log_likelihood(self, k, y, x):
        """Log density of the measurement y_k given the states: (...)."""
        return self.v.log_density(y - self.h(k, x))

    def jacobian_h(self, k, x):
        """Derivative of the measurement by the state: (..., n_y, n_x)."""
        return self._jacobian_h(k, x)


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
        super().__init__(F, H, Q, R, m0, P0)


def copies(model, n):
    """N independent copies of a model, as one model of n times the dimension.

    The state stacks the copies, ``x.reshape(..., n, n_x)`` takes it apart again; so does y. Every
    posterior is the product of the posteriors of the copies, which is what makes this the fair
    measure of what dimension costs.

    Parameters
    ----------
    model : AdditiveGaussian
    n : int
        Number of copies.

    Returns
    -------
    AdditiveGaussian
        A :class:`LinearGaussian` of one.

    Raises
    ------
    MissingPieceError
        If the model has no functions f and h with Gaussian noise.
    ValueError
        If n is not a whole number of at least 1, or noise is not simply added.

    Examples
    --------
    >>> from pfedu.models import copies, random_walk
    >>> copies(random_walk(q=1.0), 3).Q.tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    if not (n >= 1 and n == int(n)):
        raise ValueError(f"the number of copies must be a whole number of at least 1, got {n}")
    for piece in ("f", "Q", "h", "R", "P0"):
        require(model, piece, "a model of copies")
    if not model.noise_is_additive:
        raise ValueError(f"the noise of {type(model).__name__} is not simply added, which copies need")

    def many(A):
        return np.kron(np.eye(int(n)), A)

    def each(function, size):
        def stacked(k, x):
            out = function(k, x.reshape(*x.shape[:-1], int(n), model.n_x))
            return out.reshape(*x.shape[:-1], int(n) * size)

        return stacked

    f = many(model.F) if hasattr(model, "F") else each(model.f, model.n_x)
    h = many(model.H) if hasattr(model, "H") else each(model.h, model.n_y)
    kind = LinearGaussian if hasattr(model, "F") and hasattr(model, "H") else AdditiveGaussian
    return kind(f, h, many(model.Q), many(model.R), np.tile(model.m0, int(n)), many(model.P0))


def _checked(name, function, shape):
    """The function, with its shape checked at each call: broadcasting would hide a lost component."""

    def checked(k, x):
        out = function(k, x)
        if np.shape(out) != (*x.shape[:-1], *shape):
            raise ValueError(f"{name}(k, x) must give shape {(*x.shape[:-1], *shape)} for x {x.shape}, "
                             f"got {np.shape(out)}")  # fmt: skip
        return out

    return checked


def _matrix(name, A, shape):
    A = np.atleast_2d(np.array(A, dtype=float))
    if A.shape != shape:
        raise ValueError(f"{name} must be {shape} to fit m0 and R, got {A.shape}")
    return A


def _apply(A, x):
    return x * A[0, 0] if A.size == 1 else x @ A.T


def _as_many(A, x):
    """The matrix, once for each state."""
    return np.broadcast_to(A, (*x.shape[:-1], *A.shape))
