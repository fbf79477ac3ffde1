"""The jump-Markov linear system: its draws, its densities, and what it is made of."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from pfedu.models import JumpMarkov, jump_markov
from pfedu.models.jump_markov import modes

SEVERAL = 4.5  # standard errors: a handful of comparisons per test, each missed by chance once in 150 000
A = np.array([[[0.9, 0.3], [-0.2, 0.8]], [[-0.7, 0.0], [0.5, 1.0]], [[0.2, -0.9], [0.9, 0.2]]])
C = np.array([[[1.0, 0.0]], [[0.0, 1.0]], [[1.0, -1.0]]])
Q = np.array([[[1.0, 0.5], [0.5, 1.0]], [[0.2, 0.0], [0.0, 2.0]], [[0.5, -0.3], [-0.3, 0.4]]])
R = np.array([[[0.1]], [[1.0]], [[4.0]]])
PI = np.array([[0.7, 0.2, 0.1], [0.0, 0.6, 0.4], [0.5, 0.5, 0.0]])
M0, P0, p0 = np.array([1.0, -1.0]), np.array([[1.0, 0.4], [0.4, 2.0]]), np.array([0.5, 0.3, 0.2])
PIECES = dict(A=A, C=C, Q=Q, R=R, Pi=PI, m0=M0, P0=P0, p0=p0)


def three_modes(**changes):
    return JumpMarkov(**(PIECES | changes))


def moments_by_recursion(n_steps):
    """Probability of each mode at time T, E[z; s = j] and E[z z'; s = j]: a mode mixes, then its matrices move."""
    p, m, S = p0, p0[:, None] * M0, p0[:, None, None] * (P0 + np.outer(M0, M0))
    for _ in range(n_steps):
        p, m, S = PI.T @ p, np.einsum("ij,ia->ja", PI, m), np.einsum("ij,iab->jab", PI, S)
        m = np.einsum("jab,jb->ja", A, m)
        S = A @ S @ A.transpose(0, 2, 1) + p[:, None, None] * Q
    return p, m, S


def test_simulated_moments_are_those_of_the_recursion():
    """Catches Pi transposed, matrices of the mode before, p0 ignored, and a noise of another mode.

    Indicator of the mode, times 1, z, z z', and y, y^2: means over 40 000 runs, against their own standard errors.
    """
    n, T = 40_000, 3
    x, y = three_modes().simulate(T, np.random.default_rng(1), n_runs=n)
    p, m, S = moments_by_recursion(T)
    s, z = x[:, T, 0].astype(int), x[:, T, 1:]
    for j in range(3):
        drawn = np.concatenate(
            [np.ones((n, 1)), z, (z[:, :, None] * z[:, None, :]).reshape(n, 4), y[:, T], y[:, T] ** 2], 1
        )
        want = [p[j], *m[j], *S[j].ravel(), *(C[j] @ m[j]), *(C[j] @ S[j] @ C[j].T + p[j] * R[j]).ravel()]
        drawn = drawn * (s == j)[:, None]
        se = drawn.std(axis=0, ddof=1) / np.sqrt(n)
        assert (np.abs(drawn.mean(axis=0) - want) < SEVERAL * se).all()


def test_jumps_have_the_probabilities_of_their_rows():
    """Catches rows taken for columns: every jump counted, 60 000 of them; those of probability zero never occur."""
    s = modes(three_modes().simulate(3, np.random.default_rng(2), n_runs=20_000)[0])  # (runs, T+1)
    counts = np.zeros((3, 3))
    np.add.at(counts, (s[:, :-1].ravel(), s[:, 1:].ravel()), 1)
    share, n = counts / counts.sum(axis=1, keepdims=True), counts.sum(axis=1, keepdims=True)
    assert (np.abs(share - PI) <= SEVERAL * np.sqrt(PI * (1 - PI) / n)).all()


@pytest.mark.parametrize("p", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ids=str)
def test_a_certain_mode_is_always_drawn(p):
    """Catches an edge that belongs to both sides: probability zero is never drawn, not even by a draw of 0."""
    model = three_modes(p0=p)
    assert (modes(model.sample_initial(10_000, np.random.default_rng(1))) == np.argmax(p)).all()

    class Zeros:
        def random(self, shape):
            return np.zeros(shape)

    assert model.draw_modes(np.array([p]), Zeros()) == np.argmax(p)


def states(n, seed):
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.integers(0, 3, (n, 1)), rng.standard_normal((n, 2))], axis=-1)


def test_densities_by_direct_formulas():
    """Catches a density of another mode, of the wrong end of a jump, or without the jump's probability."""
    model, x, new = three_modes(), states(50, 1), states(50, 2)
    y = np.random.default_rng(3).standard_normal((50, 1))
    with np.errstate(divide="ignore"):
        for i in range(50):
            s, t = int(x[i, 0]), int(new[i, 0])
            start = np.log(p0[s]) + multivariate_normal(M0, P0).logpdf(x[i, 1:])
            move = np.log(PI[s, t]) + multivariate_normal(A[t] @ x[i, 1:], Q[t]).logpdf(new[i, 1:])
            seen = multivariate_normal(C[s] @ x[i, 1:], R[s]).logpdf(y[i])
            assert model.log_initial(x)[i] == pytest.approx(start, rel=1e-12)
            assert model.log_transition(1, new, x)[i] == pytest.approx(move, rel=1e-12)
            assert model.log_likelihood(1, y, x)[i] == pytest.approx(seen, rel=1e-12)


def test_densities_broadcast():
    """Catches runs and particles that mix: pairs of all with all, and a measurement for each run."""
    model, x, new = three_modes(), states(6, 1).reshape(2, 3, 3), states(4, 2)
    pairs = model.log_transition(1, new, x[..., None, :])
    assert pairs.shape == (2, 3, 4)
    assert pairs[1, 2, 3] == model.log_transition(1, new[3], x[1, 2])
    y = np.array([[[0.5]], [[-1.0]]])
    log_g = model.log_likelihood(1, y, x)
    assert log_g.shape == (2, 3)
    np.testing.assert_allclose(log_g[1], model.log_likelihood(1, y[1], x[1]), rtol=1e-14)


def test_draws_have_the_density_they_claim():
    """Catches noise of another mode in a draw: E[-2 log N] = log det(2 pi Q) + n, Var = 2 n, mode by mode."""
    model, rng, n = three_modes(), np.random.default_rng(5), 30_000
    x = model.sample_initial(n, rng)
    new = model.propagate(1, x, rng)
    y = model.measure(1, new, rng)
    jump = np.log(PI[modes(x), modes(new)])
    for log_p, cov in ((model.log_transition(1, new, x) - jump, Q), (model.log_likelihood(1, y, new), R)):
        for j in range(3):
            drawn, dim = -2 * log_p[modes(new) == j], cov.shape[-1]
            want = np.linalg.slogdet(2 * np.pi * cov[j])[1] + dim
            assert abs(drawn.mean() - want) < SEVERAL * np.sqrt(2 * dim / len(drawn))


def test_shapes_of_draws():
    """Catches a lost axis: (runs, N, 1 + n_z) in, the same out, and n_y of another size."""
    model, rng = three_modes(), np.random.default_rng(1)
    x = states(6, 1).reshape(2, 3, 3)
    assert model.propagate(1, x, rng).shape == (2, 3, 3) and model.measure(1, x, rng).shape == (2, 3, 1)
    assert (model.n_x, model.n_y, model.n_z, model.n_modes) == (3, 1, 2, 3)


def test_a_singular_process_noise_is_fine_for_draws():
    """Catches a density asked for where none is needed; asked for, it is an error that names the mode."""
    model = three_modes(Q=[Q[0], np.diag([1.0, 0.0]), Q[2]])
    x, _ = model.simulate(5, np.random.default_rng(1))
    with pytest.raises(ValueError, match="Q of mode 1 is singular and has no density"):
        model.log_transition(1, x, x)


def test_the_worked_system_is_the_one_of_its_description():
    """Catches q and r swapped or squared, one sign for both modes, and a probability for its complement."""
    model = jump_markov(d=3, a=0.8, q=0.2, r=0.3, stay=0.95)
    np.testing.assert_array_equal(model.A, [0.8 * np.eye(3), -0.8 * np.eye(3)])
    np.testing.assert_array_equal(model.Q, [0.2 * np.eye(3)] * 2)
    np.testing.assert_array_equal(model.R, [0.3 * np.eye(3)] * 2)
    np.testing.assert_array_equal(model.C, [np.eye(3)] * 2)
    np.testing.assert_allclose(model.Pi, [[0.95, 0.05], [0.05, 0.95]])
    assert model.m0.tolist() == [0, 0, 0] and model.p0.tolist() == [0.5, 0.5]
    np.testing.assert_array_equal(model.P0, np.eye(3))


def test_a_model_keeps_its_own_copy_of_what_it_was_given():
    """Catches two filters that solve different models because an array was changed afterwards."""
    Pi = PI.copy()
    model = three_modes(Pi=Pi)
    Pi[:] = 1 / 3
    np.testing.assert_array_equal(model.Pi, PI)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A": 0.9}, r"A must hold one matrix for each mode, three axes in all; got \(\)"),
        ({"A": A[0]}, r"A must hold one matrix for each mode, three axes in all; got \(2, 2\)"),
        ({"C": [1.0]}, r"C must hold one matrix for each mode, three axes in all; got \(1,\)"),
        ({"R": 1.0}, r"R must hold one matrix for each mode, three axes in all; got \(\)"),
        ({"A": A[:, :1]}, r"A must have shape \(3, 2, 2\) to fit A, got \(3, 1, 2\)"),
        ({"C": C[:2]}, r"C must have shape \(3, 1, 2\) to fit A, got \(2, 1, 2\)"),
        ({"C": C[..., :1]}, r"C must have shape \(3, 1, 2\) to fit A, got \(3, 1, 1\)"),
        ({"Q": Q[:2]}, r"Q must have shape \(3, 2, 2\) to fit A, got \(2, 2, 2\)"),
        ({"R": np.ones((3, 2, 2)) + np.eye(2)}, r"R must have shape \(3, 1, 1\) to fit A, got \(3, 2, 2\)"),
        ({"Pi": PI[:2]}, r"Pi must have shape \(3, 3\) to fit A, got \(2, 3\)"),
        ({"p0": [0.5, 0.5]}, r"p0 must have shape \(3,\) to fit A, got \(2,\)"),
        ({"m0": 0.0}, r"m0 must have shape \(2,\) to fit A, got \(\)"),
        ({"P0": [1.0, 1.0, 1.0]}, r"P0 must have shape \(2, 2\) to fit A, got \(3, 3\)"),
        ({"Q": -Q}, "Q of mode 0 is not positive semi-definite"),
        ({"Pi": PI.T}, "Pi must hold probabilities that sum to 1 in each row"),
        ({"p0": [0.5, 0.6, -0.1]}, "p0 must hold probabilities that sum to 1 in each row"),
        ({"p0": [0.5, 0.5, np.nan]}, "p0 must be finite"),
        ({"m0": [0.0, np.nan]}, "m0 must be finite"),
        ({"A": np.full((3, 2, 2), np.inf)}, "A must be finite"),
    ],
)
def test_pieces_that_do_not_fit_are_named(change, message):
    """Catches shapes that broadcast, and probabilities that are none: columns that sum to one are not rows."""
    with pytest.raises(ValueError, match=message):
        three_modes(**change)
