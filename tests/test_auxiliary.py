"""The auxiliary particle filter, whatever it looks ahead by.

What is compared with exact answers, and why without an allowance for bias, stands in ``exact.py``. Standard errors
exist only where the second-stage weights p(y | x) / p(y | mu) have a variance. For the random walk that looks ahead
by the mean they have one after a correction, and in a first step from N(0, p0) if 1/p0 + 1/(q + r/2) > 1/r: not for
the q = 10, r = 1, p0 = 5 of the reference record, where the likelihood estimate is unbiased and of infinite variance.
The filters are therefore tested with process noise that is small against the measurement noise, and the last tests
show what comes of more.
"""

import functools
import itertools

import numpy as np
import pytest
from exact import SEEDS, SEVERAL, THROWN, in_standard_errors, mean_square_deviation, problem, three_states, worst

import pfedu
from pfedu.gaussian import log_density
from pfedu.grid import grid_filter
from pfedu.kalman import kalman_filter
from pfedu.models import StateSpaceModel, growth, random_walk, stochastic_volatility
from pfedu.resampling import always, interval, never, ratio
from pfedu.weights import effective_sample_size

NAN = np.nan
POLICIES = {"always": always, "ratio": ratio(0.5)}
every_policy = pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
LOOKS = {"mean": "mean", "draw": "draw", "function": lambda k, x: 0.8 * x, "exact": "exact"}
every_look = pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
GAPS = [0, 4, 5, 12]  # rows that are missing: at the start, twice inside, at the end


def run(model, y, n, seed=1, look="mean", **options):
    return pfedu.auxiliary_filter(model, y, n, rng=np.random.default_rng(seed), look_ahead=look, **options)


def blind(model, y, n, seed=1, **options):
    return pfedu.bootstrap_filter(model, y, n, rng=np.random.default_rng(seed), **options)


@functools.cache
def mild(name):
    """Model, record of 12 steps with gaps, exact track, and a point to look ahead to that is not quite the mean."""
    walk, bent = random_walk(q=0.3, p0=1.0), growth(q=1.0, r=10.0)
    model, seed, off = {
        "walk": (walk, 1, LOOKS["function"]),
        "three states, one measured": (three_states(1, 0.02), 3, LOOKS["function"]),
        "three states, two measured": (three_states(2, 0.02), 3, LOOKS["function"]),
        "growth": (bent, 4, lambda k, x: bent.f(k, x) + 0.5),
    }[name]
    y = model.simulate(12, np.random.default_rng(seed))[1]
    y[GAPS] = NAN
    exact = grid_filter(model, y, np.linspace(-40, 40, 1601)) if name == "growth" else kalman_filter(model, y)
    return model, y, exact, off


@every_policy
@pytest.mark.parametrize(
    ("name", "look"),
    [
        *itertools.product(["walk", "three states, one measured", "three states, two measured"], LOOKS),
        *itertools.product(["growth"], ["mean", "draw", "function"]),  # its measurement is not linear
    ],
)
def test_the_exact_answer_with_missing_rows_among_the_others(name, look, policy):
    """Catches second-stage weights forgotten or of the wrong ancestor, and a look at a measurement that is missing."""
    model, y, exact, off = mild(name)
    track = run(model, y, 500, look=off if look == "function" else look, policy=policy, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL
    assert (track.log_likelihood_increments[:, GAPS] == 0).all()


@every_policy
@pytest.mark.parametrize("look", ["mean", "draw", "exact"])
def test_the_exact_answer_over_the_ratio_record(look, policy):
    """Catches a look ahead that a pole throws off: 50 steps against the grid."""
    model, y, exact = problem("ratio_A")
    track = run(model, y, 500, seed=2, look=look, policy=policy, n_runs=SEEDS)
    assert max(worst(track, exact, THROWN["ratio_A"]).values()) < SEVERAL


@every_policy
@every_look
def test_the_likelihood_estimate_is_unbiased(look, policy):
    """Catches increments that lack the first stage or count it twice: 5 steps, 100 particles, 4000 runs."""
    model, y, _, _ = mild("walk")
    y = y[:6].copy()
    y[4] = 0.7
    track = run(model, y, 100, seed=3, look=look, policy=policy, n_runs=4000)
    assert in_standard_errors(np.exp(track.log_likelihood - kalman_filter(model, y).log_likelihood) - 1) < 4


@every_look
@pytest.mark.parametrize("n_particles", [1, 2, 7])
def test_the_likelihood_estimate_is_unbiased_for_very_few_particles(n_particles, look):
    """Catches what only holds for large N; a short record with a mild measurement and a missing one."""
    model, y = random_walk(q=0.5, r=4.0, p0=1.0), np.array([[0.5], [-1.0], [NAN], [1.5]])
    track = run(model, y, n_particles, seed=4, look=look, n_runs=20_000)
    assert in_standard_errors(np.exp(track.log_likelihood - kalman_filter(model, y).log_likelihood) - 1) < 4


def N(y, variance):
    """Gaussian density of y about zero."""
    return np.exp(-0.5 * y * y / variance) / np.sqrt(2 * np.pi * variance)


def tilted(y, p0, v):
    """Mean of exp((y - x)^2 / 2v) over x from N(0, p0), infinite unless p0 < v."""
    return np.exp(y * y / (2 * (v - p0))) / np.sqrt(1 - p0 / v) if p0 < v else np.inf


def second_moment(look, y, q, r, p0, n):
    """E[Zhat^2] of one step from N(0, p0) with independent ancestors, exactly, for n particles.

    Zhat = A B, A the mean of eta over the particles and B that of p(y | x_1)/eta over the moved ancestors. Given the
    particles, E[B] A is the mean of b = p(y | x_0), and E[B^2] A^2 = (1/n) A mean(c) + (1 - 1/n) mean(b)^2 with
    c = E[p(y | x_1)^2 | x_0] / eta: means over x_0 of products of Gaussian densities.
    """
    if look == "exact":  # B = 1
        return N(y, p0 + (q + r) / 2) / np.sqrt(4 * np.pi * (q + r)) / n + (1 - 1 / n) * N(y, p0 + q + r) ** 2
    square = 1 / np.sqrt(4 * np.pi * r)  # p(y | x)^2 is this times N(y; x, r/2)
    eta_c = square * N(y, p0 + q + r / 2)
    b_squared = N(y, p0 + (q + r) / 2) / np.sqrt(4 * np.pi * (q + r))
    # 1/eta is exp((y - mu)^2 / 2 r); over a draw mu from N(x_0, q) it becomes exp((y - x_0)^2 / 2 (r - q))
    v, factor, eta = r, 1.0, N(y, p0 + r)
    if look == "draw":
        v, factor, eta = r - q, 1 / np.sqrt(1 - q / r), N(y, p0 + q + r)
    narrow, wide = 1 / (q + r / 2), 1 / v  # N(y; x_0, q + r/2) exp((y - x_0)^2 / 2 v): another Gaussian, or none
    c = factor * square * np.sqrt(2 * np.pi * r) * np.sqrt(narrow / (2 * np.pi))
    if narrow > wide:
        c *= np.sqrt(2 * np.pi / (narrow - wide)) * N(y, p0 + 1 / (narrow - wide))
    else:
        c *= tilted(y, p0, 1 / (wide - narrow))
    return (eta_c / n + (1 - 1 / n) * eta * c) / n + (1 - 1 / n) * (b_squared / n + (1 - 1 / n) * N(y, p0 + q + r) ** 2)


@pytest.mark.parametrize(("look", "q"), [*itertools.product(["mean", "exact"], [0.1, 0.3, 0.6]), ("draw", 0.1)])
def test_the_variance_of_one_step_is_known(look, q):
    """Catches weights that are right on average only: E[Zhat^2] of one step in closed form, 20 000 runs, N = 20.

    For q = 0.6 p(y | x)^2 is flatter than eta once it has moved, so that weights grow towards both ends. The fourth
    moment, without which the second has no standard error, is finite here; for a draw only where q is small.
    """
    r, p0, y, n = 1.0, 0.5, 1.5, 20
    model = random_walk(q=q, r=r, p0=p0)
    track = run(model, [NAN, y], n, seed=5, look=look, resampling="multinomial", n_runs=20_000)
    assert in_standard_errors(np.exp(2 * track.log_likelihood) - second_moment(look, y, q, r, p0, n)) < 4


def test_two_particles_by_hand():
    """Catches a first stage without eta, a second without it, and eta of the particle instead of the ancestor.

    Particles at 0 and 1 both move right by one; the look ahead takes them to stay. Likelihood 1 where y is met,
    1/2 one off, 1/4 two off. For y = 1 eta is (1/2, 1), so that ancestors are picked with 1/3 and 2/3. Picked once
    each they weigh 1/2 (3/4) (2, 1), stand at 1 and 2, and are multiplied by (1, 1/2): 3/4 and 3/16.
    """
    seen = []

    def pick(weights, rng, size=None):
        seen.append(weights)
        return np.array([0, 1])

    model = StateSpaceModel(
        sample_initial=lambda n, rng: np.arange(2.0)[:, None],
        propagate=lambda k, x, rng: x + 1,
        log_likelihood=lambda k, y, x: np.log(0.5) * np.abs(y - x)[..., 0],
        f=lambda k, x: x,
    )
    track = run(model, [NAN, 1.0], 2, resampling=pick, keep=True)
    np.testing.assert_allclose(seen[0], [1 / 3, 2 / 3], rtol=1e-14)
    assert np.exp(track.log_likelihood_increments[1]) == pytest.approx(15 / 16, rel=1e-14)
    np.testing.assert_allclose(np.exp(track.log_weights[1]), [0.8, 0.2], rtol=1e-14)
    assert track.mean[1, 0] == pytest.approx(0.8 * 1 + 0.2 * 2, rel=1e-14)


@pytest.mark.parametrize("look", ["mean", "draw", "function"])
def test_without_resampling_it_is_the_bootstrap_filter(look):
    """Catches a look ahead that acts without resampling, or shifts the noise that moves particles: the same bits."""
    model, y, _, _ = mild("walk")
    ahead, plain = run(model, y, 50, seed=6, look=LOOKS[look], policy=never), blind(model, y, 50, seed=6, policy=never)
    for field in ("mean", "cov", "log_likelihood_increments", "n_eff"):
        np.testing.assert_array_equal(getattr(ahead, field), getattr(plain, field))


def test_a_look_ahead_that_says_nothing_is_the_bootstrap_filter():
    """Catches eta that does not cancel: the same point for all particles changes nothing but roundings."""
    model = random_walk(q=0.3)
    y = model.simulate(12, np.random.default_rng(7))[1]
    ahead = run(model, y, 50, seed=7, look=lambda k, x: np.zeros_like(x), policy=interval(2))
    plain = blind(model, y, 50, seed=7, policy=interval(2))
    np.testing.assert_array_equal(ahead.resampled, plain.resampled)
    np.testing.assert_allclose(ahead.log_likelihood_increments, plain.log_likelihood_increments, rtol=1e-9)
    np.testing.assert_allclose(ahead.mean, plain.mean, rtol=1e-9)


@pytest.mark.parametrize("name", ["walk", "three states, two measured", "ratio_A"])
def test_fully_adapted_weights_are_equal(name):
    """Catches a first stage that is not quite p(y_k | x_{k-1}): after always resampling all weights are 1/N.

    What is multiplied and divided again leaves roundings of a double, relative to the logarithms that are added.
    """
    model, y, _ = problem(name) if name == "ratio_A" else mild(name)[:3]
    track = run(model, y, 100, seed=8, look="exact", n_runs=5, keep=True)
    H = model.H
    evidence = log_density(y[1:, None], model.f(1, track.particles[:, :-1]) @ H.T, H @ model.Q @ H.T + model.R)
    scale = np.nanmax(np.abs(evidence).max(axis=(0, 2)))
    assert np.abs(track.log_weights + np.log(100)).max() < 8 * np.finfo(float).eps * max(scale, np.log(100))
    np.testing.assert_allclose(track.n_eff, 100, rtol=1e-12)


def test_the_policy_is_asked_with_the_weights_that_look_ahead():
    """Catches N_eff of weights that have not seen the next measurement, and one that looks past the end."""
    calls = []

    def policy(n_eff, n, count):
        calls.append((float(n_eff), n, int(count)))
        return n_eff < 0

    model, y = random_walk(q=0.3), np.array([[NAN], [1.0], [0.5]])
    track = run(model, y, 30, seed=9, policy=policy, keep=True)
    ahead = log_density(y[1:, None], track.particles[:-1], model.R)  # f of the random walk is x itself
    wanted = [*effective_sample_size(track.log_weights[:-1] + ahead), track.n_eff[-1]]
    np.testing.assert_allclose([n_eff for n_eff, _, _ in calls], wanted, rtol=1e-12)
    assert [call[1:] for call in calls] == [(30, 1), (30, 2), (30, 3)]


def test_resampling_goes_before_the_step_that_needs_it():
    """Catches a missing row at which nothing is resampled although the next one is measured, and the reverse."""
    track = run(random_walk(), [NAN, NAN, 1.0, NAN, NAN, 2.0, NAN], 10)
    assert track.resampled.tolist() == [False, True, True, False, True, True, False]


def test_an_interval_counts_from_the_first_occasion():
    """Catches a filter that resamples before anything was measured because 0 is a multiple of 2.

    Occasions are the steps next to a measurement: here those of times 1 to 4, and every second one is taken.
    """
    track = run(random_walk(), [NAN, NAN, 1.0, 2.0, 3.0], 10, policy=interval(2))
    assert track.resampled.tolist() == [False, False, True, False, True]
    batch = run(random_walk(), [[[NAN], [1.0], [NAN], [NAN], [2.0]], [[1.0], [NAN], [2.0], [3.0], [NAN]]], 10,
                policy=interval(2))  # fmt: skip
    assert batch.resampled.tolist() == [[False, True, False, False, True], [False, True, False, True, False]]


def boxed():
    """A state near 0 that takes steps of 3, measured to within 1: the mean of a step from 0 rules 3 out."""
    return StateSpaceModel(
        sample_initial=lambda n, rng: 0.1 * rng.standard_normal((n, 1)),
        propagate=lambda k, x, rng: x + 3.0 * rng.standard_normal(x.shape),
        log_likelihood=lambda k, y, x: np.where(np.abs(y - x) < 1, 0.0, -np.inf)[..., 0],
        f=lambda k, x: x,
    )


@pytest.mark.parametrize("policy", [never, ratio(0.0), interval(3)])
def test_a_look_ahead_that_sees_nothing_does_no_harm_where_nothing_is_resampled(policy):
    """Catches an error about weights that nobody asked for: the particles do get to the measurement, as in SIR."""
    ahead, plain = (f(boxed(), [0.0, 3.0], 1000, seed=3, policy=policy) for f in (run, blind))
    assert abs(ahead.mean[1, 0] - 3.0) < 1.0
    np.testing.assert_array_equal(ahead.mean, plain.mean)
    np.testing.assert_array_equal(ahead.log_likelihood_increments, plain.log_likelihood_increments)


def test_a_look_ahead_that_sees_nothing_is_an_error_where_resampling_is_due():
    """Catches NaN weights, and advice (more particles) that does not help; a run beside it is the one that is named."""
    with pytest.raises(pfedu.ZeroLikelihoodError, match=r"no particle's look-ahead point .* measurement of step 1, .*"
                       r"other points, or use the bootstrap"):  # fmt: skip
        run(boxed(), [0.0, 3.0], 1000)
    with pytest.raises(pfedu.ZeroLikelihoodError, match=r"step 1, run \[1\]: no particle's look-ahead point"):
        run(boxed(), [[[0.0], [0.0]], [[0.0], [3.0]]], 1000)


def test_a_run_that_sees_nothing_leaves_the_others_alone():
    """Catches one run's empty look ahead in the weights of another that resamples."""

    def policy(n_eff, n, count):
        return np.broadcast_to([True, False], np.shape(n_eff))

    track = run(boxed(), [[[0.0], [0.0]], [[0.0], [3.0]]], 1000, policy=policy)
    assert track.resampled.tolist() == [[True, True], [False, False]]
    np.testing.assert_allclose(track.mean[:, 1, 0], [0.0, 3.0], atol=1.0)
    assert np.isfinite(track.log_likelihood).all()


@every_look
def test_several_records_at_once(look):
    """Catches runs that see each other's measurements, now or ahead: each misses a row that the other has."""
    model = random_walk(q=0.3, p0=1.0)
    y = model.simulate(8, np.random.default_rng(10), n_runs=2)[1]
    y[0, 3], y[1, 0], y[1, 6:] = NAN, NAN, NAN
    track = run(model, y, 500, seed=10, look=look, n_runs=SEEDS)
    assert track.mean.shape == (SEEDS, 2, 9, 1) and track.log_likelihood.shape == (SEEDS, 2)
    assert max(worst(track, kalman_filter(model, y)).values()) < SEVERAL


@pytest.mark.parametrize("look", ["draw", "exact"])
def test_a_batch_is_a_loop_over_seeds_in_distribution(look):
    """Catches runs of a batch that share draws: the scatter over a batch must be that over seeds.

    Log variances of 300 nearly normal values differ by sqrt(4/299) in one standard error, means by hypot.
    """
    model, y, _, _ = mild("walk")
    batch = run(model, y, 200, seed=11, look=look, n_runs=300).log_likelihood
    seeds = np.array([run(model, y, 200, seed=1000 + i, look=look).log_likelihood for i in range(300)])
    assert abs(batch.mean() - seeds.mean()) < 4 * np.hypot(batch.std(), seeds.std()) / np.sqrt(300)
    assert abs(np.log(batch.var() / seeds.var())) < 4 * np.sqrt(4 / 299)


def test_the_same_seed_gives_the_same_bits():
    """Catches randomness from anywhere but the generator."""
    model, y, _, _ = mild("growth")
    one, two = (run(model, y, 50, seed=12, look="draw", keep=True) for _ in range(2))
    np.testing.assert_array_equal(one.particles, two.particles)
    np.testing.assert_array_equal(one.log_weights, two.log_weights)


@functools.cache
def volatile():
    """Stochastic volatility: model, record of 50 returns, exact track by the grid."""
    model = stochastic_volatility()
    y = model.simulate(50, np.random.default_rng(6))[1]
    return model, y, grid_filter(model, y, np.linspace(-8, 6, 561))


@pytest.mark.parametrize("look", [None, "mean", "draw"])
def test_stochastic_volatility_against_the_grid(look):
    """Catches a measurement that is not the state plus noise: bootstrap and auxiliary filter meet the grid."""
    model, y, exact = volatile()
    track = run(model, y, 500, seed=13, look=look, n_runs=SEEDS) if look else blind(model, y, 500, 13, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


def test_stochastic_volatility_by_two_filters():
    """Catches likelihoods that only one of the filters believes: what chapter 13 compares parameters by.

    log Zhat plus half its variance is free of bias to first order, for either filter.
    """
    model, y, exact = volatile()
    for track in (run(model, y, 2000, seed=14, n_runs=100), blind(model, y, 2000, seed=14, n_runs=100)):
        error = track.log_likelihood - exact.log_likelihood
        v = error.var(ddof=1)
        assert abs(error.mean() + v / 2) < 4 * np.sqrt(v / 100 + v**2 / (2 * 99))


def shares(model, exact, y):
    """N_eff / N of bootstrap and auxiliary filter (by the mean) of the random walk for infinitely many particles.

    Resampled every step. With g = p(y | x_k), x_{k-1} from N(m, P) and d = y - m, N_eff/N is (E w)^2 / E w^2: for w = g
    under the prediction, and for w = g/eta under the posterior of time k-1 times eta.
    """
    q, r = model.Q.item(), model.R.item()
    d, P = (y[..., 1:, :] - exact.mean[..., :-1, :])[..., 0], exact.cov[..., :-1, 0, 0]  # (runs, T)
    z, square = N(d, P + q + r), 1 / np.sqrt(4 * np.pi * r)
    bend = 1 / (q + r / 2) - 1 / r  # g^2/eta, averaged over the move, is exp(-bend (y - x_{k-1})^2 / 2) times this:
    factor, room = square * np.sqrt(r / (q + r / 2)), np.maximum(1 + bend * P, 0)
    with np.errstate(divide="ignore", over="ignore"):  # no room: E w^2 is infinite
        mean = np.exp(-0.5 * bend * d * d / room) / np.sqrt(room)
    return z**2 / (square * N(d, P + q + r / 2)), z**2 / (N(d, P + r) * factor * mean)


@functools.cache
def study(q, n, n_records=120):
    """Records of 50 steps of the random walk, the first row missing: model, records, exact tracks, both filters."""
    model = random_walk(q=q)
    y = model.simulate(50, np.random.default_rng(15), n_records)[1]
    y[:, 0] = NAN
    return model, y, kalman_filter(model, y), blind(model, y, n, 16, policy=always), run(model, y, n, 17)


@pytest.mark.parametrize("q", [0.01, 0.1])
def test_the_effective_number_has_the_limit_that_theory_gives(q):
    """Catches second-stage weights of the wrong spread: N_eff on 120 records against Gaussian integrals.

    N_eff exceeds its limit by a share of 1/N or so; twice the figure for 2N less that for N is free of it. The first
    step is left out: it starts from a prior so wide that few particles meet the measurement.
    """
    model, y, exact, *few = study(q, 500)
    *_, plain, ahead = study(q, 1000)
    for one, two, limit in zip(few, (plain, ahead), shares(model, exact, y), strict=True):
        found = (2 * two.n_eff[:, 1:] / 1000 - one.n_eff[:, 1:] / 500 - limit)[:, 1:]
        assert in_standard_errors(found.mean(axis=-1)) < 4


@pytest.mark.parametrize(("q", "plain", "ahead"), [(0.01, 446, 495), (0.1, 397, 457), (1.0, 293, 261), (10.0, 143, 63)])
def test_the_effective_number_an_independent_program_found(q, plain, ahead):
    """Catches a gain where there is none: looking ahead helps for q = 0.01 and 0.1, and hurts for q = 1 and 10.

    N = 500, averages over records drawn from the model; the program's own uncertainty is taken to be ours. The
    reference record, with q = 10, is no average one: both figures are lower there.
    """
    *_, without, with_look = study(q, 500)
    for track, figure in ((without, plain), (with_look, ahead)):
        n_eff = track.n_eff[:, 1:].mean(axis=-1)
        assert abs(n_eff.mean() - figure) < 4 * np.sqrt(2) * n_eff.std(ddof=1) / np.sqrt(len(n_eff)) + 0.5
    gain = (with_look.n_eff - without.n_eff)[:, 1:].mean(axis=-1)
    assert (gain.mean() > 0) == (q < 0.5) and in_standard_errors(gain) > SEVERAL


def test_large_process_noise():
    """Shows what thin tails do, q = 10, r = 1: worse by a factor, and N_eff does not tell by how much.

    An independent program found the error to grow from 0.092 to 0.256, and 0.0428 for the fully adapted filter. N_eff
    is more than twice what infinitely many particles would have: it counts only weights that were drawn. And although
    the mean of Zhat/Z is one, nearly every run stays below a tenth.
    """
    model, y, exact, plain, ahead = study(10.0, 500)
    adapted = run(model, y, 500, 18, look="exact")
    for track, figure, rounding in ((plain, 0.092, 5e-4), (ahead, 0.256, 5e-4), (adapted, 0.0428, 5e-5)):
        rms = np.sqrt(mean_square_deviation(track, exact))
        assert abs(rms.mean() - figure) < 4 * np.sqrt(2) * rms.std(ddof=1) / np.sqrt(len(rms)) + rounding
    excess = ahead.n_eff[:, 2:] / 500 - 2 * shares(model, exact, y)[1][:, 1:]  # the first step has no limit above zero
    assert excess.mean() > 0 and in_standard_errors(excess.mean(axis=-1)) > SEVERAL
    assert (ahead.log_likelihood - exact.log_likelihood < np.log(0.1)).mean() > 0.9
    assert second_moment("mean", 0.0, 10.0, 1.0, 5.0, 500) == np.inf


def test_the_reference_record_with_large_process_noise():
    """Catches figures of simulated records taken for those of the reference record, q = 10.

    N_eff is lower than the averages 143 and 63, without and with a look ahead by the mean; the error of the fully
    adapted filter, 0.0428, is the same.
    """
    model, y, exact = problem("linear_A")
    plain, ahead = blind(model, y, 500, policy=always, n_runs=SEEDS), run(model, y, 500, n_runs=SEEDS)
    for track, average in ((plain, 143), (ahead, 63)):
        short = average - 0.5 - track.n_eff[:, 1:].mean(axis=-1)
        assert short.mean() > 0 and in_standard_errors(short) > SEVERAL
    rms = np.sqrt(mean_square_deviation(run(model, y, 500, 19, look="exact", n_runs=SEEDS), exact))
    assert abs(rms.mean() - 0.0428) < 4 * np.sqrt(2) * rms.std(ddof=1) / np.sqrt(SEEDS) + 5e-5


def test_an_outlier():
    """Catches a look ahead that comes too late: the measurement of step 20 is 6 deviations of its noise off.

    q = 0.1, r = 1, N = 500, 1000 records; an independent program found N_eff to rise from 18 to 100. The error of
    that step falls by more than a quarter.
    """
    model = random_walk(q=0.1)
    y = model.simulate(20, np.random.default_rng(20), 1000)[1]
    y[:, 0], y[:, 20] = NAN, y[:, 20] + 6.0
    exact = kalman_filter(model, y)
    plain, ahead = blind(model, y, 500, 21, policy=always), run(model, y, 500, 22)
    for track, figure in ((plain, 18), (ahead, 100)):
        n_eff = track.n_eff[:, 20]
        assert abs(n_eff.mean() - figure) < 4 * np.sqrt(2 / 1000) * n_eff.std(ddof=1) + 0.5
    squares = [(track.mean - exact.mean)[:, 20, 0] ** 2 for track in (plain, ahead)]
    gain = 0.75**2 * squares[0] - squares[1]
    assert gain.mean() > 0 and in_standard_errors(gain) > 4


def test_growth_with_large_process_noise_is_worse():
    """Catches a look ahead sold as an improvement: on the growth record it errs more than twice as much."""
    model, y, exact = problem("growth_A")
    plain, ahead = blind(model, y, 500, 23, policy=always, n_runs=100), run(model, y, 500, 24, n_runs=100)
    rms = [np.sqrt(mean_square_deviation(track, exact)) for track in (plain, ahead)]
    assert rms[1].mean() > 2 * rms[0].mean() and in_standard_errors(rms[1] - 2 * rms[0]) > SEVERAL


@pytest.mark.parametrize("look", ["median", None, 3.0])
def test_an_unknown_look_ahead_is_an_error(look):
    """Catches a misspelt name that falls back to a default."""
    with pytest.raises(ValueError, match=r"look_ahead must be 'mean', 'draw', 'exact' or a function .* got"):
        run(random_walk(), [0.0, 1.0], 5, look=look)


def test_a_missing_piece_is_named():
    """Catches "NoneType is not callable": the message tells model, piece and what asked for it."""
    bare = StateSpaceModel(lambda n, rng: np.zeros((n, 1)), lambda k, x, rng: x, lambda k, y, x: -np.abs(y - x)[..., 0])
    with pytest.raises(pfedu.MissingPieceError, match="StateSpaceModel has no f, which looking ahead by the mean"):
        run(bare, [0.0, 1.0], 5)
    with pytest.raises(pfedu.MissingPieceError, match="AdditiveGaussian has no H, which the fully adapted filter"):
        run(growth(), [0.0, 1.0], 5, look="exact")
    assert run(bare, [0.0, 1.0], 5, look="draw").mean.shape == (2, 1)


@pytest.mark.parametrize(
    ("look", "error", "message"),
    [
        (lambda k, x: x[..., :1, :], ValueError, r"step 1: looking ahead must give one value .* shape \(5,\), it gave"),
        (lambda k, x: x + NAN, ValueError, "step 1: .*log weight nan at index"),
        (lambda k, x: x + 1e200, pfedu.ZeroLikelihoodError, "step 1: no particle's look-ahead point can explain"),
    ],
    ids=["shape", "NaN", "far away"],
)
def test_a_look_ahead_that_is_no_weight_is_an_error(look, error, message):
    """Catches one point for all particles by broadcasting, NaN, and a look ahead that leaves no particle."""
    with np.errstate(over="ignore"), pytest.raises(error, match=message):
        run(random_walk(), [0.0, 1.0], 5, look=look)


def test_a_look_ahead_that_works_in_place_is_an_error():
    """Catches x += drift in a function of one's own: the particles themselves would move."""

    def look(k, x):
        x += 1.0
        return x

    with pytest.raises(ValueError, match="read-only"):
        run(random_walk(), [0.0, 1.0], 5, look=look)
