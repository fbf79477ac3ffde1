"""Derivatives of a model's functions, where nobody wrote them down."""

import numpy as np


def jacobian(function, x, scale=1.0):
    r"""Derivative of a function of many states at once, by central differences.

    .. math:: \frac{\partial f_i}{\partial x_j} \approx \frac{f_i(x + h_j e_j) - f_i(x - h_j e_j)}{2 h_j}

    With :math:`h_j = \epsilon^{1/3} \max(|x_j|, s_j)`, where :math:`\epsilon` is the spacing of doubles at 1,
    truncation and rounding are about equally large: some ten digits are right.

    Parameters
    ----------
    function : callable
        Of states (..., n) to values (..., m).
    x : ndarray, shape (..., n)
    scale : float or array_like, shape (n,)
        The size s of a component that counts as ordinary, in its unit.

    Returns
    -------
    ndarray, shape (..., m, n)

    Examples
    --------
    >>> from pfedu.models.jacobian import jacobian
    >>> jacobian(lambda x: x**2, np.array([[1.0, 3.0]])).round(6).tolist()
    [[[2.0, 0.0], [0.0, 6.0]]]
    """
    x = np.asarray(x, dtype=float)
    h = np.cbrt(np.finfo(float).eps) * np.maximum(np.abs(x), np.where(np.asarray(scale) > 0, scale, 1.0))  # (..., n)
    moves = h[..., None, :] * np.eye(x.shape[-1])  # (..., n, n): row j moves component j
    up, down = x[..., None, :] + moves, x[..., None, :] - moves
    width = np.sum(up - down, axis=-1)  # (..., n), as rounded
    return np.swapaxes((function(up) - function(down)) / width[..., None], -1, -2)
