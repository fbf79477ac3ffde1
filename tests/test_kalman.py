"""The Kalman filter against answers that were found in another way."""

import numpy as np
import pytest
from records import measurements, reference

import pfedu
from pfedu.data import nile
from pfedu.kalman import correct, kalman_filter, predict
from pfedu.models import LinearGaussian, MissingPieceError, growth, local_level, random_walk

NAN = np.nan


def joint_gaussian_posterior(model, y):
    """Filtered means, covariances and log-likelihoods by conditioning the whole trajectory at once.

    Trajectory and measurements are one Gaussian vector, written down from the model's equations:
    x = A (x_0, w_1, ..., w_T), y = H x + v. No recursion; each step conditions on all rows so far.
    """
    T, n = len(y) - 1, model.n_x
    A = np.zeros(((T + 1) * n, (T + 1) * n))
    for k in range(T + 1):
        for j in range(k + 1):
            A[k * n : (k + 1) * n, j * n : (j + 1) * n] = np.linalg.matrix_power(model.F, k - j)
    noise = np.zeros_like(A)
    for k in range(T + 1):
        noise[k * n : (k + 1) * n, k * n : (k + 1) * n] = model.Q if k else model.P0
    mean_x, cov_x = A[:, :n] @ model.m0, A @ noise @ A.T
    C = np.kron(np.eye(T + 1), model.H)
    mean_y, cov_y = C @ mean_x, C @ cov_x @ C.T + np.kron(np.eye(T + 1), model.R)
    flat, log_p = y.ravel(), [0.0]
    means, covs = [], []
    for k in range(T + 1):
        seen = np.flatnonzero(~np.isnan(flat[: (k + 1) * model.n_y]))
        now = slice(k * n, (k + 1) * n)
        S, cross = cov_y[np.ix_(seen, seen)], (cov_x @ C.T)[now][:, seen]
        d = flat[seen] - mean_y[seen]
        gain = cross @ np.linalg.inv(S)
        means.append(mean_x[now] + gain @ d)
        covs.append(cov_x[now, now] - gain @ cross.T)
        log_p.append(-0.5 * (d @ np.linalg.inv(S) @ d + np.linalg.slogdet(S)[1] + len(seen) * np.log(2 * np.pi)))
    return np.array(means), np.array(covs), np.diff(log_p)


# Three states, two measured quantities, noises that are correlated; no matrix is symmetric by chance.
F = np.array([[0.9, 0.3, 0.0], [-0.2, 1.0, 0.4], [0.1, 0.0, 0.7]])
H = np.array([[1.0, 0.0, 0.5], [0.3, -1.0, 0.2]])
R = np.array([[0.5, 0.2], [0.2, 0.8]])
P0 = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 1.5]])
FULL = np.array([[1.0, 0.4, 0.0], [0.4, 0.6, -0.1], [0.0, -0.1, 0.3]])
RANK_ONE = np.outer([1.0, 2.0, -1.0], [1.0, 2.0, -1.0])


def three_states(Q=FULL):
    return LinearGaussian(F=F, H=H, Q=Q, R=R, m0=[1.0, -2.0, 0.5], P0=P0)


@pytest.mark.parametrize("with_y0", [False, True])
def test_the_reference_record(with_y0):
    """Catches a first measurement used when it is missing (or not used when it is there), and any constant."""
    data, suffix = reference("linear_A"), "_with_y0" if with_y0 else ""
    track = kalman_filter(random_walk(), measurements("linear_A", with_y0=with_y0))
    np.testing.assert_allclose(track.mean[:, 0], data[f"kf_mean{suffix}"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(track.cov[:, 0, 0], data[f"kf_var{suffix}"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(track.log_likelihood_increments, data[f"loglik_inc{suffix}"], rtol=0, atol=1e-9)
    assert track.log_likelihood == pytest.approx(-136.7534810489 if with_y0 else -133.2318559261, abs=1e-9)


@pytest.mark.parametrize("Q", [FULL, RANK_ONE, np.zeros((3, 3))], ids=["full", "rank one", "zero"])
@pytest.mark.parametrize("missing", [[], [0], [2, 3], [0, 6]], ids=str)
def test_several_dimensions_against_the_joint_gaussian(Q, missing):
    """Catches transposes that a scalar hides, a singular Q, and a missing row that still moves the mean."""
    model = three_states(Q)
    y = model.simulate(6, np.random.default_rng(1))[1]
    y[missing] = NAN
    mean, cov, increments = joint_gaussian_posterior(model, y)
    track = kalman_filter(model, y)
    np.testing.assert_allclose(track.mean, mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(track.cov, cov, rtol=0, atol=1e-9)
    np.testing.assert_allclose(track.log_likelihood_increments, increments, rtol=0, atol=1e-9)


def test_a_missing_row_is_predicted_over():
    """Catches a correction with a made-up value: posterior = prediction, log-likelihood increment exactly zero."""
    model = three_states()
    y = model.simulate(3, np.random.default_rng(2))[1]
    y[2] = NAN
    track = kalman_filter(model, y)
    m, P = predict(track.mean[1], track.cov[1], model.F, model.Q)
    np.testing.assert_array_equal(track.mean[2], m)
    np.testing.assert_array_equal(track.cov[2], P)
    assert track.log_likelihood_increments[2] == 0.0


def test_a_batch_is_a_loop_over_its_records():
    """Catches records that mix, also where one misses a row and another does not."""
    model = three_states()
    y = model.simulate(8, np.random.default_rng(3), n_runs=6)[1].reshape(2, 3, 9, 2)
    y[0, 1, 4], y[1, 2, 0], y[:, :, 7] = NAN, NAN, NAN
    together = kalman_filter(model, y)
    assert together.mean.shape == (2, 3, 9, 3) and together.cov.shape == (2, 3, 9, 3, 3)
    assert together.log_likelihood.shape == (2, 3)
    for run in np.ndindex(2, 3):
        alone = kalman_filter(model, y[run])
        np.testing.assert_allclose(together.mean[run], alone.mean, rtol=0, atol=1e-12)
        np.testing.assert_allclose(together.cov[run], alone.cov, rtol=0, atol=1e-12)
        np.testing.assert_allclose(together.log_likelihood[run], alone.log_likelihood, rtol=0, atol=1e-11)


def test_a_constant_is_estimated_as_in_any_statistics_book():
    """Catches a variance that does not fall: Q = 0 leaves Bayes' rule for n measurements of one number."""
    p0, r, y = 5.0, 2.0, np.array([[1.0], [3.0], [-2.0], [0.5]])
    track = kalman_filter(random_walk(q=0.0, r=r, m0=1.0, p0=p0), y)
    n = np.arange(1, 5)
    want_var = 1 / (1 / p0 + n / r)
    np.testing.assert_allclose(track.cov[:, 0, 0], want_var, rtol=1e-13)
    np.testing.assert_allclose(track.mean[:, 0], want_var * (1.0 / p0 + y[:, 0].cumsum() / r), rtol=1e-13)


def test_the_variance_settles_at_the_root_of_the_riccati_equation():
    """Catches q and r swapped: for a random walk p- = (q + sqrt(q^2 + 4 q r)) / 2 and p+ = p- r / (p- + r)."""
    q, r = 10.0, 1.0
    before = (q + np.sqrt(q * q + 4 * q * r)) / 2
    track = kalman_filter(random_walk(q=q, r=r), np.zeros((60, 1)))
    assert track.cov[-1, 0, 0] == pytest.approx(before * r / (before + r), rel=1e-12)


def test_the_nile():
    """Catches a start, a burned-in term or a constant that differs from the literature's.

    Local level with Durbin and Koopman's variances, first measurement burned. statsmodels 0.15
    (UnobservedComponents) gives -632.5456251156739 with ``use_exact_diffuse=True`` less the constant
    -log(2 pi)/2 it counts for the first measurement, and -632.5376950475525 with its default start,
    which is not quite flat: N(0, 1e6).
    """
    y = nile()[1][:, None]
    rest = np.vstack([[[NAN]], y[1:]])
    exact = kalman_filter(local_level(y[0, 0], q=1469.1, r=15099.0), rest)
    assert exact.log_likelihood == pytest.approx(-632.5456251156739, abs=1e-9)
    default = kalman_filter(random_walk(q=1469.1, r=15099.0, p0=1e6), y)
    assert default.log_likelihood_increments[1:].sum() == pytest.approx(-632.5376950475525, abs=1e-9)


def test_the_covariance_stays_symmetric_and_positive():
    """Catches (I - K H) P: with measurements a million times sharper than the prior it loses both by rounding."""
    model = LinearGaussian(
        F=[[1.0, 1.0], [0.0, 1.0]], H=[[1.0, 1.0], [1.0, 1.0 + 1e-6]], Q=np.zeros((2, 2)),
        R=[1e-12, 1e-12], m0=[0.0, 0.0], P0=[1e6, 1e6],
    )  # fmt: skip
    P = kalman_filter(model, np.zeros((10, 2))).cov
    assert (np.linalg.eigvalsh(P) > 0).all() and (np.diagonal(P, axis1=-2, axis2=-1) > 0).all()
    # Joseph's form is symmetric up to the rounding of its own two terms
    largest = np.abs(P).max(axis=(-2, -1))
    assert (np.abs(P[:, 0, 1] - P[:, 1, 0]) <= 8 * np.finfo(float).eps * largest).all()


def test_correct_by_hand():
    """Catches a gain without H, or an innovation with the wrong sign.

    Prior N(1, 4) of one quantity, measured twice over: y = 2 x + N(0, 9) = 8. S = 25, K = 8/25.
    """
    m, P, log_p = correct(np.array([1.0]), np.array([[4.0]]), np.array([8.0]), np.array([[2.0]]), np.array([[9.0]]))
    assert m[0] == pytest.approx(1 + 8 / 25 * 6)
    assert P[0, 0] == pytest.approx(4 * 9 / 25)
    assert log_p == pytest.approx(-0.5 * (36 / 25 + np.log(2 * np.pi * 25)))


def test_predict_by_hand():
    """Catches F' P F for F P F': F = [[1, 1], [0, 1]], P = I gives [[2, 1], [1, 1]]."""
    m, P = predict(np.array([1.0, 2.0]), np.eye(2), np.array([[1.0, 1.0], [0.0, 1.0]]), np.diag([0.5, 0.25]))
    assert m.tolist() == [3.0, 2.0] and P.tolist() == [[2.5, 1.0], [1.0, 1.25]]


def test_fields_that_a_kalman_filter_has_not_are_none():
    """Catches zeros where there is nothing: a figure must be able to ask."""
    track = kalman_filter(random_walk(), [[1.0]])
    assert track.n_eff is track.resampled is track.particles is track.grid is track.density is None


def test_a_missing_row_needs_no_measurement_noise():
    """Catches a correction worked out and thrown away: with r = 0 and a known start it divides by zero."""
    track = kalman_filter(random_walk(q=1.0, r=0.0, p0=0.0), [[NAN], [2.0]])
    assert track.mean.ravel().tolist() == [0.0, 2.0] and track.cov.ravel().tolist() == [0.0, 0.0]


def test_a_model_that_is_not_linear_is_an_error():
    """Catches 'object has no attribute F' three calls down."""
    with pytest.raises(MissingPieceError, match="AdditiveGaussian has no F, which the Kalman filter needs"):
        pfedu.kalman_filter(growth(), [[1.0]])


@pytest.mark.parametrize(
    ("y", "message"),
    [
        (np.ones((5, 1)), r"shape \(\.\.\., T\+1, 2\), one row a time step; got \(5, 1\)"),
        ([[1.0, NAN]], r"row \[0\] of the record is NaN in part"),
        ([[1.0, np.inf]], r"infinite value in row \[0\]"),
    ],
)
def test_bad_records_are_named(y, message):
    """Catches a filter that skips the common check of its record."""
    with pytest.raises(ValueError, match=message):
        kalman_filter(three_states(), y)


def test_a_certain_state_measured_without_noise_is_an_error():
    """Catches 'Singular matrix' from three calls down."""
    with pytest.raises(ValueError, match="S = H P H' \\+ R is singular"):
        kalman_filter(random_walk(q=0.0, r=0.0, p0=0.0), [[1.0]])


@pytest.mark.parametrize("run", [kalman_filter, pfedu.extended_kalman_filter])
def test_a_skipped_measurement_does_not_stop_the_other_records(run):
    """Catches S of a record that is not corrected: after y_0 without noise nothing is left to correct."""
    model = LinearGaussian(1.0, 1.0, Q=0.0, R=0.0, m0=0.0, P0=1.0)
    records = np.array([[[1.0], [np.nan]], [[np.nan], [2.0]], [[np.nan], [np.nan]]])
    track = run(model, records)
    for i, y in enumerate(records):
        alone = run(model, y)
        for field in ("mean", "cov", "log_likelihood_increments"):
            np.testing.assert_array_equal(getattr(track, field)[i], getattr(alone, field))
