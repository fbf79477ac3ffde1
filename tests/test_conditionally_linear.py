"""Conditionally linear models: parts that make the whole, and positioning by pseudo-ranges."""

import numpy as np
import pytest

from pfedu.models import ConditionallyLinear, positioning
from pfedu.models.jacobian import jacobian

SEVERAL = 4.5  # standard errors: a handful of comparisons per test, each missed by chance once in 150 000


def f(k, u):
    return np.concatenate([np.sin(u) + k, u[..., :1] * u[..., 1:]], axis=-1)


def A(k, u):
    """A matrix (3, 1) for each u, of which no two entries are alike."""
    return np.stack([u[..., :1], k * u[..., 1:], np.cos(u[..., :1])], axis=-2)


def h(k, u):
    return u**2


def C(k, u):
    return np.stack([u[..., :1] - k, u[..., 1:]], axis=-2)


def bent(**changes):
    """Two states that are not linear, one that is."""
    pieces = dict(n_u=2, f=f, A=A, h=h, C=C, Q=[1.0, 2.0, 3.0], R=[0.5, 0.7], m0=[1.0, -1.0, 0.5], P0=[1.0, 1.0, 1.0])
    return ConditionallyLinear(**(pieces | changes))


@pytest.mark.parametrize("lead", [(), (5,), (2, 5)], ids=str)
def test_the_whole_is_made_of_its_parts(lead):
    """Catches a part of another state, a matrix transposed, and z taken from the wrong end."""
    model, x = bent(), np.random.default_rng(1).standard_normal((*lead, 3))
    moved, seen = model.f(3, x), model.h(3, x)
    assert moved.shape == (*lead, 3) and seen.shape == (*lead, 2)
    for i in np.ndindex(lead):
        a, b, z = x[i]
        np.testing.assert_allclose(moved[i], [np.sin(a) + 3 + a * z, np.sin(b) + 3 + 3 * b * z, a * b + np.cos(a) * z])
        np.testing.assert_allclose(seen[i], [a**2 + (a - 3) * z, b**2 + b * z])


def test_a_matrix_is_a_function_that_does_not_change():
    """Catches a matrix taken another way than a function: the same whole, in one shape or in many."""
    a, c = np.array([[1.0], [2.0], [3.0]]), np.array([[0.5], [-1.0]])
    x = np.random.default_rng(1).standard_normal((4, 5, 3))
    matrices = bent(A=a, C=c)
    functions = bent(A=lambda k, u: np.broadcast_to(a, (*u.shape[:-1], 3, 1)), C=lambda k, u: c)
    np.testing.assert_array_equal(matrices.f(1, x), functions.f(1, x))
    np.testing.assert_array_equal(matrices.h(1, x), functions.h(1, x))
    np.testing.assert_allclose(matrices.f(1, x), f(1, x[..., :2]) + x[..., 2:] * a[:, 0], rtol=1e-13)


def test_draws_and_densities_are_those_of_an_additive_model():
    """Catches noise for u alone: E[-2 log p] = log det(2 pi Q) + n with variance 2 n, of moves and measurements."""
    model, n, rng = bent(Q=[[1.0, 0.3, 0.2], [0.3, 2.0, 0.5], [0.2, 0.5, 3.0]]), 30_000, np.random.default_rng(2)
    x = model.sample_initial(n, rng)
    new = model.propagate(1, x, rng)
    y = model.measure(1, new, rng)
    for log_p, cov in ((model.log_transition(1, new, x), model.Q), (model.log_likelihood(1, y, new), model.R)):
        want = np.linalg.slogdet(2 * np.pi * cov)[1] + len(cov)
        assert abs((-2 * log_p).mean() - want) < SEVERAL * np.sqrt(2 * len(cov) / n)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(n_u=0), "n_u must be a whole number of at least 1 and below the 3 states of m0, got 0"),
        (dict(n_u=3), "n_u must be a whole number of at least 1 and below the 3 states of m0, got 3"),
        (dict(n_u=1.5), "n_u must be a whole number"),
        (dict(A=np.ones((3, 2))), r"A must be \(3, 1\) to fit m0, n_u and R, got \(3, 2\)"),
        (dict(A=np.ones((2, 1))), r"A must be \(3, 1\) to fit m0, n_u and R, got \(2, 1\)"),
        (dict(C=[[1.0]]), r"C must be \(2, 1\) to fit m0, n_u and R, got \(1, 1\)"),
        (dict(Q=[1.0, 1.0]), "Q is 2 x 2, but m0 has 3 states"),
    ],
)
def test_pieces_that_do_not_fit_are_named(change, message):
    """Catches shapes that broadcast."""
    with pytest.raises(ValueError, match=message):
        bent(**change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(f=lambda k, u: u), r"f\(k, u\) must give shape \(\.\.\., 3\) for u \(4, 2\), got \(4, 2\)"),
        (dict(A=lambda k, u: np.ones((4, 1, 1))), r"A\(k, u\) must give shape .*3, 1\) for u .* got \(4, 1, 1\)"),
    ],
)  # fmt: skip
def test_functions_of_the_wrong_size_are_named(change, message):
    """Catches one row that broadcasts to all states."""
    with pytest.raises(ValueError, match=message):
        bent(**change).f(1, np.zeros((4, 3)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(h=lambda k, u: u[..., :1]), r"h\(k, u\) must give shape \(\.\.\., 2\) for u \(4, 2\), got \(4, 1\)"),
        (dict(C=lambda k, u: np.ones((4, 1, 1))), r"C\(k, u\) must give shape .*2, 1\) for u .* got \(4, 1, 1\)"),
    ],
)  # fmt: skip
def test_measurements_of_the_wrong_size_are_named(change, message):
    """Catches one range that broadcasts to all beacons."""
    with pytest.raises(ValueError, match=message):
        bent(**change).h(1, np.zeros((4, 3)))


# Positioning


def transition(dt):
    """Position and bias move with velocity and drift, state by state."""
    F = np.eye(6)
    F[0, 2] = F[1, 3] = F[4, 5] = dt
    return F


def test_the_vehicle_moves_with_its_velocity_and_the_bias_with_its_drift():
    """Catches a velocity added to the other axis, a drift that moves nothing, and dt left out."""
    model, x = positioning(dt=0.5), np.random.default_rng(1).standard_normal((20, 6))
    np.testing.assert_allclose(model.f(1, x), x @ transition(0.5).T, atol=1e-14)
    np.testing.assert_allclose(jacobian(lambda z: model.f(1, z), x[:1])[0], transition(0.5), atol=1e-9)
    assert (model.n_u, model.n_z) == (2, 4)


def test_the_noise_is_white_noise_on_velocity_and_drift():
    """Catches powers and factors of dt: the integral of F(t) G q G' F(t)' over a step, by Gauss's rule, exact here."""
    q_v, q_d, dt = 0.3, 0.02, 1.7
    nodes, weights = np.polynomial.legendre.leggauss(4)
    intensity = np.diag([0.0, 0.0, q_v, q_v, 0.0, q_d])
    want = sum(dt / 2 * w * transition(t) @ intensity @ transition(t).T
               for t, w in zip(dt / 2 * (nodes + 1), weights, strict=True))  # fmt: skip
    np.testing.assert_allclose(positioning(q_v=q_v, q_d=q_d, dt=dt).Q, want, rtol=0, atol=1e-13)


def test_two_steps_are_one_of_twice_the_length():
    """Catches a noise that depends on how often one looks: F Q F' + Q = Q(2 dt)."""
    one, two = positioning(dt=0.5), positioning(dt=1.0)
    np.testing.assert_allclose(transition(0.5) @ one.Q @ transition(0.5).T + one.Q, two.Q, rtol=0, atol=1e-15)


def test_pseudo_ranges_by_hand():
    """Catches squares not rooted, a beacon's coordinates swapped, and a bias that is not in every range.

    From (3, 4): 5 to the origin, hypot(997, 4) and hypot(3, 996) to the others, 7 of clock on each.
    """
    model = positioning()
    want = np.array([5.0, np.hypot(997.0, 4.0), np.hypot(3.0, 996.0)]) + 7.0
    got = model.h(1, np.array([3.0, 4.0, 100.0, -50.0, 7.0, 99.0]))
    np.testing.assert_allclose(got, want, rtol=1e-15)
    np.testing.assert_array_equal(model.R, 25.0 * np.eye(3))


def test_a_range_falls_towards_its_beacon():
    """Catches a sign: the slope of a range is the unit vector from the beacon to the vehicle, 1 for the bias."""
    model, x = positioning(), np.array([[300.0, 400.0, 1.0, 1.0, 5.0, 0.0]])
    H = model.jacobian_h(1, x)[0]
    for row, beacon in zip(H, [(0.0, 0.0), (1000.0, 0.0), (0.0, 1000.0)], strict=True):
        away = x[0, :2] - beacon
        np.testing.assert_allclose(row, [*(away / np.linalg.norm(away)), 0, 0, 1, 0], atol=1e-7)


@pytest.mark.parametrize("n", [2, 5])
def test_any_number_of_beacons(n):
    """Catches a three that is written somewhere."""
    beacons = np.random.default_rng(1).uniform(0, 1000, (n, 2))
    x, y = positioning(beacons=beacons).simulate(3, np.random.default_rng(1))
    assert x.shape == (4, 6) and y.shape == (4, n)


@pytest.mark.parametrize("beacons", [(0.0, 0.0), [[0.0, 0.0, 0.0]]])
def test_beacons_that_are_no_points_are_an_error(beacons):
    """Catches one beacon handed over as two."""
    with pytest.raises(ValueError, match=r"beacons must be rows of two coordinates, shape \(n_y, 2\); got"):
        positioning(beacons=beacons)
