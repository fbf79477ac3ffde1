"""Gaussian noise: roots, samples and densities."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfedu.gaussian import Gaussian, as_cov, log_density, sqrt_cov
from pfedu.kalman import update

SINGULAR = np.array([[1.0, 2.0, 0.0], [2.0, 4.0, 0.0], [0.0, 0.0, 3.0]])  # null direction (2, -1, 0)
REGULAR = np.array([[2.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 0.5]])
properties = settings(deadline=None, max_examples=100, derandomize=True)


def density_by_definition(d, P):
    """The textbook formula, with determinant and inverse."""
    return -0.5 * (d @ np.linalg.inv(P) @ d + np.linalg.slogdet(P)[1] + len(d) * np.log(2 * np.pi))


def test_a_scalar_a_vector_and_a_matrix_state_the_same_covariance():
    """Catches a vector read as standard deviations or as a row of a matrix."""
    assert as_cov(4.0).tolist() == [[4.0]]
    assert as_cov([1.0, 4.0]).tolist() == as_cov(np.diag([1.0, 4.0])).tolist()


@pytest.mark.parametrize(
    ("cov", "message"),
    [
        (np.ones((2, 3)), r"Q must be a scalar, a vector of variances or a square matrix, got shape \(2, 3\)"),
        ([[1.0, 0.5], [0.4, 1.0]], "Q is not symmetric"),
        ([[1.0, np.nan], [np.nan, 1.0]], "Q has an entry that is not finite"),
        (np.inf, "Q has an entry that is not finite"),
        ([[1.0, 2.0], [2.0, 1.0]], "Q is not positive semi-definite: its correlations have the eigenvalue -1"),
        (-1.0, "Q is not positive semi-definite: it has the variance -1"),
    ],
)
@pytest.mark.parametrize("use", [sqrt_cov, Gaussian])
def test_what_is_no_covariance_is_named(use, cov, message):
    """Catches a Cholesky factor that reads one triangle only, and NaN that comes back as a root."""
    with pytest.raises(ValueError, match=message):
        use(cov, "Q")


@pytest.mark.parametrize("cov", [[1e6, 4e6, -4e-6], np.diag([1e6, 4e6, -4e-6])])
def test_a_negative_variance_is_an_error_beside_large_ones(cov):
    """Catches a sign slip in one state of many units, which a tolerance relative to the largest hides."""
    with pytest.raises(ValueError, match="not positive semi-definite"):
        sqrt_cov(cov)


@pytest.mark.parametrize("other", [0.0, 1.0])
def test_a_covariance_with_what_does_not_vary_is_an_error(other):
    """Catches a tolerance that turns an indefinite matrix into another one: |cov| <= sd sd leaves no room here."""
    with pytest.raises(
        ValueError, match="P0 is not positive semi-definite: a variance of zero has the covariance 1e-11"
    ):
        sqrt_cov([[0.0, 1e-11], [1e-11, other]], "P0")
    with pytest.raises(ValueError, match="a variance of zero"):
        sqrt_cov([np.eye(2), [[0.0, 1e-11], [1e-11, other]]])


def test_one_bad_covariance_in_a_batch_is_an_error():
    """Catches a tolerance taken from the largest covariance of the batch."""
    with pytest.raises(ValueError, match="not positive semi-definite"):
        sqrt_cov([[[1e12]], [[-1.0]]])


@pytest.mark.parametrize("cov", [0.0, 4.0, [1.0, 0.0, 2.0], REGULAR, SINGULAR, np.zeros((2, 2)), np.ones((3, 3))])
def test_root_times_its_transpose_is_the_covariance(cov):
    """Catches a transposed root and a singular covariance that is not handled."""
    S, P = sqrt_cov(cov), as_cov(cov)
    np.testing.assert_allclose(S @ S.T, P, rtol=0, atol=1e-14 * max(np.abs(P).max(), 1e-300) * len(P))


def test_roots_of_a_batch_are_the_roots_of_each():
    """Catches eigenvectors scaled along the wrong axis; one singular member takes the whole batch there."""
    S = sqrt_cov(np.stack([REGULAR, SINGULAR]))
    np.testing.assert_allclose(S @ np.swapaxes(S, -1, -2), np.stack([REGULAR, SINGULAR]), rtol=0, atol=1e-14 * 4 * 3)


@properties
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_every_gram_matrix_is_accepted(entries):
    """Catches a test for positive semi-definite that rejects rounding: A A' of rank two is always one."""
    A = np.reshape(entries, (3, 2))
    P = A @ A.T
    S = sqrt_cov(P)
    # the eigenvector root clips eigenvalues down to -1e-10 of the largest
    np.testing.assert_allclose(S @ S.T, P, rtol=0, atol=1e-9 * max(P.max(), 1e-300))


@pytest.mark.parametrize("cov", [4.0, [1.0, 9.0], REGULAR, SINGULAR])
def test_samples_have_the_covariance(cov):
    """Catches a variance used as a standard deviation and z @ S for z @ S'.

    An entry of a sample covariance of n Gaussian draws (mean known) has variance
    (P_ii P_jj + P_ij^2) / n; the mean has variance P_ii / n. Four standard errors each.
    """
    n, noise = 40_000, Gaussian(cov)
    x, P = noise.sample((n,), np.random.default_rng(3)), noise.cov
    se_cov = np.sqrt((np.outer(np.diag(P), np.diag(P)) + P**2) / n)
    assert x.shape == (n, noise.n)
    assert (np.abs(x.T @ x / n - P) <= 4 * se_cov + 1e-12).all()
    assert (np.abs(x.mean(axis=0)) <= 4 * np.sqrt(np.diag(P) / n) + 1e-12).all()


def test_no_noise_leaks_into_the_null_direction():
    """Catches jitter added to a singular covariance: 2 x_0 = x_1 holds for every draw."""
    x = Gaussian(SINGULAR).sample((1000,), np.random.default_rng(4))
    np.testing.assert_allclose(2 * x[:, 0], x[:, 1], rtol=0, atol=1e-6)
    assert (Gaussian([1.0, 0.0]).sample((5,), np.random.default_rng(4))[:, 1] == 0).all()


def test_the_same_draws_are_scaled_by_another_covariance():
    """Catches a sampler that consumes randomness differently for another variance: a slider moves one thing."""
    small, large = (Gaussian(v).sample((7,), np.random.default_rng(5)) for v in (1.0, 9.0))
    np.testing.assert_allclose(large, 3 * small, rtol=1e-14)


@pytest.mark.parametrize("cov", [4.0, [1.0, 9.0], REGULAR])
def test_log_density_is_the_formula(cov):
    """Catches a lost log determinant, a lost 2 pi and a whitening by the transpose, one or many at a time."""
    noise = Gaussian(cov)
    d = np.random.default_rng(6).standard_normal((2, 5, noise.n))
    want = [[density_by_definition(v, noise.cov) for v in row] for row in d]
    np.testing.assert_allclose(noise.log_density(d), want, rtol=1e-12)
    np.testing.assert_allclose(log_density(d + 7.0, np.full(noise.n, 7.0), cov), want, rtol=1e-12)


def test_log_density_takes_one_covariance_for_each_point():
    """Catches a batch of covariances used crosswise."""
    covs, d = np.stack([REGULAR, np.eye(3)]), np.random.default_rng(7).standard_normal((2, 3))
    want = [density_by_definition(v, P) for v, P in zip(d, covs, strict=True)]
    np.testing.assert_allclose(log_density(d, np.zeros(3), covs), want, rtol=1e-12)


def test_a_density_integrates_to_one():
    """Catches any constant, without a formula to copy it from; the trapezoidal rule is exact to rounding here."""
    x = np.linspace(-20, 20, 2001)
    assert np.exp(Gaussian(2.5).log_density(x[:, None])).sum() * (x[1] - x[0]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("cov", [0.0, [1.0, 0.0], SINGULAR, [[0.01, 0.03], [0.03, 0.09]]])
def test_a_singular_covariance_has_no_density(cov):
    """Catches a density of 1e18 returned where there is none."""
    noise = Gaussian(cov, "Q")
    with pytest.raises(ValueError, match="Q is singular and has no density"):
        noise.log_density(np.zeros(noise.n))


def test_every_covariance_of_rank_one_has_no_density():
    """Catches a rank-one covariance whose Cholesky factor exists only by rounding: its density is noise."""
    a = np.random.default_rng(8).standard_normal((200, 2))
    assert all(Gaussian(np.outer(v, v)).is_singular for v in a)


def test_log_density_of_an_indefinite_covariance_is_an_error():
    """Catches a NaN returned as a likelihood."""
    with pytest.raises(ValueError, match="not positive definite"):
        log_density([0.0, 0.0], [0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]])


@pytest.mark.parametrize("bad", [0.0, -3.0, np.nan])
def test_of_many_covariances_a_message_shows_the_bad_one(bad):
    """Catches a message with a matrix for each of 100 000 particles, and one that names none."""
    cov = np.ones((1000, 1, 1))
    cov[700] = bad
    with pytest.raises(ValueError, match=rf"the proposal .*: \[\[{bad}\]\]$"):
        log_density(np.zeros((1000, 1)), 0.0, cov, "the proposal")


def test_noise_is_one_covariance():
    """Catches a batch of covariances where one is meant."""
    with pytest.raises(ValueError, match=r"R must be one matrix \(n, n\), got shape \(2, 1, 1\)"):
        Gaussian(np.ones((2, 1, 1)), "R")


@pytest.fixture
def numpy_of_the_page(monkeypatch):
    """Linear algebra as numpy in the browser does it: nothing is raised, what fails is NaN."""

    def silent(function):
        def wrapped(*given):
            try:
                return function(*given)
            except np.linalg.LinAlgError:
                return np.full_like(given[-1], np.nan)

        return wrapped

    for name in ("cholesky", "solve"):
        monkeypatch.setattr(np.linalg, name, silent(getattr(np.linalg, name)))


def test_roots_and_messages_are_the_same_in_the_page(numpy_of_the_page):
    """Catches a fallback, or a clear error, that is never reached where numpy cannot raise."""
    root = sqrt_cov(SINGULAR)
    np.testing.assert_allclose(root @ root.T, SINGULAR, atol=1e-12)
    with pytest.raises(ValueError, match="P is not positive definite"):
        log_density(np.zeros(3), 0.0, SINGULAR, "P")
    with pytest.raises(ValueError, match="H P H' \\+ R is singular"):
        update(np.zeros(1), np.zeros((1, 1)), np.ones(1), np.eye(1), np.zeros((1, 1)))
