"""The online object: the same steps as the batch filter, driven by hand.

Three oracles. The batch filter, itself tested against exact answers, must be met bit for bit. Where the batch
filter has no say (predictions, angles) the Kalman filter and a recursion on a grid of the circle are exact, and
with Zhat/Z the likelihood estimate over the exact one, (Zhat/Z) times the error of a weighted average has mean
zero for every N (see test_bootstrap.py). And closed forms in ``reference/api_cases.json``.
"""

import copy
import itertools
import json
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from records import REFERENCE, measurements, reference

import pfedu
from pfedu.kalman import kalman_filter
from pfedu.models import growth, random_walk, van_der_pol
from pfedu.particle_filter import ParticleFilter
from pfedu.resampling import SCHEMES, always, interval, never, ratio
from pfedu.weights import ZeroLikelihoodError, wrap

NAN = np.nan
CASES = json.loads((REFERENCE / "api_cases.json").read_text(encoding="utf-8"))
SEVERAL = 5  # standard errors: with up to 200 comparisons a test, chance alone exceeds them once in 8000 tests
POLICIES = {"always": always, "ratio": ratio(0.5), "interval": interval(2), "never": never}
SHAPES = {"row": ((7, 2), (7, 1), (1, 2)), "column": ((2, 7), (1, 7), (2, 1))}  # particles, weights, state
MODELS = {"linear_A": random_walk(), "growth_A": growth(), "van_der_pol": van_der_pol(r=0.0016)}
every_orientation = pytest.mark.parametrize("orientation", ["row", "column"])


def generator(seed=1):
    return np.random.default_rng(seed)


def walk(x, rng, step=0.0):
    """Move by a step and N(0, 1) in each state."""
    return x + step + rng.standard_normal(x.shape)


def bell(x, y, sd=1.0):
    """Likelihood of a measurement of the first state, rows."""
    return np.exp(-0.5 * ((y - x[:, 0]) / sd) ** 2)


def new(transition=walk, likelihood=bell, *, n=7, seed=1, mean=(0.0, 0.0), cov=1.0, circular=None, **options):
    pf = ParticleFilter(transition, likelihood, rng=generator(seed), **options)
    pf.initialize(n, mean, cov, circular=circular)
    return pf


def still(x, rng):
    """Particles that stay where they are: what is left is the arithmetic."""
    return x.copy()


def placed(particles, weights, likelihood=lambda x, y: y, circular=None, **options):
    """A filter whose particles stand still at given places; a measurement is the likelihoods themselves."""
    particles = np.asarray(particles, dtype=float)
    pf = ParticleFilter(still, likelihood, rng=generator(), **(dict(policy=never) | options))
    pf.initialize(len(particles), np.zeros(particles.shape[1]), 1.0, circular=circular)
    pf.particles, pf.weights = particles, weights
    return pf


def of_model(model, n, seed, orientation="row", **options):
    """A filter of one of the book's models, whose functions want the time."""

    def turn(x):
        return x.T if orientation == "column" else x

    pf = ParticleFilter(
        lambda x, rng, k: turn(model.propagate(k, turn(x), rng)),
        lambda x, y, k: model.log_likelihood(k, y, turn(x)),
        rng=generator(seed), log=True, orientation=orientation, **options,
    )  # fmt: skip
    pf.initialize(n, model.m0, model.P0)
    return pf


def drive(pf, y):
    """Over a record: correct at time 0, then predict and correct; a row of NaN is a predict alone."""
    for k, y_k in enumerate(y):
        if k > 0:
            pf.predict(k)
        before = pf.particles
        if not np.isnan(y_k).any():
            pf.correct(y_k, k)
        yield before


def record(name):
    if name == "van_der_pol":
        return MODELS[name].simulate(20, generator(5))[1]
    return measurements(name, with_y0=True)[:31]


# The same numbers as the batch filter


@every_orientation
@pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
@pytest.mark.parametrize("resampling", SCHEMES)
@pytest.mark.parametrize("name", MODELS)
def test_the_same_bits_as_the_batch_filter(name, resampling, policy, orientation):
    """Catches a second version of any step, another order of draws, and an estimate taken after resampling."""
    model, y, options = MODELS[name], record(name), dict(resampling=resampling, policy=policy)
    track = pfedu.bootstrap_filter(model, y, 60, rng=generator(3), keep=True, **options)
    pf = of_model(model, 60, 3, orientation, **options)
    log_likelihoods = np.cumsum(track.log_likelihood_increments)
    for k, particles in enumerate(drive(pf, y)):
        rows = particles.T if orientation == "column" else particles
        np.testing.assert_array_equal(rows, track.particles[k])
        np.testing.assert_array_equal(pf.state.ravel(), track.mean[k])
        np.testing.assert_array_equal(pf.covariance, track.cov[k])
        assert pf.n_eff == track.n_eff[k] and pf.resampled == track.resampled[k]
        assert pf.log_likelihood == log_likelihoods[k]
        if not pf.resampled:
            np.testing.assert_array_equal(pf.weights.ravel(), np.exp(track.log_weights[k]))
    assert k == len(y) - 1 and track.resampled.any() == (policy is not never)


@every_orientation
@pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
@pytest.mark.parametrize("name", ["linear_A", "growth_A"])
def test_a_missing_measurement_is_a_predict_without_a_correct(name, policy, orientation):
    """Catches a prediction that resamples or counts as a correction: rows missing at the start, inside, at the end."""
    model, y = MODELS[name], record(name).copy()
    y[[0, 4, 5, 12, 30]] = NAN
    track = pfedu.bootstrap_filter(model, y, 60, rng=generator(4), keep=True, policy=policy)
    pf = of_model(model, 60, 4, orientation, policy=policy)
    for k, particles in enumerate(drive(pf, y)):
        rows = particles.T if orientation == "column" else particles
        np.testing.assert_array_equal(rows, track.particles[k])
        np.testing.assert_array_equal(pf.state.ravel(), track.mean[k])
        np.testing.assert_array_equal(pf.covariance, track.cov[k])
        assert pf.resampled == track.resampled[k] and pf.n_eff == track.n_eff[k]
    assert pf.log_likelihood == pytest.approx(track.log_likelihood, rel=1e-14)  # a sum in another order


def in_standard_errors(values, se=0.0):
    """Distance of the mean over runs (axis 0) from zero, in standard errors."""
    own = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return np.abs(values.mean(axis=0)) / np.hypot(own, se)


def test_predictions_against_the_kalman_filter():
    """Catches a prediction without its noise, or one that is the estimate of the step before.

    200 seeds, 10 steps; exact is m, P of the Kalman filter and P + q one step later (F = 1).
    """
    model, y = random_walk(), measurements("linear_A", with_y0=True)[:10]
    exact = kalman_filter(model, y)
    log_z = np.cumsum(exact.log_likelihood_increments)
    weighted = []
    for seed in range(200):
        pf, rows = of_model(model, 200, seed), []
        for k in range(10):
            pf.correct(y[k], k)
            factor = np.exp(pf.log_likelihood - log_z[k])
            state, covariance = pf.predict(k + 1)
            d = state[0, 0] - exact.mean[k, 0]
            rows.append([factor - 1, factor * d, factor * (covariance[0, 0] + d * d - exact.cov[k, 0, 0] - 10.0)])
        weighted.append(rows)
    assert in_standard_errors(np.array(weighted)).max() < SEVERAL


# The oscillator of the documentation of MATLAB's object, as a reader writes it down


def oscillator(x, rng):
    """One Euler step of van der Pol's equation, mu = 1, dt = 0.05, noise of standard deviation 0.025 in each state."""
    x1, x2 = x[:, 0], x[:, 1]
    moved = np.column_stack([x1 + x2 * 0.05, x2 + ((1 - x1**2) * x2 - x1) * 0.05])
    return moved + 0.025 * rng.standard_normal(x.shape)


def seen(x, y, r):
    """Likelihood of a measurement of x1 with variance r."""
    return np.exp(-((y - x[:, 0]) ** 2) / (2 * r)) / np.sqrt(2 * np.pi * r)


def track_oscillator(y, r, seed):
    """Corrected states (101, 2), log-likelihoods (101,) and number of resamplings; 1000 particles."""
    pf = ParticleFilter(oscillator, seen, rng=generator(seed))
    pf.initialize(1000, [2.0, 0.0], np.eye(2))
    states, log_likelihoods, resampled = [], [], 0
    for y_k in y:
        states.append(pf.correct(y_k, r)[0][0])
        log_likelihoods.append(pf.log_likelihood)
        resampled += pf.resampled
        pf.predict()
    return np.array(states), np.array(log_likelihoods), resampled


OSCILLATOR = [("vdp_A_doc_r0.016_posterior", 0.016), ("vdp_A_matched_r0.0016_posterior", 0.0016)]


@pytest.mark.parametrize(("name", "r"), OSCILLATOR)
def test_the_oscillator_against_its_posterior(name, r):
    """Catches a step of time between correct and predict, and r used as a standard deviation: 60 seeds, 101 points.

    Posterior means come from runs with 400 000 particles; their own standard errors are allowed for.
    """
    data = reference(name)
    log_z = np.cumsum(data["loglik_inc"])
    runs = [track_oscillator(data["y"], r, seed) for seed in range(60)]
    factor = np.exp([log_likelihood - log_z for _, log_likelihood, _ in runs])  # (seeds, 101)
    assert in_standard_errors(factor - 1).max() < SEVERAL
    for i in (0, 1):
        d = np.array([states[:, i] for states, *_ in runs]) - data[f"mean{i + 1}"]
        assert in_standard_errors(factor * d, data[f"mc_se_mean{i + 1}"]).max() < SEVERAL


@pytest.mark.parametrize(("r", "expected"), [(0.016, [0.01956, 0.04615, 11.1]), (0.0016, [0.02334, 0.0671, 37.5])])
def test_the_oscillator_against_its_truth(r, expected):
    """Catches the wrong number of resamplings, and a loss of accuracy: RMSE of x1 and x2, 60 records of their own.

    Expected are means over 1000 records, obtained with a filter written independently; their standard errors are
    those of 1000 values with the scatter of ours.
    """
    truth = np.column_stack([reference(OSCILLATOR[0][0])[column] for column in ("x1_true", "x2_true")])
    figures = []
    for seed in range(60):
        y = truth[:, 0] + 0.04 * generator(10_000 + seed).standard_normal(101)
        states, _, resampled = track_oscillator(y, r, seed)
        figures.append([*np.sqrt(np.mean((states - truth) ** 2, axis=0)), resampled])
    figures = np.array(figures)
    assert in_standard_errors(figures - expected, figures.std(axis=0, ddof=1) / np.sqrt(1000)).max() < SEVERAL


# Initialize


@every_orientation
def test_shapes(orientation):
    """Catches a vector where a row or a column is promised, and functions that see the other orientation."""
    particles, weights, state = SHAPES[orientation]
    asked = []

    def transition(x, rng):
        asked.append(x.shape)
        return x + 1

    def likelihood(x, y):
        asked.append(x.shape)
        return np.ones(7)

    pf = new(transition, likelihood, orientation=orientation)
    assert (pf.n_particles, pf.n_x, pf.orientation) == (7, 2, orientation)
    for estimate in ((pf.state, pf.covariance), pf.predict(), pf.correct(0.0)):
        assert estimate[0].shape == state and estimate[1].shape == (2, 2)
        assert pf.particles.shape == particles and pf.weights.shape == weights
        np.testing.assert_allclose(pf.weights, 1 / 7, rtol=1e-15)
    assert asked == [particles, particles]
    assert (new(orientation=orientation, estimate_method="maxweight").state).shape == state


@pytest.mark.parametrize("shape", [(60,), None], ids=["vector", "as weights"])
def test_the_same_seed_gives_transposes(shape):
    """Catches another order of draws by columns, and sums whose rounding depends on how an array lies in memory.

    Likelihoods may come as a vector or laid out as the weights are.
    """

    def by_rows(x, y):
        return np.reshape(bell(x, y), shape or (60, 1))

    def by_columns(x, y):
        return np.reshape(bell(x.T, y), shape or (1, 60))

    def transition(x, rng):
        return np.array(0.5 * x + 1, order="C")

    options = dict(n=60, mean=np.zeros(3))
    row, column = new(transition, by_rows, **options), new(transition, by_columns, orientation="column", **options)
    for y in (0.5, 1.0, 3.0, -2.0):
        for mine, other in ((row.correct(y), column.correct(y)), (row.predict(), column.predict())):
            np.testing.assert_array_equal(mine[0], other[0].T)
            np.testing.assert_array_equal(mine[1], other[1])
        np.testing.assert_array_equal(row.particles, column.particles.T)
        np.testing.assert_array_equal(row.weights, column.weights.T)


def test_the_orientation_may_be_chosen_when_the_particles_are():
    """Catches an orientation of initialize that is forgotten: it holds from then on, and for the next initialize."""
    pf = new()
    pf.initialize(7, [0.0, 0.0], 1.0, orientation="column")
    assert pf.particles.shape == (2, 7) and pf.orientation == "column"
    pf.initialize(7, [0.0, 0.0], 1.0)
    assert pf.particles.shape == (2, 7)


@pytest.mark.parametrize(
    ("cov", "full"),
    [(4.0, np.diag([4.0, 4.0])), ([4.0, 0.0], np.diag([4.0, 0.0])), ([[2.0, 1.0], [1.0, 3.0]],) * 2],
)
def test_a_scalar_or_a_vector_covariance_is_a_diagonal(cov, full):
    """Catches a variance used as a standard deviation, and a scalar that spreads to the covariances.

    Standard errors of mean and covariance entries of n Gaussians: sqrt(P_ii/n), sqrt((P_ii P_jj + P_ij^2)/n).
    """
    n, full = 20_000, np.asarray(full)
    pf = new(n=n, mean=[1.0, -5.0], cov=cov)
    var = np.diag(full)
    assert (np.abs(pf.state[0] - [1.0, -5.0]) <= SEVERAL * np.sqrt(var / n) + 1e-12).all()
    assert (np.abs(pf.covariance - full) <= SEVERAL * np.sqrt((np.outer(var, var) + full**2) / n) + 1e-12).all()


@pytest.mark.parametrize("mean", [[1.0, 2.0], [[1.0, 2.0]], [[1.0], [2.0]]])
def test_the_mean_may_be_a_row_or_a_column(mean):
    """Catches a state that cannot be handed back as a mean."""
    assert new(mean=mean, cov=0.0).particles.tolist() == [[1.0, 2.0]] * 7
    assert new(mean=3.0, cov=0.0).particles.tolist() == [[3.0]] * 7


def test_uniform_particles_within_bounds():
    """Catches bounds taken for a mean and a width, and states that share their draws.

    Mean and variance of a uniform: (a + b)/2 +- width/sqrt(12 n); width^2/12, whose standard error is
    width^2/sqrt(180 n); the covariance of two that are independent: w1 w2/(12 sqrt(n)).
    """
    n, width = 20_000, np.array([2.0, 10.0])
    pf = ParticleFilter(walk, bell, rng=generator())
    pf.initialize(n, bounds=[[-3.0, -1.0], [0.0, 10.0]])
    x = pf.particles
    assert (x.min(axis=0) >= [-3, 0]).all() and (x.max(axis=0) <= [-1, 10]).all()
    assert (np.abs(pf.state[0] - [-2.0, 5.0]) < SEVERAL * width / np.sqrt(12 * n)).all()
    assert (np.abs(np.diag(pf.covariance) - width**2 / 12) < SEVERAL * width**2 / np.sqrt(180 * n)).all()
    assert abs(pf.covariance[0, 1]) < SEVERAL * width.prod() / (12 * np.sqrt(n))


def test_initialize_starts_afresh():
    """Catches weights, corrections or a likelihood of the run before, and a second run with the first one's draws."""
    pf = new(policy=interval(2))
    first = pf.particles.copy()
    pf.correct(0.5)
    pf.predict()
    pf.initialize(7, [0.0, 0.0], 1.0)
    assert not np.array_equal(pf.particles, first)
    assert pf.log_likelihood == 0.0 and pf.n_eff == pytest.approx(7) and not pf.resampled
    pf.correct(0.5)
    assert not pf.resampled  # the first correction of this run, not the second
    pf.initialize(3, [0.0], 1.0)
    assert (pf.n_particles, pf.n_x, pf.circular.tolist()) == (3, 1, [False])


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (dict(n_particles=0, mean=0.0, cov=1.0), ValueError, "whole number of at least 1, got 0"),
        (dict(n_particles=2.5, mean=0.0, cov=1.0), ValueError, "got 2.5"),
        (dict(n_particles=np.inf, mean=0.0, cov=1.0), ValueError, "whole number of at least 1, got inf"),
        (dict(n_particles=5), TypeError, "either mean and cov, or bounds"),
        (dict(n_particles=5, mean=0.0), TypeError, "either mean and cov, or bounds"),
        (dict(n_particles=5, mean=0.0, cov=1.0, bounds=[[0, 1]]), TypeError, "either mean and cov, or bounds"),
        (dict(n_particles=5, mean=np.eye(2), cov=1.0), ValueError, r"mean must be a vector \(n_x,\)"),
        (dict(n_particles=5, mean=[NAN], cov=1.0), ValueError, "mean must be a vector"),
        (dict(n_particles=5, mean=[0, 0], cov=[1, 1, 1]), ValueError, "cov is 3 x 3, but mean has 2 states"),
        (dict(n_particles=5, mean=[0], cov=-1.0), ValueError, "cov is not positive semi-definite"),
        (dict(n_particles=5, bounds=[0.0, 1.0]), ValueError, r"bounds must have shape \(n_x, 2\).*got \(2,\)"),
        (dict(n_particles=5, bounds=[[1.0, 0.0]]), ValueError, "the lower one first"),
        (dict(n_particles=5, bounds=[[0.0, np.inf]]), ValueError, "bounds must be finite"),
        (dict(n_particles=5, bounds=[[0, 7]], circular=[True]), ValueError, "span at most 2 pi"),
        (dict(n_particles=5, mean=[0, 0], cov=1.0, circular=[True]), ValueError, "circular must be 2 times"),
        (dict(n_particles=5, mean=[0, 0], cov=1.0, circular=[0, 1]), ValueError, "circular must be 2 times"),
        (dict(n_particles=5, mean=0.0, cov=1.0, orientation="rows"), ValueError, "must be 'row' or 'column'"),
    ],
)
def test_bad_arguments_of_initialize_are_named_and_change_nothing(arguments, error, message):
    """Catches a filter half initialised: the one before, its random numbers included, is still there."""
    pf = new()
    before = pf.snapshot()
    with pytest.raises(error, match=message):
        pf.initialize(**arguments)
    assert pf.snapshot() == before


@pytest.mark.parametrize(
    "use",
    [
        ParticleFilter.predict,
        lambda pf: pf.correct(0.0),
        ParticleFilter.snapshot,
        lambda pf: setattr(pf, "particles", [[0.0]]),
        lambda pf: setattr(pf, "weights", [1.0]),
        *(
            lambda pf, name=name: getattr(pf, name)
            for name in ("n_particles", "n_x", "circular", "particles", "weights", "state", "covariance", "n_eff",
                         "resampled", "log_likelihood")
        ),
    ],
)  # fmt: skip
def test_use_before_initialize_is_an_error(use):
    """Catches \"'NoneType' object has no attribute\"."""
    pf = ParticleFilter(walk, bell, rng=generator())
    with pytest.raises(RuntimeError, match="call initialize"):
        use(pf)
    assert repr(pf) == "ParticleFilter(not initialized)"


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (dict(transition="walk"), TypeError, "transition must be a function, got 'walk'"),
        (dict(likelihood=None), TypeError, "likelihood must be a function, got None"),
        (dict(rng=7), TypeError, r"rng must be a numpy\.random\.Generator"),
        (dict(orientation="col"), ValueError, "orientation must be 'row' or 'column', got 'col'"),
        (dict(resampling="sistematic"), ValueError, "no resampling scheme 'sistematic'"),
        (dict(policy="ratio"), TypeError, "policy must be .* of pfedu.resampling, got 'ratio'"),
        (dict(estimate_method="median"), ValueError, "estimate_method must be 'mean' or 'maxweight', got 'median'"),
    ],
)
def test_bad_arguments_of_the_constructor_are_named(arguments, error, message):
    """Catches a slip that shows only when the first measurement arrives; settings are checked when set, too."""
    with pytest.raises(error, match=message):
        ParticleFilter(**(dict(transition=walk, likelihood=bell, rng=generator()) | arguments))
    (name, value), *_ = arguments.items()
    if name in ("resampling", "policy", "estimate_method"):
        with pytest.raises(error, match=message):
            setattr(new(), name, value)


# Read-only and settable


@pytest.mark.parametrize(
    "name",
    ["n_particles", "n_x", "circular", "state", "covariance", "orientation", "n_eff", "resampled", "log_likelihood"],
)
def test_what_follows_from_the_particles_is_read_only(name):
    """Catches a state that can be set without its particles."""
    with pytest.raises(AttributeError):
        setattr(new(), name, 1)


@pytest.mark.parametrize("name", ["particles", "weights", "circular"])
@every_orientation
def test_particles_and_weights_are_set_as_a_whole(name, orientation):
    """Catches `pf.weights[0] = 1` that changes a copy and says nothing, or the cloud without its checks."""
    pf = new(orientation=orientation)
    with pytest.raises(ValueError, match="read-only"):
        getattr(pf, name)[0] = 1


@every_orientation
def test_particles_can_be_set(orientation):
    """Catches an estimate that does not follow, a transpose, and an array that the caller goes on to change."""
    pf = new(orientation=orientation)
    x = np.arange(14.0).reshape(pf.particles.shape)
    pf.particles = x
    np.testing.assert_array_equal(pf.particles, x)
    mean = x.mean(axis=pf.particles.shape.index(7))
    np.testing.assert_allclose(pf.state.ravel(), mean, rtol=1e-14)
    x[:] = 99.0
    np.testing.assert_allclose(pf.state.ravel(), mean, rtol=1e-14)


@pytest.mark.parametrize("shape", [(7,), (7, 1), (1, 7)])
@every_orientation
def test_weights_can_be_set_and_are_normalised(orientation, shape):
    """Catches weights taken as they are, and estimates that do not follow; a weight of zero is a weight."""
    pf = new(orientation=orientation)
    w = np.array([0, 1, 2, 3, 4, 5, 6.0])
    if shape not in ((7,), pf.weights.shape):
        with pytest.raises(ValueError, match="one value a particle"):
            pf.weights = w.reshape(shape)
        return
    pf.weights = w.reshape(shape)
    np.testing.assert_allclose(pf.weights.ravel(), w / 21, rtol=1e-14)
    rows = pf.particles if orientation == "row" else pf.particles.T
    np.testing.assert_allclose(pf.state.ravel(), w @ rows / 21, rtol=1e-13)
    assert pf.n_eff == pytest.approx(21**2 / 91)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "particles",
            np.zeros((2, 7)),
            r"given as the shape \(2, 7\): particles must keep the shape \(7, 2\) \(rows\)",
        ),
        ("particles", np.zeros((8, 2)), r"given as the shape \(8, 2\)"),
        ("particles", np.r_[np.zeros(13), NAN].reshape(7, 2), r"given as \[0.0, nan\] for particle 6: .* finite"),
        ("weights", np.ones(6), r"given as the shape \(6,\): one value a particle is needed, shape \(7,\) or \(7, 1\)"),
        ("weights", 1.0, r"given as the shape \(\)"),
        ("weights", [1, 1, -1, 1, 1, 1, 1], "weight -1.0 of particle 2: a weight is finite and not negative"),
        ("weights", [1, 1, 1, NAN, 1, 1, 1], "weight nan of particle 3"),
        ("weights", [1, 1, 1, np.inf, 1, 1, 1], "weight inf of particle 3"),
        ("weights", np.zeros(7), "all weights are zero"),
    ],
)
def test_bad_particles_and_weights_are_named_and_change_nothing(name, value, message):
    """Catches broadcasting, and NaN on its way into every later estimate."""
    pf = new()
    before = pf.snapshot()
    with pytest.raises(ValueError, match=message):
        setattr(pf, name, value)
    assert pf.snapshot() == before


# Predict and correct


def test_extras_are_forwarded():
    """Catches arguments dropped, or handed to the other function; positional and by name."""
    calls = []

    def transition(x, rng, *args, **kwargs):
        calls.append((args, kwargs, isinstance(rng, np.random.Generator)))
        return x + args[0]

    def likelihood(x, y, *args, **kwargs):
        calls.append((y, args, kwargs))
        return np.ones(len(x))

    pf = new(transition, likelihood, cov=0.0)
    pf.predict(2.0, "u", dt=0.1)
    pf.correct([1.0, 2.0], 3.0, sensor="left")
    assert calls == [((2.0, "u"), {"dt": 0.1}, True), ([1.0, 2.0], (3.0,), {"sensor": "left"})]
    np.testing.assert_allclose(pf.state, [[2.0, 2.0]], rtol=1e-14)


def test_correct_by_hand():
    """Catches weights that are replaced rather than multiplied, and likelihoods that must sum to one.

    Weights (1/2, 1/4, 1/4) times (2, 4, 8) are (1, 1, 2)/4; the likelihood of both measurements is 4 then 13/4.
    """
    pf = placed([[0.0], [4.0], [8.0]], [2.0, 1.0, 1.0])
    state, covariance = pf.correct([2.0, 4.0, 8.0])
    np.testing.assert_allclose(pf.weights.ravel(), [0.25, 0.25, 0.5], rtol=1e-14)
    assert state[0, 0] == pytest.approx(5.0) and covariance[0, 0] == pytest.approx(11.0)
    assert pf.n_eff == pytest.approx(8 / 3) and pf.log_likelihood == pytest.approx(np.log(4.0))
    pf.predict()
    np.testing.assert_allclose(pf.weights.ravel(), [0.25, 0.25, 0.5], rtol=1e-14)
    pf.correct([3.0, 2.0, 4.0])
    np.testing.assert_allclose(pf.weights.ravel(), np.array([3, 2, 8]) / 13, rtol=1e-14)
    assert pf.log_likelihood == pytest.approx(np.log(13.0))


def test_logarithms_are_the_same_likelihoods():
    """Catches a logarithm taken twice or not at all."""
    plain = new()
    log = new(likelihood=lambda x, y: np.log(bell(x, y)), log=True)
    for y in (0.5, 2.0, -1.0):
        for mine, other in ((plain.correct(y), log.correct(y)), (plain.predict(), log.predict())):
            np.testing.assert_allclose(mine[0], other[0], rtol=1e-12)
            np.testing.assert_allclose(mine[1], other[1], rtol=1e-9)


def test_logarithms_reach_where_likelihoods_are_zero():
    """Catches exp() on the way: exp(-5000) is zero in doubles, its ratio to exp(-5001) is not."""
    pf = placed([[0.0], [1.0]], [1.0, 1.0], log=True)
    pf.correct([-5000.0, -5001.0])
    np.testing.assert_allclose(pf.weights.ravel(), np.array([1.0, np.exp(-1)]) / (1 + np.exp(-1)), rtol=1e-12)
    with pytest.raises(ZeroLikelihoodError) as caught:
        placed([[0.0], [1.0]], [1.0, 1.0]).correct(np.exp([-5000.0, -5001.0]))
    assert "log=True" in caught.value.__notes__[0]


def test_a_particle_of_likelihood_zero_may_be_followed_by_others():
    """Catches log(0) that warns, or that comes back to life."""
    pf = placed([[0.0], [1.0], [2.0]], [1.0, 1.0, 1.0])
    pf.correct([0.0, 1.0, 1.0])
    pf.correct([5.0, 1.0, 3.0])
    np.testing.assert_allclose(pf.weights.ravel(), [0, 0.25, 0.75], rtol=1e-14)


@pytest.mark.parametrize("method", ["mean", "maxweight"])
@pytest.mark.parametrize("policy", [always, never], ids=["resampled", "carried"])
@every_orientation
def test_the_state_after_correct_is_what_it_returned(orientation, policy, method):
    """Catches an estimate taken after resampling, where all weights are alike and the heaviest is any particle."""
    turn = np.transpose if orientation == "column" else np.asarray
    pf = new(likelihood=lambda x, y: bell(turn(x), y, 0.3), orientation=orientation, policy=policy,
             estimate_method=method, n=50)  # fmt: skip
    before = turn(pf.particles)
    state, covariance = pf.correct(1.0)
    np.testing.assert_array_equal(pf.state, state)
    np.testing.assert_array_equal(pf.covariance, covariance)
    w = bell(before, 1.0, 0.3)
    expected = before[w.argmax()] if method == "maxweight" else w @ before / w.sum()
    np.testing.assert_allclose(state.ravel(), expected, rtol=1e-12)
    assert pf.resampled == (policy is always)
    assert (np.ptp(pf.weights) == 0) == pf.resampled
    if pf.resampled:
        np.testing.assert_allclose(pf.weights, 1 / 50, rtol=1e-15)
        assert {*map(tuple, turn(pf.particles))} < {*map(tuple, before)}  # copies of some of them


def test_the_method_may_change_after_the_fact():
    """Catches an estimate frozen with the method of its time: the heaviest is found among the weighed particles."""
    pf = new(likelihood=lambda x, y: bell(x, y, 0.3), policy=always, n=50)
    before = pf.particles
    mean, _ = pf.correct(1.0)
    pf.estimate_method = "maxweight"
    np.testing.assert_array_equal(pf.state[0], before[bell(before, 1.0).argmax()])
    assert pf.covariance is None
    pf.estimate_method = "mean"
    np.testing.assert_array_equal(pf.state, mean)


def test_settings_may_change_on_the_way():
    """Catches a policy, a scheme or a function that is fixed at birth."""
    calls = []

    def pick(weights, rng, size=None):
        calls.append(weights)
        return np.zeros(7, dtype=int)

    pf = new()
    pf.policy, pf.resampling = always, pick
    pf.likelihood, pf.transition = (lambda x, y: np.arange(1.0, 8.0)), still
    first = pf.particles[0].copy()
    pf.correct(0.0)
    assert pf.policy is always and pf.resampling is pick
    np.testing.assert_allclose(calls, [np.arange(1.0, 8.0) / 28], rtol=1e-14)
    assert (pf.particles == first).all() and (pf.predict()[0].ravel() == pytest.approx(first))


def test_the_ratio_policy_asks_for_strictly_fewer():
    """Catches <= for <: two of four equal weights are N_eff = N/2 exactly; a hair less triggers."""
    for tilt, expected in ((1.0, False), (1.001, True)):
        pf = placed(np.zeros((4, 1)), [1.0, 1.0, 1.0, 1.0], policy=ratio(0.5))
        pf.correct([1.0, tilt, 0.0, 0.0])
        assert pf.resampled is expected


@pytest.mark.parametrize(
    ("policy", "expected"), [(interval(1), [1, 1, 1, 1]), (interval(3), [0, 0, 1, 0]), (interval(np.inf), [0, 0, 0, 0])]
)
def test_the_interval_policy_counts_corrections(policy, expected):
    """Catches predictions that are counted: every n-th correct, whatever lies between, and never for inf."""
    pf = new(policy=policy)
    resampled = []
    for _ in range(4):
        pf.predict()
        pf.predict()
        pf.correct(0.0)
        resampled.append(pf.resampled)
    assert resampled == [bool(e) for e in expected]
    pf.predict()
    assert not pf.resampled


def test_the_policy_sees_what_it_sees_in_the_batch_filter():
    """Catches arguments in another order: N_eff, N, and the number of corrections."""
    seen = []
    pf = placed(np.zeros((4, 1)), np.ones(4), policy=lambda n_eff, n, count: seen.append((float(n_eff), n, count)))
    pf.correct([1.0, 1.0, 0.0, 0.0])
    pf.correct([1.0, 0.0, 1.0, 0.0])
    assert seen == [(pytest.approx(2.0), 4, 1), (pytest.approx(1.0), 4, 2)]


def test_weighted_cases():
    """Catches the unbiased covariance, N_eff of unnormalised weights, and a heaviest particle that is the last."""
    case = CASES["weighted"]
    pf = placed(case["particles_rows"], np.multiply(10, case["weights"]))
    np.testing.assert_allclose(pf.state, [case["mean"]], rtol=1e-14)
    np.testing.assert_allclose(pf.covariance, case["cov_biased"], rtol=1e-14)
    assert pf.n_eff == pytest.approx(case["neff"], rel=1e-14)
    assert pf.n_eff / pf.n_particles == pytest.approx(case["neff_ratio"], rel=1e-14)
    pf.estimate_method = "maxweight"
    assert pf.state.tolist() == [case["maxweight_state"]] and pf.covariance is None


def test_of_several_heaviest_particles_the_first_is_the_estimate():
    """Catches a choice that depends on rounding or on the order of a sort."""
    pf = placed([[5.0], [6.0], [7.0]], [1.0, 2.0, 2.0], estimate_method="maxweight")
    assert pf.state.tolist() == [[6.0]]


# Circular states


def test_circular_cases():
    """Catches the arithmetic mean across the seam, differences that are not wrapped, and the unbiased variance."""
    case = CASES["circular"]
    angles = np.array(case["angles"])
    pf = placed(np.column_stack([angles, angles]), case["weights"], circular=[True, False])
    assert pf.circular.tolist() == [True, False]
    np.testing.assert_allclose(pf.state, [[case["circular_mean"], case["linear_mean"]]], rtol=1e-14)
    assert pf.covariance[0, 0] == pytest.approx(case["wrapped_var_biased"], rel=1e-12)


@pytest.mark.parametrize("prior", [dict(mean=[3.0, 3.0], cov=4.0), dict(bounds=[[2.0, 5.0], [2.0, 5.0]])])
def test_circular_particles_are_wrapped_and_no_others(prior):
    """Catches angles outside [-pi, pi], directions that change on the way, and a state that is no angle wrapped."""
    flat, round_ = (ParticleFilter(walk, bell, rng=generator()) for _ in range(2))
    flat.initialize(500, **prior)
    round_.initialize(500, **prior, circular=[True, False])
    for _ in range(3):
        x, angle = flat.particles, round_.particles
        assert np.abs(angle[:, 0]).max() <= np.pi < np.abs(x[:, 0]).max()
        np.testing.assert_allclose(np.exp(1j * angle[:, 0]), np.exp(1j * x[:, 0]), rtol=0, atol=1e-14)
        np.testing.assert_array_equal(angle[:, 1], x[:, 1])
        flat.predict(1.0)
        round_.predict(1.0)
    round_.particles = np.full((500, 2), 3 * np.pi / 2)
    np.testing.assert_allclose(round_.particles[0], [-np.pi / 2, 3 * np.pi / 2], rtol=1e-15)


def exact_on_the_circle(y, q, kappa, nodes=400):
    """Posterior of a direction that diffuses: circular means and variances of wrapped differences, a step a row.

    x_k = x_{k-1} + N(0, q) on the circle, x_0 uniform, y_k of von Mises density about x_k. Sums over equally
    spaced nodes integrate smooth periodic functions to rounding; the variance, whose integrand has a kink opposite
    the mean, to the square of the spacing times the density there, which is below 1e-6 here.
    """
    grid = -np.pi + 2 * np.pi * np.arange(nodes) / nodes
    d = grid[:, None] - grid
    kernel = sum(np.exp(-0.5 * (d + 2 * np.pi * turn) ** 2 / q) for turn in range(-3, 4))
    p, rows = np.ones(nodes), []
    for k, y_k in enumerate(y):
        p = (kernel @ p if k else p) * np.exp(kappa * np.cos(y_k - grid))
        p /= p.sum()
        mean = np.angle(p @ np.exp(1j * grid))
        rows.append([mean, p @ wrap(grid - mean) ** 2])
    return np.array(rows)


def test_a_direction_against_a_grid_of_the_circle():
    """Catches a heading that loses its way at the seam: estimates near +-pi against the exact posterior.

    100 seeds of 1000 particles. The bias of a ratio of weighted sums is about its variance, 1/100 of a standard
    deviation or so here, a tenth of a standard error.
    """
    q, kappa, y = 0.3, 4.0, np.array([3.0, -2.8, -3.1, 2.5, 2.9, -2.2, 3.1])
    exact = exact_on_the_circle(y, q, kappa)
    assert np.abs(exact[:, 0]).min() > 2.5 and np.ptp(np.sign(exact[:, 0])) == 2  # on both sides of the seam
    errors = []
    for seed in range(100):
        pf = ParticleFilter(
            lambda x, rng: x + np.sqrt(q) * rng.standard_normal(x.shape),
            lambda x, y: kappa * np.cos(y - x[:, 0]), log=True, rng=generator(seed),
        )  # fmt: skip
        pf.initialize(1000, bounds=[[-np.pi, np.pi]], circular=[True])
        rows = []
        for k, y_k in enumerate(y):
            if k > 0:
                pf.predict()
            state, covariance = pf.correct(y_k)
            rows.append([wrap(state[0, 0] - exact[k, 0]), covariance[0, 0] - exact[k, 1]])
        errors.append(rows)
    assert in_standard_errors(np.array(errors)).max() < SEVERAL


# Errors that change nothing


def draws_then(result):
    """A transition that draws random numbers before it goes wrong."""

    def transition(x, rng):
        rng.standard_normal(1000)
        return result(x)

    return transition


def raises(*_, **__):
    raise KeyError("of the reader's own")


def in_place(x, *_):
    x[0] = 1.0
    return x


ERRORS = {
    "transition: shape": (dict(transition=draws_then(lambda x: x[:, :1])), ValueError,
                          r"transition gave the shape \(7, 1\): particles must keep the shape \(7, 2\)"),
    "transition: nothing": (dict(transition=draws_then(lambda x: None)), ValueError, "gave nothing .* return missing"),
    "transition: nan": (dict(transition=draws_then(lambda x: np.where(np.arange(7)[:, None] == 3, NAN, 1.0 + 0 * x))),
                        ValueError, r"transition gave \[nan, nan\] for particle 3: states must be finite"),
    "transition: inf": (dict(transition=draws_then(lambda x: x / 0.0)), ValueError, "inf.* for particle 0"),
    "transition: its own error": (dict(transition=draws_then(raises)), KeyError, "of the reader's own"),
    "transition: in place": (dict(transition=in_place), ValueError, "read-only"),
    "likelihood: scalar": (dict(likelihood=lambda x, y: 1.0), ValueError,
                           r"likelihood gave the shape \(\): one value a particle is needed, shape \(7,\) or \(7, 1\)"),
    "likelihood: row": (dict(likelihood=lambda x, y: np.ones((1, 7))), ValueError, r"gave the shape \(1, 7\)"),
    "likelihood: too many": (dict(likelihood=lambda x, y: np.exp(-(y - x) ** 2)), ValueError, r"the shape \(7, 2\)"),
    "likelihood: nothing": (dict(likelihood=lambda x, y: None), ValueError, "likelihood gave nothing"),
    "likelihood: negative": (dict(likelihood=lambda x, y: np.arange(7.0) - 1), ValueError,
                             "likelihood -1.0 of particle 0: a likelihood is finite and not negative"),
    "likelihood: nan": (dict(likelihood=lambda x, y: np.array([1, 1, NAN, 1, 1, 1, 1])), ValueError,
                        "likelihood nan of particle 2.*a missing measurement is a predict without a correct"),
    "likelihood: inf": (dict(likelihood=lambda x, y: np.array([1, np.inf, 1, 1, 1, 1, 1])), ValueError,
                        "likelihood inf of particle 1"),
    "log-likelihood: nan": (dict(likelihood=lambda x, y: np.full(7, NAN), log=True), ValueError,
                            "log-likelihood nan of particle 0: a logarithm is finite, or -inf"),
    "log-likelihood: inf": (dict(likelihood=lambda x, y: np.array([0, 0, 0, np.inf, 0, 0, 0]), log=True), ValueError,
                            "log-likelihood inf of particle 3"),
    "likelihood: zero": (dict(likelihood=lambda x, y: np.zeros(7)), ZeroLikelihoodError,
                         "step 2: every particle has likelihood zero"),
    "log-likelihood: zero": (dict(likelihood=lambda x, y: np.full(7, -np.inf), log=True), ZeroLikelihoodError,
                             "step 2: every particle has likelihood zero"),
    "likelihood: in place": (dict(likelihood=in_place), ValueError, "read-only"),
    "resampling: shape": (dict(resampling=lambda w, rng, size=None: rng.integers(7, size=3), policy=always), ValueError,
                          r"resampling must give whole numbers of shape \(7,\)"),
    "policy: its own error": (dict(policy=raises), KeyError, "of the reader's own"),
}  # fmt: skip


@pytest.mark.parametrize(("bad", "error", "message"), ERRORS.values(), ids=ERRORS)
def test_a_failed_call_changes_nothing(bad, error, message):
    """Catches particles moved, weights lost or random numbers used up by a call that then fails.

    After the error the reader mends the function and goes on as if nothing had happened, to the same bits.
    """
    pf, smooth = new(), new()
    for filter_ in (pf, smooth):
        filter_.correct(0.5)
        filter_.predict()
        filter_.predict()
    good = {name: getattr(pf, name) for name in bad}
    before = pf.snapshot()
    for name, value in bad.items():
        setattr(pf, name, value)
    with np.errstate(divide="ignore"), pytest.raises(error, match=message):
        pf.predict() if "transition" in bad else pf.correct(0.5)
    assert pf.snapshot() == before
    for name, value in good.items():
        setattr(pf, name, value)
    for mine, other in ((pf.predict(), smooth.predict()), (pf.correct(0.1), smooth.correct(0.1))):
        np.testing.assert_array_equal(mine[0], other[0])
        np.testing.assert_array_equal(mine[1], other[1])


def test_a_failed_call_spawns_nothing():
    """Catches random numbers that are put back without the children that were spawned off them."""
    broken = False

    def spawns(x, rng):
        moved = x + rng.spawn(1)[0].standard_normal(x.shape) + rng.standard_normal()
        return moved[:-1] if broken else moved

    pf, smooth = new(spawns), new(spawns)
    broken = True
    before = pf.snapshot()
    with pytest.raises(ValueError, match="transition gave"):
        pf.predict()
    assert pf.snapshot() == before
    broken = False
    for _ in range(2):
        np.testing.assert_array_equal(pf.predict()[0], smooth.predict()[0])


def test_errors_speak_of_columns_by_columns():
    """Catches a message that tells a reader of columns about rows."""
    pf = new(lambda x, rng: x.T, lambda x, y: np.ones((7, 1)), orientation="column")
    with pytest.raises(
        ValueError, match=r"gave the shape \(7, 2\): particles must keep the shape \(2, 7\) \(columns\)"
    ):
        pf.predict()
    with pytest.raises(ValueError, match=r"gave the shape \(7, 1\).*shape \(7,\) or \(1, 7\)"):
        pf.correct(0.0)


# Copies, and going on later


def continued(pf, y=(0.3, -0.5, 2.0, 0.0)):
    """What a filter does from here on."""
    seen = []
    for y_k in y:
        seen += [*pf.predict(0.1), *pf.correct(y_k)]
        seen += [pf.particles, pf.weights, pf.log_likelihood, pf.resampled]
    return seen


def assert_same(first, second):
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def on_the_way(seed=1, kind=np.random.PCG64, **options):
    """A filter in mid-career: corrected, resampled, moved; a half-used draw in its generators."""

    def odd(x, rng, step=0.0):
        rng.integers(3, dtype=np.int32)  # leaves 32 random bits behind
        return walk(x, rng, step)

    pf = ParticleFilter(odd, bell, rng=np.random.Generator(kind(seed)), **options)
    pf.initialize(20, [0.0, 3.0], 1.0, circular=[False, True])
    for y in (0.5, 1.5):
        pf.predict()
        pf.correct(y)
    return pf


@pytest.mark.parametrize("copier", [ParticleFilter.clone, copy.deepcopy, copy.copy], ids=["clone", "deepcopy", "copy"])
@every_orientation
def test_a_clone_goes_on_like_the_original_and_on_its_own(copier, orientation):
    """Catches shared particles, generators or policies, whichever of the two moves first; lambdas are no obstacle."""
    pf = of_model(van_der_pol(), 30, 1, orientation)
    pf.correct(np.array([2.1]), 0)
    twin, third = copier(pf), copier(pf)

    def go_on(filter_):
        return [*filter_.predict(1), *filter_.correct(np.array([1.9]), 1), *filter_.predict(2)]

    expected = go_on(pf)
    assert_same(go_on(twin), expected)
    assert_same(go_on(third), expected)
    assert twin.orientation == orientation and twin.snapshot() == pf.snapshot()
    before = pf.snapshot()
    twin.particles = np.zeros(twin.particles.shape)
    twin.policy, twin.estimate_method = never, "maxweight"
    twin.predict(3)
    assert pf.snapshot() == before and pf.policy != never and pf.estimate_method == "mean"


def test_a_clone_has_a_policy_of_its_own():
    """Catches a policy that keeps count, shared by both: each must see its own corrections only."""

    class Counting:
        calls = 0

        def __call__(self, n_eff, n, count):
            self.calls += 1
            return self.calls == 3

    pf = new(policy=Counting())
    pf.correct(0.0)
    twin = pf.clone()
    for filter_ in (pf, twin):
        filter_.correct(0.0)
        assert not filter_.resampled
    for filter_ in (pf, twin):
        filter_.correct(0.0)
        assert filter_.resampled


@pytest.mark.parametrize("method", ["mean", "maxweight"])
@every_orientation
def test_pickle_goes_on_where_it_was(orientation, method):
    """Catches anything left behind: functions that can be imported, settings, generators, the estimate."""
    pf = ParticleFilter(walk, bell_of_columns if orientation == "column" else bell, rng=generator(),
                        orientation=orientation, policy=interval(2), resampling="residual",
                        estimate_method=method)  # fmt: skip
    pf.initialize(20, [0.0, 3.0], 1.0, circular=[False, True])
    pf.correct(0.5)
    pf.correct(0.5)
    later = pickle.loads(pickle.dumps(pf))
    np.testing.assert_array_equal(later.state, pf.state)
    assert (later.resampling, later.policy, later.estimate_method) == ("residual", interval(2), method)
    if method == "mean":
        assert_same(continued(later), continued(pf))
    else:
        assert later.snapshot() == pf.snapshot()


def bell_of_columns(x, y):
    return bell(x.T, y)


def test_pickle_of_a_filter_without_particles():
    """Catches a filter that can be sent to a worker only after it was started."""
    pf = ParticleFilter(walk, bell, rng=generator())
    later = pickle.loads(pickle.dumps(pf))
    for filter_ in (pf, later):
        filter_.initialize(5, [0.0, 0.0], 1.0)
    assert_same(continued(later), continued(pf))


@pytest.mark.parametrize(
    "options",
    [
        dict(transition=lambda x, rng: x),
        dict(likelihood=lambda x, y: x[:, 0]),
        dict(policy=lambda n_eff, n, count: False),
        dict(resampling=lambda w, rng, size=None: np.arange(len(w))),
    ],
    ids=lambda options: next(iter(options)),
)
def test_what_cannot_be_pickled_is_named(options):
    """Catches \"Can't pickle <lambda>\" without a word on which, and what to do instead."""
    (name,) = options
    with pytest.raises(pickle.PicklingError, match=rf"{name} <function .*top of a module, or keep snapshot\(\)"):
        pickle.dumps(new(**options))


def by_json(pf, tmp_path):
    return json.loads(json.dumps(pf.snapshot()))


def by_npz(pf, tmp_path):
    np.savez(tmp_path / "filter.npz", **pf.snapshot())
    return np.load(tmp_path / "filter.npz", allow_pickle=False)


def directly(pf, tmp_path):
    return pf.snapshot()


KINDS = [np.random.PCG64, np.random.PCG64DXSM, np.random.MT19937, np.random.Philox, np.random.SFC64]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("way", [directly, by_json, by_npz])
def test_a_snapshot_goes_on_bit_for_bit(way, kind, tmp_path):
    """Catches a digit lost on the way, a generator of another kind or a half-used draw, and a filter that forgets.

    What it is restored into has another seed, another kind of generator, and another number of particles.
    """
    pf = on_the_way(kind=kind)
    saved = way(pf, tmp_path)
    later = ParticleFilter(pf.transition, pf.likelihood, rng=generator(99), orientation="column")
    later.initialize(3, [0.0], 1.0)
    later.restore(saved)
    np.testing.assert_array_equal(later.state, pf.state)
    np.testing.assert_array_equal(later.covariance, pf.covariance)
    assert later.circular.tolist() == [False, True] and later.orientation == "row"
    assert later.snapshot() == pf.snapshot()
    assert_same(continued(later), continued(pf))


def test_a_snapshot_is_not_moved_by_what_follows():
    """Catches a snapshot that shares the filter's arrays; going back and on again gives the same."""
    pf = on_the_way()
    saved = pf.snapshot()
    kept = copy.deepcopy(saved)
    first = continued(pf)
    assert saved == kept
    pf.restore(saved)
    assert_same(continued(pf), first)


def test_a_snapshot_keeps_the_estimate_that_was_resampled_away():
    """Catches a state that jumps when restored: after resampling, particles alone no longer tell it."""
    pf = on_the_way(policy=always)
    pf.estimate_method = "maxweight"
    later = on_the_way(seed=2, policy=always)
    later.restore(pf.snapshot())
    later.estimate_method = "maxweight"
    np.testing.assert_array_equal(later.state, pf.state)
    assert later.resampled and later.n_eff == pf.n_eff < 20


def test_a_snapshot_keeps_children_of_the_generators_apart():
    """Catches restored generators that spawn the children which were already spawned."""

    def spawns(x, rng):
        return x + rng.spawn(1)[0].standard_normal(x.shape)

    pf = new(spawns)
    pf.predict()
    later = new(spawns, seed=9)
    later.restore(json.loads(json.dumps(pf.snapshot())))
    np.testing.assert_array_equal(later.predict()[0], pf.predict()[0])


def test_weights_of_zero_survive_a_snapshot():
    """Catches -inf that JSON in the strict sense, or a check, does not let through."""
    pf = placed([[0.0], [1.0], [2.0]], [1.0, 1.0, 1.0])
    pf.correct([0.0, 1.0, 1.0])
    later = placed(np.zeros((3, 1)), [1, 1, 1])
    later.restore(json.loads(json.dumps(pf.snapshot(), allow_nan=False)))
    np.testing.assert_array_equal(later.weights, pf.weights)
    assert later.snapshot() == pf.snapshot()
    with pytest.raises(ZeroLikelihoodError):  # not a weight of 1e-308 that a likelihood brings back
        later.correct([1.0, 0.0, 0.0])


def test_whole_numbers_in_a_snapshot_are_numbers():
    """Catches a program that writes 1.0 as 1, as those in JavaScript do: integers would stay integers."""
    pf = placed([[0.0], [1.0]], [1.0, 1.0])
    saved = pf.snapshot() | {"x": [[0], [1]], "log_likelihood": 0}
    pf.restore(saved)
    assert pf.particles.dtype == float


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda s: s.pop("x"), "the snapshot lacks x"),
        (lambda s: s.pop("rng_pick"), "the snapshot lacks rng_pick"),
        (lambda s: s.update(log_w=s["log_w"][:-1]), "snapshot's log_w does not fit its particles x"),
        (lambda s: s.update(x=s["x"][0]), "snapshot's x does not fit"),
        (lambda s: s.update(circular=[True]), "snapshot's circular does not fit"),
        (lambda s: s.update(orientation="up"), "snapshot's orientation must be 'row' or 'column'"),
        (lambda s: s.update(log_w=[0.0] * 20), "snapshot's log_w is not normalised: its weights sum to 20"),
        (lambda s: s.update(log_w=[1000.0] * 20), "snapshot's log_w holds what is no finite number"),
        (lambda s: s.update(log_w_weighed=[NAN] * 20), "snapshot's log_w_weighed holds what is no finite number"),
        (lambda s: s.update(x=[[NAN, 0.0]] * 20), "snapshot's x holds what is no finite number"),
        (lambda s: s.update(x_weighed=[[-np.inf, 0.0]] * 20), "snapshot's x_weighed holds what is no finite number"),
        (lambda s: s.update(x=[["0", "0"]] * 20), "snapshot's x holds what is no finite number"),
        (lambda s: s.update(circular=[0, 1]), "circular must be 2 times True or False"),
        (lambda s: s.update(k=-1), "snapshot's k cannot be -1"),
        (lambda s: s.update(corrections=1.5), "snapshot's corrections cannot be 1.5"),
        (lambda s: s.update(log_likelihood=NAN), "snapshot's log_likelihood cannot be nan"),
        (lambda s: s.update(resampled="no"), "snapshot's resampled cannot be 'no'"),
        (lambda s: s.update(rng_move="{}"), "snapshot's generator is damaged"),
        (lambda s: s.update(rng_pick=s["rng_pick"].replace("PCG64", "Generator")), "snapshot's generator is damaged"),
    ],
)
def test_a_damaged_snapshot_is_named_and_changes_nothing(damage, message):
    """Catches a filter half restored."""
    pf = on_the_way()
    saved, before = pf.snapshot(), pf.snapshot()
    damage(saved)
    with pytest.raises(ValueError, match=message):
        pf.restore(saved)
    assert pf.snapshot() == before


def test_a_generator_of_ones_own_kind_has_no_snapshot():
    """Catches a snapshot that could not be restored: better said when it is taken."""

    class Own(np.random.PCG64):
        pass

    with pytest.raises(TypeError, match="numpy's own bit generators, not of Own"):
        on_the_way(kind=Own).snapshot()


# Whatever happens between the steps, the steps are the same


def fails(pf):
    """Every way to fail that a step has."""
    good = pf.transition, pf.likelihood
    pf.transition, pf.likelihood = draws_then(lambda x: x * NAN), lambda x, y: np.zeros(len(x))
    for error, step in ((ValueError, pf.predict), (ZeroLikelihoodError, lambda: pf.correct(0.0))):
        with pytest.raises(error):
            step()
    pf.transition, pf.likelihood = good
    return pf


def moved_house(pf):
    later = new(n=2, seed=77)
    later.policy, later.resampling = pf.policy, pf.resampling
    later.restore(json.loads(json.dumps(pf.snapshot())))
    return later


DETOURS = {
    "clone": ParticleFilter.clone,
    "pickle": lambda pf: pickle.loads(pickle.dumps(pf)),
    "snapshot": moved_house,
    "failure": fails,
    "reading": lambda pf: (pf.state, pf.covariance, pf.weights, pf.n_eff, repr(pf)) and pf,
}
steps = st.lists(
    st.tuples(st.sampled_from([None, 0.0, 1.0, -2.0]), st.none() | st.sampled_from(sorted(DETOURS))),
    min_size=1,
    max_size=12,
)


@settings(deadline=None, max_examples=60, derandomize=True)
@given(steps, st.sampled_from(sorted(SCHEMES)), st.sampled_from([always, ratio(0.5), interval(2)]))
def test_detours_do_not_change_the_way(steps, resampling, policy):
    """Catches any copy, failure or mere look that leaves a trace, in any order of predict (None) and correct (y)."""
    straight, pf = (new(resampling=resampling, policy=policy, n=9) for _ in range(2))
    for y, detour in steps:
        if detour:
            pf = DETOURS[detour](pf)
        for filter_ in (straight, pf):
            filter_.predict(0.5) if y is None else filter_.correct(y)
        np.testing.assert_array_equal(pf.state, straight.state)
        np.testing.assert_array_equal(pf.covariance, straight.covariance)
    assert pf.snapshot() == straight.snapshot()


@settings(deadline=None, max_examples=60, derandomize=True)
@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(0, 10)), min_size=1, max_size=12), st.floats(1e-3, 1e3))
def test_a_common_factor_of_the_likelihood_changes_nothing_but_the_evidence(cloud, factor):
    """Catches likelihoods that must be normalised, and a log-likelihood that leaves the factor out."""
    x, g = np.array(cloud).T
    if not (g > 1e-3).any():
        return
    one, other = (placed(x[:, None], np.ones(len(x))) for _ in range(2))
    one.correct(g)
    other.correct(factor * g)
    np.testing.assert_allclose(one.state, other.state, rtol=0, atol=1e-10)
    assert other.log_likelihood == pytest.approx(one.log_likelihood + np.log(factor), abs=1e-10)
    assert one.log_likelihood == pytest.approx(np.log(np.mean(g)), abs=1e-10)


def test_two_corrections_of_one_time_are_one_of_both():
    """Catches a correction that moves particles: two sensors one after the other are their product at once."""
    one, other = new(policy=never, n=50), new(likelihood=lambda x, y: bell(x, y[0]) * bell(x, y[1]), policy=never, n=50)
    one.correct(0.5)
    one.correct(1.5)
    other.correct([0.5, 1.5])
    np.testing.assert_allclose(one.state, other.state, rtol=1e-12)
    assert one.log_likelihood == pytest.approx(other.log_likelihood)


def test_the_noise_of_a_prediction_does_not_depend_on_resampling():
    """Common random numbers: catches one generator for both, by which a change of scheme changes every step."""
    noise = []
    for resampling, policy in itertools.product(SCHEMES, (always, never)):
        pf = new(resampling=resampling, policy=policy)
        for _ in range(2):
            pf.correct(1.0)
            before = pf.particles
            pf.predict()
        noise.append(pf.particles - before)
    for other in noise[1:]:
        np.testing.assert_allclose(other, noise[0], rtol=0, atol=1e-14)


def test_it_says_what_it_is():
    """Catches <pfedu.particle_filter.ParticleFilter object at 0x...> in a reader's notebook."""
    assert repr(new()) == "ParticleFilter(n_particles=7, n_x=2, n_eff=7.0)"
