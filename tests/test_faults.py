"""Faults that published material and teaching code have, each beside the right form.

Every wrong form is written here, small, and shown to miss by many standard errors; the right one, that of ``pfedu``,
is put to the same measure and hits. What is compared with exact answers, and why without an allowance for bias, stands
in ``exact.py``.
"""

import numpy as np
import pytest
from exact import SEEDS, SEVERAL, in_standard_errors, mean_square_deviation, problem
from records import reference, resampling_cases

import pfedu
from pfedu.filters import loop
from pfedu.filters.optimal import conditioned
from pfedu.gaussian import log_density
from pfedu.grid import grid_filter, trapezoid_weights
from pfedu.kalman import kalman_filter
from pfedu.models import falling_body, growth, random_walk, van_der_pol
from pfedu.models import ratio as ratio_model
from pfedu.resampling import always, never, ratio, stratified, systematic
from pfedu.unscented import Unscented, augmented
from pfedu.weights import ZeroLikelihoodError, normalize

NAN = np.nan
FAR = 10  # standard errors by which a fault must miss


def generator(seed):
    return np.random.default_rng(seed)


def run(model, y, n=500, seed=1, filter=pfedu.bootstrap_filter, **options):
    return filter(model, y, n, rng=generator(seed), **options)


def about_the_pole(n):
    """Nodes for the ratio model, crowded where its motion is steep; their number is even, so none is on the pole."""
    return -1 + 0.01 * np.sinh(np.linspace(np.arcsinh(-299 / 0.01), np.arcsinh(301 / 0.01), n))


# The mean, taken after resampling


@pytest.mark.parametrize("resampling", ["multinomial", "systematic"])
def test_the_mean_taken_after_resampling(resampling):
    """Catches an estimate that the noise of resampling was added to, for nothing.

    The mean of N independent ancestors scatters about the weighted mean with the variance of the cloud over N, which
    is what the mean square deviation grows by; the comb of the systematic scheme adds less, but it adds.
    """
    model, y, exact = problem("linear_A")
    track = run(model, y, resampling=resampling, policy=always, n_runs=SEEDS, keep=True)
    resampled = np.take_along_axis(track.particles[:, :-1], track.ancestors[:, 1:, :, None], axis=-2)
    late = resampled.mean(axis=-2)  # (runs, T, n_x): row k is time k, after resampling
    now, then = (mean[:, 1:, 0] - exact.mean[1:-1, 0] for mean in (track.mean[:, :-1], late))
    added = (then**2 - now**2).mean(axis=-1)
    expected = track.cov[:, 1:-1, 0, 0].mean(axis=-1) / 500
    if resampling == "multinomial":
        assert in_standard_errors(added - expected) < 4
    else:
        assert in_standard_errors(added - 0.5 * expected) > FAR and added.mean() < 0.5 * expected.mean()
    assert added.mean() > 0 and in_standard_errors(added) > FAR


# Weights not reset


def keep_weights(x, log_w, due, pick, rng, *more):
    """Copy particles by their weights, and let each copy keep the weight as well."""
    x, _, ancestors = resample(x, log_w, due, pick, rng, *more)
    return x, normalize(np.take_along_axis(log_w, ancestors, axis=-1))[0], ancestors


resample = loop.resample


def not_reset(name, monkeypatch):
    """Mean square deviation for N = 1000 and 4000, 100 runs each: of the right form, and of the wrong one."""
    model, y, exact = problem(name)
    right = [mean_square_deviation(run(model, y, n, seed=n, n_runs=100), exact) for n in (1000, 4000)]
    monkeypatch.setattr(loop, "resample", keep_weights)
    return right, [mean_square_deviation(run(model, y, n, seed=n, n_runs=100), exact) for n in (1000, 4000)]


def test_weights_not_reset_after_resampling(monkeypatch):
    """Catches a measurement that counts twice: once in the copies, once more in their weights.

    On the growth record more particles hardly help: the mean square deviation falls more slowly than N^-1/2, that of
    the right form as 1/N, and with N = 4000 it is more than five times as large.
    """
    right, wrong = not_reset("growth_A", monkeypatch)
    (rate, se), (wrong_rate, wrong_se) = falling_rate(*right), falling_rate(*wrong)
    assert abs(rate - 1) < 4 * se and wrong_rate < 0.5 - 4 * wrong_se
    excess = wrong[1] - 5 * right[1]
    assert excess.mean() > 0 and in_standard_errors(excess) > SEVERAL


def test_weights_not_reset_where_it_hardly_shows(monkeypatch):
    """Catches a fault that a forgiving system hides: on the linear record the error grows, but does not double.

    There the process noise is ten times the measurement noise, and what was counted twice is soon forgotten.
    """
    right, wrong = not_reset("linear_A", monkeypatch)
    excess = wrong[1] - 1.1 * right[1]
    assert excess.mean() > 0 and in_standard_errors(excess) > SEVERAL
    assert wrong[1].mean() < 2 * right[1].mean()


def falling_rate(few, many):
    """Exponent a of mean square deviation ~ N^-a between N and 4 N particles, and its standard error."""
    relative = [m.std(ddof=1) / m.mean() / np.sqrt(len(m)) for m in (few, many)]
    return np.log(few.mean() / many.mean()) / np.log(4), np.hypot(*relative) / np.log(4)


# The evidence with 1 + x^2 where the model has 1 + x^3


def misprinted(model, y, n, n_runs):
    """The optimal filter of the ratio model, weighed by the evidence of its sister without a pole."""
    move, _ = conditioned(model, "a test")
    _, evidence = conditioned(ratio_model(power=2), "a test")
    sister = ratio_model(power=2)

    def propose(k, y, x, rng):
        return move(y, model.f(k, x), rng), evidence(y, sister.f(k, x))

    options = dict(rng=generator(3), resampling="systematic", policy=ratio(0.5), n_runs=n_runs)
    return loop.particle_filter(propose, model, y, n, **options)


def test_evidence_of_another_denominator():
    """Catches a misprint that tame records hide: on the reference record it costs 0.2 units of log-likelihood.

    On a record that begins close to the pole, and jumps, it costs more than 5.
    """
    model, y, exact = problem("ratio_A")
    wrong, right = misprinted(model, y, 500, 100), run(model, y, filter=pfedu.optimal_filter, n_runs=100)
    off = wrong.log_likelihood - exact.log_likelihood
    assert in_standard_errors(off) > FAR and in_standard_errors(off + 0.2) < 4
    assert in_standard_errors(np.exp(right.log_likelihood - exact.log_likelihood) - 1) < 4
    x, y = model.simulate(10, generator(4), x0=[-0.96])
    y[0] = NAN
    exact = grid_filter(model, y, about_the_pole(1200))
    wrong, right = misprinted(model, y, 4000, 50), run(model, y, 4000, filter=pfedu.optimal_filter, n_runs=50)
    assert x[1, 0] > 7 and (wrong.log_likelihood < exact.log_likelihood - 5).all()
    assert in_standard_errors(np.exp(right.log_likelihood - exact.log_likelihood) - 1) < 4


# The growth model, one step off


def test_the_phase_of_the_growth_model_one_step_off():
    """Catches a loop index in place of the time of the step: the filter believes in the cosine of the step before.

    100 records, N = 500: the error against the truth more than doubles, and the likelihood falls by tens of units.
    """
    model = growth(phase=0)
    x, y = model.simulate(50, generator(5), 100)
    y[:, 0] = NAN
    right, wrong = (run(growth(phase=phase), y, seed=6, policy=always) for phase in (0, 1))
    rmse = [np.sqrt(np.mean((track.mean - x)[:, 1:, 0] ** 2, axis=-1)) for track in (right, wrong)]
    assert in_standard_errors(rmse[1] - 2 * rmse[0]) > SEVERAL and rmse[1].mean() > 2 * rmse[0].mean()
    fall = right.log_likelihood - wrong.log_likelihood
    assert fall.mean() > 20 and in_standard_errors(fall - 20) > SEVERAL


def test_the_two_growth_records_tell_the_phase():
    """Catches a phase that is right for the one convention only: each record is explained by its own."""
    for name, phase in (("growth_A", 0), ("growth_C", 1)):
        _, y, exact = problem(name, 20)
        right, wrong = (run(growth(phase=p), y, 2000, seed=7, n_runs=50) for p in (phase, 1 - phase))
        assert in_standard_errors(np.exp(right.log_likelihood - exact.log_likelihood) - 1) < 4
        assert (wrong.log_likelihood < exact.log_likelihood - 10).all()


# The optimal density with a joint density where a conditional one belongs


@pytest.mark.parametrize("x_old", [0.7, -2.0])
def test_the_joint_density_in_place_of_the_conditional(x_old):
    """Catches p(x, x_old) for p(x | x_old) in p(y | x) p(x | x_old) / p(y | x_old): it does not integrate to one.

    By the trapezoidal rule with a gap of 0.01, thirty times finer than the narrowest density. The density pfedu draws
    from has the same integral, mean and variance as the right form.
    """
    model, y, dx = ratio_model(), 1.3, 0.01
    x = np.arange(-15.0, 15.0, dx)[:, None]
    move, evidence = conditioned(model, "a test")
    f = model.f(1, np.array([x_old]))
    likelihood = np.exp(model.log_likelihood(1, np.array([y]), x))
    moved = np.exp(model.log_transition(1, x, np.array([x_old])))
    of_y = np.sum(likelihood * moved) * dx
    prior = np.exp(model.log_initial(np.array([x_old])))
    assert np.exp(evidence(np.array([y]), f)) == pytest.approx(of_y, rel=1e-9)
    joint, right = likelihood * moved * prior / of_y, likelihood * moved / of_y
    assert np.sum(joint) * dx == pytest.approx(prior, rel=1e-9) and prior < 0.13
    assert np.sum(right) * dx == pytest.approx(1, rel=1e-9)
    mean = np.sum(right * x[:, 0]) * dx
    draws = move(np.array([y]), np.broadcast_to(f, (40_000, 1)), generator(8))[:, 0]
    assert in_standard_errors(draws - mean) < 4
    assert in_standard_errors((draws - mean) ** 2 - np.sum(right * (x[:, 0] - mean) ** 2) * dx) < 4


# The auxiliary filter without its second stage


@pytest.mark.parametrize("q", [0.1, 1.0, 10.0])
def test_the_auxiliary_filter_without_second_stage_weights(q, monkeypatch):
    """Catches a look ahead that is never taken back: the cloud is as wide as the prediction, not as the posterior.

    Picking by N(y; x, r) conditions each particle before it moves, so the variances obey P+ = P r / (P + r) + q: the
    recursion of the prediction of the Kalman filter, which settles at 1 + P-/r times the posterior: 11.9 for q = 10.
    """

    def one_stage(x, log_w, due, pick, rng, *more):
        x, log_w, ancestors = resample(x, log_w, due, pick, rng, *more)
        return x, np.full_like(log_w, -np.log(log_w.shape[-1])), ancestors

    model = random_walk(q=q)
    y = model.simulate(40, generator(9), 100)[1]
    exact = kalman_filter(model, y)
    algorithm = loop.Algorithm(
        propose=lambda k, y, x, rng: (model.propagate(k, x, rng), np.zeros(x.shape[:-1])),
        look_ahead=lambda k, y, x, rng: model.log_likelihood(k, y, model.f(k, x)),
    )
    options = dict(resampling="systematic", policy=always)
    right = run(model, y, 2000, seed=10, filter=pfedu.auxiliary_filter, look_ahead="exact", policy=always)
    monkeypatch.setattr(loop, "resample", one_stage)
    wrong = loop.particle_filter(algorithm, model, y, 2000, rng=generator(10), **options)
    settled = (q + np.sqrt(q * q + 4 * q)) / 2
    share = [(track.cov / exact.cov)[:, 20:, 0, 0].mean(axis=-1) for track in (right, wrong)]
    for values, wanted in zip(share, (1, 1 + settled), strict=True):  # N particles are too narrow by a share of 1/N
        allowance = wanted * 5 / 2000
        assert abs(values.mean() - wanted) < 4 * values.std(ddof=1) / np.sqrt(len(values)) + allowance
    assert share[1].mean() > 1.3 and in_standard_errors(share[1] - 1.3) > FAR


# The optimal filter that never resamples


def test_the_optimal_filter_that_never_resamples():
    """Catches a good proposal taken for a cure of degeneracy: it loses to the bootstrap filter that resamples.

    N_eff of 500 particles at the end of 50 steps, on 200 records of the ratio model with q = 0.1: 125, as an
    independent program found, whose own uncertainty is taken to be ours.
    """
    model = ratio_model()
    y = model.simulate(50, generator(11), SEEDS)[1]
    y[:, 0] = NAN
    wrong = run(model, y, seed=12, filter=pfedu.optimal_filter, policy=never)
    right = run(model, y, seed=12, filter=pfedu.optimal_filter, policy=ratio(0.5))
    last = wrong.n_eff[:, -1]
    assert abs(last.mean() - 125) < 4 * np.sqrt(2 / SEEDS) * last.std(ddof=1) + 0.5
    assert in_standard_errors(right.n_eff[:, -1] - 2 * last) > SEVERAL and right.n_eff[:, -1].mean() > 2 * last.mean()
    model, y, exact = problem("ratio_A")
    wrong = mean_square_deviation(
        run(model, y, seed=13, filter=pfedu.optimal_filter, policy=never, n_runs=SEEDS), exact
    )
    blind, best = (mean_square_deviation(run(model, y, seed=14, filter=f, policy=always, n_runs=SEEDS), exact)
                   for f in (pfedu.bootstrap_filter, pfedu.optimal_filter))  # fmt: skip
    assert wrong.mean() > 1.3 * blind.mean() and in_standard_errors(wrong - 1.3 * blind) > SEVERAL
    assert best.mean() < blind.mean()


# The density estimate that ignores the weights


def test_a_density_estimate_that_ignores_the_weights():
    """Catches a histogram of particles where one of weights belongs: more particles do not mend it.

    Total variation over cells of 0.2, optimal filter on the ratio record at time 1. The expectation of the unweighted
    histogram is the density the particles are drawn from, so its distance cannot fall below that density's (Jensen's
    inequality); that of the weighted one halves with four times the particles.
    """
    model, y, _ = problem("ratio_A", 1)
    nodes = about_the_pole(2400)
    exact = grid_filter(model, y, nodes)
    f, (q, r) = model.f(1, nodes[:, None]), (model.Q.item(), model.R.item())
    from_node = log_density(nodes[None, :, None], (f + q / (q + r) * (y[1] - f))[:, None], q * r / (q + r))
    drawn = (trapezoid_weights(nodes) * np.exp(model.log_initial(nodes[:, None]))) @ np.exp(from_node)
    edges = np.concatenate([[-np.inf], np.linspace(-4, 4, 41), [np.inf]])
    truth, drawn = (in_cells(density, nodes, edges) for density in (exact.density[1], drawn))
    limit = 0.5 * np.abs(drawn - truth).sum()
    distance = {}
    for n in (500, 2000):
        track = run(model, y, n, seed=n, filter=pfedu.optimal_filter, policy=never, n_runs=SEEDS, keep=True)
        cells = np.digitize(track.particles[:, 1, :, 0], edges) - 1 + (edges.size - 1) * np.arange(SEEDS)[:, None]
        for kind, w in (("right", np.exp(track.log_weights[:, 1])), ("wrong", np.full((SEEDS, n), 1 / n))):
            shares = np.bincount(cells.ravel(), w.ravel(), (edges.size - 1) * SEEDS).reshape(SEEDS, -1)
            distance[kind, n] = 0.5 * np.abs(shares - truth).sum(axis=-1)
    assert limit > 0.05
    for n in (500, 2000):
        assert in_standard_errors(distance["wrong", n] - distance["right", n]) > FAR
        assert distance["wrong", n].mean() > limit - 4 * distance["wrong", n].std() / np.sqrt(SEEDS)
    falls = distance["right", 500].mean() / distance["right", 2000].mean()
    se = falls * np.hypot(*(distance["right", n].std() / distance["right", n].mean() for n in (500, 2000)))
    assert abs(falls - 2) < 4 * se / np.sqrt(SEEDS)
    assert distance["right", 2000].mean() < limit / 2


def in_cells(density, nodes, edges):
    """Probability of each cell, of a density at the nodes."""
    cumulative = np.concatenate([[0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(nodes))])
    return np.diff(np.interp(edges, nodes, cumulative / cumulative[-1]))


# The pole, and weights that are not logarithms


def lost_runs(model, y, n, rng):
    """Bootstrap filter with weights as they stand in the formula: which runs divided zero by zero."""
    runs = len(y)
    x = model.sample_initial(runs * n, rng).reshape(runs, n, 1)
    lost = np.zeros(runs, dtype=bool)
    for k in range(1, y.shape[-2]):
        x = model.propagate(k, x, rng)
        w = np.exp(model.log_likelihood(k, y[:, None, k], x))
        with np.errstate(invalid="ignore"):
            w /= w.sum(axis=-1, keepdims=True)
        lost |= np.isnan(w).any(axis=-1)
        w[lost] = 1 / n  # so that the other runs can go on
        x = np.take_along_axis(x, systematic(w, rng)[..., None], axis=-2)
    return lost


def test_the_pole_and_weights_that_are_not_logarithms():
    """Catches likelihoods that underflow when the truth is thrown far away by the pole: some runs in a thousand.

    With logarithms no run of the same records is lost.
    """
    model = ratio_model()
    x, y = model.simulate(50, generator(15), 1500)
    y[:, 0] = NAN
    lost = lost_runs(model, y, 100, generator(16))
    assert 0.001 < lost.mean() < 0.02
    assert np.abs(x[lost, 1:]).max(axis=(1, 2)).min() > 30  # the likelihood of 38 deviations is beyond a double
    track = run(model, y, 100, seed=16, policy=always)
    assert np.isfinite(track.mean).all() and np.isfinite(track.log_likelihood).all()


def test_what_a_resampler_makes_of_nan():
    """Catches the silent sequel: in a search through NaN every point falls to the first particle."""
    w = np.full(5, NAN)
    assert np.searchsorted(np.cumsum(w), [0.1, 0.5, 0.9]).tolist() == [0, 0, 0]
    with pytest.raises(ValueError, match="weights must be finite, got nan"):
        systematic(w, generator(1))
    with pytest.raises(ZeroLikelihoodError, match="all weights are zero"):
        normalize(np.full(5, -np.inf))


# Missing transposes in the unscented covariance


def summed(d, W, product):
    """Covariance as the loop over sigma points sums it up."""
    P = np.zeros((3, 3))
    for weight, e in zip(W, d, strict=True):
        P += weight * product(e, e)
    return P


def test_missing_transposes_in_the_unscented_covariance():
    """Catches d * d for the outer product of d: broadcasting makes a matrix of it without a word.

    Sigma points of the falling body's first step. The wrong form has the variance of the height, above 1e5 ft^2, where
    the covariance of coefficient and height stands, and is not symmetric. The right one has the covariance of a cloud
    of 40 000 draws, and so has pfedu, to rounding.
    """
    model, transform, both = falling_body(), Unscented(), np.zeros((6, 6))
    both[:3, :3], both[3:, 3:] = model.P0, model.Q
    points = transform.points(np.append(model.m0, np.zeros(3)), both)  # (13, 6): state and noise
    moved, (mean_weights, W) = model.step(1, points[:, :3], points[:, 3:]), transform.weights(6)
    d = moved - mean_weights @ moved
    wrong, right = summed(d, W, np.multiply), summed(d, W, np.outer)
    m, P = augmented(model, transform)[0](1, model.m0, model.P0)
    sd = np.sqrt(np.diag(P))
    scale = np.outer(sd, sd)
    np.testing.assert_allclose(P / scale, right / scale, rtol=0, atol=1e-12)
    assert wrong[2, 0] > 1e5 and np.abs(wrong - wrong.T).max() > 1e5 and np.abs(right[2, 0]) < 1
    x = model.propagate(1, model.sample_initial(40_000, generator(17)), generator(18))
    z = (x - m) / sd
    assert (in_standard_errors(z) < SEVERAL).all()
    assert (in_standard_errors(z[:, :, None] * z[:, None, :] - right / scale) < SEVERAL).all()
    assert in_standard_errors(z[:, 2] * z[:, 0] - wrong[2, 0] / scale[2, 0]) > FAR


# A fresh random number for each tooth of the comb


def fresh_numbers(weights, rng, size=None):
    """The systematic scheme with its random number drawn inside the search."""
    n = weights.shape[-1]
    points = (np.arange(n) + rng.random(weights.shape)) / n  # (..., N)
    return (np.cumsum(weights, axis=-1)[..., None, :] <= points[..., None]).sum(axis=-1).clip(max=n - 1)


def test_a_fresh_random_number_for_each_tooth():
    """Catches a comb whose teeth move one by one: its counts have the variances of the stratified scheme.

    20 000 draws against the exact variances of both schemes.
    """
    cases, draws = resampling_cases(), 20_000
    w = np.broadcast_to(cases["weights"], (draws, 8))

    def scatter(scheme):
        ancestors = scheme(w, generator(19))
        counts = (ancestors[:, :, None] == np.arange(8)).sum(axis=1)
        return (counts - np.array(cases["expected_counts_all_methods"])) ** 2

    wrong, right = scatter(fresh_numbers), scatter(systematic)
    assert in_standard_errors(right - cases["var_systematic"]).max() < SEVERAL
    assert in_standard_errors(wrong - cases["var_stratified"]).max() < SEVERAL
    assert in_standard_errors(scatter(stratified) - cases["var_stratified"]).max() < SEVERAL
    assert in_standard_errors(wrong - cases["var_systematic"]).max() > FAR


# A variance read as a standard deviation


def test_the_variance_of_a_random_walk_read_as_a_standard_deviation():
    """Catches N(0, 10) read as ten metres: a Kalman filter with q = 100 errs more, and its likelihood tells at once.

    With gain K the error settles at the variance P = (1 - K)^2 (P + q) + K^2 r, q that of the truth: a deviation of
    0.957 for the right gain, 0.991 for the wrong one. 1000 records; the first steps are left out.
    """
    model, q, r = random_walk(), 10.0, 1.0
    x, y = model.simulate(40, generator(20), 1000)
    for believed in (10.0, 100.0):
        track = kalman_filter(random_walk(q=believed), y)
        prior = (believed + np.sqrt(believed**2 + 4 * believed * r)) / 2
        K = prior / (prior + r)
        settled = ((1 - K) ** 2 * q + K**2 * r) / (1 - (1 - K) ** 2)
        squares = ((track.mean - x)[:, 5:, 0] ** 2).mean(axis=-1)
        assert in_standard_errors(squares - settled) < 4
        assert np.sqrt(settled) == pytest.approx({10.0: 0.957, 100.0: 0.991}[believed], abs=5e-4)
    right, wrong = (kalman_filter(random_walk(q=believed), y).log_likelihood for believed in (10.0, 100.0))
    assert in_standard_errors(right - wrong - 20) > FAR and (right - wrong).mean() > 20


def test_the_variance_of_the_oscillator_read_as_a_standard_deviation():
    """Catches 0.025 taken for the variance of the van der Pol oscillator's process noise, which is 0.025^2.

    40 steps of the record, 1000 particles, 50 runs, against the posterior of runs with 400 000. The variance of
    the wrong cloud is more than three times too large in the measured state, and more than 25 times in the other.
    """
    data = reference("vdp_A_doc_r0.016_posterior")[:41]
    variances = np.stack([data["P11"], data["P22"]], axis=-1)
    share = {}
    for q in (0.025**2, 0.025):
        model = van_der_pol(q=q, r=0.016)
        track = run(model, data["y"][:, None], 1000, seed=21, n_runs=50)
        share[q] = (np.diagonal(track.cov, axis1=-2, axis2=-1) / variances)[:, 20:].mean(axis=1)  # (runs, 2)
    right, wrong = share.values()
    assert (in_standard_errors(right - 1) < 4).all()
    assert (in_standard_errors(wrong - [3.0, 25.0]) > FAR).all() and (wrong.mean(axis=0) > [3.0, 25.0]).all()
