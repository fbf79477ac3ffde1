"""Problems with exact answers, and the distance of a particle filter from them in standard errors.

The exact answers come from the Kalman filter and from the grid. What is compared follows from one theorem: with
Z_k the exact likelihood of y_0..y_k and Zhat_k its estimate, the expectation of Zhat_k / Z_k times any weighted
average equals the exact average, for every N, every unbiased resampling scheme and every policy that looks at
the weights only (Del Moral 2004, theorem 7.4.2; Whiteley, Lee and Heine 2016 for adaptive policies). A filter with
another proposal, or one that looks ahead, is a bootstrap filter of another model, and the theorem holds for it as
well. Hence over independent runs

    Zhat_k / Z_k - 1,   (Zhat_k / Z_k) (m_k - exact mean),   (Zhat_k / Z_k) (second moment about it - exact var)

all have mean zero without any allowance for bias, and the bound is a number of standard errors, each taken
from the scatter of the runs themselves.
"""

import functools

import numpy as np
from records import measurements, reference

from pfedu.grid import grid_filter
from pfedu.kalman import kalman_filter
from pfedu.models import LinearGaussian, growth, random_walk, ratio
from pfedu.track import Track

SEEDS = 200  # independent runs behind every comparison with an exact answer
SEVERAL = 5  # standard errors: with up to 150 comparisons a test, chance alone exceeds them once in 10 000 tests
THROWN = {"ratio_A": [12]}  # step at which one run in a hundred has a particle that the pole threw far, and that stays
RECORDED = {"growth_A": growth(), "growth_C": growth(phase=1), "ratio_A": ratio()}


@functools.cache
def problem(name, n_steps=50):
    """Model, record and exact track (mean, cov, log-likelihood increments) of a reference record up to a step."""
    y = measurements(name)[: n_steps + 1]
    if name == "linear_A":
        model = random_walk()
        return model, y, kalman_filter(model, y)
    data = reference(name)[: n_steps + 1]
    exact = Track(data["post_mean"][:, None], data["post_var"][:, None, None], data["loglik_inc"])
    return RECORDED[name], y, exact


@functools.cache
def tame_ratio(n_steps=50, n_runs=None):
    """The ratio model without a pole, accurately measured: model, records made with it, exact tracks.

    The posterior is at least 0.0995 wide, 1.7 times the gap of 0.057: the trapezoidal rule errs by exp(-2 (1.7 pi)^2).
    """
    model = ratio(q=1.0, r=0.01, power=2)
    y = model.simulate(n_steps, np.random.default_rng(1), n_runs)[1]
    return model, y, grid_filter(model, y, np.linspace(-16.0, 16.0, 561))


def three_states(n_y, scale=1.0):
    """A linear model without symmetries: noise of rank one drives three states, that of two measurements is correlated.

    ``scale`` is that of the process noise.
    """
    return LinearGaussian(
        F=[[0.9, 0.3, 0.0], [-0.2, 1.0, 0.4], [0.1, 0.0, 0.7]],
        H=[[1.0, 0.0, 0.5], [0.3, -1.0, 0.2]][:n_y],
        Q=scale * np.outer([1.0, 2.0, -1.0], [1.0, 2.0, -1.0]),
        R=np.array([[0.5, 0.2], [0.2, 0.8]])[:n_y, :n_y],
        m0=[1.0, -2.0, 0.5],
        P0=[[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 1.5]],
    )


def in_standard_errors(values):
    """Distance of the mean over runs (axis 0) from zero, in standard errors; rounding (1e-10) counts as none."""
    se = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return np.abs(values.mean(axis=0)) / np.maximum(se, 1e-10)


def worst(track, exact, rare=()):
    """Largest distance of likelihood, mean and covariance from the exact ones, over steps and entries.

    ``rare`` are steps whose covariance is left out: it rests on draws too rare for a standard error.
    """
    ratio_z = np.exp(np.cumsum(track.log_likelihood_increments - exact.log_likelihood_increments, axis=-1))
    d = track.mean - exact.mean  # (runs, ..., T+1, n_x)
    second = track.cov + d[..., :, None] * d[..., None, :] - exact.cov
    weighted = {"likelihood": ratio_z - 1, "mean": ratio_z[..., None] * d, "cov": ratio_z[..., None, None] * second}
    weighted["cov"] = np.delete(weighted["cov"], rare, axis=-3)
    return {name: in_standard_errors(values).max() for name, values in weighted.items()}


def mean_square_deviation(track, exact):
    """Mean square deviation from the exact mean of each run, the steps with a measurement averaged: (runs,)."""
    return np.mean((track.mean - exact.mean)[:, 1:, 0] ** 2, axis=-1)
