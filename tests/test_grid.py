"""The grid filter: exact where the Kalman filter is, and where it is not."""

import tracemalloc

import numpy as np
import pytest
from records import measurements, reference

import pfedu.grid
from pfedu.gaussian import log_density
from pfedu.grid import GridError, grid_filter, trapezoid_weights
from pfedu.kalman import kalman_filter
from pfedu.models import (
    AdditiveGaussian,
    LinearGaussian,
    MissingPieceError,
    StateSpaceModel,
    growth,
    random_walk,
    ratio,
)

NAN = np.nan

# The trapezoidal rule of spacing h on a smooth density of standard deviation s errs by a share of
# exp(-2 (pi s / h)^2): the posterior sd of linear_A is 0.957, so h = 0.5 leaves exp(-72).
EVEN = np.linspace(-60.0, 60.0, 241)
# Gaps that grow from 0.19 at the left end to 0.56 at the right. The rule stays as sharp, because the nodes
# lie on a parabola x(u): the gap over both neighbours, 2 h x'(u), is exactly the change of variable.
UNEVEN = -60.0 + 60.0 * np.linspace(0.0, 1.0, 321) * (1.0 + np.linspace(0.0, 1.0, 321))


@pytest.mark.parametrize("nodes", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("with_y0", [False, True])
def test_the_grid_is_the_kalman_filter_where_that_is_exact(nodes, with_y0):
    """Catches a lost spacing, a transition matrix transposed, a constant, and nodes taken as evenly spaced."""
    y = measurements("linear_A", with_y0=with_y0)
    grid, exact = grid_filter(random_walk(), y, nodes), kalman_filter(random_walk(), y)
    np.testing.assert_allclose(grid.mean, exact.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(grid.cov, exact.cov, rtol=0, atol=1e-9)
    np.testing.assert_allclose(grid.log_likelihood_increments, exact.log_likelihood_increments, rtol=0, atol=1e-9)
    if not with_y0:
        assert grid.log_likelihood == pytest.approx(-133.2318559261, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "phase", "total"), [("growth_A", 0, -122.6402065006), ("growth_C", 1, -124.2006124531)]
)
def test_the_growth_records(name, phase, total):
    """Catches a phase one step off, and a posterior with several peaks that is boiled down to one."""
    data, nodes = reference(name), np.linspace(-50, 50, 1251)  # a gap of 0.1 errs by 4e-8, one of 0.08 by far less
    track = grid_filter(growth(phase=phase), measurements(name), nodes)
    np.testing.assert_allclose(track.mean[:, 0], data["post_mean"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(track.cov[:, 0, 0], data["post_var"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(track.log_likelihood_increments, data["loglik_inc"], rtol=0, atol=1e-9)
    assert track.log_likelihood == pytest.approx(total, abs=1e-9)
    third = track.density * (nodes - track.mean) ** 3 @ trapezoid_weights(nodes)
    np.testing.assert_allclose(third / track.sd[:, 0] ** 3, data["post_skew"], rtol=0, atol=1e-8)


def test_the_wrong_phase_is_another_model():
    """Shows that the test above can fail: one step off costs tens of units of log-likelihood."""
    wrong = grid_filter(growth(phase=1), measurements("growth_A"), np.linspace(-50, 50, 501))
    assert wrong.log_likelihood < -122.64020650 - 10


def test_the_ratio_record():
    """Catches a motion with a pole put on nodes that do not crowd about it, and weights off by more than is known.

    With nodes x = -1 + c sinh(u), u in even steps of h, half the distance of both neighbours is x'(u) sinh(h): the
    rule that is exact in u, h x'(u), times one constant, sinh(h)/h. Normalising takes the constant out of every
    posterior, so moments agree to rounding; each increment keeps its logarithm, h^2/6 = 2e-4. The number of nodes
    is even, so that none lies on the pole. The ends are far out because a state near the pole is thrown that far:
    a step loses 2/3 p(-1)/300, which is 4e-4 at most.
    """
    u = np.linspace(np.arcsinh(-299 / 0.01), np.arcsinh(301 / 0.01), 600)
    data, h = reference("ratio_A"), u[1] - u[0]
    track = grid_filter(ratio(), measurements("ratio_A"), -1 + 0.01 * np.sinh(u))
    np.testing.assert_allclose(track.mean[:, 0], data["post_mean"], rtol=0, atol=1e-13)
    np.testing.assert_allclose(track.cov[:, 0, 0], data["post_var"], rtol=0, atol=1e-13)
    known = np.where(np.arange(51) > 0, np.log(np.sinh(h) / h), 0.0)  # the missing row has no increment
    np.testing.assert_allclose(track.log_likelihood_increments - known, data["loglik_inc"], rtol=0, atol=1e-12)
    assert track.log_likelihood - known.sum() == pytest.approx(-69.03025606, abs=1e-8)  # so many digits are known


def test_tails_cut_off_by_the_ends_call_for_a_wider_grid():
    """Catches the advice of a finer grid where 0.3 % of the states lie beyond the ends, in a tail too low to see."""
    nodes = -1 + 0.01 * np.sinh(np.linspace(np.arcsinh(-24 / 0.01), np.arcsinh(26 / 0.01), 400))
    with pytest.raises(GridError, match=r"step 1 the density integrates to 0\.997\d .* use a wider grid"):
        grid_filter(ratio(), measurements("ratio_A"), nodes)


def test_a_missing_row_is_predicted_over():
    """Catches a missing row corrected with zero: the Kalman filter, which has no grid, must agree."""
    y = measurements("linear_A", with_y0=True)[:12]
    y[[3, 4, 9, 11]] = NAN
    grid, exact = grid_filter(random_walk(), y, EVEN), kalman_filter(random_walk(), y)
    np.testing.assert_allclose(grid.mean, exact.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(grid.cov, exact.cov, rtol=0, atol=1e-9)
    assert (grid.log_likelihood_increments[[3, 4, 9, 11]] == 0.0).all()


def test_a_missing_row_far_from_zero():
    """Catches a missing measurement weighed as if it were zero: it then has no probability anywhere."""
    model, nodes = random_walk(q=1.0, r=1.0, m0=1e4, p0=1.0), np.linspace(9900, 10100, 801)
    track = grid_filter(model, [[NAN], [1.0001e4], [NAN]], nodes)
    exact = kalman_filter(model, [[NAN], [1.0001e4], [NAN]])
    np.testing.assert_allclose(track.mean, exact.mean, rtol=0, atol=1e-7)  # a sum of 801 terms of size 1e4


@pytest.mark.parametrize("runs", [(6,), (2, 3)])
def test_a_batch_is_a_loop_over_its_records(runs):
    """Catches records that mix, also where one misses a row and another does not."""
    y = random_walk().simulate(6, np.random.default_rng(1), n_runs=6)[1]
    y[1, 4], y[5, 0], y[:, 5] = NAN, NAN, NAN
    y = y.reshape(*runs, 7, 1)
    together = grid_filter(random_walk(), y, EVEN)
    assert together.mean.shape == (*runs, 7, 1) and together.cov.shape == (*runs, 7, 1, 1)
    assert together.density.shape == (*runs, 7, EVEN.size) and together.log_likelihood.shape == runs
    for run in np.ndindex(runs):
        alone = grid_filter(random_walk(), y[run], EVEN)
        np.testing.assert_allclose(together.density[run], alone.density, rtol=0, atol=1e-12)
        np.testing.assert_allclose(together.log_likelihood[run], alone.log_likelihood, rtol=0, atol=1e-11)


def test_densities_are_densities():
    """Catches probabilities of nodes handed out as densities, and a mean that is not the density's."""
    y = measurements("linear_A")[:10]
    track, dx = grid_filter(random_walk(), y, UNEVEN), trapezoid_weights(UNEVEN)
    np.testing.assert_array_equal(track.grid, UNEVEN)
    np.testing.assert_allclose(track.density @ dx, 1.0, rtol=0, atol=1e-12)
    exact = kalman_filter(random_walk(), y)
    want = np.exp(-0.5 * ((UNEVEN - exact.mean) / exact.sd) ** 2) / (np.sqrt(2 * np.pi) * exact.sd)
    np.testing.assert_allclose(track.density, want, rtol=0, atol=1e-9)
    assert track.n_eff is track.resampled is track.particles is None


def test_trapezoid_weights_integrate_straight_lines():
    """Catches a gap given whole to one neighbour: the rule is exact for a + b x on any nodes."""
    nodes = np.sort(np.random.default_rng(2).uniform(-3, 5, 40))
    dx = trapezoid_weights(nodes)
    length = nodes[-1] - nodes[0]
    assert dx.sum() == pytest.approx(length, rel=1e-13)
    assert nodes @ dx == pytest.approx(length * (nodes[0] + nodes[-1]) / 2, rel=1e-13)


def test_a_missing_density_is_named():
    """Catches a model of samplers alone that ends in 'NoneType is not callable'."""
    pieces = dict(sample_initial=print, propagate=print, log_likelihood=print)
    with pytest.raises(MissingPieceError, match="StateSpaceModel has no log_initial, which the grid filter needs"):
        grid_filter(StateSpaceModel(**pieces), [[1.0]], EVEN)
    with pytest.raises(MissingPieceError, match="StateSpaceModel has no log_transition, which the grid filter needs"):
        grid_filter(StateSpaceModel(**pieces, log_initial=print), [[1.0]], EVEN)


@pytest.mark.parametrize(
    ("nodes", "step"), [(np.linspace(-3, 3, 61), 0), (np.linspace(-9, 9, 91), 1), (np.linspace(-9, 50, 291), 1)]
)
def test_a_narrow_grid_is_an_error(nodes, step):
    """Catches probability that leaves by the ends and is normalised away in silence."""
    with pytest.raises(GridError, match=rf"step {step} the density integrates to 0\.\d+ .* use a wider grid"):
        grid_filter(random_walk(), [[NAN], [0.5], [1.0]], nodes)


def test_a_coarse_grid_is_an_error():
    """Catches a transition so sharp that it falls between nodes, or is counted several times on one."""
    with pytest.raises(GridError, match=r"the step to time 1 is narrower than the grid can see: .* finer grid"):
        grid_filter(random_walk(q=0.01), [[NAN], [1.0]], np.linspace(-20, 20, 41))


def test_a_coarse_grid_between_whose_nodes_everything_falls():
    """Catches the advice to widen a grid that is wide enough: half a gap off, the sum is 3e-5."""
    drift = AdditiveGaussian(f=lambda k, x: x + 0.5, h=lambda k, x: x, Q=0.01, R=1.0, m0=0.0, P0=5.0)
    with pytest.raises(GridError, match=r"step 1 the density integrates to 2\.97.e-05 .* use a finer grid"):
        grid_filter(drift, [[NAN], [1.0]], np.linspace(-20, 20, 41))


def test_a_measurement_sharper_than_the_grid_is_an_error():
    """Catches a posterior of one node, whose variance is zero and whose likelihood is arbitrary."""
    with pytest.raises(GridError, match="at step 1 the posterior rests on 1 nodes: use a finer grid there"):
        grid_filter(random_walk(r=1e-4), [[NAN], [1.0]], np.linspace(-30, 30, 61))


def test_a_measurement_far_outside_the_grid_is_an_error():
    """Catches 0/0 where no node can explain the measurement."""
    with pytest.raises(
        GridError, match=r"at step 0 the posterior rests on 1 nodes: .* wider one if it lies beyond the ends"
    ):
        grid_filter(random_walk(r=0.01, p0=0.5), [[60.0]], EVEN)


def test_the_tolerance_decides():
    """Catches a tolerance that is not passed on: +-8 loses 3.5e-4 of N(0, 5) at the start."""
    nodes = np.linspace(-8, 8, 161)
    assert grid_filter(random_walk(), [[NAN]], nodes).mean[0, 0] == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(GridError, match="step 0"):
        grid_filter(random_walk(), [[NAN]], nodes, tolerance=1e-4)


def test_a_singular_noise_has_no_density():
    """Catches a transition density of zero everywhere: q = 0 cannot be put on a grid."""
    with pytest.raises(ValueError, match="Q is singular and has no density"):
        grid_filter(random_walk(q=0.0), [[NAN], [1.0]], EVEN)


@pytest.mark.parametrize("nodes", [[0.0, 1.0], [0.0, 2.0, 1.0], [0.0, 0.0, 1.0], [0.0, NAN, 1.0], np.ones((3, 3))])
def test_nodes_that_do_not_ascend_are_an_error(nodes):
    """Catches negative spacings, which give negative probabilities."""
    with pytest.raises(ValueError, match="vector of at least 3 ascending nodes"):
        grid_filter(random_walk(), [[1.0]], nodes)


@pytest.mark.parametrize(
    ("y", "message"),
    [
        ([[1.0, 2.0]], r"got \(1, 2\)"),
        ([[np.inf]], r"infinite value in row \[0\]"),
        (np.empty((0, 1)), r"got \(0, 1\)"),
    ],
)
def test_bad_records_are_named(y, message):
    """Catches a filter that skips the common check of its record."""
    with pytest.raises(ValueError, match=message):
        grid_filter(random_walk(), y, EVEN)


@pytest.mark.parametrize(("q", "nodes"), [(1.0, 201), (1.0, 501), (10.0, 201)])
def test_a_grid_too_coarse_for_the_motion_is_an_error(q, nodes):
    """Catches a posterior off by standard deviations: about zero the growth model moves neighbours 25 times apart."""
    y = growth(q=q).simulate(50, np.random.default_rng(1))[1]
    with pytest.raises(GridError, match=r"the step to time \d+ is narrower than the grid can see"):
        grid_filter(growth(q=q), y, np.linspace(-50, 50, nodes))


def test_what_passes_the_checks_is_accurate():
    """Catches a check that lets a coarse grid through: what is accepted is right to a twentieth of a deviation."""
    y = growth(q=1.0).simulate(50, np.random.default_rng(1))[1]
    fine = grid_filter(growth(q=1.0), y, np.linspace(-50, 50, 2401))  # 3201 change it by 6e-9
    accepted = grid_filter(growth(q=1.0), y, np.linspace(-50, 50, 1601))
    assert (np.abs(accepted.mean - fine.mean) < 0.05 * fine.sd).all()


def test_a_likelihood_of_the_wrong_shape_is_an_error():
    """Catches y - x[..., 0], which gives one number for the whole grid and a posterior that never moves."""
    walk = random_walk()
    model = StateSpaceModel(
        walk.sample_initial, walk.propagate, lambda k, y, x: walk.v.log_density(y - x[..., 0]),
        log_initial=walk.log_initial, log_transition=walk.log_transition)  # fmt: skip
    with pytest.raises(ValueError, match=r"log_likelihood must give shape \(601,\) on this grid"):
        grid_filter(model, [[1.0]], np.linspace(-30, 30, 601))


def test_a_measurement_far_from_the_prediction_does_not_underflow():
    """Catches a likelihood whose peak lies where the prediction has underflowed: 60 is 35 deviations away."""
    model, y = random_walk(q=1.0, r=1.0, p0=1.0), [[0.0], [0.0], [45.0]]
    track, exact = grid_filter(model, y, np.linspace(-80, 140, 4401)), kalman_filter(model, y)
    np.testing.assert_allclose(track.mean, exact.mean, atol=1e-8)


# Two states. A sum over the pairs of nodes errs by a share of exp(-2 pi^2 v), v the least variance of
# m1 x1 / h1 + m2 x2 / h2 over whole numbers m1 and m2, not both zero. The narrowest posterior on the widest
# gaps below has v = 1.3, which leaves 5e-12; beyond the ends lies less than that.
TURNING = LinearGaussian(F=[[0.9, 0.4], [-0.3, 0.8]], H=[[1.0, 0.5]], Q=[[1.0, 0.4], [0.4, 0.7]], R=0.8,
                         m0=[1.0, -1.0], P0=[[2.0, 0.5], [0.5, 1.0]])  # fmt: skip
EVEN_PAIR = (np.linspace(-12.5, 12.5, 45), np.linspace(-10.5, 10.5, 43))
either_axis = pytest.mark.parametrize("axis", [1, 2])


def parabola(end, n):
    """Nodes on which the rule stays sharp, with a gap at one end 1.8 times that of the other, from -end to end."""
    u = np.linspace(0.0, 1.0, n)
    return -end + 2.0 * end * u * (1.0 + 0.4 * u) / 1.4


UNEVEN_PAIR = (parabola(12.5, 51), -parabola(10.5, 49)[::-1])


def pair(axis, this, other):
    """The nodes ``this`` on that axis, ``other`` on the other one."""
    return (this, other) if axis == 1 else (other, this)


def assert_same(track, exact, atol):
    """Compare mean, covariance and increments."""
    for field in ("mean", "cov", "log_likelihood_increments"):
        np.testing.assert_allclose(getattr(track, field), getattr(exact, field), rtol=0, atol=atol, err_msg=field)


@pytest.mark.parametrize(
    "grid", [EVEN_PAIR, UNEVEN_PAIR, (EVEN_PAIR[0], UNEVEN_PAIR[1])], ids=["even", "uneven", "one uneven"]
)
def test_two_states_are_the_kalman_filter_where_that_is_exact(grid):
    """Catches axes or their weights swapped, F or the pairs of nodes transposed, and F or Q taken as diagonal.

    Row 2 is missing: corrected with zero, or its step left out, it would show as well.
    """
    y = TURNING.simulate(3, np.random.default_rng(3))[1]
    y[2] = NAN
    track, exact = grid_filter(TURNING, y, grid), kalman_filter(TURNING, y)
    assert_same(track, exact, atol=1e-11)
    assert track.mean.shape == (4, 2) and track.cov.shape == (4, 2, 2)
    assert track.log_likelihood_increments[2] == 0.0


def test_densities_of_two_states_are_densities():
    """Catches a density with its axes swapped, or probabilities handed out as densities.

    A density at a node is a sum over where it came from, which is narrower than the posterior: its variance of 0.29
    on gaps of 0.54 leaves 2e-9 of densities below 0.3. Moments, above, average that away.
    """
    y = TURNING.simulate(1, np.random.default_rng(3))[1]
    track, exact = grid_filter(TURNING, y, UNEVEN_PAIR), kalman_filter(TURNING, y)
    assert isinstance(track.grid, tuple) and track.density.shape == (2, 51, 49)
    np.testing.assert_array_equal(track.grid[0], UNEVEN_PAIR[0])
    np.testing.assert_array_equal(track.grid[1], UNEVEN_PAIR[1])
    x = np.stack(np.meshgrid(*track.grid, indexing="ij"), axis=-1)
    for k in range(2):
        want = np.exp(log_density(x, exact.mean[k], exact.cov[k]))
        np.testing.assert_allclose(track.density[k], want, rtol=0, atol=5e-9)


@pytest.mark.parametrize("runs", [(3,), (2, 2)])
def test_a_batch_of_two_states_is_a_loop_over_its_records(runs):
    """Catches records that mix with each other or with an axis of the grid, also where only one misses a row.

    Sums of some hundred terms in another order differ by 1e-14 of values up to 30.
    """
    y = TURNING.simulate(2, np.random.default_rng(1), n_runs=int(np.prod(runs)))[1]
    y[1, 1], y[0, 0], y[:, 2] = NAN, NAN, NAN
    y, grid = y.reshape(*runs, 3, 1), (np.linspace(-12.0, 12.0, 41), np.linspace(-10.0, 10.0, 35))
    together = grid_filter(TURNING, y, grid)
    assert together.mean.shape == (*runs, 3, 2) and together.cov.shape == (*runs, 3, 2, 2)
    assert together.density.shape == (*runs, 3, 41, 35) and together.log_likelihood.shape == runs
    for run in np.ndindex(runs):
        alone = grid_filter(TURNING, y[run], grid)
        np.testing.assert_allclose(together.density[run], alone.density, rtol=0, atol=1e-13)
        np.testing.assert_allclose(together.cov[run], alone.cov, rtol=0, atol=1e-12)
        np.testing.assert_allclose(together.log_likelihood[run], alone.log_likelihood, rtol=0, atol=1e-12)


def swing(k, x):
    """A motion with slopes between -1.1 and 2.1 that throws states apart at zero."""
    return 0.5 * x + 1.6 * np.sin(x) + 0.3 * k


ONES = [
    AdditiveGaussian(f=swing, h=lambda k, x: x * x / 10, Q=q, R=r, m0=0.2, P0=2.0) for q, r in ((1.0, 0.3), (0.7, 0.6))
]
SWINGING = np.linspace(-10.0, 10.0, 48)


def two_at_once(angle):
    """Both problems of one state as one of two, in axes turned by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    A = np.array([[c, -s], [s, c]])
    f, h = lambda k, z: swing(k, z @ A) @ A.T, lambda k, z: (z @ A) ** 2 / 10
    Q = A @ np.diag([1.0, 0.7]) @ A.T
    return AdditiveGaussian(f=f, h=h, Q=Q, R=[0.3, 0.6], m0=A @ [0.2, 0.2], P0=[2.0, 2.0]), A


def swinging_records(n_steps=3):
    """A record of both quantities, and the two tracks of one state on a grid ten times as fine."""
    y = np.hstack([model.simulate(n_steps, np.random.default_rng(i))[1] for i, model in enumerate(ONES, start=5)])
    return y, [grid_filter(model, y[:, [i]], np.linspace(-12, 12, 601)) for i, model in enumerate(ONES)]


def test_two_independent_states_have_the_product_of_their_densities():
    """Catches what only a linear model hides; the posteriors have two peaks, so the joint one has four.

    On a product grid the sums factor too, on any grid, so that the product holds to rounding.
    """
    y, _ = swinging_records()
    one, two = (grid_filter(model, y[:, [i]], SWINGING) for i, model in enumerate(ONES))
    both = grid_filter(two_at_once(0.0)[0], y, (SWINGING, SWINGING))
    product = one.density[:, :, None] * two.density[:, None, :]
    np.testing.assert_allclose(both.density, product, rtol=0, atol=1e-13)
    np.testing.assert_allclose(both.mean, np.hstack([one.mean, two.mean]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(both.cov[:, 0, 1], 0.0, rtol=0, atol=1e-12)
    increments = one.log_likelihood_increments + two.log_likelihood_increments
    np.testing.assert_allclose(both.log_likelihood_increments, increments, rtol=0, atol=1e-12)
    peaks = [count_peaks(track.density) for track in (one, two)]
    assert min(peaks) > 1  # else this would be no harder than a Gaussian


def count_peaks(density):
    """The most peaks that the density of any step has."""
    inside = density[:, 1:-1]
    return ((inside > density[:, :-2]) & (inside > density[:, 2:])).sum(axis=-1).max()


def test_two_states_in_turned_axes():
    """Catches sums that are right only where states are independent: here neither density nor motion factors.

    The narrowest thing summed is the motion as a function of where it came from, sqrt(0.7) / 2.1 = 0.40 wide: on
    gaps of 0.43 that leaves 3e-8.
    """
    y, (one, two) = swinging_records()
    model, A = two_at_once(0.6)
    both = grid_filter(model, y, (SWINGING, SWINGING))
    apart = np.stack([one.cov[:, 0, 0], two.cov[:, 0, 0]], axis=-1)  # (T+1, 2): a diagonal each
    np.testing.assert_allclose(both.mean, np.hstack([one.mean, two.mean]) @ A.T, rtol=0, atol=1e-7)
    np.testing.assert_allclose(both.cov, A * apart[:, None, :] @ A.T, rtol=0, atol=1e-7)
    increments = one.log_likelihood_increments + two.log_likelihood_increments
    np.testing.assert_allclose(both.log_likelihood_increments, increments, rtol=0, atol=1e-7)


def test_a_step_taken_in_pieces_is_the_step(monkeypatch):
    """Catches nodes left out, or taken twice, where a piece of the transition density ends."""
    y = TURNING.simulate(1, np.random.default_rng(3), n_runs=2)[1]
    whole = grid_filter(TURNING, y, EVEN_PAIR)
    monkeypatch.setattr(pfedu.grid, "_AT_ONCE", 2 * 45 * 43 * 97)  # 1935 nodes in pieces of 97: the last has 92
    pieces = grid_filter(TURNING, y, EVEN_PAIR)
    np.testing.assert_allclose(pieces.density, whole.density, rtol=0, atol=1e-14)
    monkeypatch.setattr(pfedu.grid, "_AT_ONCE", 1)  # one node at a time is the least
    one_by_one = grid_filter(random_walk(), [[NAN], [0.5]], EVEN)
    assert_same(one_by_one, kalman_filter(random_walk(), [[NAN], [0.5]]), atol=1e-9)


def test_a_large_grid_fits_in_memory():
    """Catches the transition density held whole: for 60 x 60 nodes one array of it is 104 MB, and a step has six."""
    y = TURNING.simulate(1, np.random.default_rng(3))[1]
    tracemalloc.start()
    try:
        grid_filter(TURNING, y, (np.linspace(-12, 12, 60), np.linspace(-11, 11, 60)))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 250e6


@either_axis
@pytest.mark.parametrize(("wide", "step"), [(3.5, 0), (6.0, 1)])
def test_a_grid_narrow_along_one_axis_is_an_error(axis, wide, step):
    """Catches the wrong axis named, and probability that leaves by the ends of one axis only."""
    model = LinearGaussian(F=np.eye(2), H=[[0.0, 0.0]], Q=[4.0, 4.0], R=1.0, m0=[0.0, 0.0], P0=[2.0, 2.0])
    grid = pair(axis, np.linspace(-wide, wide, 15), np.linspace(-14.0, 14.0, 29))
    with pytest.raises(
        GridError, match=rf"step {step} .* 0\.9\d+ .* it sticks out at an end of axis {axis}, use a wider"
    ):
        grid_filter(model, [[NAN], [0.5]], grid)


def test_a_grid_narrow_along_both_axes_is_an_error():
    """Catches one axis named where both are at fault."""
    grid = (np.linspace(-3, 3, 31), np.linspace(-2, 2, 31))
    with pytest.raises(GridError, match="it sticks out at an end of axes 1 and 2, use a wider grid"):
        grid_filter(TURNING, [[NAN]], grid)


@either_axis
def test_a_motion_too_narrow_for_one_axis_is_an_error(axis):
    """Catches halves of the nodes that are compared along one axis only, or the wrong axis named."""
    q = [0.04, 1.0] if axis == 1 else [1.0, 0.04]
    model = LinearGaussian(F=np.eye(2), H=[[1.0, 1.0]], Q=q, R=1.0, m0=[0.0, 0.0], P0=[2.0, 2.0])
    grid = (np.linspace(-9, 9, 25), np.linspace(-9, 9, 25))
    with pytest.raises(GridError, match=rf"the step to time 1 is narrower .* every second node of axis {axis} the"):
        grid_filter(model, [[NAN], [0.5]], grid)
    finer = pair(axis, np.linspace(-9, 9, 91), grid[0])
    exact = kalman_filter(model, [[NAN], [0.5]])
    assert_same(grid_filter(model, [[NAN], [0.5]], finer), exact, atol=1e-3)  # what the message asks for helps


def test_a_motion_too_narrow_across_the_diagonal_is_an_error():
    """Catches a ridge that neither axis sees alone: 0.06 wide across, on gaps of 0.5, and wide along both axes."""
    Q = [[1.0, 0.998], [0.998, 1.0]]
    model = LinearGaussian(F=np.eye(2), H=[[1.0, 1.0]], Q=Q, R=1.0, m0=[0.0, 0.0], P0=[1.0, 1.0])
    grid = (np.linspace(-8, 8, 33), np.linspace(-8, 8, 33))
    with pytest.raises(GridError, match=r"the step to time 1 is narrower .* every second node of axes 1 and 2 the"):
        grid_filter(model, [[NAN], [0.5]], grid)


@either_axis
def test_a_density_between_the_nodes_of_one_axis_is_an_error(axis):
    """Catches the wrong axis named where the prior itself is narrower than the gaps of one axis."""
    p0 = [0.02, 1.0] if axis == 1 else [1.0, 0.02]
    model = LinearGaussian(F=np.eye(2), H=[[1.0, 1.0]], Q=np.eye(2), R=1.0, m0=[0.2, 0.2], P0=p0)
    grid = (np.linspace(-8, 8, 33), np.linspace(-8, 8, 33))
    with pytest.raises(GridError, match=rf"step 0 .* it falls between nodes of axis {axis}, use a finer grid"):
        grid_filter(model, [[NAN]], grid)


@either_axis
def test_a_measurement_too_sharp_for_one_axis_is_an_error(axis):
    """Catches a posterior of one node on one axis that many nodes on the other hide."""
    H = [[1.0, 0.0]] if axis == 1 else [[0.0, 1.0]]
    model = LinearGaussian(F=np.eye(2), H=H, Q=np.eye(2), R=0.01, m0=[0.0, 0.0], P0=[2.0, 2.0])
    grid = (np.linspace(-8, 8, 33), np.linspace(-8, 8, 33))
    with pytest.raises(GridError, match=rf"step 0 the posterior rests on 1(\.\d)? nodes of axis {axis} with the other"):
        grid_filter(model, [[0.5]], grid)


def test_a_measurement_too_sharp_across_the_diagonal_is_an_error():
    """Catches nodes counted along each axis for itself: each has nine, and the ridge still lies on single nodes."""
    model = LinearGaussian(F=np.eye(2), H=[[1.0, -1.0]], Q=np.eye(2), R=0.01, m0=[0.0, 0.0], P0=[2.0, 2.0])
    grid = (np.linspace(-8, 8, 33), np.linspace(-8, 8, 33))
    with pytest.raises(GridError, match=r"step 0 the posterior rests on 1 nodes of axis \d with the other state known"):
        grid_filter(model, [[0.0]], grid)


def test_what_passes_the_checks_in_two_dimensions_is_accurate():
    """Catches a check that lets a coarse axis through: what is accepted is right to a twentieth of a deviation.

    Either axis is thinned out alone and both together, from 8 nodes to 30; some must pass and some must not.
    """
    y = TURNING.simulate(2, np.random.default_rng(4))[1]
    exact, verdicts = kalman_filter(TURNING, y), []
    for n_1, n_2 in (
        [(n, 30) for n in range(8, 30, 3)] + [(30, n) for n in range(8, 30, 3)] + [(n, n) for n in (12, 18, 24)]
    ):
        try:
            track = grid_filter(TURNING, y, (np.linspace(-9, 9, n_1), np.linspace(-8, 8, n_2)), tolerance=0.01)
        except GridError:
            verdicts.append("refused")
        else:
            verdicts.append("accepted")
            assert (np.abs(track.mean - exact.mean) < 0.05 * exact.sd).all(), (n_1, n_2)
    assert verdicts.count("accepted") >= 4 and verdicts.count("refused") >= 8


def test_a_singular_noise_of_two_states_has_no_density():
    """Catches a motion without noise in one state, which moves to a line and has no density over the plane."""
    model = LinearGaussian(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=[0.0, 0.1], R=1.0, m0=[0, 1], P0=[1, 1])
    with pytest.raises(ValueError, match=r"Q is singular and has no density: \[\[0\.0, 0\.0\], \[0\.0, 0\.1\]\]"):
        grid_filter(model, [[NAN], [1.0]], (np.linspace(-12, 12, 31), np.linspace(-12, 12, 31)))


def test_three_states_are_an_error():
    """Catches a computation that would take years instead of a word about what to use."""
    model = LinearGaussian(F=np.eye(3), H=[[1.0, 0.0, 0.0]], Q=np.eye(3), R=1.0, m0=np.zeros(3), P0=np.eye(3))
    message = r"one or two dimensions, the model has 3: .* 125000 nodes, 1\.6e\+10 pairs; use a particle filter"
    with pytest.raises(ValueError, match=message):
        grid_filter(model, [[1.0]], (EVEN, EVEN, EVEN))


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (EVEN, r"must be a pair \(nodes_1, nodes_2\) of vectors, got shape \(241,\)"),
        (3.0, r"must be a pair .* got shape \(\)"),
        ((EVEN,), r"must be a pair .* got shape \(1, 241\)"),
        ((EVEN, EVEN, EVEN), r"must be a pair .* got shape \(3, 241\)"),
        ((EVEN, EVEN, UNEVEN), r"must be a pair .* got 3 parts of different shapes"),
        ((EVEN, EVEN[::-1]), r"axis 2 of the grid must be a vector of at least 3 ascending nodes, got shape \(241,\)"),
        ((EVEN[:2], EVEN), r"axis 1 of the grid must be a vector of at least 3 ascending nodes, got shape \(2,\)"),
        ((1.0, 2.0), r"axis 1 of the grid must be a vector of at least 3 ascending nodes, got shape \(\)"),
        ((EVEN, (EVEN, UNEVEN)), "axis 2 of the grid must be a vector .* got 2 parts of different shapes"),
    ],
)
def test_a_grid_that_is_no_pair_of_axes_is_an_error(grid, message):
    """Catches a mistaken grid that ends in a broadcasting error, or in a filter of something else."""
    with pytest.raises(ValueError, match=message):
        grid_filter(TURNING, [[1.0]], grid)


@pytest.mark.parametrize(
    ("grid", "got"), [((EVEN, EVEN), r"shape \(2, 241\)"), ((EVEN, UNEVEN), "2 parts of different shapes")]
)
def test_a_pair_of_axes_for_one_state_is_an_error(grid, got):
    """Catches a second axis that is dropped, and numpy's own words about ragged arrays."""
    with pytest.raises(ValueError, match=f"the grid must be a vector of at least 3 ascending nodes, got {got}"):
        grid_filter(random_walk(), [[1.0]], grid)
