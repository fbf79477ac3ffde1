"""The van der Pol oscillator: a limit cycle, one of whose two states is measured."""

import numpy as np

from pfedu.models.additive import AdditiveGaussian


def van_der_pol(mu=1.0, dt=0.05, q=0.025**2, r=0.04**2, m0=(2.0, 0.0), p0=1.0):
    r"""Van der Pol's oscillator, one Euler step at a time.

    .. math::
        x_{1,k} &= x_{1,k-1} + x_{2,k-1}\, dt + N(0, q) \\
        x_{2,k} &= x_{2,k-1} + \bigl(\mu (1 - x_{1,k-1}^2)\, x_{2,k-1} - x_{1,k-1}\bigr) dt + N(0, q) \\
        y_k &= x_{1,k} + N(0, r)

    Source: the example of MATLAB's ``particleFilter``. Two choices of its files are worth knowing. What is
    written as a variance of 0.025 is used as a standard deviation, hence q = 0.025². The likelihood has the
    variance r = 0.016, ten times that of the measurements made in the example, 0.04² = 0.0016; either can be
    had here, and the default is the one that fits the measurements.

    Parameters
    ----------
    mu : float
        Nonlinearity; 0 is a harmonic oscillator.
    dt : float
        Step, in seconds.
    q, r : float
        Variances of the process noise of each state and of the measurement.
    m0 : array_like, shape (2,)
        Mean of the initial state.
    p0 : float
        Variance of each initial state.

    Returns
    -------
    AdditiveGaussian

    Examples
    --------
    >>> from pfedu.models import van_der_pol
    >>> van_der_pol().f(1, np.array([2.0, 0.0])).tolist()
    [2.0, -0.1]
    """

    def f(k, x):
        x1, x2 = x[..., 0], x[..., 1]
        return np.stack([x1 + x2 * dt, x2 + (mu * (1 - x1 * x1) * x2 - x1) * dt], axis=-1)

    def jacobian_f(k, x):
        x1, x2 = x[..., 0], x[..., 1]
        rows = [[np.ones(x1.shape), np.full(x1.shape, dt)], [-(2 * mu * x1 * x2 + 1) * dt, 1 + mu * (1 - x1 * x1) * dt]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    return AdditiveGaussian(f=f, h=[[1.0, 0.0]], Q=[q, q], R=r, m0=m0, P0=[p0, p0], jacobian_f=jacobian_f)
