"""The particle filter with a small Kalman filter in every particle, as proposal."""

import functools

import numpy as np
import pytest
from exact import SEEDS, SEVERAL, in_standard_errors, mean_square_deviation, problem, tame_ratio, worst
from scipy.stats import ks_2samp

import pfedu
from pfedu.gaussian import log_density
from pfedu.grid import grid_filter
from pfedu.kalman import kalman_filter
from pfedu.models import AdditiveGaussian, LinearGaussian, falling_body, growth, random_walk, stochastic_volatility
from pfedu.models import ratio as ratio_model
from pfedu.models.jacobian import jacobian
from pfedu.models.van_der_pol import van_der_pol
from pfedu.resampling import always, never, ratio

NAN = np.nan
both = pytest.mark.parametrize("proposal", ["ekf", "ukf"])
carried = pytest.mark.parametrize("carry", [False, True], ids=["point", "carry"])


def run(model, y, n, seed=1, **options):
    return pfedu.local_linear_filter(model, y, n, rng=np.random.default_rng(seed), **options)


def two_states(n_y=1):
    return LinearGaussian(
        F=[[1.0, 0.5], [-0.1, 0.9]], H=[[1.0, 0.3], [0.2, -0.5]][:n_y], Q=[[1.0, 0.3], [0.3, 0.5]],
        R=[[0.5, 0.1], [0.1, 0.8]] if n_y == 2 else 0.5, m0=[1.0, -1.0], P0=[[2, 0.5], [0.5, 1]],
    )  # fmt: skip


def cubic_model():
    """A level measured through its cube, accurately.

    Far out the cube is steep and the tangent's step back overshoots: the proposal is narrow, and in the wrong place.
    """

    def slope(k, x):
        return 3 * x[..., None] ** 2 / 20

    return AdditiveGaussian(0.9, lambda k, x: x**3 / 20, Q=1.0, R=0.01, m0=0.0, P0=1.0, jacobian_h=slope)


@functools.cache
def cubic(n_steps=30, seed=1):
    """The cubic model, a record made with it, exact track."""
    model = cubic_model()
    y = model.simulate(n_steps, np.random.default_rng(seed))[1]
    y[0] = NAN
    return model, y, grid_filter(model, y, np.linspace(-8.0, 8.0, 2001))


@functools.cache
def mild_growth():
    """The growth model with little noise in its motion and much in its measurements: model, record, exact track."""
    model, y = growth(q=2.0, r=4.0, p0=1.0), np.array([[0.1], [2.0], [NAN], [1.5]])
    return model, y, grid_filter(model, y, np.linspace(-30, 30, 1501))


@both
@carried
@pytest.mark.parametrize("defensive", [0, 0.1, 1])
def test_the_exact_answer_on_the_linear_record(proposal, carry, defensive):
    """Catches a weight that lacks the transition, the proposal or the mixture; weights are bounded throughout."""
    model, y, exact = problem("linear_A", 12)
    track = run(model, y, 100, proposal=proposal, carry=carry, defensive=defensive, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@both
@carried
@pytest.mark.parametrize("n_y", [1, 2])
def test_several_dimensions_against_the_kalman_filter(proposal, carry, n_y):
    """Catches a transposed root of the proposal, and states or measurements that mix."""
    model = two_states(n_y)
    y = model.simulate(6, np.random.default_rng(8))[1]
    track = run(model, y, 100, proposal=proposal, carry=carry, defensive=0.2, n_runs=SEEDS)
    assert max(worst(track, kalman_filter(model, y)).values()) < SEVERAL


@both
@carried
@pytest.mark.parametrize("name", ["growth_A", "ratio_A"])
def test_the_exact_answer_on_nonlinear_records(name, proposal, carry):
    """Catches a weight that is right for a linear model alone.

    With a defensive tenth every weight is at most ten times the likelihood, so that Zhat/Z has the variance that its
    scatter shows. Without it, on the growth record, the mirror peak of the posterior lies where the tangent's proposal
    has a density of 1e-6 and less: finite, but nothing that 200 runs would see.
    """
    model, y, exact = problem(name, 8)
    track = run(model, y, 250, seed=2, proposal=proposal, carry=carry, defensive=0.1, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@both
def test_a_linear_measurement_needs_no_defence(proposal):
    """Catches a proposal that is not the optimal one where it could be: its weights are bounded by N(y; y, Q + R)."""
    model, y, exact = problem("ratio_A", 20)
    track = run(model, y, 200, seed=3, proposal=proposal, policy=always, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@both
@pytest.mark.parametrize("policy", [always, ratio(0.5)], ids=["always", "ratio"])
@pytest.mark.parametrize("n_particles", [1, 3])
def test_the_likelihood_estimate_is_unbiased_for_very_few_particles(proposal, policy, n_particles):
    """Catches what only holds for large N, and a mixture whose density is not that of its draws."""
    model, y, exact = mild_growth()
    track = run(model, y, n_particles, proposal=proposal, policy=policy, defensive=0.3, seed=5, n_runs=10_000)
    assert in_standard_errors(np.exp(track.log_likelihood - exact.log_likelihood) - 1) < 4


def test_the_share_must_be_in_the_density(monkeypatch):
    """Shows that the tests above can fail: draws of a mixture, weighed by the proposal alone."""

    def undefended(model, k, x, new, m, cov, share, rng):
        swap = rng.random(x.shape[:-1]) < share
        new = np.where(swap[..., None], model.propagate(k, x, rng), new)
        return new, log_density(new, m, cov)

    monkeypatch.setattr(pfedu.filters.local_linear, "_defended", undefended)
    model, y, exact = problem("linear_A", 12)
    assert worst(run(model, y, 200, carry=True, defensive=0.1, n_runs=SEEDS), exact)["likelihood"] > SEVERAL


@both
@pytest.mark.parametrize("n_y", [1, 2])
def test_for_a_linear_model_the_proposal_is_the_optimal_density(proposal, n_y):
    """Catches any other proposal or weight: the two filters are the same to rounding, draw by draw."""
    model = two_states(n_y)
    y = model.simulate(20, np.random.default_rng(9))[1]
    options = dict(policy=ratio(0.5), keep=True, n_runs=3)
    track = run(model, y, 50, proposal=proposal, **options)
    best = pfedu.optimal_filter(model, y, 50, rng=np.random.default_rng(1), **options)
    assert best.resampled.any() and not best.resampled.all()
    for field in ("particles", "log_weights", "mean", "cov", "log_likelihood_increments"):
        np.testing.assert_allclose(getattr(track, field), getattr(best, field), rtol=1e-9, atol=1e-9)


@both
def test_a_curved_motion_keeps_the_proposal_optimal(proposal):
    """Catches the motion linearised where it need not be: only h bends a proposal that starts from points."""
    model, y, _ = tame_ratio()
    track = run(model, y, 50, proposal=proposal, keep=True)
    best = pfedu.optimal_filter(model, y, 50, rng=np.random.default_rng(1), keep=True)
    np.testing.assert_allclose(track.log_weights, best.log_weights, rtol=1e-6, atol=1e-6)


def by_tangent(f, prior, y, r):
    """Mean and variance after an EKF's correction for h = x^2/20."""
    H = f / 10
    K = prior * H / (H * prior * H + r)
    return f + K * (y - f**2 / 20), (1 - K * H) * prior


def by_sigma_points(f, prior, y, r):
    """The same by three points, f and f +- sd, with weights 0, 1/2, 1/2 (2 for the first in a covariance)."""
    sd = np.sqrt(prior)
    h0, up, down = f**2 / 20, (f + sd) ** 2 / 20, (f - sd) ** 2 / 20
    mean = (up + down) / 2
    S = 2 * (h0 - mean) ** 2 + (up - mean) ** 2 / 2 + (down - mean) ** 2 / 2 + r
    K = sd * (up - down) / 2 / S
    return f + K * (y - mean), prior - K**2 * S


@pytest.mark.parametrize(("proposal", "by_hand"), [("ekf", by_tangent), ("ukf", by_sigma_points)])
@pytest.mark.parametrize("defensive", [0.0, 0.3])
def test_weights_by_hand(proposal, by_hand, defensive):
    """Catches a slip in the weight itself: two steps of the growth model, from the particles that were kept."""
    model, y = growth(), np.array([[NAN], [3.0], [5.0]])
    track = run(model, y, 40, proposal=proposal, defensive=defensive, policy=never, keep=True)
    want = 0.0
    for k in (1, 2):
        x, new = track.particles[k - 1, :, 0], track.particles[k, :, 0]
        f = x / 2 + 25 * x / (1 + x**2) + 8 * np.cos(1.2 * k)
        m, v = by_hand(f, 10.0, y[k, 0], 1.0)
        move, drawn = (np.exp(-0.5 * (new - a) ** 2 / s) / np.sqrt(2 * np.pi * s) for a, s in ((f, 10.0), (m, v)))
        g = np.exp(-0.5 * (y[k, 0] - new**2 / 20) ** 2) / np.sqrt(2 * np.pi)
        want = want + np.log(g * move / ((1 - defensive) * drawn + defensive * move))
    got = track.log_weights[2] + track.log_likelihood + np.log(40)
    np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("carry", [False, True], ids=["point", "carry"])
def test_a_carried_covariance_by_hand(carry):
    """Catches a covariance that is not carried, is another particle's, or is carried where it should not be.

    After one step each particle has a P of its own; the second step starts from F P F + q, or from q alone.
    """
    model, y = growth(), np.array([[NAN], [3.0], [5.0]])
    track = run(model, y, 40, carry=carry, policy=never, keep=True)
    x0, x1, x2 = track.particles[..., 0]
    f1, f2 = (model.f(k, x[:, None])[:, 0] for k, x in ((1, x0), (2, x1)))
    P = by_tangent(f1, 10.0, 3.0, 1.0)[1]
    slope = 0.5 + 25 * (1 - x1**2) / (1 + x1**2) ** 2
    m, v = by_tangent(f2, 10.0 + carry * slope**2 * P, 5.0, 1.0)
    ratio_w = -0.5 * ((5.0 - x2**2 / 20) ** 2 + (x2 - f2) ** 2 / 10.0 - (x2 - m) ** 2 / v - np.log(v))
    first = track.log_weights[1] + track.log_likelihood_increments[1]
    both_steps = track.log_weights[2] + track.log_likelihood_increments[1:].sum()
    np.testing.assert_allclose(both_steps - first, ratio_w - np.log(2 * np.pi * 10.0) / 2, rtol=1e-8, atol=1e-8)


def test_entirely_defensive_is_the_bootstrap_filter():
    """Catches a share that is not one: weights are the likelihood, moves the process noise, estimates alike.

    The last is a Kolmogorov-Smirnov test of 400 log-likelihood estimates each; p below 1e-4 by chance 1 in 10 000.
    """
    model, y, _ = problem("growth_A", 12)
    track = run(model, y, 100, defensive=1, policy=never, keep=True, n_runs=100)
    x = track.particles
    log_g = model.log_likelihood(0, y[1:, None, :], x[:, 1:]).cumsum(axis=1)
    want = log_g - np.logaddexp.reduce(log_g, axis=-1, keepdims=True)
    np.testing.assert_allclose(track.log_weights[:, 1:], want, rtol=1e-9, atol=1e-8)
    noise = np.stack([x[:, k] - model.f(k, x[:, k - 1]) for k in range(1, 13)]) / np.sqrt(10.0)
    assert abs(noise.mean()) < 4 / np.sqrt(noise.size)
    assert abs((noise**2).mean() - 1) < 4 * np.sqrt(2 / noise.size)
    ours = run(model, y, 100, seed=2, defensive=1, n_runs=400).log_likelihood
    theirs = pfedu.bootstrap_filter(model, y, 100, rng=np.random.default_rng(3), n_runs=400, policy=ratio(0.5))
    assert ks_2samp(ours, theirs.log_likelihood).pvalue > 1e-4


def test_a_defended_weight_is_bounded():
    """Catches a mixture that does not defend: log g is at most the log likelihood less the log of the share."""
    model, y, _ = cubic()
    excess = {}
    for share in (0.0, 0.2):
        track = run(model, y[:2], 2000, defensive=share, policy=never, keep=True)
        log_g = track.log_weights[1] + track.log_likelihood + np.log(2000)
        excess[share] = np.max(log_g - model.log_likelihood(1, y[1], track.particles[1]))
    assert excess[0.2] <= -np.log(0.2) + 1e-9 < excess[0.0]


def root_mean_square(track, exact):
    """Root of the mean square deviation over runs and steps, and its standard error."""
    square = mean_square_deviation(track, exact)
    rms = np.sqrt(square.mean())
    return rms, square.std(ddof=1) / np.sqrt(len(square)) / (2 * rms)


@functools.cache
def at_200(name, proposal=None, **options):
    """RMS deviation with 200 particles, resampled at each step, over 100 runs; the bootstrap filter for None."""
    model, y, exact = problem(name)
    options |= dict(policy=always, n_runs=100)
    if proposal is None:
        return root_mean_square(pfedu.bootstrap_filter(model, y, 200, rng=np.random.default_rng(6), **options), exact)
    return root_mean_square(run(model, y, 200, seed=6, proposal=proposal, **options), exact)


def clearly_below(small, large):
    return large[0] - small[0] > 2 * np.hypot(small[1], large[1])


def test_half_the_error_on_the_linear_record():
    """Catches a proposal that does not help: an independent program found .0707; here to 4 standard errors."""
    ours, blind = at_200("linear_A", "ekf"), at_200("linear_A")
    assert abs(ours[0] - 0.0707) < 4 * ours[1]
    assert 1.7 < blind[0] / ours[0] < 2.5


@pytest.mark.parametrize(("proposal", "found"), [("ekf", 0.77), ("ukf", 0.62)])
def test_the_error_on_the_growth_record(proposal, found):
    """Catches a proposal in the wrong place: an independent program found these; to 4 standard errors."""
    ours = at_200("growth_A", proposal)
    assert abs(ours[0] - found) < 4 * ours[1]
    assert clearly_below(ours, at_200("growth_A"))


def test_carrying_the_covariance_doubles_the_error_of_the_unscented_proposal():
    """Shows why it is not the default: each particle is a point, and a wider proposal wastes draws."""
    assert at_200("growth_A", "ukf", carry=True)[0] > 1.8 * at_200("growth_A", "ukf")[0]


def test_a_thin_tailed_proposal_fails_and_the_mixture_mends_it():
    """A pair: an accurate cubic measurement, where the tangent's proposal is worse than none.

    Found with 200 runs: .239 +- .002 for the tangent, .058 +- .001 with half of the draws defensive, .055 without
    any proposal.
    """
    model, y, exact = cubic()
    options = dict(policy=always, n_runs=50)
    thin = root_mean_square(run(model, y, 200, **options), exact)
    mended = root_mean_square(run(model, y, 200, defensive=0.5, **options), exact)
    blind = root_mean_square(pfedu.bootstrap_filter(model, y, 200, rng=np.random.default_rng(1), **options), exact)
    assert thin[0] > 3 * blind[0] and thin[0] > 3 * mended[0]
    assert mended[0] < 1.3 * blind[0]


@pytest.mark.parametrize(
    "model",
    [growth(), ratio_model(power=2), ratio_model(), van_der_pol(), cubic_model(), two_states(2)],
    ids=["growth", "tame ratio", "ratio", "van der Pol", "cubic", "linear"],
)
def test_stated_derivatives_are_those_of_differences(model):
    """Catches a slip in a derivative written by hand, a transposed one, and one of another step's f.

    Central differences are right to some ten digits; at 0.5 to 2.5 all states are far from the pole at -1.
    """
    x = np.random.default_rng(1).uniform(0.5, 2.5, (20, model.n_x))
    for k in (1, 4):
        for stated, function in ((model.jacobian_f, model.f), (model.jacobian_h, model.h)):
            want = jacobian(lambda z, k=k, function=function: function(k, z), x)
            np.testing.assert_allclose(stated(k, x), want, rtol=1e-7, atol=1e-8)


def test_the_stated_derivative_of_the_radar_is_that_of_differences():
    """Catches the distance to a radar on the ground: one slope of three is not zero, in feet."""
    model, x = falling_body(), np.random.default_rng(1).uniform([1e4, 1e3, 1e-4], [3e5, 2e4, 1e-3], (20, 3))
    want = jacobian(lambda z: model.h(1, z), x)
    np.testing.assert_allclose(model.jacobian_h(1, x), want, rtol=0, atol=1e-7)


@both
@carried
def test_missing_rows_among_the_others(proposal, carry):
    """Catches a missing row that is proposed by, or whose covariance stays behind: at the start, inside, at the end."""
    y = problem("linear_A", 12)[1].copy()
    y[[4, 5, 9]] = NAN
    track = run(random_walk(), y[:10], 200, seed=7, proposal=proposal, carry=carry, n_runs=SEEDS)
    assert max(worst(track, kalman_filter(random_walk(), y[:10])).values()) < SEVERAL
    assert (track.log_likelihood_increments[:, [0, 4, 5, 9]] == 0).all()


@carried
def test_a_missing_row_lets_the_covariance_grow(carry):
    """Catches a P that is forgotten over a gap: F P F + Q for each row missed, then one more for the next step."""
    model, y = random_walk(q=1.0, r=1.0, p0=0.0), np.array([[NAN], [NAN], [NAN], [2.0]])
    track = run(model, y, 5, carry=carry, policy=never, keep=True)
    prior = 3.0 if carry else 1.0  # of the last step
    x, new = track.particles[2, :, 0], track.particles[3, :, 0]
    m, v = x + prior / (prior + 1) * (2.0 - x), prior / (prior + 1)
    want = log_density(2.0, new[:, None], 1.0) + log_density(new[:, None], x[:, None], 1.0)
    want = want - log_density(new[:, None], m[:, None], v)
    np.testing.assert_allclose(track.log_weights[3] + track.log_likelihood + np.log(5), want, rtol=1e-9, atol=1e-9)


@both
@carried
def test_several_records_at_once(proposal, carry):
    """Catches runs that see each other's measurements: a batch is a loop, also where one run misses a row."""
    y = random_walk().simulate(8, np.random.default_rng(9), n_runs=2)[1]
    y[0, 3], y[1, 6:] = NAN, NAN
    track = run(random_walk(), y, 200, seed=9, proposal=proposal, carry=carry, defensive=0.1, n_runs=SEEDS)
    assert track.mean.shape == (SEEDS, 2, 9, 1)
    assert max(worst(track, kalman_filter(random_walk(), y)).values()) < SEVERAL


def test_the_same_seed_gives_the_same_bits():
    """Catches randomness from anywhere but the generator."""
    model, y, _ = problem("growth_A", 12)
    first, again = (run(model, y, 50, seed=4, defensive=0.2, carry=True) for _ in range(2))
    np.testing.assert_array_equal(first.mean, again.mean)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (dict(proposal="kalman"), "proposal must be one of ekf, ukf, got 'kalman'"),
        (dict(defensive=-0.1), "defensive is a share between 0 and 1, got -0.1"),
        (dict(defensive=1.5), "defensive is a share between 0 and 1, got 1.5"),
        (dict(defensive=NAN), "defensive is a share between 0 and 1, got nan"),
    ],
)
def test_options_that_are_none_are_named(options, message):
    """Catches a misspelt name that falls back to a default, and a share that is none."""
    with pytest.raises(ValueError, match=message):
        run(random_walk(), [1.0], 10, **options)


def test_a_singular_process_noise_is_an_error():
    """Catches -inf or NaN weights: a step that cannot leave a line has no density."""
    model = LinearGaussian(F=np.eye(2), H=[[1.0, 0.0]], Q=[1.0, 0.0], R=1.0, m0=[0.0, 0.0], P0=[1.0, 1.0])
    with pytest.raises(ValueError, match=r"Q is singular, so that the step has no density to weigh by"):
        run(model, [1.0], 10)


@pytest.mark.parametrize("options", [dict(proposal="ekf"), dict(proposal="ukf"), dict(defensive=0.1)])
def test_a_measurement_without_noise_is_an_error(options):
    """Catches 'cov is not positive definite' with a matrix for each particle: what to change is R."""
    with pytest.raises(ValueError, match=r"R is singular, the proposal has no density to weigh by: \[\[0.0\]\]$"):
        run(LinearGaussian(1.0, 1.0, Q=1.0, R=0.0, m0=0.0, P0=1.0), [NAN, 1.0], 10, **options)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (falling_body(), "FallingBody has no log_transition, which local linearisation needs"),
        (stochastic_volatility(), "AdditiveProcess has no h, which local linearisation needs"),
        (pfedu.models.jump_markov(), "JumpMarkov has no f, which local linearisation needs"),
    ],
)
def test_a_model_that_lacks_a_piece_is_an_error(model, message):
    """Catches 'NoneType is not callable', and noise inside the motion taken for added noise."""
    with pytest.raises(pfedu.MissingPieceError, match=message):
        run(model, np.ones((2, model.n_y)), 10)
