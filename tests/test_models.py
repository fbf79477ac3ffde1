"""Models: each stated once, so that what is simulated is what is filtered."""

import numpy as np
import pytest
from records import reference

from pfedu import bootstrap_filter, grid_filter
from pfedu.kalman import kalman_filter
from pfedu.models import (
    AdditiveGaussian,
    AdditiveProcess,
    LinearGaussian,
    MissingPieceError,
    StateSpaceModel,
    copies,
    falling_body,
    growth,
    local_level,
    random_walk,
    ratio,
    require,
    stochastic_volatility,
    van_der_pol,
)

F, H = np.array([[1.0, 0.5], [-0.2, 0.9]]), np.array([[1.0, 2.0]])
Q, R, P0, M0 = np.array([[2.0, 0.5], [0.5, 1.0]]), 0.7, np.array([[1.0, -0.3], [-0.3, 2.0]]), np.array([1.0, -1.0])
SEVERAL = 4.5  # standard errors: a handful of comparisons per test, each missed by chance once in 150 000


def linear_2d():
    return LinearGaussian(F=F, H=H, Q=Q, R=R, m0=M0, P0=P0)


def standardised_mean(draws, mean, var):
    """Distance of the sample mean from the mean, in standard errors, axis 0 being the draws."""
    return np.abs(draws.mean(axis=0) - mean) / np.sqrt(var / len(draws))


def test_simulated_moments_are_those_of_the_recursion():
    """Catches Q used as a standard deviation, F transposed, and a state that is one step late.

    Mean and covariance of x_3 follow from m <- F m, P <- F P F' + Q three times; y_3 adds H and R.
    An entry of a sample covariance has variance (P_ii P_jj + P_ij^2) / n.
    """
    n, m, P = 40_000, M0, P0
    x, y = linear_2d().simulate(3, np.random.default_rng(1), n_runs=n)
    for _ in range(3):
        m, P = F @ m, F @ P @ F.T + Q
    m_y, S = H @ m, H @ P @ H.T + R
    assert (standardised_mean(x[:, 3], m, np.diag(P)) < SEVERAL).all()
    assert (standardised_mean(y[:, 3], m_y, np.diag(S)) < SEVERAL).all()
    for sample, cov in ((x[:, 3], P), (y[:, 3], S), (x[:, 0], P0)):
        se = np.sqrt((np.outer(np.diag(cov), np.diag(cov)) + cov**2) / n)
        assert (np.abs(np.atleast_2d(np.cov(sample.T)) - cov) < SEVERAL * se).all()


def test_rows_are_times():
    """Catches a record that starts at time 1: with no noise, row k is k steps from the start."""
    count = LinearGaussian(F=1.0, H=1.0, Q=0.0, R=0.0, m0=0.0, P0=0.0)
    count.f = lambda k, x: x + k  # 0, 1, 3, 6: the sum of the times arrived at
    x, y = count.simulate(3, np.random.default_rng(1))
    assert x.tolist() == y.tolist() == [[0.0], [1.0], [3.0], [6.0]]


@pytest.mark.parametrize(("n_runs", "lead"), [(None, ()), (1, (1,)), (5, (5,))])
def test_simulate_shapes(n_runs, lead):
    """Catches runs and times swapped, and a single run that keeps an axis nobody asked for."""
    x, y = linear_2d().simulate(7, np.random.default_rng(1), n_runs=n_runs)
    assert x.shape == (*lead, 8, 2) and y.shape == (*lead, 8, 1)


def test_the_same_seed_simulates_the_same_bits():
    """Catches randomness from anywhere but the generator, and one generator that repeats itself."""
    rng = np.random.default_rng(1)
    first, second = growth().simulate(20, rng), growth().simulate(20, rng)
    again = growth().simulate(20, np.random.default_rng(1))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], second[0])


@pytest.mark.parametrize("n_runs", [None, 3])
def test_another_process_noise_scales_the_same_draws(n_runs):
    """Common random numbers: catches a slider for q that draws another truth."""
    small, large = (random_walk(q=q).simulate(30, np.random.default_rng(2), n_runs=n_runs) for q in (1.0, 9.0))
    np.testing.assert_allclose(np.diff(large[0], axis=-2), 3 * np.diff(small[0], axis=-2), atol=1e-12)
    np.testing.assert_array_equal(large[0][..., 0, :], small[0][..., 0, :])
    np.testing.assert_allclose(large[1] - large[0], small[1] - small[0], atol=1e-12)  # noise of y untouched


@pytest.mark.parametrize("make", [random_walk, growth])
def test_another_measurement_noise_scales_the_same_draws(make):
    """Common random numbers: catches a slider for r that changes the truth."""
    (x, y), (same_x, louder) = (make(r=r).simulate(30, np.random.default_rng(2)) for r in (1.0, 4.0))
    assert np.array_equal(x, same_x)
    h = make().h(0, x)
    np.testing.assert_allclose(louder - h, 2 * (y - h), atol=1e-12)


@pytest.mark.parametrize("n_runs", [None, 3])
def test_a_longer_record_begins_with_the_shorter(n_runs):
    """Common random numbers: catches a slider for T that draws other noise for the measurements there were."""
    short, long = (growth().simulate(n, np.random.default_rng(2), n_runs=n_runs) for n in (10, 20))
    np.testing.assert_array_equal(long[0][..., :11, :], short[0])
    np.testing.assert_array_equal(long[1][..., :11, :], short[1])


def test_densities_are_those_of_the_draws():
    """Catches a density that tells of another noise than the one drawn: Q for R, or m0 left out.

    For x ~ p, E[-2 log p(x)] = log det(2 pi P) + n and Var[-2 log p(x)] = 2 n: known without the code's formula.
    """
    n, model, rng = 40_000, linear_2d(), np.random.default_rng(3)
    x0 = model.sample_initial(n, rng)
    x1 = model.propagate(1, x0, rng)
    y1 = model.measure(1, x1, rng)
    drawn = {
        "P0": (model.log_initial(x0), P0),
        "Q": (model.log_transition(1, x1, x0), Q),
        "R": (model.log_likelihood(1, y1, x1), np.array([[R]])),
    }
    for name, (log_p, cov) in drawn.items():
        mean, dim = np.linalg.slogdet(2 * np.pi * cov)[1] + len(cov), len(cov)
        assert log_p.shape == (n,), name
        assert abs((-2 * log_p).mean() - mean) < SEVERAL * np.sqrt(2 * dim / n), name


def test_functions_broadcast_over_runs_and_particles():
    """Catches leading axes that are flattened or mixed: (runs, N, n_x) in, the same out."""
    model, x = linear_2d(), np.random.default_rng(4).standard_normal((3, 5, 2))
    assert model.propagate(1, x, np.random.default_rng(1)).shape == (3, 5, 2)
    assert model.measure(1, x, np.random.default_rng(1)).shape == (3, 5, 1)
    y = np.arange(3.0).reshape(3, 1, 1)
    log_g = model.log_likelihood(1, y, x)
    assert log_g.shape == (3, 5)
    for run in range(3):
        np.testing.assert_allclose(log_g[run], model.log_likelihood(1, y[run], x[run]), rtol=1e-13)


@pytest.mark.parametrize(("phase", "record"), [(0, "growth_A"), (1, "growth_C")])
def test_growth_has_the_phase_of_its_record(phase, record):
    """Catches a cosine one step off. The rest of f is odd and x_0 symmetric, so E[x_1] is the cosine alone."""
    model, pred_mean = growth(phase=phase), reference(record)["pred_mean"]
    assert model.f(1, np.zeros(1))[0] == pytest.approx(pred_mean[1], abs=1e-12)
    assert pred_mean[1] == pytest.approx(8 * np.cos(1.2 * (1 - phase)), abs=1e-12)


def test_growth_by_hand():
    """Catches x^2 in the numerator, x^2/2 for x^2/20: f_1(2) = 1 + 50/5 + 8 cos 1.2, h(2) = 1/5."""
    model = growth()
    assert model.f(1, np.array([2.0]))[0] == pytest.approx(11 + 8 * np.cos(1.2), rel=1e-14)
    assert model.h(1, np.array([2.0]))[0] == pytest.approx(0.2, rel=1e-14)


def test_growth_is_the_system_of_its_record():
    """Catches a model that the record was not made with: standardised noise of 50 steps must look like noise.

    A sum of 50 squares of standard normals has mean 50 and variance 100.
    """
    for name, phase in (("growth_A", 0), ("growth_C", 1)):
        data, model = reference(name), growth(phase=phase)
        x, y = data["x_true"][:, None], data["y"][:, None]
        moved = np.array([x[k] - model.f(k, x[k - 1]) for k in range(1, len(x))])
        for squares in ((moved**2 / 10).sum(), ((y - model.h(0, x)) ** 2)[1:].sum()):
            assert abs(squares - 50) < 4 * 10


def test_random_walk_takes_variances():
    """Catches q, r or p0 read as standard deviations, or swapped."""
    model = random_walk(q=2.0, r=3.0, m0=4.0, p0=5.0)
    assert [a.item() for a in (model.Q, model.R, model.m0, model.P0, model.F, model.H)] == [2, 3, 4, 5, 1, 1]


def test_local_level_is_the_limit_of_a_flat_prior():
    """Catches a first measurement used twice, or a start with the wrong variance.

    A prior N(0, p0) updated by y_0 has mean y_0 p0/(p0 + r) and variance r p0/(p0 + r): off by a share r/p0.
    """
    y, p0, q, r = np.array([[1120.0], [1160.0], [963.0]]), 1e12, 1469.1, 15099.0
    flat = kalman_filter(random_walk(q=q, r=r, p0=p0), y)
    level = kalman_filter(local_level(1120.0, q=q, r=r), np.vstack([[[np.nan]], y[1:]]))
    np.testing.assert_allclose(level.mean, flat.mean, rtol=2 * r / p0)
    np.testing.assert_allclose(level.cov, flat.cov, rtol=2 * r / p0)
    np.testing.assert_allclose(level.log_likelihood_increments[1:], flat.log_likelihood_increments[1:], rtol=1e-6)


def test_a_missing_piece_is_named():
    """Catches 'NoneType is not callable': the message tells the model, the piece and what asked for it."""
    walk = StateSpaceModel(lambda n, rng: np.zeros((n, 1)), lambda k, x, rng: x, lambda k, y, x: -abs(y - x)[..., 0])
    with pytest.raises(MissingPieceError, match="StateSpaceModel has no measure, which simulating measurements needs"):
        walk.simulate(3, np.random.default_rng(1))
    with pytest.raises(MissingPieceError, match="AdditiveGaussian has no F, which the Kalman filter needs"):
        require(growth(), "F", "the Kalman filter")
    require(random_walk(), "F", "the Kalman filter")


@pytest.mark.parametrize("piece", ["sample_initial", "propagate", "log_likelihood", "measure", "log_initial"])
def test_a_piece_that_is_no_function_is_named(piece):
    """Catches a matrix handed over where a function belongs, found out a hundred lines later."""
    pieces = dict.fromkeys(["sample_initial", "propagate", "log_likelihood"], print) | {piece: 3.0}
    with pytest.raises(TypeError, match=f"{piece} must be a function, got 3.0"):
        StateSpaceModel(**pieces)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"Q": 1.0}, "Q is 1 x 1, but m0 has 2 states"),
        ({"P0": [1.0, 1.0, 1.0]}, "P0 is 3 x 3, but m0 has 2 states"),
        ({"F": np.ones((2, 3))}, r"F must be \(2, 2\) to fit m0 and R, got \(2, 3\)"),
        ({"H": np.eye(2)}, r"H must be \(1, 2\) to fit m0 and R, got \(2, 2\)"),
        ({"Q": [[1.0, 2.0], [2.0, 1.0]]}, "Q is not positive semi-definite"),
        ({"R": [[-1.0]]}, "R is not positive semi-definite"),
        ({"P0": [[1.0, 0.5], [0.0, 1.0]]}, "P0 is not symmetric"),
    ],
)
def test_pieces_that_do_not_fit_are_named(change, message):
    """Catches shapes that broadcast: a missing transpose must not give a number."""
    with pytest.raises(ValueError, match=message):
        LinearGaussian(**(dict(F=F, H=H, Q=Q, R=R, m0=M0, P0=P0) | change))


@pytest.mark.parametrize("name", ["f", "h"])
def test_a_function_that_loses_a_component_is_an_error(name):
    """Catches broadcasting inside the model: one component out of two is silently used for both."""
    pieces = {"f": lambda k, x: x, "h": lambda k, x: x} | {name: lambda k, x: x[..., :1]}
    model = AdditiveGaussian(**pieces, Q=[1.0, 1.0], R=[1.0, 1.0], m0=[0.0, 0.0], P0=[1.0, 1.0])
    with pytest.raises(ValueError, match=rf"\b{name}\b"):
        model.simulate(2, np.random.default_rng(1))


def test_a_negative_number_of_steps_is_an_error():
    """Catches a record of one row where none can be."""
    with pytest.raises(ValueError, match="n_steps"):
        random_walk().simulate(-3, np.random.default_rng(1))


def test_no_runs_and_a_seed_for_a_generator_are_errors():
    """Catches one run where none was asked for, and 'int has no attribute spawn'."""
    with pytest.raises(ValueError, match="n_runs must be a whole number of at least 1, got 0"):
        random_walk().simulate(3, np.random.default_rng(1), n_runs=0)
    with pytest.raises(TypeError, match=r"default_rng\(1\); got 1"):
        random_walk().simulate(3, 1)


@pytest.mark.parametrize(("name", "number"), [*((n, v) for n in ("n_steps", "n_runs") for v in (2.5, np.nan, np.inf))])
def test_numbers_that_are_not_whole_are_errors(name, number):
    """Catches "'float' object cannot be interpreted as an integer", and half a step left out in silence."""
    with pytest.raises(ValueError, match=f"{name} must be a whole number of at least [01], got {number}"):
        random_walk().simulate(**{"n_steps": 3, "n_runs": 2, name: number}, rng=np.random.default_rng(1))
    assert random_walk().simulate(3e0, np.random.default_rng(1), n_runs=2.0)[0].shape == (2, 4, 1)


def test_states_may_be_lists():
    """Catches 'list has no attribute shape' one step after the function that gave a list."""

    def made(back):
        return StateSpaceModel(
            sample_initial=lambda n, rng: back(rng.standard_normal((n, 1))),
            propagate=lambda k, x, rng: back(x + rng.standard_normal(x.shape)),
            log_likelihood=lambda k, y, x: -((y - x) ** 2)[..., 0],
            measure=lambda k, x, rng: x,
        )

    lists, arrays = made(np.ndarray.tolist), made(np.asarray)
    seed = np.random.default_rng
    np.testing.assert_array_equal(lists.simulate(3, seed(1))[0], arrays.simulate(3, seed(1))[0])
    y = [0.0, np.nan, 1.0, 2.0]
    tracks = [bootstrap_filter(model, y, 10, rng=seed(1)) for model in (lists, arrays)]
    np.testing.assert_array_equal(tracks[0].mean, tracks[1].mean)


@pytest.mark.parametrize("m0", [[[0.0], [10.0]], [0.0, np.nan]])
def test_an_initial_mean_that_is_no_vector_of_numbers_is_an_error(m0):
    """Catches a column vector, which broadcasting turns into one draw per state."""
    with pytest.raises(ValueError, match=r"m0 must be a vector \(n_x,\) of finite numbers"):
        LinearGaussian(F=np.eye(2), H=[[1.0, 0.0]], Q=[1.0, 1.0], R=1.0, m0=m0, P0=[1.0, 1.0])


def test_a_model_keeps_its_own_copy_of_what_it_was_given():
    """Catches two filters that solve different models because an array was changed afterwards."""
    Q = np.array([[10.0]])
    model = LinearGaussian(F=1.0, H=1.0, Q=Q, R=1.0, m0=0.0, P0=5.0)
    Q *= 100
    assert model.Q.item() == 10.0


# The worked systems, each against its formula or against moments in closed form.


def test_ratio_is_what_it_says():
    """Catches the denominators of the two sisters exchanged, and a pole that becomes NaN instead of infinity."""
    x = np.array([[2.0], [-0.5]])
    np.testing.assert_allclose(ratio().f(1, x), [[4 / 9], [0.25 / 0.875]])
    np.testing.assert_allclose(ratio(power=2).f(1, x), [[4 / 5], [0.25 / 1.25]])
    assert ratio().H.tolist() == [[1.0]] and ratio(q=0.1, r=1.0, p0=10.0).P0.tolist() == [[10.0]]
    with np.errstate(all="raise"):
        at_the_pole = ratio().f(1, np.array([[-1.0]]))
    assert np.isposinf(at_the_pole).all() and ratio().log_likelihood(1, np.zeros(1), at_the_pole).tolist() == [-np.inf]
    with pytest.raises(ValueError, match="power must be 3 or 2, got 4"):
        ratio(power=4)


@pytest.mark.parametrize(("power", "limit"), [(3, 0.0), (2, 1.0)])
def test_ratio_comes_back_from_infinity(power, limit):
    """Catches inf / inf: what was at the pole, or is so far away that its square overflows, goes to the limit."""
    model, x = ratio(power=power), np.array([[np.inf], [-np.inf], [1e200], [-1e60], [1e49]])
    with np.errstate(all="raise", under="ignore"):
        np.testing.assert_allclose(model.f(2, x), np.full((5, 1), limit), atol=1e-48)
        np.testing.assert_allclose(model.jacobian_f(2, x), np.zeros((5, 1, 1)), atol=1e-48)
        assert not np.isnan(model.jacobian_f(2, np.array([[-1.0]]))).any()
        assert model.f(2, model.f(1, np.array([[-1.0]]))).tolist() == [[0.0 if power == 3 else 0.2]]


def test_stochastic_volatility_in_the_long_run():
    """Catches a start that is not stationary, and a variance of the state taken for that of the return.

    log y^2 = x + log chi^2_1, whose mean is mu - gamma - log 2 and whose variance is q/(1 - phi^2) + pi^2/2; runs are
    independent, so that the standard errors of a mean and of a variance (kurtosis bounded by 7) are simple.
    """
    mu, phi, q, n = -1.0, 0.9, 0.1, 40_000
    x, y = stochastic_volatility(mu, phi, q).simulate(5, np.random.default_rng(1), n_runs=n)
    var = q / (1 - phi**2)
    for k in (0, 5):
        assert standardised_mean(x[:, k], mu, var) < SEVERAL
        assert abs(x[:, k].var() / var - 1) < SEVERAL * np.sqrt(2 / n)
        log_square = np.log(y[:, k] ** 2)
        assert standardised_mean(log_square, mu - np.euler_gamma - np.log(2), var + np.pi**2 / 2) < SEVERAL
    lag = np.mean((x[:, 4, 0] - mu) * (x[:, 5, 0] - mu)) / var
    assert abs(lag - phi) < SEVERAL * np.sqrt(2 / n)
    for bad in (1.0, -1.2):
        with pytest.raises(ValueError, match="phi must lie between -1 and 1"):
            stochastic_volatility(phi=bad)


def test_the_likelihood_of_a_return():
    """Catches a lost constant or sign: the density of y given x is that of N(0, exp(x))."""
    y, x = np.array([0.3]), np.array([[-1.0], [2.0]])
    want = [-0.5 * (np.log(2 * np.pi * np.exp(v)) + 0.09 / np.exp(v)) for v in (-1.0, 2.0)]
    np.testing.assert_allclose(stochastic_volatility().log_likelihood(1, y, x), want)


def test_the_oscillator_turns_as_the_equation_says():
    """Catches a sign: for small steps a period of mu = 0 is 2 pi, and mu = 1 has its limit cycle of amplitude 2.009."""
    quiet = dict(q=0.0, dt=1e-3, p0=0.0)
    circle = van_der_pol(mu=0.0, **quiet).simulate(6283, np.random.default_rng(1))[0]
    np.testing.assert_allclose(circle[-1], [2.0, 0.0], atol=0.01)
    cycle = van_der_pol(mu=1.0, **quiet).simulate(20_000, np.random.default_rng(1))[0]
    assert np.abs(cycle[10_000:, 0]).max() == pytest.approx(2.009, abs=0.01)


def test_copies_are_independent_copies():
    """Catches copies that mix, and measurements out of order: each copy is the model itself."""
    for model in (growth(), van_der_pol(), linear_2d()):
        many, x = copies(model, 3), np.random.default_rng(1).standard_normal((5, 3 * model.n_x))
        apart = x.reshape(5, 3, model.n_x)
        assert (many.n_x, many.n_y) == (3 * model.n_x, 3 * model.n_y)
        np.testing.assert_allclose(many.f(2, x).reshape(apart.shape), model.f(2, apart))
        np.testing.assert_allclose(many.h(2, x).reshape(5, 3, model.n_y), model.h(2, apart))
        np.testing.assert_allclose(many.log_transition(2, x[1:], x[:-1]),
                                   model.log_transition(2, apart[1:], apart[:-1]).sum(axis=-1))  # fmt: skip
        np.testing.assert_allclose(many.log_initial(x), model.log_initial(apart).sum(axis=-1))
    assert isinstance(copies(linear_2d(), 2), LinearGaussian) and hasattr(copies(van_der_pol(), 2), "H")
    with pytest.raises(ValueError, match="noise of FallingBody is not simply added, which copies need"):
        copies(falling_body(), 2)
    with pytest.raises(MissingPieceError, match="AdditiveProcess has no h, which a model of copies needs"):
        copies(stochastic_volatility(), 2)
    with pytest.raises(ValueError, match="number of copies must be a whole number of at least 1, got 0"):
        copies(growth(), 0)


def test_matrices_in_place_of_functions():
    """Catches a matrix taken for a function, and one whose shape nobody checked."""
    model = AdditiveGaussian(f=lambda k, x: np.sin(x), h=H, Q=Q, R=R, m0=M0, P0=P0)
    x = np.random.default_rng(1).standard_normal((4, 2))
    np.testing.assert_allclose(model.h(1, x), x @ H.T)
    np.testing.assert_array_equal(model.jacobian_h(1, x), np.broadcast_to(H, (4, 1, 2)))
    assert not hasattr(model, "F")
    with pytest.raises(ValueError, match=r"H must be \(1, 2\) to fit m0 and R, got \(1, 3\)"):
        AdditiveGaussian(f=F, h=[[1.0, 2.0, 3.0]], Q=Q, R=R, m0=M0, P0=P0)


@pytest.mark.parametrize("x0", [[1.0, 2.0], [[1.0, 2.0], [3.0, 4.0]]])
def test_a_simulation_starts_where_it_is_told(x0):
    """Catches a start drawn all the same, or all runs at that of the first."""
    x, _ = linear_2d().simulate(3, np.random.default_rng(1), n_runs=2, x0=x0)
    np.testing.assert_array_equal(x[:, 0], np.broadcast_to(x0, (2, 2)))
    with pytest.raises(ValueError, match=r"x0 must be a state, shape \(2,\), or one a run, \(2, 2\); got \(3,\)"):
        linear_2d().simulate(3, np.random.default_rng(1), n_runs=2, x0=[1.0, 2.0, 3.0])


def test_a_process_with_a_measurement_of_any_kind():
    """Catches an AdditiveProcess that only works with Gaussian measurements: counts, filtered and on the grid."""

    def log_likelihood(k, y, x):
        return (y * x - np.exp(x))[..., 0]  # Poisson, up to its constant

    model = AdditiveProcess(
        0.9, log_likelihood, Q=0.1, m0=0.0, P0=1.0, measure=lambda k, x, rng: rng.poisson(np.exp(x))
    )
    y = model.simulate(10, np.random.default_rng(1))[1]
    exact = grid_filter(model, y, np.linspace(-6, 6, 601))
    track = bootstrap_filter(model, y, 1000, rng=np.random.default_rng(2), n_runs=200)
    error = track.mean.mean(axis=0) - exact.mean
    assert (np.abs(error) < SEVERAL * track.mean.std(axis=0) / np.sqrt(200) + 5 * exact.sd / 1000).all()
