"""The posterior over time as a surface, and the density of weighted particles that such a picture needs."""

import numpy as np

from pfedu.figures.style import COLORS


def kernel_density(x, log_w, nodes, *, bandwidth=None):
    r"""Smooth density of weighted particles: a Gaussian about each, as heavy as its weight.

    .. math:: \widehat p(x) = \sum_i w^{(i)} N(x; x^{(i)}, h^2)

    The bandwidth h is Silverman's rule of thumb with the effective number of particles in place of their number,
    :math:`h = 0.9 \min(\text{sd}, \text{IQR} / 1.34) \, N_\text{eff}^{-1/5}`, both spreads weighted. Source:
    Silverman, *Density Estimation for Statistics and Data Analysis* (1986), section 3.4.2.

    Parameters
    ----------
    x : array_like, shape (..., N)
        One state of each particle.
    log_w : array_like, shape (..., N)
        Normalised log weights.
    nodes : array_like, shape (G,)
        Where to evaluate the density, the same states for every run and time step.
    bandwidth : float, optional
        h, in the units of the state.

    Returns
    -------
    ndarray, shape (..., G)
        Per unit of the state.

    Examples
    --------
    >>> from pfedu.figures.surface import kernel_density
    >>> density = kernel_density([-1.0, 1.0], np.log([0.25, 0.75]), [-1.0, 1.0], bandwidth=0.1)
    >>> (density[1] / density[0]).round(6)
    np.float64(3.0)
    """
    x, w, nodes = np.asarray(x, dtype=float), np.exp(log_w), np.asarray(nodes, dtype=float)
    h = np.full(x.shape[:-1], bandwidth) if bandwidth else _silverman(x, w)
    z = (nodes[:, None] - x[..., None, :]) / h[..., None, None]  # (..., G, N)
    return np.einsum("...gn,...n->...g", np.exp(-0.5 * z * z), w) / (h[..., None] * np.sqrt(2 * np.pi))


def _silverman(x, w):
    mean = np.sum(w * x, axis=-1, keepdims=True)
    sd = np.sqrt(np.sum(w * (x - mean) ** 2, axis=-1))
    order = np.argsort(x, axis=-1)
    below = np.cumsum(np.take_along_axis(w, order, axis=-1), axis=-1)
    ends = [np.argmax(below >= level, axis=-1)[..., None] for level in (0.25, 0.75)]
    low, high = (np.take_along_axis(np.take_along_axis(x, order, axis=-1), end, axis=-1)[..., 0] for end in ends)
    spread = np.where(high > low, np.minimum(sd, (high - low) / 1.34), sd)
    return 0.9 * spread * np.sum(w * w, axis=-1) ** 0.2


def plot_surface(ax, x, densities, *, times=None, color=COLORS["light"], edge=COLORS["particles"]):
    """Draw densities over the state and time as one surface; every row stands over the same states.

    Parameters
    ----------
    ax : mpl_toolkits.mplot3d.axes3d.Axes3D
        From ``subplots(subplot_kw={"projection": "3d"})``.
    x : array_like, shape (G,)
        States, the same at all times.
    densities : array_like, shape (T+1, G)
        One density a row.
    times : array_like, shape (T+1,), optional
    color, edge : str
        Of the surface and of its lines, one a row.

    Returns
    -------
    mpl_toolkits.mplot3d.art3d.Poly3DCollection

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.surface import plot_surface
    >>> ax = Figure().subplots(subplot_kw={"projection": "3d"})
    >>> surface = plot_surface(ax, [0, 1, 2], [[0, 1, 0], [0, 2, 0]])
    >>> ax.get_zlabel()
    'density'
    """
    densities = np.asarray(densities, dtype=float)
    times = np.arange(len(densities)) if times is None else np.asarray(times)
    states, rows = np.meshgrid(x, times)
    look = dict(color=color, edgecolor=edge, linewidth=0.25, antialiased=True)
    surface = ax.plot_surface(states, rows, densities, rcount=len(times), ccount=min(len(x), 100), **look)
    ax.set(xlabel="state", ylabel="time step k", zlabel="density")
    return surface
