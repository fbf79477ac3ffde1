"""The extended and the unscented Kalman filter: exact where they must be, and wrong by the known amount elsewhere."""

import numpy as np
import pytest
from records import measurements, reference
from test_kalman import three_states

import pfedu
from pfedu.kalman import extended_kalman_filter, kalman_filter, linearised
from pfedu.models import (
    AdditiveGaussian,
    MissingPieceError,
    StateSpaceModel,
    falling_body,
    growth,
    random_walk,
    van_der_pol,
)
from pfedu.models.jacobian import jacobian
from pfedu.unscented import Unscented, augmented, centred, sampled, unscented_kalman_filter

NAN = np.nan
FILTERS = {
    "extended": extended_kalman_filter,
    "additive": unscented_kalman_filter,
    "augmented": lambda model, y: unscented_kalman_filter(model, y, noise="augmented"),
    "narrow": lambda model, y: unscented_kalman_filter(model, y, alpha=0.5, kappa=1.0),
}
each_filter = pytest.mark.parametrize("run", FILTERS.values(), ids=FILTERS)
RANK_ONE = np.outer([1.0, 2.0, -1.0], [1.0, 2.0, -1.0])


@each_filter
@pytest.mark.parametrize("Q", [np.diag([1.0, 0.6, 0.3]), RANK_ONE, np.zeros((3, 3))], ids=["full", "rank one", "zero"])
def test_a_linear_model_is_solved_exactly(run, Q):
    """Catches transposes, weights, a lost Q or R, and a square root that needs a regular covariance.

    A linear function of sigma points has exactly the transformed mean and covariance, whatever alpha and kappa
    (beta adds (1 - alpha^2 + beta) times the square of a deviation of the centre that is zero).
    """
    model = three_states(Q)
    y = model.simulate(8, np.random.default_rng(1), n_runs=3)[1]
    y[0, 3], y[1, 0], y[:, 6] = NAN, NAN, NAN
    got, exact = run(model, y), kalman_filter(model, y)
    np.testing.assert_allclose(got.mean, exact.mean, rtol=0, atol=1e-7)
    np.testing.assert_allclose(got.cov, exact.cov, rtol=0, atol=1e-7)
    np.testing.assert_allclose(got.log_likelihood_increments, exact.log_likelihood_increments, rtol=0, atol=1e-7)


@each_filter
def test_a_singular_prior(run):
    """Catches a Cholesky factor asked of a covariance that has none: two states known exactly, one not."""
    model = AdditiveGaussian(f=np.eye(3), h=[[1.0, 1.0, 1.0]], Q=np.zeros((3, 3)), R=1.0, m0=[1, 2, 3], P0=[0, 4.0, 0])
    y = np.array([[7.0], [8.0]])
    exact = kalman_filter(model, y)
    np.testing.assert_allclose(run(model, y).mean, exact.mean, atol=1e-7)
    np.testing.assert_allclose(run(model, y).cov, exact.cov, atol=1e-7)


def test_sigma_points_of_a_square():
    """Catches weights of mean and covariance mixed up: x^2 of N(m, P) has mean m^2 + P and variance 4 m^2 P + 2 P^2.

    With alpha 1, beta 2 and kappa 0 the transform gives both exactly in one dimension.
    """
    m, P = np.array([3.0]), np.array([[2.0]])
    mean, d, W = centred(Unscented().points(m, P) ** 2, Unscented(), 1)
    assert mean[0] == pytest.approx(11.0) and W @ d[:, 0] ** 2 == pytest.approx(4 * 9 * 2 + 2 * 4)


@pytest.mark.parametrize("alpha", [1.0, 0.5, 1e-3])
@pytest.mark.parametrize("kappa", [0.0, 1.0])
def test_sigma_points_have_the_moments_they_stand_for(alpha, kappa):
    """Catches a spread that does not match the weights, and square roots taken by rows instead of columns."""
    P = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 1.0]])
    m, transform = np.array([1.0, -2.0, 3.0]), Unscented(alpha, 2.0, kappa)
    points = transform.points(m, P)
    assert points.shape == (7, 3)
    mean, d, W = centred(points, transform, 3)
    np.testing.assert_allclose(mean, m, atol=1e-8)
    np.testing.assert_allclose((d * W[:, None]).T @ d, P, atol=1e-8)


def test_many_gaussians_are_one_at_a_time():
    """Catches axes that mix: the updates serve a Gaussian a particle."""
    model, rng = van_der_pol(), np.random.default_rng(2)
    m = rng.standard_normal((4, 5, 2))
    root = rng.standard_normal((4, 5, 2, 2))
    P, y = root @ np.swapaxes(root, -1, -2), rng.standard_normal((4, 5, 1))
    for predict, correct in (linearised(model), sampled(model, Unscented()), augmented(model, Unscented())):
        together = predict(1, m, P), correct(1, *predict(1, m, P), y)
        for i in np.ndindex(4, 5):
            alone = predict(1, m[i], P[i]), correct(1, *predict(1, m[i], P[i]), y[i])
            for whole, part in zip(together, alone, strict=True):
                for a, b in zip(whole, part, strict=True):
                    np.testing.assert_allclose(a[i], b, rtol=1e-9, atol=1e-9)


def test_noise_inside_the_step():
    """Catches a noise that is added where the model has it inside: x_k = x_{k-1} (1 + w) has variance m^2 q + P(1+q).

    The extended filter keeps m^2 q + P, the augmented one finds m^2 q + P as well plus what its points see of the
    product; with P = 0 both must give exactly m^2 q, and adding noise would give q.
    """

    class Factor(AdditiveGaussian):
        noise_is_additive = False
        log_transition = None

        def step(self, k, x, w):
            return x * (1 + w)

    model = Factor(f=lambda k, x: x, h=1.0, Q=0.01, R=1.0, m0=5.0, P0=0.0)
    y = [[NAN], [NAN]]
    for track in (extended_kalman_filter(model, y), unscented_kalman_filter(model, y, noise="augmented")):
        assert track.cov[1, 0, 0] == pytest.approx(25 * 0.01, rel=1e-6)
    with pytest.raises(ValueError, match="noise of Factor is not simply added: use noise='augmented'"):
        unscented_kalman_filter(model, y)


def test_the_growth_model_defeats_both():
    """What is taught of it: one Gaussian cannot follow two peaks. Over 200 records the exact mean is far better.

    Paired over records, in standard errors; the exact answer comes from the grid.
    """
    model = growth()
    x, y = model.simulate(30, np.random.default_rng(3), n_runs=200)
    exact = pfedu.grid_filter(model, y, np.linspace(-55, 55, 801))
    best = np.mean((exact.mean - x)[:, 1:, 0] ** 2, axis=-1)
    for run in (extended_kalman_filter, unscented_kalman_filter):
        worse = np.mean((run(model, y).mean - x)[:, 1:, 0] ** 2, axis=-1) - best
        assert worse.mean() > 5 * worse.std(ddof=1) / np.sqrt(200)


def test_the_growth_record():
    """The unscented filter beats the extended one on this record; both miss the exact mean by more than it misses."""
    data = reference("growth_A")
    y, x = measurements("growth_A"), data["x_true"][:, None]

    def rmse(mean):
        return np.sqrt(np.mean((mean - x)[1:] ** 2))

    exact = rmse(data["post_mean"][:, None])
    extended, unscented = (rmse(run(growth(), y).mean) for run in (extended_kalman_filter, unscented_kalman_filter))
    assert exact < unscented < extended and unscented - exact > 1


def test_a_mild_nonlinearity_is_followed():
    """Catches a derivative taken at the wrong place: where curvature is small the answer is nearly exact.

    y = x + x^2/1000 about x = 10: both filters must agree with the grid to a hundredth of a standard deviation.
    """
    model = AdditiveGaussian(f=0.9, h=lambda k, x: x + x * x / 1000, Q=0.1, R=0.1, m0=10.0, P0=0.5)
    y = model.simulate(20, np.random.default_rng(4))[1]
    exact = pfedu.grid_filter(model, y, np.linspace(-10, 20, 1501))
    for run in (extended_kalman_filter, unscented_kalman_filter):
        track = run(model, y)
        assert np.abs((track.mean - exact.mean) / exact.sd).max() < 0.01
        assert np.abs(track.log_likelihood - exact.log_likelihood) < 0.01


@pytest.mark.parametrize(
    "model", [growth(), pfedu.models.ratio(), pfedu.models.ratio(power=2), van_der_pol(),
              pfedu.models.stochastic_volatility(), falling_body()], ids=lambda m: type(m).__name__,
)  # fmt: skip
def test_stated_derivatives_are_those_of_the_functions(model):
    """Catches a sign in a derivative written by hand: central differences leave some eight digits."""
    x = model.m0 + np.random.default_rng(5).standard_normal((20, model.n_x)) * np.sqrt(np.diag(model.P0)) * 0.3
    np.testing.assert_allclose(model.jacobian_f(3, x), jacobian(lambda z: model.f(3, z), x), rtol=1e-6, atol=1e-6)
    if hasattr(model, "h"):
        np.testing.assert_allclose(model.jacobian_h(3, x), jacobian(lambda z: model.h(3, z), x), rtol=1e-6, atol=1e-6)


def test_differences_stand_in_for_derivatives():
    """Catches columns and rows of the Jacobian exchanged, and a step too large or too small for the size of x."""
    x = np.array([[1e5, 1e-3, 2.0], [-3.0, 0.0, 1e-8]])

    def f(x):
        return np.stack([x[..., 0] * x[..., 1], np.sin(x[..., 2])], axis=-1)

    want = np.zeros((2, 2, 3))
    want[:, 0, 0], want[:, 0, 1], want[:, 1, 2] = x[:, 1], x[:, 0], np.cos(x[:, 2])
    np.testing.assert_allclose(jacobian(f, x), want, rtol=1e-8, atol=1e-8)


@each_filter
def test_a_batch_is_a_loop_over_its_records(run):
    """Catches records that mix, and the points of one prediction used for another."""
    model = van_der_pol()
    y = model.simulate(6, np.random.default_rng(6), n_runs=4)[1]
    y[2, 3] = NAN
    together = run(model, y)
    for i in range(4):
        np.testing.assert_allclose(together.mean[i], run(model, y[i]).mean, rtol=0, atol=1e-10)
        np.testing.assert_allclose(together.log_likelihood[i], run(model, y[i]).log_likelihood, atol=1e-9)


@each_filter
def test_a_missing_row_adds_nothing(run):
    """Catches a missing row corrected with NaN, or with the prediction."""
    model, y = van_der_pol(), np.array([[2.0], [NAN], [1.9]])
    track = run(model, y)
    assert track.log_likelihood_increments[1] == 0.0 and np.isfinite(track.mean).all()
    assert track.cov[1, 0, 0] > track.cov[0, 0, 0]


def test_bad_input_is_named():
    """Catches a model without functions, an unknown form of noise, and points that cannot be placed."""
    bare = StateSpaceModel(print, print, print)
    with pytest.raises(MissingPieceError, match="has no f, which the extended Kalman filter needs"):
        extended_kalman_filter(bare, [[1.0]])
    with pytest.raises(MissingPieceError, match="has no h, which the unscented Kalman filter needs"):
        unscented_kalman_filter(pfedu.models.stochastic_volatility(), [[1.0]])
    with pytest.raises(ValueError, match="noise must be one of additive, augmented, got 'both'"):
        unscented_kalman_filter(growth(), [[1.0]], noise="both")
    with pytest.raises(ValueError, match="alpha must be positive, got 0"):
        unscented_kalman_filter(growth(), [[1.0]], alpha=0)
    with pytest.raises(ValueError, match=r"alpha\^2 \(n \+ kappa\) must be positive for n = 1, got -1"):
        unscented_kalman_filter(growth(), [[1.0]], kappa=-2.0)
    with pytest.raises(ValueError, match=r"jacobian_f\(k, x\) must give shape \(1, 1\) for x \(1,\), got \(1,\)"):
        model = AdditiveGaussian(lambda k, x: x, 1.0, 1.0, 1.0, 0.0, 1.0, jacobian_f=lambda k, x: np.ones_like(x))
        extended_kalman_filter(model, [[1.0], [1.0]])


@pytest.mark.parametrize("noise", ["additive", "augmented"])
@pytest.mark.parametrize(("p0", "r"), [(1e13, 1e-4), (1e10, 1e-6), (1e6, 1e-10)])
def test_a_sharp_measurement_of_something_unknown(p0, r, noise):
    """Catches P - K S K', which leaves rounding of the size of the prior where the posterior is tiny."""
    model, y = random_walk(q=1.0, r=r, p0=p0), np.array([[1.0], [2.0], [3.0]])
    got, exact = unscented_kalman_filter(model, y, noise=noise), kalman_filter(model, y)
    np.testing.assert_allclose(got.cov, exact.cov, rtol=1e-6)
    np.testing.assert_allclose(got.mean, exact.mean, rtol=1e-6)


@pytest.mark.parametrize("alpha", [1.0, 1e-3, 1e-6])
def test_points_close_together_keep_their_digits(alpha):
    """Catches weights of 1/alpha^2 that cancel: x^2 of N(3, 2) has mean 11 and variance 80, however close they lie."""
    transform = Unscented(alpha=alpha)
    points = transform.points(np.array([3.0]), np.array([[2.0]])) ** 2
    mean, d, W = centred(points, transform, 1)
    assert mean[0] == pytest.approx(11.0, rel=1e-3) and W @ d[:, 0] ** 2 == pytest.approx(80.0, rel=1e-3)


def test_differences_know_the_scale_of_the_state():
    """Catches a step of 6e-6 taken across a whole wave: a state of the size of 1e-6, measured through a sine of it."""
    model = AdditiveGaussian(f=1.0, h=lambda k, x: np.sin(x / 1e-6), Q=1e-14, R=0.01, m0=0.0, P0=1e-14)
    assert model.jacobian_h(0, np.zeros(1))[0, 0] == pytest.approx(1e6, rel=1e-6)
