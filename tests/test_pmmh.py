"""Particle marginal Metropolis-Hastings against posteriors that are known: by the Kalman filter, on a grid.

The theorem: the chain has the exact posterior for every number of particles. So means of functions of theta over
independent chains differ from the exact ones by chance alone, which the scatter between chains measures.
"""

import functools

import numpy as np
import pytest
from exact import SEVERAL, in_standard_errors
from scipy import stats

import pfedu
from pfedu.filters import loop
from pfedu.gaussian import log_density
from pfedu.models import LinearGaussian, StateSpaceModel
from pfedu.pmmh import Chain, particle_metropolis_hastings
from pfedu.weights import ZeroLikelihoodError

NAN, T, CHAINS = np.nan, 12, 60
Y = LinearGaussian(F=0.6, H=1.0, Q=1.0, R=1.0, m0=0.0, P0=1.0).simulate(T, np.random.default_rng(7))[1]
Y[4] = NAN


def returning(theta):
    """x_k = a x_{k-1} + N(0, 1), y_k = x_k + N(0, 1); one coefficient a for each chain, theta (..., 1)."""
    a = theta[..., None, :]  # against states (..., N, 1)
    return StateSpaceModel(
        lambda n, rng: rng.standard_normal((n, 1)),
        lambda k, x, rng: a * x + rng.standard_normal(x.shape),
        lambda k, y, x: log_density(y, x, 1.0),
    )


def log_prior(theta):
    """Uniform from -0.2 to 1: the posterior leans against an end, where proposals are thrown out."""
    return np.where((theta[..., 0] > -0.2) & (theta[..., 0] < 1.0), 0.0, -np.inf)


@functools.cache
def posterior():
    """Nodes and probabilities of a: midpoints, so that the ends of the prior need no care."""
    a = -0.2 + 1.2 * (np.arange(240) + 0.5) / 240
    log_z = [pfedu.kalman_filter(LinearGaussian(b, 1.0, 1.0, 1.0, 0.0, 1.0), Y).log_likelihood for b in a]
    p = np.exp(np.array(log_z) - np.max(log_z))
    return a, p / p.sum()


@functools.cache
def run(n_particles, n_steps=400, seed=1, step=0.09, **options):
    """Chains that begin at draws from the posterior, without their first quarter."""
    rng = np.random.default_rng(seed)
    a, p = posterior()
    start = rng.choice(a, size=(CHAINS, 1), p=p)
    chain = particle_metropolis_hastings(
        returning, Y, n_particles, log_prior=log_prior, start=start, step_cov=step, n_steps=n_steps, rng=rng, **options
    )
    return chain.after(n_steps // 4)


def distances(chain):
    """Mean, square and shares below five quantiles: distance from the exact ones in standard errors over chains."""
    a, p = posterior()
    m = a @ p
    ends = a[np.searchsorted(np.cumsum(p), [0.1, 0.25, 0.5, 0.75, 0.9])] + 0.6 / 240  # between two nodes
    theta = chain.theta[..., 0]
    values = [theta - m, (theta - m) ** 2 - (a - m) ** 2 @ p]
    values += [(theta < end) - p[a < end].sum() for end in ends]
    return in_standard_errors(np.stack([v.mean(axis=-1) for v in values], axis=-1))


@pytest.mark.parametrize("n_particles", [4, 15, 60])
def test_the_posterior_is_exact_for_any_number_of_particles(n_particles):
    """Catches any error of the ratio or of what is kept: mean, spread and five quantiles, 60 chains of 300 steps."""
    assert distances(run(n_particles)).max() < SEVERAL


def test_few_particles_cost_acceptances():
    """Catches an estimate that is made anew at each step, with which few particles move as freely as many."""
    few, many = run(4), run(60)
    assert few.acceptance.mean() + 0.1 < many.acceptance.mean()
    changes = np.diff(few.log_likelihood, axis=-1) != 0
    np.testing.assert_array_equal(changes, few.accepted[:, 1:])


def test_with_the_kalman_filter_it_is_plain_metropolis_hastings():
    """Catches an error that the noise of the particles hides: one chain, the exact likelihood, batch means."""

    def kalman(model, y, n_particles, rng):
        return pfedu.kalman_filter(model, y)

    chain = particle_metropolis_hastings(
        lambda theta: LinearGaussian(theta[0], 1.0, 1.0, 1.0, 0.0, 1.0), Y, 1, log_prior=log_prior, start=[0.5],
        step_cov=0.2, n_steps=2000, rng=np.random.default_rng(5), filter=kalman,
    ).after(100)  # fmt: skip
    a, p = posterior()
    assert np.abs(chain.mean - a @ p) < 4 * chain.standard_error()
    assert np.abs(chain.theta[:, 0].std() - np.sqrt((a - a @ p) ** 2 @ p)) < 0.02


def shifted(model, y, n_particles, rng):
    """A bootstrap filter with a wrong normalisation: the mean of the logarithms, not the logarithm of the mean."""
    honest = loop.reweight

    def biased(log_w, log_g, k):
        return honest(log_w, log_g, k)[0], np.sum(np.exp(log_w) * log_g, axis=-1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "reweight", biased)
        return pfedu.bootstrap_filter(model, y, n_particles, rng=rng)


def test_a_likelihood_that_is_wrongly_normalised_is_found_out():
    """Shows that the comparison can fail: the fault bends the likelihood only a little, and is seen."""
    assert distances(run(15, filter=shifted)).max() > SEVERAL


def test_an_estimate_made_anew_at_each_step_is_found_out():
    """Shows that the comparison can fail: without its own estimate kept, the present point is judged too mildly.

    A chain of 400 steps is put together from 400 of one step, each of which estimates its start anew.
    """
    a, p = posterior()
    rng = np.random.default_rng(6)
    theta, kept = rng.choice(a, size=(CHAINS, 1), p=p), []
    for _ in range(400):
        theta = particle_metropolis_hastings(
            returning, Y, 4, log_prior=log_prior, start=theta, step_cov=0.09, n_steps=1, rng=rng
        ).theta[:, -1]
        kept.append(theta)
    theta = np.stack(kept[100:], axis=-2)
    assert distances(Chain(theta, theta[..., 0], theta[..., 0] > 0)).max() > SEVERAL


def test_two_parameters_and_a_prior_that_is_not_flat():
    """Catches a prior that is left out of the ratio, or a covariance that is taken for standard deviations.

    The record says nothing, so that the posterior is the prior, a correlated Gaussian; 60 chains of 1000 steps.
    """
    cov = np.array([[1.0, 0.8], [0.8, 4.0]])
    chain = particle_metropolis_hastings(
        lambda theta: returning(theta[..., :1]), np.full((2, 1), NAN), 1, rng=np.random.default_rng(8),
        log_prior=lambda theta: log_density(theta, [1.0, -2.0], cov),
        start=stats.multivariate_normal([1.0, -2.0], cov).rvs(CHAINS, 9), step_cov=cov, n_steps=1000,
    )  # fmt: skip
    d = chain.theta - [1.0, -2.0]
    assert in_standard_errors(d.mean(axis=1)).max() < SEVERAL
    assert in_standard_errors(np.einsum("cki,ckj->cij", d, d) / d.shape[1] - cov).max() < SEVERAL
    # for a step of the covariance of the target, the share is known: E min(1, p'/p) in two dimensions
    rng = np.random.default_rng(10)
    at = rng.standard_normal((200_000, 2))
    to = at + rng.standard_normal(at.shape)
    share = np.minimum(1.0, np.exp(0.5 * np.sum(at**2 - to**2, axis=-1)))
    assert abs(chain.accepted[:, 1:].mean() - share.mean()) < 0.01


def test_batch_means_know_the_standard_error_of_a_chain():
    """Catches batches along the wrong axis, and sqrt(n) of the steps in place of the batches.

    An autoregression with coefficient 0.8 has a mean whose variance is (1 + 0.8) / (1 - 0.8) = 9 times that of
    independent draws. 200 chains: the mean square of the estimated errors is known to 2 sqrt(2/19/200) = 5 %.
    """
    rng = np.random.default_rng(11)
    x = [rng.standard_normal(200)]
    for _ in range(3999):
        x.append(0.8 * x[-1] + 0.6 * rng.standard_normal(200))
    theta = np.stack(x, axis=-1)[..., None]
    chain = Chain(theta, theta[..., 0], theta[..., 0] > 0)
    assert np.mean(chain.standard_error(20) ** 2) == pytest.approx(9 / 4000, rel=0.12)


def test_the_same_seed_gives_the_same_chain():
    """Catches a draw from elsewhere."""
    one, other = run.__wrapped__(5, 20, seed=3), run.__wrapped__(5, 20, seed=3)
    np.testing.assert_array_equal(one.theta, other.theta)
    assert (run(5, 20, seed=4).theta != one.theta).any()


def single(**options):
    """One chain on a model whose likelihood is zero beyond 1 of the state, for errors."""
    box = StateSpaceModel(lambda n, rng: rng.random((n, 1)), lambda k, x, rng: x,
                          lambda k, y, x: np.where(np.abs(y - x)[..., 0] < 1, 0.0, -np.inf))  # fmt: skip
    given = dict(model_of=lambda theta: box, y=[[0.5]], n_particles=5, log_prior=lambda theta: 0.0, start=[0.0],
                 step_cov=1.0, n_steps=3, rng=np.random.default_rng(1)) | options  # fmt: skip
    return particle_metropolis_hastings(**given)


def test_an_estimate_of_zero_is_rejected_and_at_the_start_an_error():
    """Catches a chain that stops where a particle filter dies, although zero is an estimate like any other."""

    def shifted_box(theta):
        return StateSpaceModel(lambda n, rng: theta + rng.random((n, 1)), lambda k, x, rng: x,
                               lambda k, y, x: np.where(np.abs(y - x)[..., 0] < 1, 0.0, -np.inf))  # fmt: skip

    chain = single(model_of=shifted_box, step_cov=9.0, n_steps=200)
    assert (np.abs(chain.theta) < 1.5).all() and 0 < chain.acceptance < 0.9
    with pytest.raises(ZeroLikelihoodError, match="step 0: every particle has likelihood zero"):
        single(model_of=shifted_box, start=[5.0])
    with pytest.raises(ZeroLikelihoodError, match="step 0, run"):
        single(model_of=lambda theta: _boxes(theta), start=np.zeros((4, 1)), step_cov=100.0, n_steps=20,
               log_prior=lambda theta: np.zeros(len(theta)))  # fmt: skip


def test_a_filter_may_say_zero_of_one_chain():
    """Catches -inf in the place of an error: NaN in the odds, or a chain that is told its start explains nothing."""

    def box(model, y, n, rng):
        return pfedu.Track(0, 0, np.where(np.abs(model) < 1, 0.0, -np.inf))

    def several(start):
        return single(model_of=lambda theta: theta, start=start, step_cov=1.0, n_steps=50, filter=box,
                      log_prior=lambda theta: np.zeros(len(theta)))  # fmt: skip

    chain = several(np.zeros((4, 1)))
    assert (np.abs(chain.theta) < 1).all() and (0 < chain.acceptance).all() and (chain.acceptance < 0.95).all()
    with pytest.raises(ZeroLikelihoodError, match=r"zero at the start \[3\.0\]"):
        several(np.array([[0.0], [3.0]]))


def _boxes(theta):
    def log_likelihood(k, y, x):
        return np.where(np.abs(y - x - theta[:, None])[..., 0] < 1, 0.0, -np.inf)

    return StateSpaceModel(lambda n, rng: rng.random((n, 1)), lambda k, x, rng: x, log_likelihood)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": np.zeros((2, 2, 1))}, "start must be finite parameters"),
        ({"start": [NAN]}, "start must be finite parameters"),
        ({"start": []}, "start must be finite parameters"),
        ({"n_steps": 0}, "n_steps must be a whole number of at least 1, got 0"),
        ({"step_cov": [1.0, 2.0]}, "step_cov is 2 x 2, but there are 1 parameters"),
        ({"step_cov": -1.0}, "step_cov"),
        ({"log_prior": lambda theta: np.zeros(1)}, r"log_prior must give shape \(\) for theta \(1,\), it gave \(1,\)"),
        ({"log_prior": lambda theta: NAN}, "log_prior must be finite or -inf, it is nan"),
        ({"log_prior": lambda theta: -np.inf}, r"the prior is zero at the start \[0\.0\]"),
        ({"n_particles": 0}, "n_particles must be a whole number of at least 1"),
        ({"filter": lambda m, y, n, rng: pfedu.Track(0, 0, np.zeros((2, 1)))}, "one log-likelihood a chain"),
        ({"filter": lambda m, y, n, rng: pfedu.Track(0, 0, np.array([NAN]))}, "and no NaN"),
        ({"filter": lambda m, y, n, rng: pfedu.Track(0, 0, np.array([np.inf]))}, "and no NaN or inf"),
    ],
)
def test_bad_input_is_an_error(options, message):
    """Catches a chain of nonsense, or a message about broadcasting."""
    with pytest.raises(ValueError, match=message):
        single(**options)


def test_a_chain_is_cut_and_divided_only_where_it_can_be():
    """Catches an empty mean."""
    chain = single()
    assert chain.theta.shape == (4, 1) and chain.after(3).theta.shape == (1, 1)
    for n in (4, -1):
        with pytest.raises(ValueError, match="the chain has 4 steps, of which"):
            chain.after(n)
    for n in (1, 5, 2.5):
        with pytest.raises(ValueError, match="n_batches must be a whole number from 2 to the 4 steps"):
            chain.standard_error(n)
    assert chain.standard_error(2.0) == chain.standard_error(2)
    with pytest.raises(TypeError, match=r"rng must be a numpy\.random\.Generator"):
        single(rng=1)
