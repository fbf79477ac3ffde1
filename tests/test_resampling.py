"""Resampling: unbiased copies, known scatter, and no particle of weight zero."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from records import resampling_cases

from pfedu.resampling import SCHEMES, always, interval, never, ratio, scheme

CASES = resampling_cases()
U_MAX = np.nextafter(1.0, 0.0)  # the largest double that a generator can give
properties = settings(deadline=None, max_examples=100, derandomize=True)
every_scheme = pytest.mark.parametrize("resample", SCHEMES.values(), ids=SCHEMES)


class FixedUniforms:
    """A generator that gives the numbers it was handed, broadcast to the shape asked for."""

    def __init__(self, u):
        self.u = np.asarray(u, dtype=float)

    def random(self, size=None):
        return np.broadcast_to(self.u, size).copy()


def counts_of(ancestors, n):
    """How often each particle was chosen: (..., size) -> (..., n)."""
    return (ancestors[..., None] == np.arange(n)).sum(axis=-2)


@pytest.fixture(scope="module")
def many_counts():
    """Counts of 100 000 independent resamplings of the reference weights, scheme by scheme."""
    w = np.broadcast_to(CASES["weights"], (100_000, 8))
    return {name: counts_of(s(w, np.random.default_rng(11)), 8) for name, s in SCHEMES.items()}


@pytest.mark.parametrize("name", SCHEMES)
def test_expected_copies_are_n_times_the_weight(many_counts, name):
    """Catches every bias: a residual scheme without its remainder, an index off by one, a lost last particle.

    The standard error of a mean count is known, sqrt(var / draws), from the exact variance of the counts;
    where that is zero the count must be exact in every draw. 4.5 of them: 32 comparisons in all.
    """
    counts, var = many_counts[name], np.array(CASES[f"var_{name}"])
    want = np.array(CASES["expected_counts_all_methods"])
    assert (np.abs(counts.mean(axis=0) - want) <= 4.5 * np.sqrt(var / len(counts)) + 1e-12).all()


@pytest.mark.parametrize("name", SCHEMES)
def test_counts_scatter_as_the_scheme_says(many_counts, name):
    """Catches one scheme passed off as another, e.g. a comb whose offset is drawn again for each tooth.

    A sample variance of n draws has variance (m4 - var^2) / n with m4 the fourth central moment.
    """
    counts, var = many_counts[name].astype(float), np.array(CASES[f"var_{name}"])
    d = counts - np.array(CASES["expected_counts_all_methods"])
    se = np.sqrt(np.maximum((d**4).mean(axis=0) - var**2, 0) / len(d))
    assert (np.abs((d**2).mean(axis=0) - var) <= 4.5 * se + 1e-12).all()


@pytest.mark.parametrize("example", CASES["systematic_example"], ids=lambda e: f"u={e['u1_times_N']}")
def test_systematic_picks_the_known_ancestors(example):
    """Catches a comb that is shifted, reversed, or searched from the wrong side."""
    ancestors = SCHEMES["systematic"](CASES["weights"], FixedUniforms(example["u1_times_N"]))
    assert (ancestors + 1).tolist() == example["index_1based"]


@every_scheme
def test_equal_weights_give_equal_chances(resample):
    """Catches a scheme that favours particles by their place in the array: the index carries no meaning."""
    draws, n = 40_000, 5
    counts = counts_of(resample(np.full((draws, n), 1 / n), np.random.default_rng(12)), n)
    bound = 4.5 * np.sqrt((1 - 1 / n) / draws)  # no scheme scatters more than the multinomial one
    assert (np.abs(counts.mean(axis=0) - 1) <= bound).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", ["residual", "stratified", "systematic"])
def test_equal_weights_are_each_copied_once(name, dtype):
    """Catches N w = 0.999... rounded down to no copy at all: such a residual scheme is multinomial."""
    wrong = []
    for n in range(1, 200):
        ancestors = SCHEMES[name](np.full(n, 1 / n, dtype), np.random.default_rng(13))
        if ancestors.tolist() != list(range(n)):
            wrong.append(n)
    assert wrong == []


# Weights in sixteenths, so that their sum is exact; zeros lead, stand inside and trail.
ZEROS = np.array([0, 0, 3, 0, 5, 0, 0, 8, 0, 0]) / 16


@every_scheme
@pytest.mark.parametrize("u", [0.0, U_MAX, 0.5])
@pytest.mark.parametrize("size", [1, 7, 10, 16, 1000])
@pytest.mark.parametrize("runs", [(), (3,)])
def test_a_particle_of_weight_zero_is_never_chosen(resample, u, size, runs):
    """Catches a search from the left (u = 0) and a point rounded up to one (u at its largest)."""
    ancestors = resample(np.broadcast_to(ZEROS, (*runs, 10)), FixedUniforms(u), size)
    assert (ZEROS[ancestors] > 0).all()


@every_scheme
def test_weights_rounded_to_single_precision(resample):
    """Catches cumulative sums that end below one: the points above them fall to a particle of weight zero."""
    rng, w = np.random.default_rng(14), np.ones(1, np.float32)
    while np.cumsum(w)[-1] >= 1:  # a few tries
        w = np.append(rng.random(1000), np.zeros(3)).astype(np.float32)
        w /= w.sum()
    for u in (0.0, U_MAX):
        assert (w[resample(w, FixedUniforms(u))] > 0).all()
    assert (w[resample(np.stack([w, w]), np.random.default_rng(15), 50_000)] > 0).all()


@every_scheme
@pytest.mark.parametrize("excess", [-1, 1])
def test_sums_that_are_not_quite_one(resample, excess):
    """Catches runs that overlap: cumulative sums that end above one reach into the stretch of the next run.

    The next run leads with a weight of zero, and a point of exactly zero must not find it (nor index -1). Whether
    a binary search steps on the overlap depends on the length of the table, so several numbers of runs are tried.
    """
    rng, w = np.random.default_rng(16), np.ones(1)
    while w.sum() != 1 or np.sign(np.cumsum(w)[-1] - 1) != excess:  # a few tries
        w = rng.dirichlet(np.ones(10))
    for runs in range(2, 12):
        batch = np.stack([ZEROS if run % 2 else w for run in range(runs)])
        for u in (0.0, U_MAX):
            ancestors = resample(batch, FixedUniforms(u))
            assert ((0 <= ancestors) & (ancestors < 10)).all()
            assert (np.take_along_axis(batch, ancestors, axis=-1) > 0).all()


@every_scheme
@pytest.mark.parametrize("shape", [(2,), (3, 2)])
def test_weights_that_sum_to_one_but_for_rounding_keep_their_shares(resample, shape):
    """Catches the missing share given to the last particle: halves short of one still meet at 1/2."""
    w = np.full(shape, 0.499996)
    assert (resample(w, FixedUniforms(0.499998), size=1) == 0).all()
    assert (resample(w, FixedUniforms(0.500001), size=1) == 1).all()


@every_scheme
def test_a_batch_is_a_loop_over_its_runs(resample):
    """Catches runs that see each other's weights or points: same uniforms, same ancestors."""
    rng = np.random.default_rng(17)
    w, u = rng.dirichlet(np.full(30, 0.3), size=(4, 5)), rng.random((4, 5, 1))
    together = resample(w, FixedUniforms(u), 40)
    assert together.shape == (4, 5, 40)
    for run in np.ndindex(4, 5):
        assert together[run].tolist() == resample(w[run], FixedUniforms(u[run]), 40).tolist()


@every_scheme
def test_runs_of_a_batch_are_independent(resample):
    """Catches one draw shared by all runs, which makes a Monte Carlo study of one run.

    Counts of one particle in two runs: their correlation over n pairs is within 4.5 / sqrt(n) of zero.
    """
    pairs = 20_000
    w = np.broadcast_to(CASES["weights"], (pairs, 2, 8))
    first, second = counts_of(resample(w, np.random.default_rng(18)), 8)[:, :, 1].T
    assert abs(np.corrcoef(first, second)[0, 1]) <= 4.5 / np.sqrt(pairs)


@every_scheme
def test_the_same_seed_gives_the_same_bits(resample):
    """Catches randomness from anywhere but the generator."""
    w = np.random.default_rng(19).dirichlet(np.ones(50))
    first, again, other = (resample(w, np.random.default_rng(seed)).tolist() for seed in (1, 1, 2))
    assert first == again != other


@every_scheme
def test_weights_are_left_as_they_were(resample):
    """Catches a cumulative sum or a normalisation done in place."""
    w = np.array([0.25, 0.5, 0.25])
    resample(w, np.random.default_rng(1))
    assert w.tolist() == [0.25, 0.5, 0.25]


def normalised(raw):
    w = np.array(raw)
    return w / w.sum()


some_weights = (
    st.lists(st.floats(0, 1) | st.just(0.0), min_size=1, max_size=30).filter(lambda w: sum(w) > 1e-3).map(normalised)
)


@properties
@given(st.sampled_from(list(SCHEMES)), some_weights, st.integers(1, 80), st.integers(0, 2**32 - 1))
def test_ancestors_are_indices_in_ascending_order(name, w, size, seed):
    """Catches counts that do not add up, indices out of range, and `size` taken for N or the reverse."""
    ancestors = SCHEMES[name](w, np.random.default_rng(seed), size)
    assert ancestors.shape == (size,) and np.issubdtype(ancestors.dtype, np.integer)
    assert (np.diff(ancestors) >= 0).all()
    assert ancestors[0] >= 0 and ancestors[-1] < len(w)
    assert (w[ancestors] > 0).all()


@properties
@given(some_weights, st.integers(1, 80), st.integers(0, 2**32 - 1))
def test_counts_stay_near_their_expectation(w, size, seed):
    """Catches a comb with uneven teeth, cells of uneven width, and whole copies that are not certain.

    A stretch of length w holds floor(size w) or one more teeth of a comb; it covers all but two of its
    cells whole, so a stratified count is less than two away; and a residual count is at least its floor.
    The 1e-9 lets a stretch that ends on a tooth to within rounding fall either way.
    """
    counts = {name: counts_of(s(w, np.random.default_rng(seed), size), len(w)) for name, s in SCHEMES.items()}
    low, high = np.floor(size * w - 1e-9), np.ceil(size * w + 1e-9)
    assert (counts["systematic"] >= low).all() and (counts["systematic"] <= high).all()
    assert (np.abs(counts["stratified"] - size * w) < 2 + 1e-9).all()
    assert (counts["residual"] >= low).all()
    assert all(c.sum() == size for c in counts.values())


@every_scheme
@pytest.mark.parametrize(
    ("weights", "size", "message"),
    [
        ([0.5, -0.5, 1.0], None, "weights must not be negative, got -0.5"),
        ([0.5, np.nan], None, "weights must be finite, got nan"),
        ([0.5, np.inf], None, "weights must be finite, got inf"),
        ([0.0, 0.0], None, "weights must sum to 1, got 0.0"),
        ([1.0, 1.0], None, "weights must sum to 1, got 2.0; divide them by their sum"),
        ([[0.5, 0.5], [0.5, 0.4]], None, "weights must sum to 1, got 0.9"),
        ([-0.7, -1.6], None, "weights must not be negative"),  # logarithms handed over by mistake
        ([], None, r"shape \(\.\.\., N\) with N >= 1, got shape \(0,\)"),
        (1.0, None, r"shape \(\.\.\., N\) with N >= 1, got shape \(\)"),
        ([0.5, 0.5], 0, "size must be a whole number of at least 1, got 0"),
    ],
)
def test_bad_weights_are_named(resample, weights, size, message):
    """Catches a resampler that answers index 0 everywhere, silently."""
    with pytest.raises(ValueError, match=message):
        resample(weights, np.random.default_rng(1), size)


def test_schemes_go_by_name():
    """Catches a name that leads to another scheme, and a function of one's own that is refused."""

    def own(weights, rng, size=None):
        return np.zeros(size, dtype=int)

    assert scheme(own) is own
    assert all(scheme(name) is s and s.__name__ == name for name, s in SCHEMES.items())
    with pytest.raises(ValueError, match="no resampling scheme 'systemic': choose one of multinomial, residual"):
        scheme("systemic")


def test_ratio_resamples_strictly_below_its_share():
    """Catches `<=`: at a ratio of exactly one half the weights are still good."""
    due = ratio(0.5)(n_eff=np.array([49.999, 50.0, 50.001]), n=100, count=7)
    assert due.tolist() == [True, False, False]
    assert not ratio(0.0)(n_eff=1.0, n=100, count=1)
    assert ratio().threshold == 0.5


def test_interval_resamples_every_nth_correction():
    """Catches an interval that starts at the first correction instead of the n-th."""
    due = [bool(interval(3)(n_eff=1.0, n=10, count=k)) for k in range(1, 10)]
    assert due == [False, False, True] * 3
    assert always(n_eff=np.ones(2), n=10, count=np.array([1, 2])).tolist() == [True, True]
    assert never(n_eff=np.ones(2), n=10, count=np.array([1, 2])).tolist() == [False, False]


@pytest.mark.parametrize("threshold", [-0.1, np.nan])
def test_a_threshold_that_is_no_share_is_an_error(threshold):
    """Catches NaN, with which every comparison is false and nothing is ever resampled."""
    with pytest.raises(ValueError, match="share of N and must be at least 0"):
        ratio(threshold)


@pytest.mark.parametrize("n", [0, -1, 2.5, np.nan])
def test_an_interval_that_is_no_whole_number_is_an_error(n):
    """Catches a division by zero at the first correction."""
    with pytest.raises(ValueError, match="whole number of corrections, at least 1, or inf"):
        interval(n)
