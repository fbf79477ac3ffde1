"""The bank of Kalman filters: right where the model is linear, and the form that uses each measurement twice."""

import functools

import numpy as np
import pytest
from exact import SEEDS, SEVERAL, in_standard_errors, mean_square_deviation, problem, worst

import pfedu
from pfedu.filters.kalman_bank import mixture_moments
from pfedu.kalman import kalman_filter
from pfedu.models import LinearGaussian, falling_body, growth, random_walk, stochastic_volatility
from pfedu.resampling import SCHEMES, always, never, ratio
from pfedu.weights import weighted_moments

NAN = np.nan
both = pytest.mark.parametrize("kalman", ["ekf", "ukf"])
POLICIES = {"always": always, "ratio": ratio(0.5), "never": never}


def run(model, y, n, seed=1, **options):
    return pfedu.kalman_bank_filter(model, y, n, rng=np.random.default_rng(seed), **options)


def two_states(Q=((1.0, 0.3), (0.3, 0.5)), n_y=1):
    return LinearGaussian(
        F=[[1.0, 0.5], [-0.1, 0.9]], H=[[1.0, 0.3], [0.2, -0.5]][:n_y], Q=Q,
        R=[[0.5, 0.1], [0.1, 0.8]] if n_y == 2 else 0.5, m0=[1.0, -1.0], P0=[[2, 0.5], [0.5, 1]],
    )  # fmt: skip


def slow_walk():
    """A small q keeps the start from being forgotten, so that the scatter of the points drawn at time 0 is seen."""
    model = random_walk(q=0.1, r=1.0, p0=5.0)
    y = model.simulate(10, np.random.default_rng(2))[1]
    return model, y, kalman_filter(model, y)


@both
@pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
def test_the_exact_answer_on_a_linear_record(kalman, policy):
    """Catches evidence taken after the correction, a covariance left out, and a start that is not the prior."""
    model, y, exact = slow_walk()
    track = run(model, y, 50, kalman=kalman, policy=policy, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@pytest.mark.parametrize("resampling", SCHEMES)
def test_the_exact_answer_with_every_scheme(resampling):
    """Catches covariances and means that are not resampled together."""
    model, y, exact = slow_walk()
    track = run(model, y, 50, resampling=resampling, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@both
@pytest.mark.parametrize("n_y", [1, 2])
@pytest.mark.parametrize("Q", [((1.0, 0.3), (0.3, 0.5)), ((0.0, 0.0), (0.0, 0.1))], ids=["full", "singular"])
def test_several_dimensions_against_the_kalman_filter(kalman, n_y, Q):
    """Catches a transposed matrix, and a need for densities of the motion: a singular Q will do."""
    model = two_states(Q, n_y)
    y = model.simulate(8, np.random.default_rng(8))[1]
    track = run(model, y, 100, kalman=kalman, policy=ratio(0.5), n_runs=SEEDS)
    assert max(worst(track, kalman_filter(model, y)).values()) < SEVERAL


@both
@pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
@pytest.mark.parametrize("n_particles", [1, 2, 7])
def test_the_likelihood_estimate_is_unbiased_for_very_few_particles(kalman, policy, n_particles):
    """Catches what only holds for large N. A particle's evidence is p(y | its x_0), of which the mean is p(y)."""
    model, y = random_walk(q=0.2, r=4.0, p0=1.0), np.array([[0.5], [-1.0], [NAN], [1.5]])
    track = run(model, y, n_particles, kalman=kalman, policy=policy, seed=5, n_runs=10_000)
    z = np.exp(track.log_likelihood - kalman_filter(model, y).log_likelihood) - 1
    assert in_standard_errors(z) < 4


def test_the_error_falls_as_one_over_root_n():
    """Catches every lasting bias: 16 times the particles, a 16th of the mean square deviation, within its error."""
    model, y, exact = slow_walk()
    few, many = (
        mean_square_deviation(run(model, y, n, seed=n, resampling="multinomial", n_runs=SEEDS), exact)
        for n in (100, 1600)
    )
    cv = [m.std(ddof=1) / m.mean() / np.sqrt(SEEDS) for m in (few, many)]
    assert abs(np.log(few.mean() / many.mean()) / np.log(16) - 1) < 4 * np.hypot(*cv) / np.log(16)


def test_one_particle_is_the_kalman_filter_of_a_known_start():
    """Catches anything but a Kalman filter in a particle, to rounding: mean, covariance, and the evidence."""
    model = two_states(n_y=2)
    y = model.simulate(8, np.random.default_rng(3))[1]
    track = run(model, y, 1, keep=True)
    known = LinearGaussian(model.F, model.H, model.Q, model.R, m0=track.particles[0, 0], P0=[0.0, 0.0])
    alone = kalman_filter(known, y)
    np.testing.assert_allclose(track.mean, alone.mean, rtol=0, atol=1e-11)
    np.testing.assert_allclose(track.cov, alone.cov, rtol=0, atol=1e-11)
    np.testing.assert_allclose(track.log_likelihood_increments, alone.log_likelihood_increments, rtol=0, atol=1e-11)


def test_unscented_and_extended_agree_where_all_is_linear():
    """Catches a set of points that is not exact for a linear function: the same bank to rounding."""
    model = two_states(n_y=2)
    y = model.simulate(8, np.random.default_rng(3))[1]
    tangents, points = (run(model, y, 30, kalman=kalman, policy=ratio(0.5), keep=True) for kalman in ("ekf", "ukf"))
    for field in ("particles", "log_weights", "mean", "cov"):
        np.testing.assert_allclose(getattr(tangents, field), getattr(points, field), rtol=0, atol=1e-9)


@functools.cache
def linear_bank(use_twice, n):
    """RMS deviation of the mean from the exact one, and mean share of the exact variance, after the fifth step."""
    model, y, exact = problem("linear_A")
    track = run(model, y, n, use_twice=use_twice, n_runs=10)
    rms = np.sqrt(mean_square_deviation(track, exact).mean())
    return rms, np.mean((track.cov / exact.cov)[:, 5:])


@pytest.mark.parametrize("n", [500, 5000])
def test_a_measurement_used_twice_is_wrong_for_every_n(n):
    """A pair with the next test. Ten times the particles change nothing.

    An independent program found an RMS deviation of 0.260 at N = 500 and at 5000, and 0.7 % of the exact variance.
    """
    rms, share = linear_bank(True, n)
    assert rms == pytest.approx(0.26, abs=0.006)
    assert share == pytest.approx(0.007, abs=0.0005)


@pytest.mark.parametrize("n", [500, 5000])
def test_a_measurement_used_once_is_right(n):
    """The other half of the pair: the start forgotten, the mixture is the Kalman filter, with all of its variance."""
    rms, share = linear_bank(False, n)
    assert rms < 0.003
    assert share == pytest.approx(1, abs=1e-9)


def test_a_measurement_used_twice_has_the_limit_of_theory():
    """Catches another form than the one described: the fixed point of its recursion on a linear model.

    With a large N the cloud is Gaussian, N(m, v). Noise makes it N(m, v + q); weighed by the likelihood where it then
    stands it has the mean m + L (y - m) and the variance (1 - L) (v + q), L = (v + q) / (v + q + r); and moved by the
    Kalman filters, whose gain K is that of a known start, x -> (1 - K) x + K y.
    """
    model, y, exact = problem("linear_A")
    m, v, P = np.zeros(51), np.full(51, 5.0), 0.0
    for k in range(1, 51):  # q = 10, r = 1
        P = K = (P + 10) / (P + 11)
        L = (v[k - 1] + 10) / (v[k - 1] + 11)
        m[k] = (1 - K) * (m[k - 1] + L * (y[k, 0] - m[k - 1])) + K * y[k, 0]
        v[k] = (1 - K) ** 2 * L
    track = run(model, y, 5000, use_twice=True, n_runs=10)
    assert np.abs(track.mean.mean(axis=0)[1:, 0] - m[1:]).max() < 0.01
    np.testing.assert_allclose(track.cov.mean(axis=0)[1:, 0, 0], v[1:], rtol=0.15)
    assert np.sqrt(np.mean((m - exact.mean[:, 0])[1:] ** 2)) == pytest.approx(0.26, abs=0.006)


@pytest.mark.parametrize(("kalman", "floor"), [("ekf", 8.8), ("ukf", 5.1)])
def test_on_the_growth_record_it_is_no_better_than_its_filters(kalman, floor):
    """States what the bank cannot do: ten times the particles leave the error of the linearisation as it is.

    Its particles differ by their start alone, which the model soon forgets; from then on the bank is one extended or
    unscented filter. Bootstrap with 500 particles is at 0.6.
    """
    model, y, exact = problem("growth_A")
    few, many = (run(model, y, n, kalman=kalman, n_runs=10) for n in (100, 1000))
    rms = [np.sqrt(mean_square_deviation(track, exact)) for track in (few, many)]
    assert abs(rms[0].mean() - rms[1].mean()) < 0.02
    assert rms[1].mean() == pytest.approx(floor, abs=0.1)
    single = pfedu.extended_kalman_filter if kalman == "ekf" else pfedu.unscented_kalman_filter
    np.testing.assert_allclose(many.mean[:, 20:].mean(axis=0), single(model, y).mean[20:], atol=0.01)


def test_on_the_growth_record_it_knows_the_start():
    """States what it can do: points drawn at time 0 carry both peaks of a first measurement of the square, exactly.

    Row 0 alone is importance sampling of the prior, whatever the linearisation; the grid's answer, with no bias.
    """
    model, y = growth(), np.array([[1.0]])
    exact = pfedu.grid_filter(model, y, np.linspace(-15, 15, 601))
    track = run(model, y, 200, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@pytest.mark.parametrize("lead", [(), (3,), (2, 3)], ids=str)
@pytest.mark.parametrize("shared", [False, True])
def test_moments_of_a_mixture_against_brute_force(lead, shared):
    """Catches weights on the wrong axis, a lost term, and a shared covariance counted N times or once for all runs."""
    rng = np.random.default_rng(1)
    m, roots = rng.standard_normal((*lead, 4, 2)), rng.standard_normal((*lead, 1 if shared else 4, 2, 2))
    P, w = roots @ np.swapaxes(roots, -1, -2), rng.dirichlet(np.ones(4), size=lead or None)
    mean, cov = mixture_moments((m, P), np.log(w))
    for run_ in np.ndindex(lead):
        second, first = np.zeros((2, 2)), np.zeros(2)
        for i in range(4):
            first += w[run_][i] * m[run_][i]
            second += w[run_][i] * (P[run_][0 if shared else i] + np.outer(m[run_][i], m[run_][i]))
        np.testing.assert_allclose(mean[run_], first, atol=1e-14)
        np.testing.assert_allclose(cov[run_], second - np.outer(first, first), atol=1e-13)


def test_moments_without_the_covariances_are_found_out(monkeypatch):
    """Shows that the comparison with the Kalman filter can fail: moments of the means alone."""
    monkeypatch.setattr(
        pfedu.filters.kalman_bank, "mixture_moments", lambda bank, log_w: weighted_moments(bank[0], log_w)
    )
    model, y, exact = slow_walk()
    assert worst(run(model, y, 50, n_runs=SEEDS), exact)["cov"] > SEVERAL


@both
@pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
def test_missing_rows_among_the_others(kalman, policy):
    """Catches a missing row that is corrected or whose covariance does not grow: at the start, inside, at the end."""
    y = problem("linear_A", 12)[1][:10].copy()
    y[[4, 5, 9]] = NAN
    track = run(random_walk(), y, 50, kalman=kalman, policy=policy, n_runs=SEEDS)
    assert max(worst(track, kalman_filter(random_walk(), y)).values()) < SEVERAL
    assert (track.log_likelihood_increments[:, [0, 4, 5, 9]] == 0).all()


@both
def test_several_records_at_once(kalman):
    """Catches runs that see each other's measurements or covariances: one record misses rows that the other has."""
    model = random_walk(q=0.1, r=1.0, p0=5.0)
    y = model.simulate(8, np.random.default_rng(9), n_runs=2)[1]
    y[0, 3], y[1, 6:] = NAN, NAN
    track = run(model, y, 100, kalman=kalman, policy=ratio(0.5), n_runs=SEEDS)
    assert track.mean.shape == (SEEDS, 2, 9, 1)
    assert max(worst(track, kalman_filter(model, y)).values()) < SEVERAL


def test_used_twice_a_missing_row_is_predicted_with_noise():
    """Catches particles that stand still over a gap: without a measurement the cloud widens by q each step."""
    model, y = random_walk(q=2.0, p0=1.0), np.array([[NAN], [NAN], [NAN]])
    track = run(model, y, 1000, use_twice=True, n_runs=50)
    var = track.cov[..., 0, 0].mean(axis=0)
    np.testing.assert_allclose(var, [1.0, 3.0, 5.0], rtol=4 * np.sqrt(2 / 50_000))


def test_the_same_seed_gives_the_same_bits():
    """Catches randomness from anywhere but the generator."""
    model, y, _ = problem("growth_A", 12)
    first, again = (run(model, y, 50, seed=4, keep=True) for _ in range(2))
    np.testing.assert_array_equal(first.particles, again.particles)
    assert first.particles.shape == (13, 50, 1)


def test_noise_inside_the_motion_needs_tangents():
    """Catches Q added to the state where it is not: sigma points of the state alone do not know how noise enters."""
    with pytest.raises(ValueError, match="the noise of FallingBody is not simply added: use kalman='ekf'"):
        run(falling_body(), [1e5], 10, kalman="ukf")
    assert run(falling_body(), [1e5, 1e5], 10).mean.shape == (2, 3)


def test_a_misspelt_filter_is_an_error():
    """Catches a name that falls back to a default."""
    with pytest.raises(ValueError, match="kalman must be one of ekf, ukf, got 'unscented'"):
        run(random_walk(), [1.0], 10, kalman="unscented")


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (stochastic_volatility(), "AdditiveProcess has no h, which a bank of Kalman filters needs"),
        (pfedu.models.jump_markov(), "JumpMarkov has no f, which a bank of Kalman filters needs"),
    ],
)
def test_a_model_that_lacks_a_piece_is_an_error(model, message):
    """Catches 'object has no attribute'."""
    with pytest.raises(pfedu.MissingPieceError, match=message):
        run(model, np.ones((2, model.n_y)), 10)
