"""Linear systems that jump between modes: given the modes everything is Gaussian, and there are too many of them."""

import numpy as np

from pfedu.gaussian import Gaussian, log_density
from pfedu.models.state_space import StateSpaceModel


class JumpMarkov(StateSpaceModel):
    r"""A jump-Markov linear system: a hidden mode picks the matrices of each step.

    .. math::
        p(s_k = j \mid s_{k-1} = i) = \Pi_{ij}, \qquad z_k = A_{s_k} z_{k-1} + N(0, Q_{s_k}), \qquad
        y_k = C_{s_k} z_k + N(0, R_{s_k})

    The state is :math:`x = (s, z)`, the mode first, as a float. Source: Doucet, Gordon and Krishnamurthy (2001).

    Parameters
    ----------
    A : array_like, shape (M, n_z, n_z)
        Transition matrix of each mode.
    C : array_like, shape (M, n_y, n_z)
        Measurement matrix of each mode.
    Q, R : array_like, shape (M, n_z, n_z) and (M, n_y, n_y)
        Covariances of each mode.
    Pi : array_like, shape (M, M)
        Probabilities of the next mode; row i is for mode i and sums to one.
    m0, P0 : array_like, shape (n_z,) and (n_z, n_z)
        Mean and covariance of z at time 0.
    p0 : array_like, shape (M,), optional
        Probabilities of the mode at time 0; equal by default.

    Raises
    ------
    ValueError
        If shapes do not fit together, a number is not finite, or probabilities do not sum to one.

    Examples
    --------
    >>> from pfedu.models import jump_markov
    >>> x, y = jump_markov().simulate(10, np.random.default_rng(1))
    >>> x.shape, sorted(set(x[:, 0].tolist()))
    ((11, 3), [0.0, 1.0])
    """

    def __init__(self, A, C, Q, R, Pi, m0, P0, p0=None):
        for name, each in {"A": A, "C": C, "Q": Q, "R": R}.items():
            if np.ndim(each) != 3:
                raise ValueError(f"{name} must hold one matrix for each mode, three axes in all; got {np.shape(each)}")
        self.A, self.C, self.Pi = (np.array(a, dtype=float) for a in (A, C, Pi))
        self.n_modes, self.n_z = self.A.shape[0], self.A.shape[-1]
        self.p0 = np.full(self.n_modes, 1 / self.n_modes) if p0 is None else np.array(p0, dtype=float)
        self.w = [Gaussian(q, f"Q of mode {s}") for s, q in enumerate(Q)]
        self.v = [Gaussian(r, f"R of mode {s}") for s, r in enumerate(R)]
        self.z0 = Gaussian(P0, "P0")
        self.m0, self.P0 = np.array(m0, dtype=float), self.z0.cov
        self.Q, self.R = np.stack([w.cov for w in self.w]), np.stack([v.cov for v in self.v])
        self.n_x, self.n_y = 1 + self.n_z, self.C.shape[-2]
        self._check()

    def _check(self):
        M, n, m = self.n_modes, self.n_z, self.n_y
        wanted = {"A": (M, n, n), "C": (M, m, n), "Q": (M, n, n), "R": (M, m, m), "Pi": (M, M), "p0": (M,),
                  "m0": (n,), "P0": (n, n)}  # fmt: skip
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must have shape {shape} to fit A, got {getattr(self, name).shape}")
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"{name} must be finite, got {getattr(self, name).tolist()}")
        for name in ("Pi", "p0"):
            p = getattr(self, name)
            if (p < 0).any() or (np.abs(p.sum(axis=-1) - 1) > 1e-9).any():
                raise ValueError(f"{name} must hold probabilities that sum to 1 in each row, got {p.tolist()}")

    def sample_initial(self, n, rng):
        """Draw n states (s, z) of time 0: (n, 1 + n_z)."""
        s = self.draw_modes(np.broadcast_to(self.p0, (n, self.n_modes)), rng)
        return np.concatenate([s[:, None], self.m0 + self.z0.sample((n,), rng)], axis=-1)

    def draw_modes(self, p, rng):
        """Draw a mode from each row of probabilities (..., M), as floats: (...)."""
        return np.sum(rng.random(p.shape[:-1])[..., None] >= np.cumsum(p, axis=-1)[..., :-1], axis=-1).astype(float)

    def propagate(self, k, x, rng):
        """Draw the mode of time k, then z by that mode: shape of x."""
        s = self.draw_modes(self.Pi[modes(x)], rng)
        i, noise = s.astype(int), rng.standard_normal((*s.shape, self.n_z))
        roots = np.stack([w.root for w in self.w])
        z = _times(self.A[i], x[..., 1:]) + _times(roots[i], noise)
        return np.concatenate([s[..., None], z], axis=-1)

    def measure(self, k, x, rng):
        """Draw a measurement of each state: (..., n_y)."""
        i, noise = modes(x), rng.standard_normal((*x.shape[:-1], self.n_y))
        roots = np.stack([v.root for v in self.v])
        return _times(self.C[i], x[..., 1:]) + _times(roots[i], noise)

    def log_likelihood(self, k, y, x):
        """Log density of the measurement y_k given the states: (...)."""
        i = modes(x)
        return _density(self.v, i, y - _times(self.C[i], x[..., 1:]))

    def log_initial(self, x):
        """Log density (of z) times probability (of the mode) at time 0: (...)."""
        with np.errstate(divide="ignore"):
            return np.log(self.p0)[modes(x)] + log_density(x[..., 1:], self.m0, self.P0)

    def log_transition(self, k, x_new, x):
        """Log of the probability of the jump times the density of the move: (...)."""
        i, j = modes(x), modes(x_new)
        d = x_new[..., 1:] - _times(self.A[j], x[..., 1:])
        with np.errstate(divide="ignore"):
            return np.log(self.Pi)[i, j] + _density(self.w, j, d)


def modes(x):
    """Modes of states (s, z), as whole numbers.

    Parameters
    ----------
    x : ndarray, shape (..., 1 + n_z)

    Returns
    -------
    ndarray of int, shape (...)

    Examples
    --------
    >>> from pfedu.models.jump_markov import modes
    >>> modes(np.array([[1.0, 0.3], [0.0, 2.0]])).tolist()
    [1, 0]
    """
    return x[..., 0].astype(int)


def _times(A, x):
    return (A @ x[..., None])[..., 0]


def _density(noises, i, d):
    """Log density of each deviation d (..., n) by the noise of its own mode i: (...)."""
    log_p = np.stack([noise.log_density(d) for noise in noises], axis=-1)  # (..., M)
    i = np.broadcast_to(i, log_p.shape[:-1])  # d may be of all pairs
    return np.take_along_axis(log_p, i[..., None], axis=-1)[..., 0]


def jump_markov(d=2, a=0.9, q=0.5, r=0.5, stay=0.9):
    r"""A system of d dimensions that turns about at random: :math:`A_0 = a I`, :math:`A_1 = -a I`.

    .. math:: z_k = \pm a\, z_{k-1} + N(0, q I), \qquad y_k = z_k + N(0, r I), \qquad z_0 \sim N(0, I)

    Its posterior is a mixture of one Gaussian for each sequence of modes, so that for a short record the exact
    answer can be had by going through all of them.

    Parameters
    ----------
    d : int
        Dimension of z.
    a : float
        Factor of a step, up to its sign.
    q, r : float
        Variances of process and measurement noise.
    stay : float
        Probability that the mode stays what it is.

    Returns
    -------
    JumpMarkov

    Examples
    --------
    >>> from pfedu.models import jump_markov
    >>> jump_markov(d=1).A.ravel().tolist()
    [0.9, -0.9]
    """
    eye = np.eye(d)
    both = np.stack([eye, eye])
    return JumpMarkov(A=[a * eye, -a * eye], C=both, Q=q * both, R=r * both, m0=np.zeros(d), P0=eye,
                      Pi=[[stay, 1 - stay], [1 - stay, stay]])  # fmt: skip
