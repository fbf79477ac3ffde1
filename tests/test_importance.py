"""Importance sampling against closed forms.

With W the weight before normalising, Zhat its mean over the N draws and m the exact mean of phi, these hold for
every N, without any allowance for bias:

    E[Zhat] = Z,   E[Zhat (mean(phi) - m)] = 0,   E[Zhat^2 N / N_eff] = E[W^2],
    E[(Zhat / Z)^2 (mean(phi) - m)^2] = (1/N) E[W^2 (phi - m)^2] / Z^2

so that the bound is a number of standard errors, each taken from the scatter of independent runs.
"""

import numpy as np
import pytest

from pfedu.gaussian import Gaussian, log_density
from pfedu.importance import importance_sample
from pfedu.models import growth
from pfedu.weights import ZeroLikelihoodError

RUNS = 2000
SEVERAL = 4.5  # standard errors: chance alone exceeds them in 1 of 150 000 comparisons


class Normal:
    """N(mean, cov) as a proposal and as a target."""

    def __init__(self, mean, cov):
        self.mean, self.noise = np.atleast_1d(np.asarray(mean, dtype=float)), Gaussian(cov)

    def sample(self, n, rng):
        return self.mean + self.noise.sample((n,), rng)

    def log_density(self, x):
        return self.noise.log_density(x - self.mean)


def draw(target, proposal, n, seed=1, log_z=0.0, n_runs=RUNS):
    return importance_sample(
        lambda x: target.log_density(x) + log_z,
        proposal.sample,
        proposal.log_density,
        n,
        rng=np.random.default_rng(seed),
        n_runs=n_runs,
    )


def in_standard_errors(values):
    """Largest distance of the mean over runs (axis 0) from zero, in standard errors."""
    return np.max(np.abs(values.mean(axis=0)) / (values.std(axis=0, ddof=1) / np.sqrt(len(values))))


def chi_square(target, proposal):
    """1 + chi^2 = E_q[W^2] / E_q[W]^2, the integral of p^2 / q, for two Gaussians.

    With precisions A of p and B of q, p^2 / q is a Gaussian of precision C = 2A - B (it must be positive), times
    |A| / sqrt(|B| |C|) and the value of its exponent at the peak.
    """
    A, B = np.linalg.inv(target.noise.cov), np.linalg.inv(proposal.noise.cov)
    C = 2 * A - B
    assert (np.linalg.eigvalsh(C) > 0).all()
    a, b = target.mean, proposal.mean
    top = np.linalg.solve(C, 2 * A @ a - B @ b)  # where p^2 / q has its peak
    exponent = -((top - a) @ A @ (top - a)) + 0.5 * (top - b) @ B @ (top - b)
    return np.linalg.det(A) / np.sqrt(np.linalg.det(B) * np.linalg.det(C)) * np.exp(exponent)


PAIRS = {
    "narrow in wide": (Normal(1.0, 0.5), Normal(0.0, 2.0)),
    "beside": (Normal(0.7, 1.0), Normal(0.0, 1.0)),
    "a little too thin": (Normal(0.0, 1.0), Normal(0.2, 0.85)),
    "three dimensions": (
        Normal([0.5, -0.5, 0.0], [[1.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, 0.5]]),
        Normal([0.0, 0.0, 0.3], [1.8, 1.8, 1.5]),
    ),
}
every_pair = pytest.mark.parametrize(("target", "proposal"), PAIRS.values(), ids=PAIRS)


@every_pair
@pytest.mark.parametrize("n", [2, 50])
def test_the_constant_and_the_mean(target, proposal, n):
    """Catches any bias of Zhat or of the mean: a factor N, the proposal left out or turned over, a lost constant."""
    log_z = -3.0
    s = draw(target, proposal, n, log_z=log_z)
    z = np.exp(s.log_z - log_z)
    assert in_standard_errors(z - 1) < SEVERAL
    assert in_standard_errors(z[:, None] * (s.mean() - target.mean)) < SEVERAL
    second = s.mean(lambda x: x[..., 0] ** 2) - target.mean[0] ** 2 - target.noise.cov[0, 0]
    assert in_standard_errors(z * second) < SEVERAL


def test_a_weight_without_the_proposal_is_found_out():
    """Shows that the test above can fail: weights that are the target alone."""
    target, proposal = PAIRS["narrow in wide"]
    flat = Normal(0.0, 2.0)
    flat.log_density = lambda x: np.zeros(x.shape[:-1])
    flat.sample = proposal.sample
    s = draw(target, flat, 50)
    assert in_standard_errors(np.exp(s.log_z)[:, None] * (s.mean() - target.mean)) > SEVERAL


@every_pair
def test_the_effective_number_has_its_closed_form(target, proposal):
    """Catches N_eff of other weights: Zhat^2 N / N_eff has the mean 1 + chi^2 for every N."""
    s = draw(target, proposal, 200)
    assert in_standard_errors(np.exp(2 * s.log_z) * 200 / s.n_eff - chi_square(target, proposal)) < SEVERAL


def test_the_effective_number_tends_to_its_limit():
    """Catches N_eff that is right on average only together with Zhat: a single large sample, to 1 %.

    N_eff (1 + chi^2) / N is a ratio of means with a relative standard error of order 1 / sqrt(N): below 0.2 %.
    """
    target, proposal = PAIRS["narrow in wide"]
    s = draw(target, proposal, 1_000_000, n_runs=None)
    assert s.n_eff / 1_000_000 == pytest.approx(1 / chi_square(target, proposal), rel=0.01)
    assert s.largest_weight == np.exp(s.log_weights).max() < 1e-4


@every_pair
def test_the_variance_of_the_mean(target, proposal):
    """Catches standard errors of the wrong size: true, estimated and closed form must be one variance.

    The true one by (Zhat / Z)^2 (mean - m)^2, exact for every N. The estimate squared times Zhat^2 has the same
    mean up to a share of order (1 + chi^2) / N, here 2000 draws: 1 % is allowed on top of the standard errors.
    """
    n = 2000
    s = draw(target, proposal, n, n_runs=500)
    z2 = np.exp(2 * s.log_z)
    exact = mean_of_square_weight(target, proposal) / n
    true, seen = z2 * (s.mean() - target.mean)[:, 0] ** 2, z2 * s.standard_error()[:, 0] ** 2
    assert in_standard_errors(true - exact) < SEVERAL
    assert abs(seen.mean() - exact) < 0.01 * exact + SEVERAL * seen.std() / np.sqrt(500)


def mean_of_square_weight(target, proposal):
    """E_q[W^2 (x_1 - m_1)^2]: x under p^2 / q is Gaussian, of precision 2A - B."""
    A, B = np.linalg.inv(target.noise.cov), np.linalg.inv(proposal.noise.cov)
    mean = np.linalg.solve(2 * A - B, 2 * A @ target.mean - B @ proposal.mean)
    return chi_square(target, proposal) * (np.linalg.inv(2 * A - B)[0, 0] + (mean - target.mean)[0] ** 2)


def coverage(s, exact, phi=None):
    """Share of runs whose interval of +-1.96 standard errors holds the exact value."""
    return np.mean(np.abs(s.mean(phi) - exact) < 1.96 * s.standard_error(phi))


@pytest.mark.parametrize("name", ["narrow in wide", "beside", "three dimensions"])
def test_the_standard_error_covers(name):
    """Catches a standard error that is too small or too large: 95 % of 2000 intervals hold the exact mean.

    Their share has a standard error of 0.5 %; the estimate is normal up to terms of order 1/N = 0.1 %.
    """
    target, proposal = PAIRS[name]
    s = draw(target, proposal, 1000)
    exact = target.mean[0]
    assert abs(coverage(s, exact, lambda x: x[..., 0]) - 0.95) < SEVERAL * np.sqrt(0.95 * 0.05 / RUNS) + 0.001


def test_the_relative_error_of_z():
    """Catches a wrong divisor, also for N as small as 5: (Zhat err)^2 is the variance s^2 / N without bias."""
    target, proposal = PAIRS["beside"]
    variance = chi_square(target, proposal) - 1
    for n in (5, 100):
        s = draw(target, proposal, n, n_runs=20_000 if n == 5 else RUNS)
        assert in_standard_errors(np.exp(2 * s.log_z) * s.z_relative_error**2 - variance / n) < SEVERAL
        assert in_standard_errors((np.exp(s.log_z) - 1) ** 2 - variance / n) < SEVERAL


def test_plain_and_self_normalised():
    """Catches the two estimates mixed up: both means, both variances, and which of them needs the constant.

    Of phi = x + 10 the plain estimate has the variance E[W^2 phi^2] - 10.7^2, the self-normalised that of phi - m.
    """
    (target, proposal), n = PAIRS["beside"], 500
    s, phi = draw(target, proposal, n), lambda x: x[..., 0] + 10.0
    m, d = 10.7, 0.7  # x under p^2/q: N(2 d, 1), so that phi has the mean 10 + 2 d
    plain = (chi_square(target, proposal) * (1 + (10 + 2 * d) ** 2) - m**2) / n
    assert in_standard_errors(s.plain_mean(phi) - m) < SEVERAL
    assert in_standard_errors((s.plain_mean(phi) - m) ** 2 - plain) < SEVERAL
    assert in_standard_errors(s.plain_standard_error(phi) ** 2 - plain) < SEVERAL
    assert np.mean((s.mean(phi) - m) ** 2) < plain / 20  # the constant 10 costs it nothing
    scaled = draw(target, proposal, n, log_z=np.log(3.0))
    np.testing.assert_allclose(scaled.plain_mean(phi), 3 * s.plain_mean(phi), rtol=1e-12)
    np.testing.assert_allclose(scaled.mean(phi), s.mean(phi), rtol=1e-12)


def test_the_plain_estimate_of_one_is_z():
    """Catches two meanings of the constant."""
    s = draw(*PAIRS["beside"], 20, log_z=-2.0, n_runs=7)
    one = lambda x: np.ones(x.shape[:-1])  # noqa: E731
    np.testing.assert_allclose(s.plain_mean(one), np.exp(s.log_z), rtol=1e-12)
    np.testing.assert_allclose(s.plain_standard_error(one), np.exp(s.log_z) * s.z_relative_error, rtol=1e-9)
    np.testing.assert_allclose(s.mean(one), 1.0, rtol=1e-14)
    np.testing.assert_allclose(s.standard_error(one), 0.0, atol=1e-15)


@pytest.mark.parametrize("n", [10, 1000])
def test_independent_draws_have_variance_p_over_n(n):
    """Catches weights where there should be none: var(mean) = var(x) / N, by the chi-square of 2000 runs.

    The mean square of 2000 normal deviations has the relative standard error sqrt(2 / 2000).
    """
    target = Normal([1.0, -2.0], [4.0, 0.25])
    s = draw(target, target, n)
    np.testing.assert_allclose(s.n_eff, n, rtol=1e-12)
    np.testing.assert_allclose(s.log_z, 0.0, atol=1e-12)
    variance = np.mean((s.mean() - target.mean) ** 2, axis=0)
    assert (np.abs(variance * n / [4.0, 0.25] - 1) < SEVERAL * np.sqrt(2 / RUNS)).all()
    seen = np.mean(s.standard_error() ** 2, axis=0)  # of N draws about their own mean: (N - 1) / N
    assert (np.abs(seen * n / [4.0, 0.25] / (1 - 1 / n) - 1) < SEVERAL * np.sqrt(2 / (n * RUNS))).all()


def test_tails_that_are_too_thin_misreport_themselves():
    """Shows what the numbers cannot show: N(0, 0.2) for N(0, 1) has weights of infinite variance.

    More than half of the intervals of 95 % for E[x^2] lie wholly below the exact 1, since what would raise them
    was not drawn, and more than half of the Zhat lie below Z, though their mean is Z. (Shares of 2000 runs: 1.1 %
    is one standard error of one half.) The same target from N(0, 2) has no such trouble.
    """
    target, square = Normal(0.0, 1.0), lambda x: x[..., 0] ** 2
    thin, wide = (draw(target, Normal(0.0, v), 1000) for v in (0.2, 2.0))
    half = 0.5 + SEVERAL * 0.5 / np.sqrt(RUNS)
    assert np.mean(thin.mean(square) + 1.96 * thin.standard_error(square) < 1.0) > half
    assert coverage(thin, 1.0, square) < 1 - half
    assert np.mean(thin.log_z < 0) > half
    assert abs(coverage(wide, 1.0, square) - 0.95) < SEVERAL * np.sqrt(0.95 * 0.05 / RUNS) + 0.001


def test_thin_tails_have_no_limit_of_n_eff():
    """Shows the one sign there is: N_eff / N falls on with N, where it should settle.

    With q = N(0, v) the tail of W falls as the power -1 / (1 - v); for v below 1/2 its variance is infinite, and
    N_eff / N falls in the end as N^(2 v - 1): for v = 0.2, by 1/16 from N = 100 to 10 000, a bound of 1/4 while that
    is approached. With v = 2 it settles. Medians of 400 runs, so that one lucky run counts for nothing.
    """
    target = Normal(0.0, 1.0)

    def share(v, n):
        return np.median(draw(target, Normal(0.0, v), n, n_runs=400).n_eff) / n

    assert share(0.2, 10_000) < share(0.2, 100) / 4
    assert share(2.0, 10_000) == pytest.approx(share(2.0, 100), rel=0.03)


def test_a_target_that_is_zero_somewhere():
    """Catches NaN from log 0 and from what phi is there: uniform on (0, 1), drawn from N(0.5, 1).

    E[log x] = -1, and log x is NaN or -inf at more than half of the draws. chi^2 is moderate, so the law holds.
    """

    def log_uniform(x):
        return np.where((x[..., 0] > 0) & (x[..., 0] < 1), 0.0, -np.inf)

    def log_x(x):
        with np.errstate(invalid="ignore"):
            return np.log(x)

    q = Normal(0.5, 1.0)
    s = importance_sample(log_uniform, q.sample, q.log_density, 1000, rng=np.random.default_rng(1), n_runs=RUNS)
    z = np.exp(s.log_z)
    assert in_standard_errors(z - 1) < SEVERAL
    assert in_standard_errors(z[:, None] * (s.mean(log_x) + 1)) < SEVERAL
    assert in_standard_errors(s.plain_mean(log_x) + 1) < SEVERAL
    assert np.isfinite(s.standard_error(log_x)).all() and np.isfinite(s.plain_standard_error(log_x)).all()
    assert (s.n_eff < 500).all()  # 38 % of the draws carry all


@pytest.mark.parametrize("shift", [-1e4, 1e4])
def test_a_constant_that_no_double_can_hold(shift):
    """Catches weights that leave the log scale: exp(+-10000) is no double, the estimates must not change."""
    at_home, far = (draw(*PAIRS["three dimensions"], 50, log_z=log_z, n_runs=3) for log_z in (0.0, shift))
    np.testing.assert_allclose(far.log_z - shift, at_home.log_z, atol=1e-10)
    np.testing.assert_allclose(far.mean(), at_home.mean(), rtol=1e-9)
    np.testing.assert_allclose(far.standard_error(), at_home.standard_error(), rtol=1e-9)


def test_five_draws_by_hand():
    """Catches a formula that parts from the paper: W = 8, 4, 2, 2, 0, so w = 1/2, 1/4, 1/8, 1/8, 0 and Zhat = 3.2.

    The draws are x = 0, 1, 2, 3, 4, and the rest are fractions.
    """
    with np.errstate(divide="ignore"):
        log_w = np.log([8.0, 4.0, 2.0, 2.0, 0.0])
    s = importance_sample(
        lambda x: log_w - 1.0,
        lambda n, rng: np.arange(5.0)[:, None],
        lambda x: np.full(5, -1.0),
        5,
        rng=np.random.default_rng(1),
    )
    np.testing.assert_allclose(np.exp(s.log_weights), [1 / 2, 1 / 4, 1 / 8, 1 / 8, 0], rtol=1e-14)
    np.testing.assert_allclose(np.exp(s.log_z), 16 / 5, rtol=1e-14)
    np.testing.assert_allclose([s.n_eff, s.largest_weight], [64 / 22, 1 / 2], rtol=1e-14)
    np.testing.assert_allclose(s.mean(), [7 / 8], rtol=1e-14)
    # deviations -7, 1, 9, 17 eighths times weights 4, 2, 1, 1 eighths
    np.testing.assert_allclose(s.standard_error(), [np.sqrt(28**2 + 2**2 + 9**2 + 17**2) / 64], rtol=1e-14)
    np.testing.assert_allclose(s.plain_mean(), [14 / 5], rtol=1e-14)
    # terms 0, 4, 4, 6, 0 about 2.8: squares sum to 28.8, divided by 4, by 5
    np.testing.assert_allclose(s.plain_standard_error(), [np.sqrt(28.8 / 20)], rtol=1e-14)
    # W about 3.2: squares sum to 36.8
    np.testing.assert_allclose(s.z_relative_error, np.sqrt(36.8 / 20) / 3.2, rtol=1e-14)


def test_shapes_of_phi():
    """Catches an axis that is lost or summed: a number, a vector, a single component, with and without runs."""
    phis = {(): lambda x: x[..., 0], (1,): lambda x: x[..., :1], (4,): lambda x: np.stack([x[..., 0]] * 4, axis=-1)}
    for n_runs, runs in ((None, ()), (1, (1,)), (3, (3,))):
        s = draw(*PAIRS["three dimensions"], 20, n_runs=n_runs)
        assert s.x.shape == (*runs, 20, 3) and s.log_weights.shape == (*runs, 20)
        for number in (s.log_z, s.n_eff, s.largest_weight, s.z_relative_error):
            assert number.shape == runs
        for estimate in (s.mean, s.standard_error, s.plain_mean, s.plain_standard_error):
            assert estimate().shape == (*runs, 3)
            for shape, phi in phis.items():
                assert estimate(phi).shape == runs + shape
                np.testing.assert_allclose(estimate(phi).reshape(*runs, -1)[..., 0], estimate()[..., 0], rtol=1e-12)


def test_a_batch_is_a_loop_over_its_draws():
    """Catches runs that share weights or constants: each run of a batch, computed alone from its own draws."""
    target, proposal = PAIRS["narrow in wide"]
    batch = draw(target, proposal, 30, n_runs=4)
    assert len(np.unique(batch.x)) == 120
    for run in range(4):
        alone = importance_sample(
            target.log_density,
            lambda n, rng, run=run: batch.x[run],
            proposal.log_density,
            30,
            rng=np.random.default_rng(1),
        )
        np.testing.assert_allclose(alone.log_weights, batch.log_weights[run], rtol=1e-12)
        for name in ("mean", "standard_error", "plain_mean", "plain_standard_error"):
            np.testing.assert_allclose(getattr(alone, name)(), getattr(batch, name)()[run], rtol=1e-12)
        for name in ("log_z", "n_eff", "z_relative_error"):
            np.testing.assert_allclose(getattr(alone, name), getattr(batch, name)[run], rtol=1e-12)


def test_the_same_seed_gives_the_same_bits():
    """Catches the global generator."""
    a, b, c = (draw(*PAIRS["beside"], 10, seed=seed, n_runs=2) for seed in (1, 1, 2))
    assert np.array_equal(a.x, b.x) and np.array_equal(a.log_weights, b.log_weights)
    assert not np.array_equal(a.x, c.x)


def test_a_model_is_a_proposal():
    """Catches signatures that do not fit: prior of the growth model, first measurement, against quadrature."""
    model, y = growth(), np.array([1.5])
    nodes = np.linspace(-40, 40, 8001)[:, None]
    p = np.exp(model.log_initial(nodes) + model.log_likelihood(0, y, nodes))
    s = importance_sample(
        lambda x: model.log_initial(x) + model.log_likelihood(0, y, x),
        model.sample_initial,
        model.log_initial,
        200,
        rng=np.random.default_rng(1),
        n_runs=RUNS,
    )
    z = np.exp(s.log_z) / (p.sum() * 0.01)
    second = (p @ nodes[:, 0] ** 2) / p.sum()
    assert in_standard_errors(z - 1) < SEVERAL
    assert in_standard_errors(z * (s.mean(lambda x: x[..., 0] ** 2) - second)) < SEVERAL


def attempt(log_target=None, sample=None, log_proposal=None, n=10, rng=None, **options):
    q = Normal(0.0, 1.0)
    return importance_sample(
        log_target or q.log_density,
        sample or q.sample,
        log_proposal or q.log_density,
        n,
        rng=rng or np.random.default_rng(1),
        **options,
    )


def constant(value):
    return lambda x: np.full(x.shape[:-1], value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"log_target": constant(np.nan)}, r"log_target gave nan at x = \["),
        ({"log_target": constant(np.inf)}, r"log_target gave inf at x = \["),
        ({"log_target": lambda x: -(x**2)}, r"log_target must give shape \(10,\) for draws \(10, 1\)"),
        ({"log_target": lambda x: 0.0}, r"log_target must give shape .* it gave \(\)"),
        ({"log_proposal": constant(np.nan)}, "log_proposal gave nan"),
        ({"log_proposal": constant(np.inf)}, "log_proposal gave inf"),
        ({"log_proposal": constant(-np.inf)}, "do not belong together"),
        ({"log_proposal": lambda x: x}, "log_proposal must give shape"),
        ({"sample": lambda n, rng: rng.standard_normal(n)}, r"here \(10, n_x\); it gave \(10,\)"),
        ({"sample": lambda n, rng: rng.standard_normal((n + 1, 1))}, r"it gave \(11, 1\)"),
        ({"sample": lambda n, rng: np.full((n, 1), np.nan)}, r"not finite: \[nan\]"),
        ({"n": 1}, "n_particles must be a whole number of at least 2, got 1"),
        ({"n": 2.5}, "n_particles"),
        ({"n_runs": 0}, "n_runs must be a whole number of at least 1, got 0"),
    ],
)
def test_bad_input_is_said_clearly(options, message):
    """Catches a NaN that would spread, broadcasting that hides a lost axis, and a density of another proposal."""
    with pytest.raises(ValueError, match=message):
        attempt(**options)


def test_a_seed_is_no_generator():
    """Catches an error from deep inside the caller's own function."""
    with pytest.raises(TypeError, match="default_rng"):
        attempt(rng=7)


def test_a_target_that_is_missed_altogether():
    """Catches weights of 0 / 0: one run of three that sees nothing is enough for the error."""
    with pytest.raises(ZeroLikelihoodError, match="zero at all 10 draws"):
        attempt(log_target=constant(-np.inf))

    def blind_in_one_run(x):
        return np.where(np.arange(3)[:, None] == 1, -np.inf, np.zeros(x.shape[:-1]))

    with pytest.raises(ZeroLikelihoodError):
        attempt(log_target=blind_in_one_run, n_runs=3)


@pytest.mark.parametrize(
    ("phi", "message"),
    [
        (lambda x: x.sum(), r"phi must give shape \(10,\) or \(10, 'm'\).* it gave \(\)"),
        (lambda x: x[:-1], r"it gave \(9, 1\)"),
        (lambda x: x[..., None], r"it gave \(10, 1, 1\)"),
        (lambda x: np.full(len(x), np.nan), r"phi gave nan at x = \[.*has a weight"),
        (lambda x: np.full(x.shape, np.inf), "phi gave inf"),
    ],
)
def test_a_bad_phi_is_said_clearly(phi, message):
    """Catches a mean over the wrong axis, and NaN as an answer."""
    for estimate in ("mean", "standard_error", "plain_mean", "plain_standard_error"):
        with pytest.raises(ValueError, match=message):
            getattr(attempt(), estimate)(phi)


def test_functions_cannot_change_the_draws():
    """Catches a target or phi that shifts x in place and so moves the sample under its own weights."""

    def shifts(x):
        x -= 1.0
        return log_density(x, 0.0, 1.0)

    with pytest.raises(ValueError, match="read-only"):
        attempt(log_target=shifts)
    with pytest.raises(ValueError, match="read-only"):
        attempt().mean(shifts)
