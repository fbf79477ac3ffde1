"""The Rao-Blackwellised filter: against all mode sequences, the Kalman filter, the grid, and the bootstrap filter."""

import functools

import numpy as np
import pytest
from exact import SEEDS, SEVERAL, in_standard_errors, worst
from records import reference

import pfedu
from pfedu.filters import rao_blackwellized
from pfedu.grid import grid_filter
from pfedu.kalman import kalman_filter
from pfedu.models import ConditionallyLinear, JumpMarkov, LinearGaussian, growth, jump_markov, positioning, random_walk
from pfedu.resampling import SCHEMES, always, never, ratio
from pfedu.track import Track

NAN = np.nan
POLICIES = {"always": always, "ratio": ratio(0.5), "never": never}
every_policy = pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)


def run(model, y, n, seed=1, **options):
    return pfedu.rao_blackwellized_filter(model, y, n, rng=np.random.default_rng(seed), **options)


# Jump-Markov systems


def all_sequences(model, y):
    """Exact track of a jump-Markov system: one Kalman filter for each of the M^(T+1) sequences of modes.

    Arrays run over records (...) and sequences (s); at each step a sequence branches into M.
    """
    M, last, steps, log_z = model.n_modes, np.arange(model.n_modes), [], [np.zeros(y.shape[:-2])]
    m, P = np.broadcast_to(model.m0, (*y.shape[:-2], M, model.n_z)), np.broadcast_to(model.P0, (M, *model.P0.shape))
    with np.errstate(divide="ignore"):
        log_p0, log_Pi = np.log(model.p0), np.log(model.Pi)
    log_p = np.broadcast_to(log_p0, m.shape[:-1])
    for k in range(y.shape[-2]):
        if k > 0:
            before, last = np.repeat(last, M), np.tile(np.arange(M), len(last))
            log_p = np.repeat(log_p, M, axis=-1) + log_Pi[before, last]
            A = model.A[last]
            m, P = np.einsum("sij,...sj->...si", A, np.repeat(m, M, axis=-2)), np.repeat(P, M, axis=0)
            P = A @ P @ A.transpose(0, 2, 1) + model.Q[last]
        if not np.isnan(y[..., k, :]).any():
            C = model.C[last]
            S = C @ P @ C.transpose(0, 2, 1) + model.R[last]
            e = y[..., k, None, :] - np.einsum("sij,...sj->...si", C, m)
            square = np.einsum("...si,sij,...sj->...s", e, np.linalg.inv(S), e)
            log_p = log_p - 0.5 * (square + np.linalg.slogdet(2 * np.pi * S)[1])
            K = P @ C.transpose(0, 2, 1) @ np.linalg.inv(S)
            m, P = m + np.einsum("sij,...sj->...si", K, e), P - K @ S @ K.transpose(0, 2, 1)
        log_z.append(np.logaddexp.reduce(log_p, axis=-1))
        w = np.exp(log_p - log_z[-1][..., None])
        x = np.concatenate([np.broadcast_to(last[:, None], (*m.shape[:-1], 1)), m], axis=-1)
        mean = np.einsum("...s,...si->...i", w, x)
        d = x - mean[..., None, :]
        cov = np.einsum("...s,...si,...sj->...ij", w, d, d)
        cov[..., 1:, 1:] += np.einsum("...s,sij->...ij", w, P)
        steps.append((mean, cov))
    return Track(np.stack([s[0] for s in steps], -2), np.stack([s[1] for s in steps], -3), np.diff(log_z, axis=0).T)


def three_modes(n_y=1, p0=(0.5, 0.3, 0.2)):
    """Nothing alike in two modes: motion, measurement and both noises; two jumps never happen."""
    rng = np.random.default_rng(21)
    roots, noises = rng.standard_normal((3, 2, 2)), rng.standard_normal((3, n_y, n_y))
    return JumpMarkov(
        A=[[[0.9, 0.3], [-0.2, 0.8]], [[-0.7, 0.0], [0.5, 1.0]], [[0.2, -0.9], [0.9, 0.2]]],
        C=rng.standard_normal((3, n_y, 2)),
        Q=0.5 * roots @ roots.transpose(0, 2, 1),
        R=0.5 * noises @ noises.transpose(0, 2, 1) + np.array([0.2, 0.5, 1.0])[:, None, None] * np.eye(n_y),
        Pi=[[0.7, 0.2, 0.1], [0.0, 0.6, 0.4], [0.5, 0.5, 0.0]],
        m0=[1.0, -1.0],
        P0=[[1.0, 0.4], [0.4, 2.0]],
        p0=p0,
    )


@functools.cache
def three_mode_problem(n_y=1, n_steps=5):
    model = three_modes(n_y)
    y = model.simulate(n_steps, np.random.default_rng(3))[1]
    return model, y, all_sequences(model, y)


def jmls_record():
    """The reference record, from time 1 on; a first row of NaN makes the mode at time 1 uniform, as there."""
    data = reference("jmls_A")
    return np.vstack([[[NAN, NAN]], np.stack([data["y1"], data["y2"]], axis=-1)]), data


def test_going_through_all_sequences_gives_the_reference_record():
    """Catches a slip in the oracle of this file: another program went through the same 1024 sequences."""
    y, data = jmls_record()
    exact = all_sequences(jump_markov(), y)
    np.testing.assert_allclose(exact.mean[1:, 0], data["exact_prob_mode1"], rtol=0, atol=1e-11)
    np.testing.assert_allclose(exact.mean[1:, 1:], np.stack([data["exact_mean1"], data["exact_mean2"]], -1), atol=1e-10)
    np.testing.assert_allclose(exact.log_likelihood_increments.cumsum()[1:], data["cum_loglik"], rtol=0, atol=1e-9)
    var = (exact.cov[1:, 1, 1] + exact.cov[1:, 2, 2]) / 2
    np.testing.assert_allclose(var, data["exact_mean_var"], rtol=0, atol=1e-10)


@every_policy
def test_the_reference_record(policy):
    """Catches a mode drawn after the measurement, A of the mode before, and weights lost: probabilities, means, all.

    5 standard errors and 2e-5: at times 2 to 5 mode 1 has a probability of 2e-6 or less, and once those particles are
    resampled away, no run of these sees what they contribute, 2e-6 times a distance of 5.
    """
    y, data = jmls_record()
    track = run(jump_markov(), y, 100, policy=policy, n_runs=SEEDS)
    ratio_z = np.exp(track.log_likelihood_increments.cumsum(axis=-1)[:, 1:] - data["cum_loglik"])
    d = track.mean[:, 1:] - np.stack([data[f"exact_{name}"] for name in ("prob_mode1", "mean1", "mean2")], axis=-1)
    var = (track.cov[..., 1, 1] + track.cov[..., 2, 2])[:, 1:] / 2 + (d[..., 1:] ** 2).mean(axis=-1)
    for values in (ratio_z - 1, ratio_z[..., None] * d, ratio_z * (var - data["exact_mean_var"])):
        se = values.std(axis=0, ddof=1) / np.sqrt(SEEDS)
        assert (np.abs(values.mean(axis=0)) < SEVERAL * se + 2e-5).all()


@every_policy
@pytest.mark.parametrize("n_y", [1, 2, 3])
def test_three_modes_against_all_sequences(policy, n_y):
    """Catches Pi transposed, matrices of another mode, p0 ignored, and the covariance between mode and state."""
    model, y, exact = three_mode_problem(n_y)
    track = run(model, y, 100, policy=policy, n_runs=SEEDS)
    assert track.mean.shape == (SEEDS, 6, 3)
    assert max(worst(track, exact).values()) < SEVERAL


@pytest.mark.parametrize("resampling", SCHEMES)
def test_three_modes_with_every_scheme(resampling):
    """Catches a mode resampled without its Gaussian."""
    model, y, exact = three_mode_problem()
    track = run(model, y, 50, policy=always, resampling=resampling, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


def test_the_bootstrap_filter_on_the_same_system():
    """Catches a model whose draws and likelihoods are not what the matrices say."""
    model, y, exact = three_mode_problem(2)
    track = pfedu.bootstrap_filter(model, y, 500, rng=np.random.default_rng(1), n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


def test_a_known_mode_is_a_kalman_filter():
    """Catches anything drawn that need not be: with one mode a single particle is exact, to rounding."""
    model = JumpMarkov(
        A=[[[1.0, 0.5], [-0.1, 0.9]]], C=[[[1.0, 0.3]]], Q=[[[1.0, 0.3], [0.3, 0.5]]], R=[[[0.5]]], Pi=[[1.0]],
        m0=[1.0, -1.0], P0=[[2, 0.5], [0.5, 1]],
    )  # fmt: skip
    y = model.simulate(8, np.random.default_rng(3))[1]
    y[4] = NAN
    exact = kalman_filter(LinearGaussian(model.A[0], model.C[0], model.Q[0], model.R[0], model.m0, model.P0), y)
    track = run(model, y, 1)
    np.testing.assert_allclose(track.mean[:, 1:], exact.mean, rtol=0, atol=1e-11)
    np.testing.assert_allclose(track.cov[:, 1:, 1:], exact.cov, rtol=0, atol=1e-11)
    np.testing.assert_allclose(track.log_likelihood_increments, exact.log_likelihood_increments, rtol=0, atol=1e-11)
    assert (track.mean[:, 0] == 0).all() and (track.cov[:, 0] == 0).all()


@pytest.mark.parametrize("policy", [always, ratio(0.5)], ids=["always", "ratio"])
@pytest.mark.parametrize("n_particles", [1, 2, 7])
def test_the_likelihood_estimate_is_unbiased_for_very_few_particles(policy, n_particles):
    """Catches what only holds for large N; 4000 runs on four rows, one of them missing."""
    model, y = three_modes(), np.array([[0.5], [NAN], [1.0], [-0.5]])
    track = run(model, y, n_particles, policy=policy, seed=5, n_runs=4000)
    z = np.exp(track.log_likelihood - all_sequences(model, y).log_likelihood) - 1
    assert in_standard_errors(z) < 4


@functools.cache
def deviations(d, n_records):
    """Mean square deviation from the exact mean of z, per dimension: Rao-Blackwell (200), bootstrap (2000)."""
    model = jump_markov(d)
    y = model.simulate(10, np.random.default_rng(8), n_runs=n_records)[1]
    exact = all_sequences(model, y).mean[..., 1:]
    tracks = run(model, y, 200), pfedu.bootstrap_filter(model, y, 2000, rng=np.random.default_rng(1))
    return [np.mean((track.mean[..., 1:] - exact) ** 2, axis=(-2, -1)) for track in tracks]


@pytest.mark.parametrize(("d", "n_records", "at_least"), [(1, 100, 0.7), (4, 40, 15), (8, 20, 150)])
def test_what_it_saves_grows_with_the_dimension(d, n_records, at_least):
    """Catches particles for what is known exactly: the mode alone is drawn, so dimensions of z cost nothing.

    Found over hundreds of records: mean square deviation per dimension at d = 1, 4, 8 with 200 particles 2.5e-4,
    8e-5, 1e-5, and for bootstrap with ten times as many 5.8e-4, 6e-3, 4.3e-2. The bound holds for the ratio less
    3 standard errors of its logarithm.
    """
    ours, blind = deviations(d, n_records)
    cv = [e.std(ddof=1) / e.mean() / np.sqrt(n_records) for e in (ours, blind)]
    assert np.log(blind.mean() / ours.mean()) - 3 * np.hypot(*cv) > np.log(at_least)
    assert ours.mean() < 1e-3


# Conditionally linear models


def partitioned(linear, n_u, as_functions=False):
    """A linear model, stated as one that is linear given its first n_u states."""
    F, H = linear.F, linear.H

    def many(A):
        return (lambda k, u: np.broadcast_to(A, (*u.shape[:-1], *A.shape))) if as_functions else A

    return ConditionallyLinear(
        n_u, lambda k, u: u @ F[:, :n_u].T, many(F[:, n_u:]), lambda k, u: u @ H[:, :n_u].T, many(H[:, n_u:]),
        linear.Q, linear.R, linear.m0, linear.P0,
    )  # fmt: skip


@functools.cache
def four_states(n_y=1):
    """Every state moves every other, and all noises are correlated: model, record, exact track."""
    rng = np.random.default_rng(31)
    root, start, noise = rng.standard_normal((3, 4, 4))
    F = rng.standard_normal((4, 4))
    model = LinearGaussian(
        F=0.95 * F / np.abs(np.linalg.eigvals(F)).max(), H=rng.standard_normal((n_y, 4)), Q=0.3 * root @ root.T,
        R=noise[:n_y] @ noise[:n_y].T, m0=[1.0, -1.0, 0.5, 0.0], P0=start @ start.T,
    )  # fmt: skip
    y = model.simulate(6, np.random.default_rng(8))[1]
    return model, y, kalman_filter(model, y)


@pytest.mark.parametrize("as_functions", [False, True], ids=["matrices", "functions"])
@pytest.mark.parametrize("n_u", [1, 2, 3])
@pytest.mark.parametrize("n_y", [1, 2])
def test_a_linear_model_taken_apart_is_the_kalman_filter(n_y, n_u, as_functions):
    """Catches u's motion that does not inform z, correlated noises taken for independent, and z's part left out of u.

    A_u, the first rows of A, is not zero: where u went tells of z before any measurement does.
    """
    linear, y, exact = four_states(n_y)
    track = run(partitioned(linear, n_u, as_functions), y, 100, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@every_policy
def test_a_linear_model_taken_apart_with_every_policy(policy):
    """Catches a covariance that all particles share and that resampling takes apart."""
    linear, y, exact = four_states()
    track = run(partitioned(linear, 2), y, 200, policy=policy, resampling="residual", n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@pytest.mark.parametrize("forgets", ["motion", "noise"])
def test_what_u_tells_of_z_may_not_be_forgotten(forgets, monkeypatch):
    """Shows that the tests above can fail: z not conditioned on where u went; or conditioned with its mean alone."""
    draw = rao_blackwellized._draw_part

    def forgetful(mean, cov, n, rng):
        u, z, P = draw(mean, cov, n, rng)
        prior = np.broadcast_to(cov, (*P.shape[:-2], *cov.shape[-2:]))[..., n:, n:]
        return (u, mean[..., n:], prior) if forgets == "motion" else (u, z, prior)

    monkeypatch.setattr(rao_blackwellized, "_draw_part", forgetful)
    linear, y, exact = four_states()
    assert max(worst(run(partitioned(linear, 2), y, 200, n_runs=SEEDS), exact).values()) > SEVERAL


def test_functions_and_matrices_are_the_same_model():
    """Catches a shared covariance handled in another way than one for each particle: the same draws, to rounding."""
    linear, y, _ = four_states(2)
    ours, theirs = (run(partitioned(linear, 2, functions), y, 50, n_runs=3, keep=True) for functions in (False, True))
    for field in ("particles", "log_weights", "mean", "cov"):
        np.testing.assert_allclose(getattr(ours, field), getattr(theirs, field), rtol=1e-8, atol=1e-9)


def covariance_axes(model, y, n, monkeypatch, **options):
    """Lengths of the axis of particles of each covariance that is corrected."""
    lengths = []

    def update(m, P, *rest):
        lengths.append(P.shape[-3])
        return kalman_update(m, P, *rest)

    kalman_update = rao_blackwellized.update
    monkeypatch.setattr(rao_blackwellized, "update", update)
    run(model, y, n, **options)
    return lengths


def test_covariances_are_shared_where_no_matrix_depends_on_u(monkeypatch):
    """Catches N copies of one covariance; runs with other rows missing still have one each."""
    model = positioning()
    y = model.simulate(5, np.random.default_rng(1), n_runs=2)[1]
    y[0, 2] = NAN
    assert covariance_axes(model, y, 50, monkeypatch) == [1] * 6


@pytest.mark.parametrize("only", ["A", "C"])
def test_covariances_are_not_shared_where_a_matrix_depends_on_u(only, monkeypatch):
    """Catches one particle's covariance used for all: a function of u for A or for C alone."""
    model = curved(bend_A=only == "A", bend_C=only == "C")
    y = np.array([[0.5], [NAN], [1.0], [2.0]])
    assert covariance_axes(model, y, 50, monkeypatch)[-1] == 50


def curved(bend_A=True, bend_C=True):
    """A nonlinear u, and matrices that depend on it: a model of two states, which a grid can do."""

    def f(k, u):
        return np.concatenate([np.sin(u) + 0.3 * np.cos(k), 0.4 * u], axis=-1)

    def A(k, u):
        return np.stack([0.6 + 0.3 * np.cos(u), 0.7 + 0.2 * np.sin(u)], axis=-2)

    def C(k, u):
        return (0.5 + 0.3 * u)[..., None, :]

    return ConditionallyLinear(
        1, f, A if bend_A else [[0.8], [0.7]], lambda k, u: 0.5 * u**2, C if bend_C else [[0.5]],
        Q=[[0.8, 0.25], [0.25, 0.4]], R=0.8, m0=[0.2, 0.5], P0=[[0.6, -0.2], [-0.2, 0.8]],
    )  # fmt: skip


@functools.cache
def curved_problem(bend_A, bend_C):
    """The model, a record with a missing row, and the exact track from a grid of two dimensions."""
    model = curved(bend_A, bend_C)
    y = np.array([[0.5], [1.2], [-0.3], [NAN], [1.5]])
    return model, y, grid_filter(model, y, (np.linspace(-5.5, 5.5, 37), np.linspace(-5.5, 5.5, 37)))


@pytest.mark.parametrize("bends", [(True, True), (True, False), (False, True)], ids=str)
def test_a_nonlinear_model_against_the_grid(bends):
    """Catches A or C of another particle or another time, and h or f of u left out; with P of each and shared."""
    model, y, exact = curved_problem(*bends)
    track = run(model, y, 100, n_runs=SEEDS)
    assert max(worst(track, exact).values()) < SEVERAL


@pytest.mark.parametrize("n_particles", [1, 2, 7])
def test_the_likelihood_of_a_nonlinear_model_is_unbiased(n_particles):
    """Catches what only holds for large N, with one covariance for each particle."""
    model, y, exact = curved_problem(True, True)
    z = np.exp(run(model, y, n_particles, seed=5, n_runs=4000).log_likelihood - exact.log_likelihood) - 1
    assert in_standard_errors(z) < 4


def track_of_position(q=0.0):
    """Position without noise of its own, velocity with: where u goes is all that z does."""
    return LinearGaussian([[1.0, 1.0], [0.0, 0.9]], [[1.0, 0.0]], [0.0, q], 1.0, [0.0, 0.5], [[1.0, 0.3], [0.3, 0.5]])


def test_a_motion_without_noise_tells_all():
    """Catches the inverse of a singular covariance, and what is left of a variance counted twice."""
    model = track_of_position(0.2)
    y = model.simulate(5, np.random.default_rng(4))[1]
    track = run(partitioned(model, 1), y, 300, n_runs=SEEDS)
    assert max(worst(track, kalman_filter(model, y)).values()) < SEVERAL


def test_without_any_noise_variances_do_not_become_negative():
    """Catches a difference of two variances that rounding takes below zero: nothing is left of z after one step."""
    model = track_of_position(0.0)
    y = model.simulate(40, np.random.default_rng(4))[1]
    track = run(partitioned(model, 1), y, 200, n_runs=20)
    assert np.isfinite(track.mean).all() and (np.diagonal(track.cov, axis1=-2, axis2=-1) >= 0).all()


def test_units_do_not_matter():
    """Catches what is called singular by its size: a component of u in light years beside one in millimetres.

    The same model with its states rescaled draws the same particles, rescaled.
    """
    linear, y, _ = four_states(2)
    scale = np.array([1e-8, 1e6, 1.0, 1e3])
    other = LinearGaussian(
        scale[:, None] * linear.F / scale, linear.H / scale, scale[:, None] * linear.Q * scale, linear.R,
        scale * linear.m0, scale[:, None] * linear.P0 * scale,
    )  # fmt: skip
    ours, theirs = (run(partitioned(model, 2), y, 50) for model in (linear, other))
    np.testing.assert_allclose(theirs.mean / scale, ours.mean, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(theirs.log_likelihood, ours.log_likelihood, rtol=1e-7)


def informed():
    """Positioning that starts with less to find than its default, so that few particles find it."""
    return positioning(q_v=1.0, P0=(100.0, 100.0, 4.0, 4.0, 100.0, 0.01))


def test_positioning_against_the_bootstrap_filter():
    """Catches a slip that a model of two states hides: four linear states of six, three measurements.

    Both estimate Z and Z times the mean without bias, so that over runs they agree within their standard errors:
    500 particles here, 5000 there.
    """
    model = informed()
    y = model.simulate(4, np.random.default_rng(6))[1]
    ours = run(model, y, 500, n_runs=100)
    theirs = pfedu.bootstrap_filter(model, y, 5000, rng=np.random.default_rng(2), n_runs=50)
    start, z = ours.mean.mean(axis=0), theirs.log_likelihood_increments.cumsum(axis=-1).mean(axis=0)
    values = []
    for track in (ours, theirs):
        w = np.exp(track.log_likelihood_increments.cumsum(axis=-1) - z)[..., None]
        values.append(np.concatenate([w, w * (track.mean - start)], axis=-1))
    gap = values[0].mean(axis=0) - values[1].mean(axis=0)
    se = np.sqrt(sum(v.var(axis=0, ddof=1) / len(v) for v in values))
    assert (np.abs(gap) < SEVERAL * se).all()


def nees(track, x, part):
    """Normalised error squared, (x - m)' P^-1 (x - m) of a part of the state: (runs, T+1)."""
    d = (x - track.mean)[..., part]
    return np.einsum("...i,...ij,...j->...", d, np.linalg.inv(track.cov[..., part, part]), d)


def test_positioning_is_consistent():
    """Catches a covariance of z that is too small or too large for its error, over 100 records with their truths.

    Over truths and records the expectation is the number of components, 4, whatever the posterior looks like, as the
    posterior expectation of (z - m)(z - m)' is P. The mean over all times, within 4 standard errors from the
    scatter of the records, and of each time within 5.
    """
    model = informed()
    x, y = model.simulate(15, np.random.default_rng(3), n_runs=100)
    e = nees(run(model, y, 800), x, slice(2, 6))
    assert in_standard_errors(e.mean(axis=-1) - 4) < 4
    assert in_standard_errors(e - 4).max() < SEVERAL


def test_positioning_that_takes_its_velocity_for_known_is_not_consistent(monkeypatch):
    """Shows that the test above can fail: u drawn at the mean of z, as if z had no covariance."""
    draw, model = rao_blackwellized._draw_part, informed()

    def sure(mean, cov, n, rng):
        if cov is not model.P0:
            cov = np.array(cov)
            cov[..., :n, :], cov[..., n:, :n] = model.Q[:n], model.Q[n:, :n]
        return draw(mean, cov, n, rng)

    monkeypatch.setattr(rao_blackwellized, "_draw_part", sure)
    x, y = model.simulate(15, np.random.default_rng(3), n_runs=100)
    assert in_standard_errors(nees(run(model, y, 400), x, slice(2, 6)).mean(axis=-1) - 4) > 4


# What both have in common


@pytest.mark.parametrize("kind", ["shared", "own", "modes"])
def test_several_records_at_once_and_missing_rows(kind):
    """Catches runs that see each other's measurements or covariances: rows missing in one record, and in both."""
    if kind == "modes":
        model = three_modes()
        y = model.simulate(5, np.random.default_rng(9), n_runs=2)[1]
    else:
        linear = four_states()[0]
        model = partitioned(linear, 2, as_functions=kind == "own")
        y = linear.simulate(5, np.random.default_rng(9), n_runs=2)[1]
    y[0, 0], y[0, 3], y[1, 4:], y[:, 2] = NAN, NAN, NAN, NAN
    solve = all_sequences if kind == "modes" else lambda _, record: kalman_filter(linear, record)
    track = run(model, y, 80, policy=ratio(0.6), n_runs=SEEDS)
    for i in range(2):
        alone = Track(track.mean[:, i], track.cov[:, i], track.log_likelihood_increments[:, i])
        assert max(worst(alone, solve(model, y[i])).values()) < SEVERAL
    missing = np.isnan(y[..., 0])
    assert (track.log_likelihood_increments[:, missing] == 0).all()
    assert not track.resampled[:, missing].any()


@pytest.mark.parametrize("model", [three_modes(), positioning(), curved()], ids=["modes", "shared", "own"])
def test_the_same_seed_gives_the_same_bits(model):
    """Catches randomness from anywhere but the generator; kept particles are (u, m)."""
    y = model.simulate(4, np.random.default_rng(1))[1]
    first, again = (run(model, y, 20, seed=4, keep=True) for _ in range(2))
    assert first.particles.shape == (5, 20, model.n_x)
    np.testing.assert_array_equal(first.particles, again.particles)


@pytest.mark.parametrize("model", [growth(), random_walk()], ids=["growth", "walk"])
def test_a_model_without_a_linear_part_is_told_what_to_use(model):
    """Catches 'object has no attribute'."""
    with pytest.raises(
        pfedu.MissingPieceError, match=r"states no linear part.*use pfedu.models.ConditionallyLinear or"
    ):
        run(model, [1.0], 10)


@pytest.mark.parametrize("name", ["f", "h", "A", "C"])
def test_a_part_of_the_wrong_size_is_an_error(name):
    """Catches broadcasting: an f that says where u goes and nothing of z would be added to both."""
    parts = dict(f=lambda k, u: np.concatenate([u, 0 * u], -1), A=[[1.0], [0.9]], h=lambda k, u: u, C=[[0.0]])
    parts[name] = (lambda k, u: u) if name == "f" else lambda k, u: np.ones((*u.shape[:-1], 2, 2))
    model = ConditionallyLinear(1, **parts, Q=[1.0, 1.0], R=1.0, m0=[0.0, 0.0], P0=[1.0, 1.0])
    with pytest.raises(ValueError, match=rf"^{name}\(k, u\) must give shape"):
        run(model, [1.0, 1.0], 10)
