"""The number of particles that a filter chooses: the formula against chi-square, the filter against exact answers."""

import functools

import numpy as np
import pytest
from exact import SEVERAL, in_standard_errors
from scipy import stats

import pfedu
from pfedu.adaptive import kld_number, occupied_bins
from pfedu.models import StateSpaceModel, random_walk
from pfedu.resampling import SCHEMES

NAN = np.nan
Y = np.array([[0.5], [NAN], [2.0], [-1.0], [NAN], [NAN], [1.0]])
WALK = random_walk(q=1.0, r=2.0, p0=30.0)


def test_the_number_is_that_of_the_chi_square_quantile():
    """Catches a slip in Wilson and Hilferty's formula: within 1 % of the exact quantile from 5 bins on, 8 % below."""
    for level in (0.9, 0.95, 0.99):
        bins = np.array([2, 3, 5, 10, 50, 400])
        exact = stats.chi2.ppf(level, bins - 1) / (2 * 1e-4)  # so many that rounding up does not show
        mine = kld_number(bins, 1e-4, stats.norm.ppf(level))
        np.testing.assert_allclose(mine[2:], exact[2:], rtol=0.01)
        np.testing.assert_allclose(mine[:2], exact[:2], rtol=0.08)
    assert kld_number(1) == 1 and isinstance(kld_number(7), int)
    assert kld_number(10, 0.05) == -(-kld_number(10, 1e-6) * 1e-6 // 0.05)


@pytest.mark.parametrize("level", [0.9, 0.99])
def test_so_many_draws_keep_the_divergence_in_its_bounds(level):
    """Catches a factor in the bound, e.g. epsilon for 2 epsilon: the promise itself, on a histogram that is known.

    12 bins with the binomial weights of 11 throws, flattened; 20 000 histograms of kld_number(12) draws. The
    chi-square law is that of many draws: 0.01 is allowed for it beside 4 standard errors.
    """
    p = stats.binom.pmf(np.arange(12), 11, 0.5) + 0.05
    p /= p.sum()
    n = kld_number(12, 0.02, stats.norm.ppf(level))
    drawn = np.random.default_rng(1).multinomial(n, p, size=20_000) / n
    divergence = np.sum(np.where(drawn > 0, drawn * np.log(np.maximum(drawn, 1e-300) / p), 0.0), axis=-1)
    kept = np.mean(divergence <= 0.02)
    assert abs(kept - level) < 0.01 + 4 * np.sqrt(level * (1 - level) / 20_000)


def test_two_bins_by_enumeration():
    """Catches the same without a random number: a coin, all outcomes of N throws.

    The law of a coin's count has steps of some per cent, over which the chi-square law goes smoothly.
    """
    for p in (0.5, 0.3):
        n = kld_number(2, 0.002, stats.norm.ppf(0.95))
        share = np.arange(n + 1) / n
        with np.errstate(divide="ignore", invalid="ignore"):
            divergence = np.nan_to_num(share * np.log(share / p)) + np.nan_to_num(
                (1 - share) * np.log((1 - share) / (1 - p))
            )
        inside = stats.binom.pmf(np.arange(n + 1), n, p)[divergence <= 0.002].sum()
        assert abs(inside - 0.95) < 0.02


def test_bins_are_counted_as_python_would():
    """Catches cells that meet at zero and become one, and axes that share a width."""
    x = np.random.default_rng(2).normal(0.0, 3.0, (500, 2))
    cells = {(int(a // 0.5), int(b // 2.0)) for a, b in x}
    assert occupied_bins(x, [0.5, 2.0]) == len(cells)
    assert occupied_bins(x[:, :1], 0.5) == len({int(a // 0.5) for a in x[:, 0]})


def run(model, y, seed, **options):
    return pfedu.kld_filter(model, y, rng=np.random.default_rng(seed), **options)


@functools.cache
def many(resampling="systematic", **options):
    """Tracks of 300 runs, stacked, and their numbers of particles."""
    options = dict(bin_width=1.0, epsilon=0.1, least=10, most=120) | options
    tracks, numbers = zip(*(run(WALK, Y, [3, s], resampling=resampling, **options) for s in range(300)), strict=True)
    fields = ("mean", "cov", "log_likelihood_increments", "n_eff", "resampled")
    return pfedu.Track(*(np.stack([getattr(t, f) for t in tracks]) for f in fields)), np.stack(numbers)


def worst(track, exact):
    z = np.exp(np.cumsum(track.log_likelihood_increments - exact.log_likelihood_increments, axis=-1))
    d = track.mean[..., 0] - exact.mean[..., 0]
    values = z - 1, z * d, z * (track.cov[..., 0, 0] + d**2 - exact.cov[..., 0, 0])
    return max(in_standard_errors(v).max() for v in values)


@pytest.mark.parametrize("resampling", SCHEMES)
def test_the_exact_answer_while_the_number_changes(resampling):
    """Catches weights that still think of the old number, and a number that looks at the draws it decides on.

    Likelihood, mean and variance, each weighted by Zhat/Z, without allowance for bias: 300 runs, 7 steps.
    """
    track, n = many(resampling)
    assert n[:, 1:].std() > 3 and (n[:, 0] == 120).all() and n.min() >= 10
    assert worst(track, pfedu.kalman_filter(WALK, Y)) < SEVERAL


def test_a_filter_that_stops_on_a_lucky_draw_is_found_out():
    """Shows that the comparison can fail: a number chosen by the very draws that are averaged bends the estimate."""

    def propagate(k, x, rng):
        x = WALK.propagate(k, x, rng)
        return np.where(x > x.mean(), x, x[0]) if k == 2 else x  # keeps the upper half only

    bent = StateSpaceModel(WALK.sample_initial, propagate, WALK.log_likelihood)
    tracks = [run(bent, Y, [4, s], bin_width=1.0, most=100)[0] for s in range(100)]
    fields = ("mean", "cov", "log_likelihood_increments")
    track = pfedu.Track(*(np.stack([getattr(t, f) for t in tracks]) for f in fields))
    assert worst(track, pfedu.kalman_filter(WALK, Y)) > SEVERAL


def test_the_number_follows_the_spread():
    """Catches a number that does not answer: cells occupied, hence particles, grow with the spread and shrink with it.

    Between measurements of a random walk the spread grows; each number is that of the cells of the step before.
    """
    model = random_walk(q=4.0, r=0.1, p0=400.0)
    y = np.r_[0.0, np.full(8, NAN), np.zeros(4)][:, None]
    seen = []

    def propagate(k, x, rng):
        seen.append(model.propagate(k, x, rng))
        return seen[-1]

    watched = StateSpaceModel(model.sample_initial, propagate, model.log_likelihood)
    _, n = run(watched, y, 5, bin_width=0.5, epsilon=0.05, most=3000)
    assert (np.diff(n[2:10]) > 0).all() and n[-1] < 0.6 * n[9] and n[0] == 3000
    asked = [np.clip(kld_number(len(np.unique(np.floor(x / 0.5)))), 20, 3000) for x in seen]
    assert n[2:].tolist() == asked[:-1] and [len(x) for x in seen] == n[1:].tolist()


def test_a_smaller_epsilon_brings_a_smaller_error():
    """Catches an epsilon that is not passed on: four times as small, about four times as many, half the error."""
    exact = pfedu.kalman_filter(WALK, Y).mean
    (coarse, n_coarse), (fine, n_fine) = (
        many(epsilon=e, most=100_000 if e < 0.1 else 2000, least=1, bin_width=1.0) for e in (0.4, 0.1)
    )
    assert 3 < n_fine[:, 1:].mean() / n_coarse[:, 1:].mean() < 6
    error = [np.sqrt(np.mean((t.mean[:, 1:] - exact[1:]) ** 2)) for t in (coarse, fine)]
    assert 1.5 < error[0] / error[1] < 3.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bin_width": 0.0}, "bin_width must be positive"),
        ({"bin_width": [1.0, 1.0]}, r"one number or one a state \(1\)"),
        ({"epsilon": 0.0}, "epsilon is a divergence and must be positive, got 0.0"),
        ({"z": NAN}, "z must be a quantile"),
        ({"least": 0}, "least must be a whole number of at least 1, got 0"),
        ({"most": 10.5}, "most must be a whole number of at least 1, got 10.5"),
        ({"least": 200}, "least must not be more than most, got 200 and 100"),
        ({"y": np.zeros((2, 3, 1))}, "takes one at a time"),
        ({"resampling": "wheel"}, "no resampling scheme 'wheel'"),
    ],
)
def test_bad_input_is_an_error(options, message):
    """Catches a filter that runs on nonsense."""
    given = dict(model=WALK, y=Y, bin_width=1.0, most=100, rng=np.random.default_rng(1)) | options
    with pytest.raises(ValueError, match=message):
        pfedu.kld_filter(**given)


def test_a_particle_that_is_nowhere_spoils_nothing():
    """Catches NaN in every mean as soon as one particle has run away, although its weight is zero.

    Draws of N(0, 1) above zero are lost; those below have the mean of the half-normal, to five standard errors of the
    500 particles or more that carry the step.
    """
    runaway = StateSpaceModel(lambda n, rng: rng.standard_normal((n, 1)), lambda k, x, rng: np.where(x > 0, NAN, x),
                              lambda k, y, x: np.where(x[..., 0] <= 0, 0.0, -np.inf))  # fmt: skip
    y = np.array([[NAN], [0.0]])
    track, n = pfedu.kld_filter(runaway, y, bin_width=0.1, most=20_000, rng=np.random.default_rng(1))
    assert np.isfinite(track.mean).all() and np.isfinite(track.cov).all()
    assert abs(track.mean[1, 0] + np.sqrt(2 / np.pi)) < 5 * np.sqrt((1 - 2 / np.pi) / 500) and n[1] > 500
    assert occupied_bins(np.array([[NAN], [np.inf], [0.5], [0.6]]), 1.0) == 1


def test_more_particles_than_can_be_counted_are_an_error():
    """Catches an overflow that turns the largest demand into a single particle."""
    with pytest.raises(ValueError, match="more than can be counted"):
        kld_number(100, 1e-20)


def test_a_prior_of_the_wrong_shape_is_named():
    """Catches an error about indices."""
    flat = StateSpaceModel(lambda n, rng: rng.standard_normal(n), WALK.propagate, WALK.log_likelihood)
    with pytest.raises(ValueError, match=r"must give shape \(100, 1\), it gave \(100,\)"):
        pfedu.kld_filter(flat, Y, bin_width=1.0, most=100, rng=np.random.default_rng(1))


@pytest.mark.parametrize("bins", [0, -3, 2.5, [], [3, 0], "two"])
def test_bins_that_are_none_are_an_error(bins):
    """Catches a number of particles for no cells at all."""
    with pytest.raises(ValueError, match="n_bins must be whole numbers of at least 1"):
        kld_number(bins)


def test_models_that_lack_a_piece():
    """Catches a bare AttributeError."""
    with pytest.raises(pfedu.MissingPieceError, match="no propagate"):
        run(StateSpaceModel(WALK.sample_initial, None, WALK.log_likelihood), Y, 1, bin_width=1.0)
    far = np.array([[0.0], [1e200]])
    with pytest.raises(pfedu.ZeroLikelihoodError, match="step 1"), np.errstate(over="ignore"):
        run(WALK, far, 1, bin_width=1.0, most=10, least=5)
