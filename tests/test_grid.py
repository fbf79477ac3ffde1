"""The grid filter: exact where the Kalman filter is, and where it is not."""

import numpy as np
import pytest
from records import measurements, reference

from pfedu.grid import GridError, grid_filter, trapezoid_weights
from pfedu.kalman import kalman_filter
from pfedu.models import AdditiveGaussian, LinearGaussian, MissingPieceError, StateSpaceModel, growth, random_walk

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


def test_two_states_are_an_error():
    """Catches a state whose second component is dropped."""
    model = LinearGaussian(F=np.eye(2), H=[[1.0, 0.0]], Q=np.eye(2), R=1.0, m0=[0.0, 0.0], P0=np.eye(2))
    with pytest.raises(ValueError, match="state of one dimension, the model has 2"):
        grid_filter(model, [[1.0]], EVEN)


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
    fine = grid_filter(growth(q=1.0), y, np.linspace(-50, 50, 4001))
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
