"""The curse of dimensionality: closed forms against quadrature, and simulation against closed forms.

With W the weight of a particle, Zhat its mean over the N particles and Z the exact likelihood, these hold for every
N and given innovations, without any allowance for bias (kappa: the product of the factors):

    E[Zhat / Z] = 1,   E[(Zhat / Z)^2 N / N_eff] = kappa,   N E[(Zhat / Z)^2 squared error] = error factor

so that simulation and formula are compared in standard errors over independent runs.
"""

import numpy as np
import pytest
from scipy import integrate, stats

from pfedu import dimension, kalman
from pfedu.dimension import Proposal, bootstrap, largest_weight, optimal, simulate_weights, steady_state
from pfedu.importance import importance_sample

SEVERAL = 4.5  # standard errors: chance alone exceeds them in 1 of 150 000 comparisons
GAINS = [0.05, 0.236, 0.5, 0.618, 0.9]
every_gain = pytest.mark.parametrize("K", GAINS)
every_proposal = pytest.mark.parametrize("proposal", [bootstrap(), optimal(), Proposal(0.5, 0.3)], ids=repr)


def in_standard_errors(values):
    return abs(values.mean()) / (values.std(ddof=1) / np.sqrt(len(values)))


def moment(K, z, function):
    """E[function(w, x)] over x from N(0, K), with w = N(z; x, 1 - K), by quadrature over +-12 deviations."""
    u = np.linspace(-12, 12, 20_001)  # the trapezoidal rule, far finer than any density here
    x = np.sqrt(K) * u
    w = stats.norm.pdf(z, x, np.sqrt(1 - K))
    return np.sum(function(w, x) * stats.norm.pdf(u)) * (u[1] - u[0])


def over_measurements(function):
    """Mean over z from N(0, 1), for K up to 0.9: the integrand falls by exp(-32) or more to the ends."""
    z = np.linspace(-35, 35, 7001)
    return np.sum(function(z) * stats.norm.pdf(z)) * (z[1] - z[0])


@every_gain
@pytest.mark.parametrize("z", [0.0, 1.0, -2.5])
def test_one_coordinate_by_quadrature(K, z):
    """Catches a slip in completing any of the squares: factor, variance of the log weight, divergence, error."""
    w1, w2 = moment(K, z, lambda w, x: w), moment(K, z, lambda w, x: w * w)
    proposal = Proposal(K)
    assert proposal.factor(z) == pytest.approx(w2 / w1**2, rel=1e-9)
    log_w = lambda x: stats.norm.logpdf(z, x, np.sqrt(1 - K))  # noqa: E731
    mean = moment(K, z, lambda w, x: log_w(x))
    variance = moment(K, z, lambda w, x: (log_w(x) - mean) ** 2)
    assert proposal.log_weight_variance(z) == pytest.approx(variance, rel=1e-9)
    divergence = moment(K, z, lambda w, x: w / w1 * (log_w(x) - np.log(w1)))
    assert proposal.divergence(z) == pytest.approx(divergence, rel=1e-8)
    error = moment(K, z, lambda w, x: (w * (x - K * z)) ** 2) / w1**2 / (K * (1 - K))
    assert proposal.error_factor([z]) == pytest.approx(error, rel=1e-9)


@every_gain
@pytest.mark.parametrize("fresh", [0.0, 0.8])
def test_error_of_several_coordinates(K, fresh):
    """Catches a product taken for a sum: coordinates with different innovations, one at a time by the rule above.

    The error of coordinate j is the product of the other factors times its own; what is fresh adds its variance.
    """
    z, proposal = np.array([0.3, -1.0, 2.0]), Proposal(K, fresh)
    own = np.array([Proposal(K).error_factor([v]) for v in z])
    kappa = np.prod(proposal.factor(z))
    exact = fresh * kappa + (1 - fresh) * np.mean(kappa / proposal.factor(z) * own)
    assert proposal.error_factor(z) == pytest.approx(exact, rel=1e-12)
    np.testing.assert_allclose(proposal.error_factor(np.stack([z, z[::-1]])), exact, rtol=1e-12)


@every_gain
def test_averages_over_measurements(K):
    """Catches a typical value taken for a mean: geometric, harmonic and arithmetic mean of the factor, and of the rest.

    The arithmetic mean is prior over posterior variance, 1 / (1 - K), and the mean error of one coordinate is the same.
    """
    p = Proposal(K)
    assert p.growth() == pytest.approx(np.exp(over_measurements(lambda z: np.log(p.factor(z)))), rel=1e-9)
    assert p.growth() == pytest.approx(p.factor(1.0), rel=1e-15)
    assert p.growth(1e-7) == pytest.approx(p.growth(0), rel=1e-5)
    for power in (-1, -0.5, 0.3, 1):
        mean = over_measurements(lambda z, power=power: p.factor(z) ** power) ** (1 / power)
        assert p.growth(power) == pytest.approx(mean, rel=1e-6)
    assert p.growth(1) == pytest.approx(1 / (1 - K), rel=1e-12)
    assert over_measurements(lambda z: p.error_factor(z[:, None])) == pytest.approx(1 / (1 - K), rel=1e-6)
    for quantity in (p.log_weight_variance, p.divergence):
        assert quantity() == pytest.approx(over_measurements(quantity), rel=1e-9)


@pytest.mark.parametrize("K", [0.0, 0.1, 0.5, 0.99])
@pytest.mark.parametrize("power", [1e-320, 1e-16, -1e-16, 1e-12, -1e-9])
def test_a_power_near_zero_is_the_geometric_mean(K, power):
    """Catches 1 - 2pK/(1+K) that rounds to 1: a power of 1e-16 then gives 2.01 where the limit is 1.61.

    log growth differs from its limit by p (K/(1+K))^2 to first order, and by rounding.
    """
    c = K / (1 + K)
    assert np.log(Proposal(K).growth(power) / Proposal(K).growth()) == pytest.approx(power * c * c, abs=1e-15)


def test_numbers_beyond_a_double_are_infinite():
    """Catches a division by an underflowed share, with its warning, and an end that comes too early."""
    p = Proposal(0.9)
    with np.errstate(all="raise", under="ignore"):
        assert p.particles_for_n_eff(100, [10, 2000])[1] == p.particles_for_error(0.1, 2000) == np.inf
    n_x = int(np.log(1e308 / 100) / np.log(p.growth()))  # the last that has a number
    assert np.log10(p.particles_for_n_eff(100, n_x)) == pytest.approx(2 + n_x * np.log10(p.growth()), rel=1e-12)


def test_a_mean_that_does_not_exist():
    """Catches a power mean past its pole, where the formula gives a number and the integral has none."""
    assert Proposal(0.6).growth(1.3) < np.inf == Proposal(0.6).growth(1.4)
    assert Proposal(0.0).growth(5.0) == 1.0


@pytest.mark.parametrize(("q", "r"), [(1.0, 1.0), (10.0, 1.0), (0.01, 4.0), (1e8, 1.0)])
def test_the_steady_state_stays(q, r):
    """Catches the wrong root, and q and r exchanged: the Kalman filter leaves these variances as they are."""
    P_minus, P = steady_state(q, r)
    one = np.eye(1)
    _, moved = kalman.predict(np.zeros(1), P * one, one, q * one)
    _, corrected, _ = kalman.correct(np.zeros(1), P_minus * one, np.zeros(1), one, r * one)
    assert moved[0, 0] == pytest.approx(P_minus, rel=1e-12)
    assert corrected[0, 0] == pytest.approx(P, rel=1e-7)  # Joseph's form, at r / q = 1e-8


def test_growth_of_the_two_proposals():
    """Catches rho turned over or the wrong prior: 1.864 and 1.246, by the formula in P = rho / (1 + rho) of the text.

    The literal numbers are (P (2 - P))^(-1/2) exp((1 - P) / (2 - P)) at rho = r / P_minus and (q + r) / P_plus.
    """
    P_minus, P_plus = steady_state(1.0, 1.0)
    for proposal, rho, number in ((bootstrap(), 1 / P_minus, 1.864), (optimal(), 2 / P_plus, 1.246)):
        P = rho / (1 + rho)
        assert proposal.K == pytest.approx(1 / (1 + rho), rel=1e-12)
        assert proposal.growth() == pytest.approx((P * (2 - P)) ** -0.5 * np.exp((1 - P) / (2 - P)), rel=1e-12)
        assert proposal.growth() == pytest.approx(number, abs=5e-4)


@pytest.mark.parametrize(("q", "r"), [(1.0, 1.0), (10.0, 1.0), (0.1, 2.0)])
def test_the_optimal_proposal_adds_up(q, r):
    """Catches a fresh share of the wrong density: fresh and weighed parts make up the posterior variance.

    Given x_{k-1} and y_k the state has the mean (r x + q y) / (q + r) and the variance q r / (q + r).
    """
    _, P = steady_state(q, r)
    weighed = (r / (q + r)) ** 2 * P * (q + r) / (P + q + r)  # of x_{k-1}, corrected with variance q + r
    assert optimal(q, r).fresh == pytest.approx(1 - weighed / P, rel=1e-9)
    assert optimal(q, r).K < bootstrap(q, r).K and bootstrap(q, r).fresh == 0


@every_proposal
def test_the_simulation_is_exact(proposal):
    """Catches a length, a degree of freedom or a constant: three exact means, for few particles, innovations given."""
    z = np.array([0.5, -1.2, 0.1, 1.5])
    runs = simulate_weights(proposal, 4, 300, rng=np.random.default_rng(1), n_runs=4000, z=z)
    ratio = np.exp(runs.log_z_error)
    assert in_standard_errors(ratio - 1) < SEVERAL
    assert in_standard_errors(ratio**2 * 300 / runs.n_eff - np.prod(proposal.factor(z))) < SEVERAL
    assert in_standard_errors(ratio**2 * 300 * runs.squared_error - proposal.error_factor(z)) < SEVERAL


@pytest.mark.parametrize("n_x", [1, 2, 30])
def test_the_simulation_draws_its_innovations(n_x):
    """Catches innovations of the wrong length: Zhat / Z is unbiased, and log Z itself is not seen, for any |z|.

    With K = 0.05 the mean over measurements exists with a small variance: (1 - K)^-n_x, by the growth of power 1.
    """
    p = Proposal(0.05)
    runs = simulate_weights(p, n_x, 100, rng=np.random.default_rng(2), n_runs=4000)
    ratio2 = np.exp(2 * runs.log_z_error)
    assert in_standard_errors(np.exp(runs.log_z_error) - 1) < SEVERAL
    assert in_standard_errors(ratio2 * 100 / runs.n_eff - p.growth(1) ** n_x) < SEVERAL
    assert in_standard_errors(ratio2 * 100 * runs.squared_error - p.growth(1) ** n_x) < SEVERAL


@pytest.mark.parametrize("n_x", [1, 3])
def test_the_simulation_is_the_particles_themselves(n_x):
    """Catches a law of weights that only looks alike: N particles of n_x coordinates, drawn and weighed in full.

    Far from the limit (N = 40, N_eff about 10), where the formulas say nothing; two independent sets of 4000 runs.
    """
    K, z, runs = 0.618, np.full(n_x, 1.3), 4000
    gaussian = lambda d, v: -0.5 * np.sum(d * d / v + np.log(2 * np.pi * v), axis=-1)  # noqa: E731
    full = importance_sample(
        lambda x: gaussian(x, K) + gaussian(z - x, 1 - K),
        lambda n, rng: np.sqrt(K) * rng.standard_normal((n, n_x)),
        lambda x: gaussian(x, K),
        40,
        rng=np.random.default_rng(3),
        n_runs=runs,
    )
    quick = simulate_weights(Proposal(K), n_x, 40, rng=np.random.default_rng(4), n_runs=runs, z=z)
    error = np.mean((full.mean() - K * z) ** 2, axis=-1) / (K * (1 - K))
    log_z = full.log_z - gaussian(z, np.ones(n_x))
    for a, b in (
        (full.n_eff, quick.n_eff),
        (full.largest_weight, quick.largest_weight),
        (error, quick.squared_error),
        (log_z, quick.log_z_error),
        (log_z**2, quick.log_z_error**2),
    ):
        assert abs(a.mean() - b.mean()) < SEVERAL * np.hypot(a.std(), b.std()) / np.sqrt(runs)


def test_the_optimal_density_in_full():
    """Catches the fresh part on the wrong scale: particles weighed by p(y | x_{k-1}), then moved with y known.

    q = 1, r = 2, two coordinates, 30 particles, against the exact mean; independent of every formula of the module
    but the variances of the steady state.
    """
    q, r, n, runs = 1.0, 2.0, 30, 4000
    P_minus, P = steady_state(q, r)
    S, rng, z = P_minus + r, np.random.default_rng(5), np.array([1.5, -0.5])
    y = np.sqrt(S) * z  # the last mean is zero
    before = np.sqrt(P) * rng.standard_normal((runs, n, 2))
    log_w = -0.5 * np.sum((y - before) ** 2, axis=-1) / (q + r)
    w = np.exp(log_w) / np.exp(log_w).sum(axis=-1, keepdims=True)
    x = (r * before + q * y) / (q + r) + np.sqrt(q * r / (q + r)) * rng.standard_normal(before.shape)
    error = np.mean((np.sum(w[..., None] * x, axis=-2) - P_minus / S * y) ** 2, axis=-1) / P
    quick = simulate_weights(optimal(q, r), 2, n, rng=np.random.default_rng(6), n_runs=runs, z=z).squared_error
    assert abs(error.mean() - quick.mean()) < SEVERAL * np.hypot(error.std(), quick.std()) / np.sqrt(runs)


@every_proposal
def test_the_effective_number_tends_to_its_limit(proposal):
    """Catches an exponent: N_eff at a typical innovation (every z = 1), N a thousand times the growth, to 1 %.

    The relative standard error of one N_eff is about sqrt(E[w^4] / E[w^2]^2 / N); 20 runs leave it below 0.5 %.
    """
    n_x, n = 3, 20_000
    runs = simulate_weights(proposal, n_x, n, rng=np.random.default_rng(8), n_runs=20, z=np.ones(n_x))
    assert runs.n_eff.mean() / n == pytest.approx(proposal.n_eff_share(n_x), rel=0.01)
    assert proposal.particles_for_n_eff(100, n_x) == pytest.approx(100 / proposal.n_eff_share(n_x), rel=1e-12)


def test_the_mean_share_over_measurements():
    """Catches the typical share taken for the mean one: 3 coordinates, 2000 records, N_eff about 900 of 2000."""
    p = optimal()
    runs = simulate_weights(p, 3, 4000, rng=np.random.default_rng(9), n_runs=2000)
    share = runs.n_eff / 4000
    bias = 0.005 * share.mean()  # of order kappa / N, a thousandth for most records
    assert abs(share.mean() - p.n_eff_share(3, power=-1)) < SEVERAL * share.std() / np.sqrt(2000) + bias
    assert p.n_eff_share(3, power=-1) - p.n_eff_share(3) > 5 * bias  # so that this can fail


def test_past_its_validity_the_limit_says_too_little():
    """Shows where N_eff = N / growth^n ends: 20 coordinates, N = 1000, a formula of 0.004 and an N_eff of about 3."""
    runs = simulate_weights(bootstrap(), 20, 1000, rng=np.random.default_rng(10), n_runs=500)
    assert 1000 * bootstrap().n_eff_share(20) < 0.01
    assert 2 < runs.n_eff.mean() < 4


@pytest.mark.parametrize("n_x", [1, 10, 100])
def test_independent_draws_cost_linearly_in_all(n_x):
    """Catches the total error taken for that of a coordinate: perfect proposal, P / N each and n_x P / N in all.

    The squared error is a mean of n_x chi-squares over N; given the draws' lengths its mean over runs is exact.
    """
    perfect, n = Proposal(0.0), 50
    runs = simulate_weights(perfect, n_x, n, rng=np.random.default_rng(11), n_runs=4000)
    np.testing.assert_allclose(runs.n_eff, n, rtol=1e-12)
    np.testing.assert_allclose(runs.log_z_error, 0.0, atol=1e-12)
    assert in_standard_errors(runs.squared_error * n - 1) < SEVERAL
    assert perfect.particles_for_error(1 / n, n_x) == n
    assert perfect.particles_for_error(1 / n, n_x, total=True) == n * n_x


def test_the_linear_law_lasts_while_the_weights_are_even():
    """Catches a promise beyond the overlap: with K = 0.01 linear to 10 coordinates (11 %), exponential at 1000."""
    good = Proposal(0.01)
    per_dimension = good.particles_for_error(0.05, [1, 10, 1000], total=True) / [1, 10, 1000] * 0.05
    np.testing.assert_allclose(per_dimension[:2], 1.0, atol=0.11)
    assert per_dimension[2] > 1e4


def needed(proposal, n_x, n, seed):
    """Mean squared error of one exact step over measurements, and its standard error: 8e6 particles in four parts."""
    n_runs = int(2e6 / n)
    error = np.concatenate(
        [
            simulate_weights(proposal, n_x, n, rng=np.random.default_rng([seed, i]), n_runs=n_runs).squared_error
            for i in range(4)
        ]
    )
    return error.mean(), error.std() / np.sqrt(error.size)


# N at which one exact step has the mean squared error 0.05, found by bisection of the simulation
ONE_STEP = {"bootstrap": {1: 43, 4: 317, 8: 3297, 10: 11585}, "optimal": {1: 26, 10: 170, 20: 1069}}


@pytest.mark.parametrize("name", ONE_STEP)
def test_the_numbers_the_text_quotes(name):
    """Catches a quoted N that a change of the simulation has made false, and a formula that has lost touch with it.

    The error falls about as 1 / N, so that 6 % of N allowed are 6 % of the error, besides its standard errors; the
    typical formula stays within a factor of two, and its growth within 4 % of that of the simulation.
    """
    proposal = getattr(dimension, name)()
    for n_x, n in ONE_STEP[name].items():
        error, se = needed(proposal, n_x, n, seed=12)
        assert abs(error - 0.05) < 0.003 + SEVERAL * se
        assert 0.5 < proposal.particles_for_error(0.05, n_x) / n < 2
    dims, numbers = zip(*ONE_STEP[name].items(), strict=True)
    growth = np.exp(np.polyfit(dims, np.log(numbers), 1)[0])
    assert growth == pytest.approx(proposal.growth(), rel=0.04)


def expected_largest_normal(n):
    """E[M] of N standard normals."""
    m = np.linspace(-6, 14, 20_001)
    return np.sum(m * n * np.exp(stats.norm.logpdf(m) + (n - 1) * stats.norm.logcdf(m))) * (m[1] - m[0])


def inverse_largest(tau, n):
    """E[1 / w_max] for log weights that are exactly tau times Gaussian: given the largest at m, the others add
    (N - 1) E[exp(tau (x - m)) | x < m]."""

    def integrand(m):
        others = np.exp(stats.norm.logcdf(m - tau) + 0.5 * tau**2 - tau * m + (n - 2) * stats.norm.logcdf(m))
        return n * (n - 1) * stats.norm.pdf(m) * others

    return 1 + integrate.quad(integrand, -2, 12, limit=400)[0]


def test_the_law_of_the_largest_weight():
    """Catches the wrong root or logarithm: tau (E[1/w_max] - 1) tends to E[M], and E[M] to sqrt(2 log N).

    By integrals, for exactly Gaussian log weights: the derivation step by step. E[M] / sqrt(2 log N) rises to 1
    slowly, like 1 - log log N / (4 log N).
    """
    for n in (100, 10_000):
        assert 2000 * (inverse_largest(2000.0, n) - 1) == pytest.approx(expected_largest_normal(n), rel=0.01)
    sizes = np.array([1e2, 1e4, 1e8, 1e12])
    normal = np.array([expected_largest_normal(n) for n in sizes])
    law = 1000 * (1 / largest_weight(1e6, sizes) - 1)  # tau = 1000
    ratio = normal / law
    assert (np.diff(ratio) > 0).all() and 0.8 < ratio[0] and 0.94 < ratio[-1] < 1


def test_where_the_law_holds_and_where_not():
    """Shows its use: many coordinates, tau^2 above 80 log N, within a quarter of the simulated 1 / w_max - 1;
    and its end: 4 coordinates, where it says a half and the largest of 10 000 weights is one in a hundred."""
    p = bootstrap()
    for n_x, n in ((100, 100), (400, 100), (400, 1000)):
        assert n_x * p.log_weight_variance() > 80 * np.log(n)
        inverse = 1 / simulate_weights(p, n_x, n, rng=np.random.default_rng(13), n_runs=2000).largest_weight - 1
        law = 1 / largest_weight(n_x * p.log_weight_variance(), n) - 1
        assert abs(law / inverse.mean() - 1) < 0.25
    few = simulate_weights(p, 4, 10_000, rng=np.random.default_rng(14), n_runs=200).largest_weight.mean()
    assert few < 0.03 and largest_weight(4 * p.log_weight_variance(), 10_000) > 0.5


def test_the_edge_of_collapse():
    """Catches a divergence of the wrong sign or place: far below N = exp(n D) a few weights carry all, far above none.

    150 coordinates of the optimal proposal: exp(n D) is 6e8 by the mean D. With N = 1000 the largest of a thousand
    weights carries about half; for 10 coordinates and N = 1000, well above exp(n D) = 4, about a twentieth.
    """
    p = optimal()
    below, above = (
        simulate_weights(p, n_x, 1000, rng=np.random.default_rng(15), n_runs=1000).largest_weight.mean()
        for n_x in (150, 10)
    )
    assert np.exp(150 * p.divergence()) > 1e6 * 100 and below > 0.5
    assert np.exp(10 * p.divergence()) < 5 and above < 0.1


def test_runs_and_shapes():
    """Catches an axis lost, runs that share draws, and the global generator."""
    p = optimal()
    for n_runs, runs in ((None, ()), (1, (1,)), (3, (3,))):
        w = simulate_weights(p, 5, 20, rng=np.random.default_rng(1), n_runs=n_runs)
        assert w.log_weights.shape == (*runs, 20)
        for number in (w.squared_error, w.log_z_error, w.n_eff, w.largest_weight):
            assert np.shape(number) == runs
    assert len(np.unique(w.log_weights)) == 60
    again = simulate_weights(p, 5, 20, rng=np.random.default_rng(1), n_runs=3)
    assert np.array_equal(again.log_weights, w.log_weights)
    each = simulate_weights(p, 2, 20, rng=np.random.default_rng(1), n_runs=2, z=[[0.0, 0.0], [3.0, 4.0]])
    same = simulate_weights(p, 2, 20, rng=np.random.default_rng(1), n_runs=2, z=[3.0, 4.0])
    assert np.array_equal(each.log_weights[1], same.log_weights[1])
    assert not np.array_equal(each.log_weights[0], same.log_weights[0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Proposal(1.0), "at least 0 and below 1, got 1.0"),
        (lambda: Proposal(0.5).growth(np.nan), "power must be a finite number, got nan"),
        (lambda: Proposal(-0.1), "got -0.1"),
        (lambda: Proposal(np.nan), "got nan"),
        (lambda: Proposal(0.5, fresh=1.1), "fresh is a share, from 0 to 1, got 1.1"),
        (lambda: steady_state(0.0, 1.0), "above zero, got q = 0.0"),
        (lambda: bootstrap(1.0, -1.0), "r = -1.0"),
        (lambda: optimal(np.inf, 1.0), "q = inf"),
        (lambda: bootstrap().n_eff_share(0), "n_x must be at least 1, got 0"),
        (lambda: bootstrap().particles_for_n_eff(0.5, 3), "n_eff must be at least 1, got 0.5"),
        (lambda: bootstrap().particles_for_error(0.0, 3), "error must be above zero, got 0.0"),
        (lambda: bootstrap().particles_for_error(0.1, [1, 0]), "n_x must be at least 1"),
        (lambda: largest_weight(0.0, 10), "variance of the log weights must be above zero"),
        (lambda: largest_weight(1.0, 0), "n_particles must be at least 1"),
        (lambda: simulate(n_x=0), "n_x must be a whole number of at least 1, got 0"),
        (lambda: simulate(n_particles=1.5), "n_particles must be a whole number of at least 1, got 1.5"),
        (lambda: simulate(n_runs=0), "n_runs must be a whole number"),
        (lambda: simulate(z=[1.0, 2.0]), r"z must have shape \(3,\)"),
        (lambda: simulate(z=[1.0, 2.0, np.nan]), "not finite"),
    ],
)
def test_bad_input_is_said_clearly(call, message):
    """Catches a number where there is none: a gain of one, a dimension of zero, innovations of another problem."""
    with pytest.raises(ValueError, match=message):
        call()


def simulate(n_x=3, n_particles=10, **options):
    return simulate_weights(bootstrap(), n_x, n_particles, rng=np.random.default_rng(1), **options)


def test_a_seed_is_no_generator():
    """Catches an error from deep inside."""
    with pytest.raises(TypeError, match="default_rng"):
        simulate_weights(bootstrap(), 2, 10, rng=3)
