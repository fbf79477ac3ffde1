"""Weights: the arithmetic under every filter."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from records import REFERENCE

from pfedu.weights import (
    ZeroLikelihoodError,
    as_circular,
    effective_sample_size,
    normalize,
    weighted_cov,
    weighted_mean,
    weighted_moments,
    wrap,
)

EPS = np.finfo(float).eps

# A log weight is any finite number of the size a filter meets, or a weight of zero.
log_weight = st.floats(-1e5, 1e5) | st.just(-np.inf)
log_weights = st.lists(log_weight, min_size=1, max_size=40).filter(lambda log_w: max(log_w) > -np.inf)
properties = settings(deadline=None, max_examples=100, derandomize=True)


@properties
@given(log_weights)
def test_normalized_weights_sum_to_one_and_keep_their_ratios(log_w):
    """Catches a sum taken without its peak, and a constant that is not the log of the sum."""
    bar, log_sum = normalize(log_w)
    assert math.fsum(np.exp(bar)) == pytest.approx(1.0, abs=4 * len(log_w) * EPS)
    # log w = bar + log_sum; one rounding of numbers up to 2e5
    finite = np.isfinite(log_w)
    np.testing.assert_allclose((bar + log_sum)[finite], np.array(log_w)[finite], rtol=0, atol=4 * 2e5 * EPS)
    assert (np.exp(bar)[~finite] == 0).all()


@properties
@given(st.lists(st.floats(0.01, 100), min_size=1, max_size=40))
def test_log_sum_is_the_log_of_the_sum(w):
    """Catches a constant off by log N, or one that leaves the peak out."""
    assert normalize(np.log(w))[1] == pytest.approx(math.log(math.fsum(w)), abs=1e-12)


@properties
@given(log_weights, st.floats(-1e5, 1e5))
def test_a_common_factor_changes_only_the_constant(log_w, shift):
    """Catches any dependence of the weights on the scale of the likelihood."""
    bar, log_sum = normalize(log_w)
    moved, moved_sum = normalize(np.array(log_w) + shift)
    atol = 8 * 4e5 * EPS  # both inputs are rounded at a size of up to 2e5
    np.testing.assert_allclose(np.exp(moved), np.exp(bar), rtol=0, atol=atol)
    assert moved_sum == pytest.approx(log_sum + shift, abs=atol)


@pytest.mark.parametrize("level", [-1e5, 1e5])
def test_extreme_likelihoods_neither_underflow_nor_overflow(level):
    """exp(-1e5) is zero and exp(1e5) infinite in doubles: weights 3:1 must survive both."""
    bar, log_sum = normalize([level, level - math.log(3.0)])
    np.testing.assert_allclose(np.exp(bar), [0.75, 0.25], rtol=0, atol=4 * 1e5 * EPS)
    assert log_sum == pytest.approx(level + math.log(4.0 / 3.0), abs=4 * 1e5 * EPS)


def test_normalize_treats_each_run_alone():
    """Catches a peak or a sum taken over all runs: run 0 would underflow beside run 1."""
    log_w = np.array([[-1e4, -1e4, -np.inf], [0.0, 1.0, 2.0]])
    bar, log_sum = normalize(log_w)
    assert bar.shape == (2, 3) and log_sum.shape == (2,)
    for run in range(2):
        alone = normalize(log_w[run])
        np.testing.assert_array_equal(bar[run], alone[0])
        assert log_sum[run] == alone[1]


def test_normalize_leaves_its_argument_alone():
    """Catches an in-place subtraction, which would change the caller's history of weights."""
    log_w = np.array([-1.0, -2.0])
    normalize(log_w)
    assert log_w.tolist() == [-1.0, -2.0]


@pytest.mark.parametrize(
    ("log_w", "message"),
    [
        ([0.0, np.nan], r"log weight nan at index \(1,\)"),
        ([np.inf, 0.0], r"log weight inf at index \(0,\)"),
        ([[0.0, 0.0], [np.nan, -np.inf]], r"log weight nan at index \(1, 0\)"),
        ([], r"shape \(\.\.\., N\) with N >= 1, got shape \(0,\)"),
        (1.0, r"shape \(\.\.\., N\) with N >= 1, got shape \(\)"),
    ],
)
def test_bad_log_weights_are_named(log_w, message):
    """Catches NaN that spreads silently through a whole run."""
    with pytest.raises(ValueError, match=message):
        normalize(log_w)
    with pytest.raises(ValueError, match=message):
        effective_sample_size(log_w)


@pytest.mark.parametrize("log_w", [[-np.inf, -np.inf], [[0.0, 0.0], [-np.inf, -np.inf]]])
def test_all_zero_weights_are_an_error_even_in_one_run_of_many(log_w):
    """Catches 0/0: a dead run must not come back as NaN or as equal weights."""
    with pytest.raises(ZeroLikelihoodError, match="all weights are zero"):
        normalize(log_w)


@properties
@given(log_weights)
def test_effective_sample_size_lies_between_one_and_n(log_w):
    """Catches 1 / sum(w)^2, sum(w^2), and weights used before they are normalised."""
    n_eff = effective_sample_size(log_w)
    rounding = 1 + 8 * len(log_w) * EPS
    assert 1 / rounding <= n_eff <= len(log_w) * rounding


@properties
@given(log_weights, st.integers(2, 5))
def test_splitting_every_particle_multiplies_the_effective_number(log_w, copies):
    """Catches a normalisation by N in the wrong place: k twins of each particle are k times as many."""
    split = np.repeat(log_w, copies)
    assert effective_sample_size(split) == pytest.approx(copies * effective_sample_size(log_w), rel=1e-9)


def test_effective_sample_size_of_known_weights():
    """By hand: 1 / (0.25 + 0.09 + 0.04) = 1 / 0.38; equal weights give N, a single one gives 1."""
    log_w = np.log([[0.5, 0.3, 0.2], [2.0, 2.0, 2.0], [1e-300, 1.0, 1e-300]]) - 700
    np.testing.assert_allclose(effective_sample_size(log_w), [1 / 0.38, 3.0, 1.0], rtol=1e-12)


x_hand = np.array([[0.0, 1.0], [2.0, 3.0], [4.0, -1.0]])
log_w_hand = np.log([0.5, 0.3, 0.2])


def test_mean_and_covariance_by_hand():
    """Catches the (N-1) or unbiased covariance, a transposed product, and weights used as logarithms."""
    np.testing.assert_allclose(weighted_mean(x_hand, log_w_hand), [1.4, 1.2], rtol=1e-14)
    np.testing.assert_allclose(weighted_cov(x_hand, log_w_hand), [[2.44, -0.68], [-0.68, 1.96]], rtol=1e-14)


@properties
@given(
    st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(-5, 5)), min_size=1, max_size=20),
    st.tuples(*[st.floats(-3, 3)] * 6),
)
def test_mean_and_covariance_follow_an_affine_map(rows, coefficients):
    """Catches a covariance that depends on the origin or mixes the axes up."""
    table = np.array(rows)
    x, log_w = table[:, :2], normalize(table[:, 2])[0]
    A, b = np.reshape(coefficients[:4], (2, 2)), np.array(coefficients[4:])
    np.testing.assert_allclose(weighted_mean(x @ A.T + b, log_w), A @ weighted_mean(x, log_w) + b, atol=1e-11)
    np.testing.assert_allclose(weighted_cov(x @ A.T + b, log_w), A @ weighted_cov(x, log_w) @ A.T, atol=1e-9)


def test_covariance_far_from_the_origin():
    """Catches mean of squares minus square of mean: at 1e8 that loses all 16 digits of a variance of one."""
    x = 1e8 + np.array([[-1.0], [1.0]])
    np.testing.assert_array_equal(weighted_cov(x, np.log([0.5, 0.5])), [[1.0]])


def test_covariance_is_symmetric_and_positive():
    """Catches a product that is the covariance only on average."""
    rng = np.random.default_rng(1)
    x, log_w = rng.standard_normal((4, 50, 3)), normalize(rng.standard_normal((4, 50)))[0]
    cov = weighted_cov(x, log_w)
    np.testing.assert_allclose(cov, np.swapaxes(cov, -1, -2), rtol=1e-12)
    assert (np.linalg.eigvalsh(cov) > 0).all()


def test_moments_treat_each_run_alone():
    """Catches a sum over the axis of runs."""
    rng = np.random.default_rng(2)
    x, log_w = rng.standard_normal((2, 3, 20, 2)), normalize(rng.standard_normal((2, 3, 20)))[0]
    mean, cov = weighted_mean(x, log_w), weighted_cov(x, log_w)
    assert mean.shape == (2, 3, 2) and cov.shape == (2, 3, 2, 2)
    for run in np.ndindex(2, 3):
        np.testing.assert_allclose(mean[run], weighted_mean(x[run], log_w[run]), rtol=1e-12)
        np.testing.assert_allclose(cov[run], weighted_cov(x[run], log_w[run]), rtol=1e-12)


@pytest.mark.parametrize("moment", [weighted_mean, weighted_cov])
@pytest.mark.parametrize(("x", "log_w"), [((5,), (5,)), ((5, 2), (4,)), ((3, 5, 2), (5,)), ((2, 5), (5,))])
def test_particles_and_weights_that_do_not_fit_are_an_error(moment, x, log_w):
    """Catches broadcasting that gives a number of the right shape and the wrong value."""
    with pytest.raises(ValueError, match="do not fit"):
        moment(np.zeros(x), np.zeros(log_w))


# Angles

angles = st.lists(st.tuples(st.floats(-30, 30), st.floats(-5, 5)), min_size=1, max_size=20)


def direction(angle):
    return np.exp(1j * np.asarray(angle))


@properties
@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_a_wrapped_angle_is_the_same_direction_within_pi(values):
    """Catches an interval of [0, 2 pi), one that rounding steps out of, and angles of many turns."""
    inside = wrap(values)
    assert (np.abs(inside) <= np.pi).all()
    # angles of up to 1e6 and multiples of 2 pi are rounded at that size
    np.testing.assert_allclose(direction(inside), direction(values), rtol=0, atol=4 * 1e6 * EPS)
    np.testing.assert_array_equal(wrap(inside), inside)


@pytest.mark.parametrize("angle", [0.0, 1.0, np.pi, -np.pi, np.nextafter(np.pi, 0), 1e-300])
def test_an_angle_within_pi_keeps_its_bits(angle):
    """Catches (angle + pi) % (2 pi) - pi, which rounds every angle and turns pi into -pi."""
    assert wrap(angle) == angle


@pytest.mark.parametrize("turns", [-7, -1, 1, 2, 1000])
def test_an_odd_multiple_of_pi_stays_within_pi(turns):
    """Catches an angle an ulp beyond pi where the multiple was rounded."""
    for angle in (np.pi * (2 * turns + 1), np.nextafter(np.pi * (2 * turns + 1), [-np.inf, np.inf])):
        assert (np.abs(wrap(angle)) <= np.pi).all()
        np.testing.assert_allclose(direction(wrap(angle)), -1, atol=1e-9)


def test_only_angles_are_wrapped():
    """Catches a position taken for an angle."""
    np.testing.assert_allclose(wrap([[7.0, 7.0]], [False, True]), [[7.0, 7.0 - 2 * np.pi]], rtol=1e-15)


def test_circular_moments_in_closed_form():
    """Catches the mean across the seam, differences not wrapped, the unbiased variance, and R taken for 1."""
    case = json.loads((REFERENCE / "api_cases.json").read_text(encoding="utf-8"))["circular"]
    x, log_w = np.array(case["angles"])[:, None], np.log(case["weights"])
    np.testing.assert_allclose(weighted_mean(x, log_w, [True]), [case["circular_mean"]], rtol=1e-14)
    np.testing.assert_allclose(weighted_mean(x, log_w, [False]), [case["linear_mean"]], rtol=1e-14)
    np.testing.assert_allclose(weighted_cov(x, log_w, [True]), [[case["wrapped_var_biased"]]], rtol=1e-12)
    assert np.exp(log_w) @ np.cos(x[:, 0] - case["circular_mean"]) == pytest.approx(case["R"], rel=1e-14)


@properties
@given(angles, st.floats(-10, 10))
def test_circular_moments_turn_with_the_circle(rows, turn):
    """Catches any place on the circle that is treated differently: the seam must not be seen.

    Where the resultant is short the mean direction is the ratio of small numbers: rounding is divided by it.
    """
    x, log_w = np.array(rows)[:, :1], normalize(np.array(rows)[:, 1])[0]
    resultant = abs(np.exp(log_w) @ direction(x[:, 0]))
    if resultant < 1e-3:
        return
    mean, moved = weighted_mean(x, log_w, [True]), weighted_mean(x + turn, log_w, [True])
    atol = 1e-13 / resultant
    np.testing.assert_allclose(direction(moved), direction(mean + turn), rtol=0, atol=atol)
    opposite = np.abs(np.abs(wrap(x - mean)) - np.pi).min()
    if opposite > 1e-9:  # a particle opposite the mean differs from it by pi or by -pi
        cov = weighted_cov(x, log_w, [True])
        np.testing.assert_allclose(weighted_cov(x + turn, log_w, [True]), cov, rtol=0, atol=20 * atol)


@properties
@given(angles)
def test_near_a_point_a_circle_is_a_line(rows):
    """Catches moments that are not those of the line where angles keep within 1e-4: sin d = d - d^3/6."""
    x, log_w = 1e-4 * np.array(rows)[:, :1] / 30, normalize(np.array(rows)[:, 1])[0]
    np.testing.assert_allclose(weighted_mean(x, log_w, [True]), weighted_mean(x, log_w), rtol=0, atol=1e-12)
    np.testing.assert_allclose(weighted_cov(x, log_w, [True]), weighted_cov(x, log_w), rtol=0, atol=1e-15)


def test_an_angle_beside_a_position():
    """Catches wrapped differences that do not go into the covariance of angle and position, each run alone.

    Angles pi -+ 0.1 with positions -+ 10, so the covariance is that of +-0.1 and +-10: 0.01, 1, 100.
    """
    x = np.array([[[np.pi - 0.1, -10.0], [-np.pi + 0.1, 10.0]], [[0.1, -10.0], [-0.1, 10.0]]])
    log_w = np.log(np.full((2, 2), 0.5))
    mean, cov = weighted_mean(x, log_w, [True, False]), weighted_cov(x, log_w, [True, False])
    np.testing.assert_allclose(np.abs(mean), [[np.pi, 0], [0, 0]], rtol=0, atol=1e-14)
    np.testing.assert_allclose(cov, [[[0.01, 1], [1, 100]], [[0.01, -1], [-1, 100]]], rtol=1e-12)


def test_no_circular_state_changes_no_bit():
    """Catches a detour by way of sine and cosine for states that are no angles."""
    rng = np.random.default_rng(3)
    x, log_w = rng.standard_normal((4, 30, 2)), normalize(rng.standard_normal((4, 30)))[0]
    for moment in (weighted_mean, weighted_cov):
        np.testing.assert_array_equal(moment(x, log_w, [False, False]), moment(x, log_w))


@pytest.mark.parametrize("circular", [True, [True], [0, 1], [True, False, True], ["yes", "no"]])
def test_flags_that_do_not_fit_are_an_error(circular):
    """Catches one flag spread to all states, and numbers of states (0, 1) taken for flags."""
    for use in (
        lambda: as_circular(circular, 2),
        lambda: weighted_mean(np.zeros((3, 2)), np.log([0.5, 0.25, 0.25]), circular),
        lambda: weighted_cov(np.zeros((3, 2)), np.log([0.5, 0.25, 0.25]), circular),
    ):
        with pytest.raises(ValueError, match="circular must be 2 times True or False, one for each state"):
            use()


def test_a_particle_of_weight_zero_may_be_far_away():
    """Catches zero times the square of a huge distance, in one state or two."""
    for n_x in (1, 2):
        x = np.array([[0.0] * n_x, [2.0] * n_x, [1e200] * n_x])
        mean, cov = weighted_moments(x, np.log([0.5, 0.5, 1e-320]) * [1, 1, np.inf])
        np.testing.assert_allclose(mean, 1.0)
        np.testing.assert_allclose(cov, 1.0)


def test_weights_that_are_not_normalised_are_an_error():
    """Catches a mean of twice its size, given in silence."""
    for function in (weighted_mean, weighted_cov, weighted_moments):
        with pytest.raises(ValueError, match="weights must be normalised, their sum is 2: use"):
            function([[1.0], [3.0]], [0.0, 0.0])
