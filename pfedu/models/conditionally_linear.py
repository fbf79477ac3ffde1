"""Models that are linear and Gaussian once a part of the state is known; positioning is one. Chapter 11."""

import numpy as np

from pfedu.models.additive import AdditiveGaussian


class ConditionallyLinear(AdditiveGaussian):
    r"""A state :math:`x = (u, z)` of which z is linear and Gaussian, given the path of u.

    .. math::
        x_k = \begin{pmatrix} u_k \\ z_k \end{pmatrix} = f(k, u_{k-1}) + A(k, u_{k-1})\, z_{k-1} + N(0, Q), \qquad
        y_k = h(k, u_k) + C(k, u_k)\, z_k + N(0, R)

    The Rao-Blackwellised filter needs particles for u alone. Where A and C are matrices, all particles share
    one covariance of z. Source: Schön, Gustafsson and Nordlund (2005), the mixed linear/nonlinear model.

    Parameters
    ----------
    n_u : int
        How many components of the state, the first ones, are not linear.
    f : callable
        ``(k, u) -> (..., n_x)``, the part of the step that u alone decides.
    A : array_like, shape (n_x, n_z), or callable
        The part that is linear in z; a function ``(k, u) -> (..., n_x, n_z)`` where it depends on u.
    h : callable
        ``(k, u) -> (..., n_y)``.
    C : array_like, shape (n_y, n_z), or callable
        A function ``(k, u) -> (..., n_y, n_z)`` where it depends on u.
    Q, R, m0, P0
        As in :class:`~pfedu.models.AdditiveGaussian`, for the whole state. The noises of u and z may be correlated.

    Raises
    ------
    ValueError
        If the shapes do not fit together.

    Examples
    --------
    A level that is measured through its square, and a velocity that is not measured at all:

    >>> from pfedu.models import ConditionallyLinear
    >>> model = ConditionallyLinear(
    ...     n_u=1, f=lambda k, u: np.concatenate([u, 0 * u], axis=-1), A=[[1.0], [0.9]],
    ...     h=lambda k, u: u**2, C=[[0.0]], Q=[0.1, 0.1], R=1.0, m0=[1.0, 0.0], P0=[1.0, 1.0])
    >>> model.n_x, model.n_z
    (2, 1)
    """

    def __init__(self, n_u, f, A, h, C, Q, R, m0, P0):
        n_x, n_y = np.size(m0), np.atleast_1d(R).shape[0]
        if not 1 <= n_u < n_x or n_u != int(n_u):
            raise ValueError(f"n_u must be a whole number of at least 1 and below the {n_x} states of m0, got {n_u}")
        self.n_u, self.n_z = int(n_u), n_x - int(n_u)
        self.f_u, self.h_u = _sized("f", f, (n_x,)), _sized("h", h, (n_y,))
        self.A, self.C = self._part("A", A, n_x), self._part("C", C, n_y)
        super().__init__(lambda k, x: self._whole(self.f_u, self.A, k, x),
                         lambda k, x: self._whole(self.h_u, self.C, k, x), Q, R, m0, P0)  # fmt: skip

    def _part(self, name, A, n):
        if callable(A):
            return _sized(name, A, (n, self.n_z))
        A = np.atleast_2d(np.array(A, dtype=float))
        if A.shape != (n, self.n_z):
            raise ValueError(f"{name} must be {(n, self.n_z)} to fit m0, n_u and R, got {A.shape}")
        return lambda k, u: A

    def _whole(self, function, A, k, x):
        u, z = x[..., : self.n_u], x[..., self.n_u :]
        return function(k, u) + (A(k, u) @ z[..., None])[..., 0]


def _sized(name, function, shape):
    """The function, with its last axes checked at each call: a part of the wrong size would broadcast."""

    def sized(k, u):
        out = function(k, u)
        if np.shape(out)[-len(shape) :] != shape:
            wanted = ", ".join(map(str, shape))
            raise ValueError(f"{name}(k, u) must give shape (..., {wanted}) for u {u.shape}, got {np.shape(out)}")
        return out

    return sized


def positioning(q_v=1.0, q_d=1e-4, r=25.0, dt=1.0, beacons=((0.0, 0.0), (1000.0, 0.0), (0.0, 1000.0)),
                m0=(300.0, 300.0, 10.0, 5.0, 0.0, 0.0), P0=(100.0, 100.0, 4.0, 4.0, 100.0, 0.01)):  # fmt: skip
    r"""A vehicle in the plane finds its place from pseudo-ranges, with a clock that is wrong and drifts.

    State: position (2), velocity (2), bias of the clock and its drift, both times the speed of light.

    .. math::
        p_k &= p_{k-1} + v_{k-1} dt + w_p, & v_k &= v_{k-1} + w_v, \\
        b_k &= b_{k-1} + d_{k-1} dt + w_b, & d_k &= d_{k-1} + w_d, \\
        y_{k,j} &= |p_k - \text{beacon}_j| + b_k + N(0, r)

    Noise of constant intensity acts on velocity and drift, which gives each pair the covariance
    :math:`q \begin{pmatrix} dt^3/3 & dt^2/2 \\ dt^2/2 & dt \end{pmatrix}`. Only the position is measured in a
    nonlinear way: four of six states are linear and Gaussian once its path is known. After the navigation
    examples of Gustafsson et al. (2002).

    Parameters
    ----------
    q_v, q_d : float
        Intensity of the noise of each velocity, in m²/s³, and of the drift.
    r : float
        Variance of a pseudo-range, in m².
    dt : float
        Step, in s.
    beacons : array_like, shape (n_y, 2)
        Where the beacons stand, in m.
    m0, P0 : array_like
        Mean and covariance of the initial state (m, m, m/s, m/s, m, m/s).

    Returns
    -------
    ConditionallyLinear
        With n_u = 2 and shared covariances.

    Raises
    ------
    ValueError
        If the beacons are not rows of two coordinates.

    Examples
    --------
    >>> from pfedu.models import positioning
    >>> x, y = positioning().simulate(50, np.random.default_rng(1))
    >>> x.shape, y.shape
    ((51, 6), (51, 3))
    """
    beacons = np.array(beacons, dtype=float)  # (n_y, 2)
    if beacons.ndim != 2 or beacons.shape[1] != 2:
        raise ValueError(f"beacons must be rows of two coordinates, shape (n_y, 2); got {beacons.shape}")
    A = np.zeros((6, 4))  # of velocity, bias, drift
    A[[0, 1, 4], [0, 1, 3]] = dt
    A[[2, 3, 4, 5], [0, 1, 2, 3]] = 1.0
    Q = np.zeros((6, 6))
    for place, rate, q in ((0, 2, q_v), (1, 3, q_v), (4, 5, q_d)):
        Q[np.ix_([place, rate], [place, rate])] = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    C = np.tile([0.0, 0.0, 1.0, 0.0], (len(beacons), 1))

    def f(k, u):
        return np.concatenate([u, np.zeros((*u.shape[:-1], 4))], axis=-1)

    def h(k, u):
        return np.linalg.norm(u[..., None, :] - beacons, axis=-1)

    return ConditionallyLinear(2, f, A, h, C, Q, np.full(len(beacons), r), m0, P0)
