"""A body falls through air, and one radar measures its distance: chapter 9."""

import numpy as np

from pfedu.models.additive import AdditiveGaussian

# sqrt(v^2) for |v|: the step is differentiated by complex moves, which an absolute value would lose
DRAG = {"square": lambda v: v * v, "signed": lambda v: v * np.sqrt(v * v)}


class FallingBody(AdditiveGaussian):
    r"""A vertically falling body of unknown ballistic coefficient, as :func:`falling_body` makes it.

    The noise n acts inside the equations of motion and is constant over a step, so that it is not simply
    added to the new state. The density of a step is therefore not known in closed form, and algorithms
    that need it (``log_transition``) say so.

    Parameters
    ----------
    drag : callable
        Drag as an analytic function of the velocity, in squared units of it.
    alpha : float
        Inverse of the height over which the air thins by a factor e, in 1/ft.
    radar : tuple of float
        Horizontal distance and height of the radar, in ft.
    dt : float
        Step, in s.
    Q, R, m0, P0
        As in :class:`~pfedu.models.AdditiveGaussian`.

    Raises
    ------
    ValueError
        If a covariance is not positive semi-definite or has the wrong size.

    Examples
    --------
    >>> from pfedu.models import falling_body
    >>> falling_body().f(1, np.array([3e5, 2e4, 0.0])).tolist()  # no drag: one second at 20000 ft/s
    [280000.0, 20000.0, 0.0]
    """

    noise_is_additive = False
    log_transition = None

    def __init__(self, drag, alpha, radar, dt, Q, R, m0, P0):
        self.drag, self.alpha, self.radar, self.dt = drag, alpha, radar, dt
        super().__init__(lambda k, x: self.step(k, x, 0.0), self._range, Q, R, m0, P0, jacobian_h=self._slope)

    def step(self, k, x, w):
        """One Runge-Kutta step of the equations of motion, the noise w held constant in it; shape of x."""
        with np.errstate(over="ignore", invalid="ignore"):  # a negative coefficient accelerates without end
            d1 = self._motion(x, w)
            d2 = self._motion(x + 0.5 * self.dt * d1, w)
            d3 = self._motion(x + 0.5 * self.dt * d2, w)
            d4 = self._motion(x + self.dt * d3, w)
            return x + self.dt / 6 * (d1 + 2 * d2 + 2 * d3 + d4)

    def log_likelihood(self, k, y, x):
        """Log density of the measurement y_k given the states; -inf where a state ran away: (...)."""
        gone = ~np.isfinite(x).all(axis=-1)
        with np.errstate(over="ignore"):  # the square of a distance beyond 1e154 standard deviations
            return np.where(gone, -np.inf, super().log_likelihood(k, y, np.where(gone[..., None], 0.0, x)))

    def jacobian_f(self, k, x):
        """Derivative of the step by the state, where the noise is zero: (..., 3, 3)."""
        return _derivative(lambda z: self.step(k, z, 0.0), x)

    def jacobian_w(self, k, x):
        """Derivative of the step by its noise, where the noise is zero: (..., 3, 3)."""
        return _derivative(lambda w: self.step(k, x[..., None, :], w), np.zeros(x.shape))

    def _motion(self, x, w):
        height, velocity, coefficient = x[..., 0], x[..., 1], x[..., 2]
        brake = -np.exp(-self.alpha * height) * self.drag(velocity) * coefficient
        return np.stack([-velocity, brake, np.zeros_like(height)], axis=-1) + w

    def _range(self, k, x):
        return np.hypot(self.radar[0], x[..., :1] - self.radar[1])

    def _slope(self, k, x):
        zero = np.zeros_like(x[..., :1])
        return np.stack([(x[..., :1] - self.radar[1]) / self._range(k, x), zero, zero], axis=-1)


def _derivative(function, x):
    """Derivative by a complex step: the imaginary part at x + ih, exact where differences drown in 3e5 ft."""
    moved = x[..., None, :] + 1e-20j * np.eye(3)  # (..., 3, 3): row j moves component j
    return np.swapaxes(function(moved).imag / 1e-20, -1, -2)


def falling_body(q1=1e-4, q2=1e-12, r=1e4, dt=1.0, m0=(3e5, 2e4, 0.0), P0=(1e6, 4e6, 4e-6), *, drag="square",
                 cross=1.0, alpha=5e-5, radar=(1e5, 1e5)):  # fmt: skip
    r"""The falling body of the lecture: height, velocity, ballistic coefficient; range measured once a second.

    .. math::
        \dot x_1 = -x_2 + n_1, \quad \dot x_2 = -e^{-\alpha x_1} x_2^2 x_3 + n_2, \quad \dot x_3 = n_3, \quad
        y_k = \sqrt{M^2 + (x_{1,k} - Z)^2} + N(0, r)

    .. math:: Q = \begin{pmatrix} q_1 dt^3/3 & c\, q_1 dt^2/2 & 0 \\ c\, q_1 dt^2/2 & q_1 dt & 0 \\
        0 & 0 & q_2 dt \end{pmatrix}

    integrated by one Runge-Kutta step of length dt, with the noise n ~ N(0, Q) constant in it. Feet and seconds.
    Q is what white noise of these intensities adds up to over a step, and the step integrates it once more: in thin
    air, with dt = 1 and c = 1, height gains the variance q_1/12 a step and not q_1/3, and dt other than 1 scales
    the noise by dt besides.
    Source: Crassidis, lecture 19, after Athans, Wishner and Bertolini (1968). Its truth starts at
    (3e5, 2e4, 1e-3): ``model.simulate(60, rng, x0=(3e5, 2e4, 1e-3))``. Its particles start as the defaults
    say; its unscented filter with m0 = (3e5, 2e4, 3e-5) and P0 = (1e6, 4e6, 1e-4), so that the two do not
    start with the same knowledge although the slide says so.

    Parameters
    ----------
    q1, q2 : float
        Intensities of the process noise of the motion and of the coefficient.
    r : float
        Variance of the range, in ft².
    dt : float
        Step, in s.
    m0, P0 : array_like
        Mean and covariance of the initial state.
    drag : str
        ``"square"``: drag grows with :math:`x_2^2`, as the lecture has it, also for a body that flies upwards;
        ``"signed"``: :math:`x_2 |x_2|`, which always brakes.
    cross : float
        The sign c of the covariance between the noise of height and velocity: 1 as the lecture has it; -1 as it
        follows from :math:`\dot x_1 = -x_2`, since what falls faster is lower.
    alpha : float
        Inverse of the height over which the air thins by a factor e, in 1/ft.
    radar : tuple of float
        M and Z: horizontal distance and height of the radar, in ft.

    Returns
    -------
    FallingBody

    Raises
    ------
    ValueError
        If drag or cross is none of these.

    Examples
    --------
    >>> from pfedu.models import falling_body
    >>> x, y = falling_body().simulate(60, np.random.default_rng(1), x0=(3e5, 2e4, 1e-3))
    >>> x.shape, y.shape
    ((61, 3), (61, 1))
    """
    if drag not in DRAG:
        raise ValueError(f"drag must be one of {', '.join(DRAG)}, got {drag!r}")
    if cross not in (1, -1):
        raise ValueError(f"cross is a sign, 1 or -1; got {cross}")
    q12 = cross * q1 * dt**2 / 2
    Q = np.array([[q1 * dt**3 / 3, q12, 0.0], [q12, q1 * dt, 0.0], [0.0, 0.0, q2 * dt]])
    return FallingBody(DRAG[drag], alpha, radar, dt, Q, r, m0, P0)
