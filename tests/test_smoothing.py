"""Smoothers: the exact ones against linear algebra and against each other, those of particles against the exact.

What ``exact.py`` says of filters holds of smoothers too: with Zhat_T / Z_T the estimated over the exact likelihood of
the *whole* record, the expectation of Zhat_T / Z_T times a weighted average over paths is the exact average over the
smoothing distribution, for every N, every unbiased resampling scheme and every policy that looks at the weights only.
That is so for ancestral lines and for paths drawn backward alike: one step back, the average over the new particles
is linear in their mixture density. So again nothing is allowed for bias.
"""

from itertools import product

import numpy as np
import pytest
from exact import SEEDS, SEVERAL, in_standard_errors, three_states
from scipy import stats

import pfedu
from pfedu import smoothing
from pfedu.models import LinearGaussian, StateSpaceModel, growth, random_walk
from pfedu.resampling import SCHEMES, always, never, ratio
from pfedu.smoothing import ancestral_lines, distinct_ancestors
from pfedu.weights import ZeroLikelihoodError

NAN = np.nan
POLICIES = {"always": always, "ratio": ratio(0.25), "never": never}
WALK, WALKED = random_walk(q=1.0, r=2.0, p0=3.0), np.array([[0.5], [NAN], [2.0], [-1.0], [0.3], [3.0], [NAN], [1.0]])
TWO = LinearGaussian(F=[[0.9, 0.3], [-0.2, 1.0]], H=[[1.0, 0.5]], Q=[[0.8, 0.2], [0.2, 0.5]], R=1.0, m0=[1.0, -1.0],
                     P0=[[1.0, 0.3], [0.3, 2.0]])  # fmt: skip
TWO_Y = np.array([[0.3], [NAN], [1.5], [-0.7]])
HUMP, HUMP_Y = growth(), np.array([[NAN], [3.0], [9.0], [0.4], [6.0]])
SMOOTHERS = ("genealogy", "backward")


def joint(model, y):
    """Mean (T+1, n_x) and covariance (T+1, n_x, T+1, n_x) of all states given the record, from one large Gaussian."""
    n, n_x = len(y), model.n_x
    steps = np.eye(n * n_x)  # x = steps^-1 (m0, w_1, ..., w_T)
    for k in range(1, n):
        steps[k * n_x : (k + 1) * n_x, (k - 1) * n_x : k * n_x] = -model.F
    noise = np.kron(np.eye(n), model.Q)
    noise[:n_x, :n_x] = model.P0
    inverse = np.linalg.inv(steps)
    mean, cov = inverse[:, :n_x] @ model.m0, inverse @ noise @ inverse.T
    seen = np.repeat(~np.isnan(y[:, 0]), model.n_y)
    H, R = np.kron(np.eye(n), model.H)[seen], np.kron(np.eye(n), model.R)[np.ix_(seen, seen)]
    gain = np.linalg.solve(H @ cov @ H.T + R, H @ cov).T
    mean = mean + gain @ (y.ravel()[seen] - H @ mean)
    return mean.reshape(n, n_x), (cov - gain @ H @ cov).reshape(n, n_x, n, n_x)


def smooth(model, y, n, smoother, seed=1, n_paths=None, n_runs=SEEDS, **options):
    """A filter's particles, smoothed."""
    track = pfedu.bootstrap_filter(model, y, n, rng=np.random.default_rng(seed), keep=True, n_runs=n_runs, **options)
    if smoother == "genealogy":
        return pfedu.genealogy_smoother(track)
    return pfedu.backward_smoother(model, track, n_paths or n // 2, rng=np.random.default_rng([seed, 1]))


def worst(track, exact):
    """Largest distance of mean and covariance from the exact ones, over steps and entries, in standard errors."""
    z = np.exp(track.log_likelihood - exact.log_likelihood)[:, None, None]
    d = track.mean - exact.mean
    second = track.cov + d[..., :, None] * d[..., None, :] - exact.cov
    return max(in_standard_errors(z * d).max(), in_standard_errors(z[..., None] * second).max())


@pytest.mark.parametrize(
    ("model", "y"),
    [
        (WALK, WALKED),
        (TWO, TWO_Y),
        (three_states(2), np.array([[1.0, 2.0], [NAN, NAN], [0.0, -1.0], [3.0, 0.5], [NAN, NAN]])),
    ],
    ids=["walk", "two", "three"],
)
def test_rts_is_the_conditional_of_one_large_gaussian(model, y):
    """Catches any error in the recursion: the oracle knows none. Noise of rank one, missing rows."""
    mean, cov = joint(model, y)
    track = pfedu.rts_smoother(model, y)
    np.testing.assert_allclose(track.mean, mean, atol=1e-9)
    np.testing.assert_allclose(track.cov, [cov[k, :, k] for k in range(len(y))], atol=1e-9)
    np.testing.assert_allclose(track.cov, np.swapaxes(track.cov, -1, -2), atol=1e-12)
    assert float(track.log_likelihood) == float(pfedu.kalman_filter(model, y).log_likelihood)


def test_rts_smooths_many_records_at_once():
    """Catches an axis of time and one of runs that are taken for each other."""
    y = np.random.default_rng(1).standard_normal((2, 3, 5, 1))
    many = pfedu.rts_smoother(TWO, y)
    one = pfedu.rts_smoother(TWO, y[1, 2])
    assert many.mean.shape == (2, 3, 5, 2) and many.cov.shape == (2, 3, 5, 2, 2)
    np.testing.assert_allclose(many.mean[1, 2], one.mean, atol=1e-12)
    np.testing.assert_allclose(many.cov[1, 2], one.cov, atol=1e-12)


def test_rts_of_a_state_known_for_certain_is_an_error():
    """Catches numpy's bare words about a singular matrix."""
    with pytest.raises(ValueError, match="prediction of step 1 is singular: some state is known for certain"):
        pfedu.rts_smoother(random_walk(q=0.0, p0=0.0), [[1.0], [2.0]])


def test_grid_and_rts_agree_in_one_and_two_states():
    """Catches a transposed transition, or a weight of the integral that is left out: uneven nodes as well as even."""
    for nodes in (np.linspace(-15, 15, 201), 15 * np.sinh(np.linspace(-2, 2, 401)) / np.sinh(2)):
        mine, exact = pfedu.grid_smoother(WALK, WALKED, nodes), pfedu.rts_smoother(WALK, WALKED)
        np.testing.assert_allclose(mine.mean, exact.mean, atol=2e-3)
        np.testing.assert_allclose(mine.cov, exact.cov, atol=5e-3)
    axes = np.linspace(-6.0, 8.0, 31), np.linspace(-8.5, 6.5, 33)
    mine, exact = pfedu.grid_smoother(TWO, TWO_Y, axes), pfedu.rts_smoother(TWO, TWO_Y)
    assert mine.density.shape == (4, 31, 33)
    np.testing.assert_allclose(mine.mean, exact.mean, atol=1e-4)
    np.testing.assert_allclose(mine.cov, exact.cov, atol=1e-3)


def test_grid_is_the_sum_over_all_paths(monkeypatch):
    """Catches an error that only a nonlinear model shows, and pieces that are put together wrongly: 201^3 paths."""
    monkeypatch.setattr(smoothing, "_AT_ONCE", 7 * 201)
    nodes, y = np.linspace(-10.0, 10.0, 201), HUMP_Y[:3]
    calm = pfedu.models.AdditiveGaussian(lambda k, x: HUMP.f(k, x) / 5, HUMP.h, Q=1.0, R=4.0, m0=0.0, P0=1.0)
    x = nodes[:, None]
    moves = [np.exp(calm.log_transition(k, x[None, :], x[:, None])) for k in (1, 2)]  # (old, new)
    seen = [np.exp(calm.log_likelihood(k, y[k], x)) for k in (1, 2)]
    paths = np.einsum("i,ij,j,jk,k->ijk", np.exp(calm.log_initial(x)), moves[0], seen[0], moves[1], seen[1])
    track = pfedu.grid_smoother(calm, y, nodes)
    for k, others in enumerate([(1, 2), (0, 2), (0, 1)]):
        p = paths.sum(axis=others)
        np.testing.assert_allclose(track.density[k], p / p.sum() / (nodes[1] - nodes[0]), atol=1e-7)


@pytest.mark.parametrize("resampling", SCHEMES)
@pytest.mark.parametrize("policy", POLICIES.values(), ids=POLICIES)
@pytest.mark.parametrize("smoother", SMOOTHERS)
def test_the_exact_answer_with_every_scheme_and_policy(smoother, policy, resampling):
    """Catches any bias of mean or covariance at any time: 200 seeds, 8 steps, weights carried and not."""
    track = smooth(WALK, WALKED, 100, smoother, policy=policy, resampling=resampling)
    assert worst(track, pfedu.rts_smoother(WALK, WALKED)) < SEVERAL


@pytest.mark.parametrize("smoother", SMOOTHERS)
@pytest.mark.parametrize("n", [2, 300])
def test_the_exact_answer_where_the_posterior_has_two_peaks(smoother, n):
    """Catches what only holds for Gaussians, or only for many particles; exact: the grid."""
    y = HUMP_Y if n > 2 else HUMP_Y[:2]
    exact = pfedu.grid_smoother(HUMP, y, np.linspace(-60, 60, 1201))
    assert worst(smooth(HUMP, y, n, smoother, n_runs=SEEDS if n > 2 else 5000), exact) < SEVERAL


@pytest.mark.parametrize("smoother", SMOOTHERS)
def test_states_of_one_path_belong_together(smoother):
    """Catches paths that are right at each time but put together at random: covariance of neighbouring times."""
    mean, cov = joint(TWO, TWO_Y)
    track = smooth(TWO, TWO_Y, 100, smoother)
    z = np.exp(track.log_likelihood - pfedu.kalman_filter(TWO, TWO_Y).log_likelihood)

    def distance(d):
        w = np.exp(track.log_weights)
        across = np.einsum("rkn,rkni,rknj->rkij", w[:, :-1], d[:, :-1], d[:, 1:])
        exact = [cov[k, :, k + 1] for k in range(len(mean) - 1)]
        return in_standard_errors(z[:, None, None, None] * (across - exact)).max()

    d = track.particles - mean[:, None]
    assert distance(d) < SEVERAL
    shuffled = np.stack([np.roll(d[:, k], k, axis=1) for k in range(len(mean))], axis=1)
    assert distance(shuffled) > SEVERAL


def test_a_filter_is_no_smoother():
    """Shows that the comparison can fail: what the filter knows at each time is less than the whole record tells."""
    track = pfedu.bootstrap_filter(WALK, WALKED, 100, rng=np.random.default_rng(1), n_runs=SEEDS)
    assert worst(track, pfedu.rts_smoother(WALK, WALKED)) > SEVERAL


def test_backward_simulation_that_forgets_the_weights_is_found_out(monkeypatch):
    """Shows that the comparison can fail: a common slip is to go back by the transition density alone."""
    honest = smoothing._step_back
    monkeypatch.setattr(smoothing, "_step_back", lambda m, k, x, w, ahead, rng: honest(m, k, x, 0 * w, ahead, rng))
    assert worst(smooth(WALK, WALKED, 100, "backward"), pfedu.rts_smoother(WALK, WALKED)) > SEVERAL


def test_backward_simulation_draws_each_line_as_often_as_it_should():
    """Catches a draw that is off by one particle, or a time: 27 lines of three particles over three times, exactly.

    40 000 paths, chi-square over the 27 lines with 26 degrees of freedom, exceeded once in 10 000 seeds.
    """
    model = LinearGaussian(F=0.8, H=1.0, Q=0.5, R=1.0, m0=0.0, P0=1.0)
    x = np.array([[-1.0, 0.2, 0.9], [0.5, -0.7, 1.1], [0.1, 1.4, -0.6]])[..., None]
    w = np.array([[0.2, 0.5, 0.3], [0.6, 0.1, 0.3], [0.25, 0.25, 0.5]])
    track = pfedu.Track(None, None, np.zeros(3), particles=x, log_weights=np.log(w), ancestors=np.zeros((3, 3), int))
    n = 40_000
    paths = pfedu.backward_smoother(model, track, n, rng=np.random.default_rng(3)).particles[..., 0]  # (T+1, M)
    lines = np.stack([np.argmax(paths[k] == x[k], axis=0) for k in range(3)])
    assert (np.take_along_axis(x[..., 0], lines, axis=1) == paths).all()

    def back(k, i, j):
        p = w[k] * np.exp(model.log_transition(k + 1, x[k + 1, j], x[k]))
        return p[i] / p.sum()

    expected = {(a, b, c): n * w[2, c] * back(1, b, c) * back(0, a, b) for a, b, c in product(range(3), repeat=3)}
    seen = {line: np.count_nonzero((lines.T == line).all(axis=1)) for line in expected}
    chi_square = sum((seen[line] - expected[line]) ** 2 / expected[line] for line in expected)
    assert chi_square < stats.chi2.ppf(1 - 1e-4, 26)


def test_pieces_do_not_change_the_paths(monkeypatch):
    """Catches a path that is lost, or drawn twice, where the pairs are taken in pieces."""
    track = pfedu.bootstrap_filter(WALK, WALKED, 50, rng=np.random.default_rng(1), keep=True)
    whole = pfedu.backward_smoother(WALK, track, 33, rng=np.random.default_rng(2))
    monkeypatch.setattr(smoothing, "_AT_ONCE", 10 * 50)
    pieces = pfedu.backward_smoother(WALK, track, 33, rng=np.random.default_rng(2))
    np.testing.assert_array_equal(whole.particles, pieces.particles)


@pytest.mark.parametrize("smoother", SMOOTHERS)
def test_runs_of_many_records(smoother):
    """Catches runs that draw from each other's particles: records a thousand apart, as an array (2, 3)."""
    model = random_walk(q=1.0, r=1.0, p0=1e7)
    far = 1000.0 * np.arange(6).reshape(2, 3, 1, 1)
    track = smooth(model, far + np.zeros((2, 3, 4, 1)), 20_000, smoother, n_paths=5, n_runs=None)
    assert track.particles.shape[:3] == (2, 3, 4) and track.mean.shape == (2, 3, 4, 1)
    assert np.abs(track.mean - far).max() < 10


def test_distinct_ancestors_are_those_of_wright_and_fisher():
    """Catches a line that is followed wrongly: with equal weights, multinomial resampling forgets parents exactly so.

    The number of distinct parents of j children among N is a Markov chain; its law is a product of matrices, and the
    mean over 4000 runs must be within 5 standard errors of it, at each of 8 times.
    """
    n, steps, runs = 5, 8, 4000
    P = np.zeros((n + 1, n + 1))  # P[j, m]: m distinct parents of j children, drawn one by one
    P[0, 0] = 1.0
    for j in range(n):
        P[j + 1] = P[j] * np.arange(n + 1) / n + np.append(0.0, P[j, :-1] * (n - np.arange(n)) / n)
    law = np.eye(n + 1)[n]
    expected = [law @ np.arange(n + 1)]
    for _ in range(steps):
        law = law @ P
        expected.append(law @ np.arange(n + 1))
    flat = StateSpaceModel(lambda n, rng: rng.standard_normal((n, 1)), lambda k, x, rng: x + 0.0,
                           lambda k, y, x: np.zeros(x.shape[:-1]))  # fmt: skip
    track = pfedu.bootstrap_filter(flat, np.zeros((steps + 1, 1)), n, rng=np.random.default_rng(4), keep=True,
                                   resampling="multinomial", policy=always, n_runs=runs)  # fmt: skip
    lines = ancestral_lines(track)
    counts = distinct_ancestors(lines)[:, ::-1]
    assert (counts[:, 0] == n).all()
    assert in_standard_errors(counts[:, 1:] - expected[1:]).max() < SEVERAL
    followed = np.take_along_axis(track.particles[..., 0], lines, axis=-1)
    assert (followed == followed[:, -1:]).all()  # nothing moves, so a line stays where it is


@pytest.mark.parametrize("keep", [True, False])
def test_a_track_without_particles_is_an_error(keep):
    """Catches an error about None instead of a word about what to do."""
    track = pfedu.kalman_filter(WALK, WALKED) if keep else pfedu.bootstrap_filter(
        WALK, WALKED, 5, rng=np.random.default_rng(1)
    )  # fmt: skip
    with pytest.raises(ValueError, match="run a particle filter with keep=True"):
        pfedu.genealogy_smoother(track)
    with pytest.raises(ValueError, match="run a particle filter with keep=True"):
        pfedu.backward_smoother(WALK, track, 5, rng=np.random.default_rng(1))


@pytest.mark.parametrize("n_paths", [0, -1, 2.5, np.inf, NAN])
def test_a_number_of_paths_that_is_none_is_an_error(n_paths):
    """Catches an empty average."""
    track = pfedu.bootstrap_filter(WALK, WALKED, 5, rng=np.random.default_rng(1), keep=True)
    with pytest.raises(ValueError, match="n_paths must be a whole number of at least 1"):
        pfedu.backward_smoother(WALK, track, n_paths, rng=np.random.default_rng(1))


def test_models_that_cannot_be_walked_backward():
    """Catches a cryptic error where the transition has no density, gives nonsense, or leads from nowhere."""
    track = pfedu.bootstrap_filter(WALK, WALKED, 5, rng=np.random.default_rng(1), keep=True)

    def back(log_transition):
        pieces = WALK.sample_initial, WALK.propagate, WALK.log_likelihood
        model = StateSpaceModel(*pieces, log_transition=log_transition)
        return pfedu.backward_smoother(model, track, 4, rng=np.random.default_rng(1))

    with pytest.raises(pfedu.MissingPieceError, match="no log_transition, which backward simulation needs"):
        back(None)
    with pytest.raises(ValueError, match=r"must give shape \(4, 5\) here, it gave \(4, 5, 1\)"):
        back(lambda k, x_new, x: x_new - x)
    with pytest.raises(ValueError, match="step 7: log_transition gave a value that is no log density"):
        back(lambda k, x_new, x: NAN * (x_new - x)[..., 0])
    with pytest.raises(ZeroLikelihoodError, match="step 7: no particle of time 6 could have moved"):
        back(lambda k, x_new, x: -np.inf + 0 * (x_new - x)[..., 0])
    with pytest.raises(ValueError, match="Q is singular and has no density"):
        pfedu.backward_smoother(random_walk(q=0.0), track, 4, rng=np.random.default_rng(1))
    with pytest.raises(TypeError, match=r"rng must be a numpy\.random\.Generator"):
        pfedu.backward_smoother(WALK, track, 4, rng=1)
