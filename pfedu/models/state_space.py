r"""State-space models: how the state moves and what is measured of it.

.. math:: x_k = f(k, x_{k-1}, w_k), \qquad y_k = h(k, x_k, v_k)

Step k always means the step *to* time k: ``propagate(k, x, rng)`` takes states of time k-1 to time k.
States have shape (..., n_x) and measurements (..., n_y); leading axes are particles and runs.
"""

import numpy as np


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
    f : callable, optional
        ``(k, x) -> x``, where a state most likely goes: its mean, say. The auxiliary filter looks ahead with it.
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
                 log_initial=None, log_transition=None, f=None, n_x=1, n_y=1):  # fmt: skip
        self.n_x, self.n_y = n_x, n_y
        given = dict(sample_initial=sample_initial, propagate=propagate, log_likelihood=log_likelihood,
                     measure=measure, log_initial=log_initial, log_transition=log_transition, f=f)  # fmt: skip
        for name, function in given.items():
            if function is not None and not callable(function):
                raise TypeError(f"{name} must be a function, got {function!r}")
            setattr(self, name, function)

    def simulate(self, n_steps, rng, n_runs=None, *, x0=None):
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
        x0 : array_like, shape (n_x,) or (n_runs, n_x), optional
            Start there, instead of at a draw from the prior.

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
        ValueError
            If a number of steps or runs is no such number, or ``x0`` is no state of the model.
        """
        require(self, "measure", "simulating measurements")
        for name, least, value in (("n_steps", 0, n_steps), ("n_runs", 1, 1 if n_runs is None else n_runs)):
            if not (least <= value < np.inf and value == int(value)):
                raise ValueError(f"{name} must be a whole number of at least {least}, got {value}")
        n = int(n_runs or 1)
        rng_x, rng_y = streams(rng, 2)
        x = [np.asarray(self.sample_initial(n, rng_x) if x0 is None else self._starts(x0, n))]  # (runs, n_x)
        for k in range(1, int(n_steps) + 1):
            x.append(np.asarray(self.propagate(k, read_only(x[-1]), rng_x)))
        y = [self.measure(k, x_k, rng_y) for k, x_k in enumerate(x)]
        x, y = np.stack(x, axis=1), np.stack(y, axis=1)  # (runs, T+1, n)
        return (x, y) if n_runs else (x[0], y[0])

    def _starts(self, x0, n):
        x0 = np.array(x0, dtype=float)
        if x0.shape not in {(self.n_x,), (n, self.n_x)}:
            raise ValueError(
                f"x0 must be a state, shape ({self.n_x},), or one a run, ({n}, {self.n_x}); got {x0.shape}"
            )
        return np.broadcast_to(x0, (n, self.n_x))


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
    pfedu.models.state_space.MissingPieceError: AdditiveGaussian has no F, which the Kalman filter needs
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
