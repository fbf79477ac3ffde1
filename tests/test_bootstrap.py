"""The loop of all particle filters, and the bootstrap filter on it.

What is compared with exact answers, and why without an allowance for bias, stands in ``exact.py``.
"""

import numpy as np
import pytest
from exact import SEEDS, SEVERAL, in_standard_errors, mean_square_deviation, problem, worst
from records import measurements

import pfedu
from pfedu.filters import loop
from pfedu.gaussian import log_density
from pfedu.grid import grid_filter
from pfedu.kalman import kalman_filter
from pfedu.models import LinearGaussian, StateSpaceModel, random_walk
from pfedu.resampling import SCHEMES, always, interval, never, ratio
from pfedu.weights import ZeroLikelihoodError, effective_sample_size, normalize, weighted_cov, weighted_mean

NAN = np.nan
POLICIES = {"always": always, "ratio": ratio(0.25), "interval": interval(2)}
every_scheme = pytest.mark.parametrize("resampling", SCHEMES)


def run(model, y, n, seed=1, **options):
    return pfedu.bootstrap_filter(model, y, n, rng=np.random.default_rng(seed), **options)


@pytest.mark.parametrize("name", ["linear_A", "growth_A"])
def test_the_exact_answer_over_the_whole_record(name):
    """Catches any bias of mean, variance or likelihood: 200 seeds, 50 steps, weights partly carried."""
    model, y, exact = problem(name)
    track = run(model, y, 2000, policy=ratio(0.25), n_runs=SEEDS)
    assert 0.1 < track.resampled[:, 1:].mean() < 0.9  # both branches are taken
    assert max(worst(track, exact).values()) < SEVERAL


@every_scheme
@pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
@pytest.mark.parametrize("name", ["linear_A", "growth_A"])
def test_the_exact_answer_with_every_scheme_and_policy(name, policy, resampling):
    """Catches a scheme or a policy that bends the posterior: 12 steps, so that Zhat/Z has a small variance."""
    model, y, exact = problem(name, 12)
    track = run(model, y, 500, seed=2, policy=policy, resampling=resampling, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@pytest.mark.parametrize("name", ["linear_A", "growth_A"])
def test_the_log_likelihood_scatters_as_theory_says(name):
    """Catches increments whose noise and bias do not belong together, e.g. one averaged over runs.

    log Zhat - log Z tends to a normal of mean -v/2 and variance v (Berard, Del Moral and Doucet 2014), so the
    mean plus half the variance vanishes; its standard error is sqrt(v/n + v^2/(2 (n - 1))) for n runs.
    """
    model, y, exact = problem(name)
    error = run(model, y, 1000, seed=3, policy=always, n_runs=SEEDS).log_likelihood - exact.log_likelihood
    v = error.var(ddof=1)
    assert abs(error.mean() + v / 2) < 4 * np.sqrt(v / SEEDS + v**2 / (2 * (SEEDS - 1)))


def falling_rate(name, n, **options):
    """Exponent a of mean square deviation ~ N^-a between n and 4 n particles, and its standard error."""
    model, y, exact = problem(name)
    few, many = (
        mean_square_deviation(run(model, y, size, seed=size, n_runs=100, **options), exact) for size in (n, 4 * n)
    )
    cv = [m.std(ddof=1) / m.mean() / np.sqrt(len(m)) for m in (few, many)]  # relative standard errors
    return np.log(few.mean() / many.mean()) / np.log(4), np.hypot(*cv) / np.log(4)


@pytest.mark.parametrize("name", ["linear_A", "growth_A"])
def test_the_error_falls_as_one_over_root_n(name):
    """Catches every lasting bias: the mean square deviation of the ordinary estimate must fall as 1/N."""
    rate, se = falling_rate(name, 500, policy=ratio(0.25))
    assert abs(rate - 1) < 4 * se


loop_resample = loop.resample


def forgetful(x, log_w, due, pick, rng, ahead=None, w=None):
    """The fault of half the field's teaching code: weights are 1/N after a step, resampled or not."""
    x, log_w, ancestors = loop_resample(x, log_w, due, pick, rng, ahead, w)
    return x, np.full_like(log_w, -np.log(log_w.shape[-1])), ancestors


@pytest.mark.parametrize("name", ["linear_A", "growth_A"])
def test_a_filter_that_forgets_its_weights_is_found_out(name, monkeypatch):
    """Shows that the comparisons above can fail, each of them: bias in every quantity, and a rate of zero."""
    monkeypatch.setattr(loop, "resample", forgetful)
    model, y, exact = problem(name, 12)
    found = worst(run(model, y, 500, seed=2, policy=ratio(0.25), n_runs=SEEDS), exact)
    assert min(found.values()) > SEVERAL
    rate, se = falling_rate(name, 250, policy=ratio(0.25))
    assert rate < 1 - 4 * se


@every_scheme
@pytest.mark.parametrize("policy", [always, ratio(0.25)], ids=["always", "ratio"])
def test_the_likelihood_estimate_is_unbiased(policy, resampling):
    """Catches increments that ignore carried weights, a biased scheme, and log(mean) mixed up with mean(log).

    5 steps and 100 particles: Zhat/Z has a standard deviation of about a quarter, 4000 runs give +-0.4 %.
    """
    assert unbiasedness(policy, resampling) < 4


def test_the_likelihood_estimate_is_unbiased_without_resampling():
    """Catches weights that are not carried: without resampling the filter is plain importance sampling."""
    assert unbiasedness(never, "systematic") < 4


def unbiasedness(policy, resampling):
    """Distance of the mean of Zhat/Z from one, in standard errors."""
    model, y, exact = problem("linear_A", 5)
    track = run(model, y, 100, seed=4, policy=policy, resampling=resampling, n_runs=4000)
    return in_standard_errors(np.exp(track.log_likelihood - exact.log_likelihood) - 1)


def test_a_resampler_that_loses_the_remainder_is_found_out():
    """Shows that the test above can fail: whole copies, then the heaviest for all that is left (biased)."""

    def heaviest(weights, rng, size=None):
        n = weights.shape[-1]
        copies = np.floor(n * weights).astype(int)
        left = n - copies.sum(axis=-1, keepdims=True)
        copies += left * (np.arange(n) == weights.argmax(axis=-1)[..., None])
        return np.repeat(np.tile(np.arange(n), len(weights)), copies.ravel()).reshape(weights.shape)

    assert unbiasedness(always, heaviest) > 4


@pytest.mark.parametrize("n_particles", [1, 2, 7])
def test_the_likelihood_estimate_is_unbiased_for_very_few_particles(n_particles):
    """Catches what only holds for large N, e.g. 1/(N-1) for 1/N; a short record with a mild measurement."""
    model, y = random_walk(q=1.0, r=4.0, p0=1.0), np.array([[0.5], [-1.0], [NAN], [1.5]])
    track = run(model, y, n_particles, seed=5, n_runs=40_000)
    z = np.exp(track.log_likelihood - kalman_filter(model, y).log_likelihood) - 1
    assert in_standard_errors(z) < 4


def test_the_first_measurement_is_used_where_there_is_one():
    """Catches a filter that skips row 0: the prior must be corrected by y_0."""
    y = measurements("linear_A", with_y0=True)[:8]
    exact = kalman_filter(random_walk(), y)
    assert max(worst(run(random_walk(), y, 500, seed=6, n_runs=SEEDS), exact).values()) < SEVERAL


@pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
def test_missing_rows_among_the_others(policy):
    """Catches a missing row that is corrected, resampled or not propagated, at the start, inside and at the end."""
    y = measurements("linear_A")[:10]
    y[[4, 5, 9]] = NAN
    exact = kalman_filter(random_walk(), y)
    track = run(random_walk(), y, 500, seed=7, policy=policy, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL
    missing = [0, 4, 5, 9]
    # carried weights are normalised once more: N roundings at the most
    assert np.abs(track.log_likelihood_increments[:, missing]).max() <= 500 * np.finfo(float).eps
    assert not track.resampled[:, missing].any()


def test_several_dimensions_against_the_kalman_filter():
    """Catches a transposed F or covariance, and states that mix; the noise drives one state of two (singular Q)."""
    model = LinearGaussian(
        F=[[1.0, 0.5], [-0.1, 0.9]],
        H=[[1.0, 0.3]],
        Q=np.diag([0.0, 1.0]),
        R=1.0,
        m0=[1.0, -1.0],
        P0=[[2, 0.5], [0.5, 1]],
    )
    y = model.simulate(8, np.random.default_rng(8))[1]
    track = run(model, y, 500, seed=8, policy=ratio(0.5), n_runs=SEEDS)
    assert track.mean.shape == (SEEDS, 9, 2) and track.cov.shape == (SEEDS, 9, 2, 2)
    assert max(worst(track, kalman_filter(model, y)).values()) < SEVERAL


def test_several_records_at_once():
    """Catches runs that see each other's measurements: two records, one with a row that the other misses."""
    y = random_walk().simulate(8, np.random.default_rng(9), n_runs=2)[1]
    y[0, 3], y[1, 6:] = NAN, NAN
    track = run(random_walk(), y, 500, seed=9, policy=ratio(0.4), n_runs=SEEDS)
    assert track.mean.shape == (SEEDS, 2, 9, 1) and track.log_likelihood.shape == (SEEDS, 2)
    assert max(worst(track, kalman_filter(random_walk(), y)).values()) < SEVERAL
    assert not track.resampled[:, 0, 3].any() and not track.resampled[:, 1, 6:].any()
    assert np.abs(track.log_likelihood_increments[:, 1, 6:]).max() <= 500 * np.finfo(float).eps


def test_a_batch_is_a_loop_over_seeds_in_distribution():
    """Catches runs of a batch that share draws: the scatter over a batch must be that over seeds.

    Log variances of 400 nearly normal values differ by sqrt(4/399) in one standard error, means by hypot.
    """
    model, y, _ = problem("linear_A", 12)
    batch = run(model, y, 200, seed=10, n_runs=400).log_likelihood
    seeds = np.array([run(model, y, 200, seed=1000 + i).log_likelihood for i in range(400)])
    assert abs(batch.mean() - seeds.mean()) < 4 * np.hypot(batch.std(), seeds.std()) / np.sqrt(400)
    assert abs(np.log(batch.var() / seeds.var())) < 4 * np.sqrt(4 / 399)


# A system small enough for the hand: five particles at -2..2 that move right by one a step. A particle that
# meets the measurement has likelihood 1, one that misses it by one 1/2, all others 0.


def likelihood_by_hand(k, y, x):
    with np.errstate(divide="ignore"):
        return np.log(np.clip(1 - np.abs(y - x)[..., 0] / 2, 0, None) * (np.abs(y - x)[..., 0] < 1.5))


def march(**changes):
    pieces = dict(
        sample_initial=lambda n, rng: np.resize(np.arange(-2.0, 3.0), n)[:, None],
        propagate=lambda k, x, rng: x + 1,
        log_likelihood=likelihood_by_hand,
    )
    return StateSpaceModel(**(pieces | changes))


def check(track, mean, var, likelihoods, n_eff):
    np.testing.assert_allclose(track.mean[:, 0], mean, rtol=0, atol=1e-14)
    np.testing.assert_allclose(track.cov[:, 0, 0], var, rtol=0, atol=1e-14)
    np.testing.assert_allclose(track.log_likelihood_increments, np.log(likelihoods), rtol=0, atol=1e-14)
    np.testing.assert_allclose(track.n_eff, n_eff, rtol=1e-14)


def test_five_particles_by_hand_without_resampling():
    """Catches every slip of carrying weights: (0, 1/4, 1/2, 1/4, 0) times (0, 1/2, 1, 1/2, 0) sums to 3/4."""
    track = run(march(), [0.0, 1.0], 5, policy=never)
    check(track, mean=[0, 1], var=[1 / 2, 1 / 3], likelihoods=[2 / 5, 3 / 4], n_eff=[8 / 3, 2])
    assert not track.resampled.any()


def test_five_particles_by_hand_with_resampling():
    """Catches weights not reset after resampling, an estimate taken after it, and ancestors counted from one.

    Ancestors (1, 2, 2, 3, 3) stand at -1, 0, 0, 1, 1, move to 0, 1, 1, 2, 2 and weigh 1/2, 1, 1, 1/2, 1/2:
    3.5 / 5 in all, mean 4/3.5, second moment (2 + 4)/3.5 ... each taken before the next resampling.
    """
    seen = []

    def pick(weights, rng, size=None):
        seen.append(weights)
        return np.array([1, 2, 2, 3, 3])

    track = run(march(), [0.0, 1.0], 5, policy=always, resampling=pick, keep=True)
    w = np.array([1, 2, 2, 1, 1]) / 7
    x = np.array([0, 1, 1, 2, 2])
    mean = w @ x
    check(track, [0, mean], [1 / 2, w @ x**2 - mean**2], [2 / 5, 7 / 10], [8 / 3, 49 / 11])
    np.testing.assert_allclose(seen, [[0, 0.25, 0.5, 0.25, 0], w], atol=1e-15)
    assert track.resampled.all()
    assert track.particles[:, :, 0].tolist() == [[-2, -1, 0, 1, 2], x.tolist()]
    assert track.ancestors.tolist() == [[0, 1, 2, 3, 4], [1, 2, 2, 3, 3]]
    np.testing.assert_allclose(np.exp(track.log_weights), seen, atol=1e-15)


@pytest.mark.parametrize("policy", [always, never], ids=["resampled", "carried"])
def test_weights_after_a_step_are_reset_or_carried(policy):
    """Catches the two confused: a missing row shows the weights as the step before left them."""
    track = run(march(), [0.0, NAN], 5, policy=policy, keep=True)
    want = np.full(5, 0.2) if policy is always else [0, 0.25, 0.5, 0.25, 0]
    np.testing.assert_allclose(np.exp(track.log_weights[1]), want, atol=1e-15)
    assert track.log_likelihood_increments[1] == pytest.approx(0, abs=5 * np.finfo(float).eps)
    assert track.n_eff[1] == pytest.approx(5 if policy is always else 8 / 3)


def test_runs_are_resampled_each_by_its_own_weights():
    """Catches one decision for all runs: only the run with poor weights may lose its particles."""
    y = np.array([[[0.0], [NAN]], [[1.0], [NAN]]])  # at the edge (y = 1) weights are (0, 0, 1/4, 1/2, 1/4)
    track = run(march(), np.concatenate([y, [[[2.0], [NAN]]]]), 5, policy=ratio(0.5), keep=True)
    assert track.n_eff[:, 0] == pytest.approx([8 / 3, 8 / 3, 9 / 5])
    assert track.resampled[:, 0].tolist() == [False, False, True]
    np.testing.assert_allclose(np.exp(track.log_weights[:2, 1]), np.exp(track.log_weights[:2, 0]), atol=1e-15)
    np.testing.assert_allclose(np.exp(track.log_weights[2, 1]), 0.2, atol=1e-15)
    assert (track.ancestors[:2, 1] == np.arange(5)).all() and (track.ancestors[2, 1] >= 3).all()


def test_resample_leaves_the_other_runs_alone():
    """Catches np.where with its branches swapped, and particles taken along the wrong axis."""
    x = np.arange(12.0).reshape(2, 3, 2)
    log_w = np.log([[0.5, 0.25, 0.25], [1.0, 1e-9, 1e-9]])
    new, log_w_new, ancestors = loop.resample(
        x, log_w, np.array([False, True]), lambda w, rng: np.array([[2, 2, 2], [0, 0, 1]]), None
    )
    assert ancestors.tolist() == [[0, 1, 2], [0, 0, 1]]
    assert new[0].tolist() == x[0].tolist() and new[1].tolist() == x[1, [0, 0, 1]].tolist()
    np.testing.assert_allclose(log_w_new, [log_w[0], np.full(3, -np.log(3))])


def test_the_track_is_that_of_its_particles():
    """Catches estimates after resampling, or of other particles than those kept: mean, covariance, N_eff."""
    model, y, _ = problem("growth_A", 12)
    track = run(model, y, 50, policy=ratio(0.5), n_runs=3, keep=True)
    assert track.particles.shape == (3, 13, 50, 1) and track.log_weights.shape == (3, 13, 50)
    np.testing.assert_allclose(track.mean, weighted_mean(track.particles, track.log_weights), rtol=1e-12)
    np.testing.assert_allclose(track.cov, weighted_cov(track.particles, track.log_weights), rtol=1e-12)
    np.testing.assert_allclose(track.n_eff, effective_sample_size(track.log_weights), rtol=1e-12)
    np.testing.assert_array_equal(track.resampled[:, 1:], track.n_eff[:, 1:] < 25)


def test_the_track_keeps_its_particles_only_on_demand():
    """Catches a gigabyte kept for nothing."""
    track = run(random_walk(), [1.0, 2.0], 10)
    assert track.particles is track.log_weights is track.ancestors is track.grid is None


def moves(model, track):
    """What propagation added to each particle of steps 1..T, by way of its ancestor: (T, N, n_x)."""
    parents = np.take_along_axis(track.particles[:-1], track.ancestors[1:, :, None], axis=1)
    return np.array([track.particles[k] - model.f(k, parents[k - 1]) for k in range(1, len(track.mean))])


def test_propagation_noise_does_not_depend_on_scheme_or_policy():
    """Common random numbers: catches a slider for the scheme that also changes every particle's noise.

    Up to the first resampling, after y_1, the particles themselves are the same bits.
    """
    model, y, _ = problem("growth_A", 12)
    options = [dict(policy=p, resampling=s, keep=True) for p in (always, never, ratio(0.5)) for s in SCHEMES]
    first, *others = (run(model, y, 40, seed=11, **o) for o in options)
    for other in others:
        np.testing.assert_array_equal(other.particles[:2], first.particles[:2])
        np.testing.assert_array_equal(other.log_weights[:2], first.log_weights[:2])
        # particles stay within +-60, so a difference of two is rounded at 60 eps or so
        np.testing.assert_allclose(moves(model, other), moves(model, first), rtol=0, atol=1e-12)
    assert not np.array_equal(others[-1].particles[2], first.particles[2])


def test_ancestors_lead_back_to_the_parents():
    """Catches a family tree one step off: without process noise a particle stands where its ancestor stood."""
    model = random_walk(q=0.0)
    track = run(model, measurements("linear_A", with_y0=True)[:6], 30, policy=ratio(0.9), keep=True)
    assert track.resampled.any() and not track.resampled.all()
    assert (moves(model, track) == 0).all()
    assert (track.ancestors[0] == np.arange(30)).all()


def test_the_same_seed_gives_the_same_bits():
    """Catches randomness from anywhere but the generator, and a generator that repeats itself."""
    model, y, _ = problem("growth_A", 12)
    rng = np.random.default_rng(12)
    first, next_one = (pfedu.bootstrap_filter(model, y, 100, rng=rng, keep=True) for _ in range(2))
    again = run(model, y, 100, seed=12, keep=True)
    for field in ("mean", "cov", "log_likelihood_increments", "n_eff", "resampled", "particles", "ancestors"):
        np.testing.assert_array_equal(getattr(first, field), getattr(again, field))
    assert not np.array_equal(first.particles[0], next_one.particles[0])


def test_interval_counts_corrections_not_steps():
    """Catches a missing row that counts as a correction: every second measurement, wherever it stands."""
    track = run(random_walk(), [1.0, NAN, 1.0, 1.0, NAN, NAN, 1.0], 10, policy=interval(2))
    assert track.resampled.tolist() == [False, False, True, False, False, False, True]


def test_a_policy_of_ones_own_sees_what_it_needs():
    """Catches arguments in another order: N_eff of each run, N, and how many corrections there were."""
    calls = []

    def policy(n_eff, n, count):
        calls.append((np.shape(n_eff), n, np.asarray(count).tolist()))
        return n_eff < 0

    y = np.array([[1.0, NAN], [1.0, 1.0]])[..., None]
    run(random_walk(), y, 10, policy=policy)
    assert calls == [((2,), 10, [1, 1]), ((2,), 10, [1, 2])]


def test_a_measurement_a_thousand_standard_deviations_away():
    """Catches weights that are not kept as logarithms: exp(-500 000) is zero, the posterior is not."""
    track = run(random_walk(), [1000.0], 100, keep=True)
    x, log_w = track.particles[0], track.log_weights[0]
    assert normalize(-0.5 * (1000.0 - x[:, 0]) ** 2)[0] == pytest.approx(log_w, abs=1e-8)
    assert track.mean[0, 0] == pytest.approx(x.max(), abs=0.1 * np.ptp(x))
    assert -5.1e5 < track.log_likelihood < -4.9e5


def test_a_filter_is_a_proposal_and_a_weight():
    """Catches a loop that only serves the bootstrap filter: the optimal proposal of the linear model, by hand.

    x ~ N(x + K (y - x), K r) with K = q/(q + r), weighed by N(y; x, q + r): unbiased, and with better weights.
    """
    model, y, exact = problem("linear_A", 12)
    q, r = 10.0, 1.0
    K = q / (q + r)

    def propose(k, y, x, rng):
        log_g = log_density(y, x, q + r)
        return x + K * (y - x) + np.sqrt(K * r) * rng.standard_normal(x.shape), log_g

    options = dict(resampling="systematic", policy=ratio(0.5), n_runs=SEEDS)
    track = loop.particle_filter(propose, model, y, 500, rng=np.random.default_rng(13), **options)
    assert max(worst(track, exact).values()) < SEVERAL
    blind = run(model, y, 500, seed=13, policy=ratio(0.5), n_runs=SEEDS)
    assert np.mean(mean_square_deviation(track, exact)) < np.mean(mean_square_deviation(blind, exact))


def test_a_grid_of_two_tracks():
    """Catches fields that do not line up: grid, Kalman and particle tracks are subtracted without ado."""
    y = measurements("linear_A")[:5]
    grid = grid_filter(random_walk(), y, np.linspace(-40, 40, 161))
    tracks = [kalman_filter(random_walk(), y), grid, run(random_walk(), y, 10)]
    assert {t.mean.shape for t in tracks} == {(5, 1)} and {t.cov.shape for t in tracks} == {(5, 1, 1)}
    assert {t.log_likelihood_increments.shape for t in tracks} == {(5,)}
    assert {np.shape(t.log_likelihood) for t in tracks} == {()}


@pytest.mark.parametrize("n", [0, -5, 2.5, np.inf, NAN])
def test_a_number_of_particles_that_is_none_is_an_error(n):
    """Catches a mean over nothing."""
    with pytest.raises(ValueError, match="n_particles must be a whole number of at least 1"):
        run(random_walk(), [1.0], n)


def test_a_whole_number_of_particles_may_be_a_float():
    """Catches 1e3 let through the check and stumbled over later."""
    assert run(random_walk(), [1.0], 1e1, keep=True).particles.shape == (1, 10, 1)


@pytest.mark.parametrize("rng", [7, None, np.random])
def test_rng_must_be_a_generator(rng):
    """Catches a seed or the global state where a generator belongs."""
    with pytest.raises(TypeError, match=r"rng must be a numpy\.random\.Generator, e\.g\. numpy\.random\.default_rng"):
        pfedu.bootstrap_filter(random_walk(), [1.0], 10, rng=rng)


def test_an_unknown_scheme_is_an_error():
    """Catches a misspelt name that falls back to a default."""
    with pytest.raises(ValueError, match="no resampling scheme 'sistematic': choose one of multinomial"):
        run(random_walk(), [1.0], 10, resampling="sistematic")


def test_a_measurement_that_no_particle_explains_is_an_error():
    """Catches NaN weights, and index 0 everywhere: the error tells the step and what to try."""
    with pytest.raises(ZeroLikelihoodError, match=r"step 3: every particle has likelihood zero.*use more particles"):
        run(march(), [0.0, 1.0, 2.0, 77.0], 5)


def test_one_run_of_many_that_fails_is_an_error():
    """Catches a dead run hidden among healthy ones."""
    with pytest.raises(ZeroLikelihoodError, match="step 1"):
        run(march(), [[[0.0], [1.0]], [[0.0], [99.0]]], 5)


def test_a_likelihood_of_nan_is_an_error():
    """Catches NaN that spreads through the weights to the mean."""
    model = march(log_likelihood=lambda k, y, x: np.where(x[..., 0] > 1.5, NAN, 0.0) if k else np.zeros(x.shape[:-1]))
    with pytest.raises(ValueError, match=r"step 1: log_likelihood gave a value that is no weight \(log weight nan at"):
        run(model, [0.0, 0.0], 5)


def test_a_particle_of_weight_zero_may_be_anywhere():
    """Catches 0 times infinity: a state that exploded and got weight zero must not make the mean NaN."""
    model = march(propagate=lambda k, x, rng: np.where(x > 1.5, np.inf, x + 1))
    track = run(model, [0.0, 1.0], 5, policy=never)
    assert track.mean[:, 0].tolist() == pytest.approx([0, 1]) and np.isfinite(track.cov).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(sample_initial=lambda n, rng: np.zeros(n)), r"sample_initial\(5, rng\) must .* it gave \(5,\)"),
        (dict(sample_initial=lambda n, rng: np.zeros((n, 2))), r"must give shape \(5, 1\), it gave \(5, 2\)"),
        (dict(propagate=lambda k, x, rng: x[..., 0]), r"step 1: propagate must keep the shape .* it gave \(5,\)"),
        (dict(propagate=lambda k, x, rng: x + np.zeros(2)), r"step 1: propagate must keep .* it gave \(5, 2\)"),
        (
            dict(log_likelihood=lambda k, y, x: -np.abs(y - x)),
            r"step 0: log_likelihood must give one value a particle, shape \(5,\), it gave \(5, 1\)",
        ),
        (dict(log_likelihood=lambda k, y, x: 0.0), r"step 0: log_likelihood must give one value a particle"),
    ],
)  # fmt: skip
def test_functions_of_the_wrong_shape_are_named(changes, message):
    """Catches shapes that broadcast to N x N, or that are right for N = 1 alone."""
    with pytest.raises(ValueError, match=message):
        run(march(**changes), [0.0, 1.0], 5)


def test_a_missing_propagate_is_caught_over_a_missing_row():
    """Catches a shape that is checked only where there is a measurement."""
    model = march(propagate=lambda k, x, rng: x[..., 0])
    with pytest.raises(ValueError, match="step 1: propagate must keep the shape"):
        run(model, [0.0, NAN], 5)


@pytest.mark.parametrize("piece", ["sample_initial", "propagate", "log_likelihood"])
def test_a_missing_piece_is_named(piece):
    """Catches 'NoneType is not callable': a model made for the grid alone asked to be sampled."""
    with pytest.raises(pfedu.MissingPieceError, match=f"StateSpaceModel has no {piece}"):
        run(march(**{piece: None}), [0.0, 1.0], 5)


@pytest.mark.parametrize(
    ("y", "message"),
    [
        (np.ones((4, 2)), r"shape \(\.\.\., T\+1, 1\), one row a time step; got \(4, 2\)"),
        ([1.0, np.inf], r"infinite value in row \[1\]"),
        (np.empty((0, 1)), r"got \(0, 1\)"),
    ],
)
def test_bad_records_are_named(y, message):
    """Catches a filter that skips the common check of its record."""
    with pytest.raises(ValueError, match=message):
        run(random_walk(), y, 10)


def test_a_row_that_is_nan_in_part_is_an_error():
    """Catches a half-missing row taken for a whole one."""
    model = LinearGaussian(F=1.0, H=[[1.0], [2.0]], Q=1.0, R=[1.0, 1.0], m0=0.0, P0=1.0)
    with pytest.raises(ValueError, match=r"row \[1\] of the record is NaN in part"):
        run(model, [[1.0, 2.0], [1.0, NAN]], 10)


def test_a_policy_by_name_is_an_error_that_says_what_to_give():
    """Catches "'str' object is not callable"."""
    with pytest.raises(TypeError, match=r"policy must be .*always or never of pfedu.resampling, got 'always'"):
        pfedu.bootstrap_filter(random_walk(), [1.0], 5, rng=np.random.default_rng(1), policy="always")


def test_a_missing_row_adds_exactly_nothing_to_the_log_likelihood():
    """Catches the rounding of a sum of weights that passes for information."""
    track = run(random_walk(), [1.0, NAN, NAN, 2.0], 7, policy=never)
    assert track.log_likelihood_increments[1:3].tolist() == [0.0, 0.0]


def test_a_propagate_that_works_in_place_is_an_error():
    """Catches x += noise: every kept step would be the last one."""

    def propagate(k, x, rng):
        x += 1.0
        return x

    with pytest.raises(ValueError, match="read-only"):
        run(march(propagate=propagate), [0.0, 1.0], 5)


def test_a_proposal_that_looks_at_the_measurement_may_meet_a_missing_one_in_another_run():
    """Catches NaN particles of the run that misses what the others have."""

    def propose(k, y, x, rng):
        return 0.5 * (model.propagate(k, x, rng) + y), np.zeros(x.shape[:-1])

    model, y = random_walk(q=1.0), np.ones((2, 4, 1))
    y[0, 2] = NAN
    options = dict(rng=np.random.default_rng(1), resampling="systematic", policy=always)
    track = pfedu.filters.loop.particle_filter(propose, model, y, 50, **options)
    assert np.isfinite(track.mean).all() and track.log_likelihood_increments[0, 2] == 0.0


def test_resampling_of_the_wrong_shape_is_an_error():
    """Catches one ancestor broadcast to every particle."""
    with pytest.raises(ValueError, match=r"resampling must give whole numbers of shape \(5,\), it gave int64 \(1,\)"):
        run(random_walk(), [1.0], 5, policy=always, resampling=lambda w, rng, size=None: np.array([3], np.int64))


def test_a_lost_run_is_named():
    """Catches a study of a hundred runs ended by one that nobody can find."""
    model = StateSpaceModel(
        sample_initial=lambda n, rng: np.zeros((n, 1)),
        propagate=lambda k, x, rng: x,
        log_likelihood=lambda k, y, x: np.where(np.abs(y - x)[..., 0] < 1, 0.0, -np.inf),
    )
    with pytest.raises(ZeroLikelihoodError, match=r"step 1, run \[2\]: every particle has likelihood zero"):
        run(model, np.array([[0.0, 0.0], [0.0, 0.5], [0.0, 9.0]])[..., None], 5)
