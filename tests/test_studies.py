"""Monte Carlo studies: batches, seeds and settings must not change what is measured."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import pfedu
from pfedu.studies import Summary, particles_needed, rms, study

NAN = np.nan


def draws(n_runs, rng, scale=1.0):
    first, second = rng.spawn(2)  # as every filter does
    return {"value": scale * first.standard_normal(n_runs), "pair": second.random((n_runs, 2))}


def run(settings=({},), **changes):
    return study(draws, settings, **(dict(n_runs=1000, rng=np.random.default_rng(1), batch=64) | changes))


def test_every_run_counts_once():
    """Catches a last, smaller batch that is dropped, or batches that repeat each other's draws."""
    (result,) = run()
    assert result["value"].values.shape == (1000,) and result["pair"].values.shape == (1000, 2)
    assert len(np.unique(result["value"].values)) == 1000


def test_settings_share_their_luck():
    """Catches settings compared under different draws: twice the scale is exactly twice the value."""
    one, two = run([{"scale": 1.0}, {"scale": 2.0}])
    np.testing.assert_array_equal(two["value"].values, 2 * one["value"].values)


def test_the_numbers_do_not_depend_on_where_they_were_computed():
    """Catches results in the order of completion instead of that of the jobs."""
    with ThreadPoolExecutor(4) as pool:
        elsewhere = run([{"scale": 1.0}, {"scale": 2.0}], map=pool.map)
    for here, there in zip(run([{"scale": 1.0}, {"scale": 2.0}]), elsewhere, strict=True):
        np.testing.assert_array_equal(here["value"].values, there["value"].values)


def test_the_standard_error_is_that_of_the_mean():
    """Catches a scatter reported as a standard error: over 400 studies of 25 runs, means scatter as they say."""
    (result,) = run(n_runs=10_000)
    groups = result["value"].values.reshape(400, 25)
    told = np.mean([Summary(g).standard_error ** 2 for g in groups])
    scatter = groups.mean(axis=1).var(ddof=1)
    assert abs(scatter / told - 1) < 4 * np.sqrt(2 / 399)
    assert result["value"].quantile(0.5) == np.median(result["value"].values)


def test_a_study_of_a_filter_against_its_exact_answer():
    """Catches keyword arguments that do not arrive: four times the particles, a quarter of the mean square."""
    model, y = pfedu.models.random_walk(), np.array([NAN, 1.0, 2.0, 0.0])
    exact = pfedu.kalman_filter(model, y)

    def deviation(n_runs, rng, n_particles):
        track = pfedu.bootstrap_filter(model, y, n_particles, rng=rng, n_runs=n_runs)
        return {"square": rms(track.mean - exact.mean, y) ** 2}

    few, many = study(deviation, [{"n_particles": n} for n in (250, 1000)], n_runs=400, rng=np.random.default_rng(2))
    a, b = few["square"], many["square"]
    relative = np.hypot(a.standard_error / a.mean, b.standard_error / b.mean)
    assert abs(np.log(a.mean / b.mean / 4)) < 5 * relative


def test_rms_counts_measured_steps_alone():
    """Catches a step without a measurement that dilutes the error, and components averaged instead of summed."""
    error = np.array([[9.0, 9.0], [3.0, 4.0], [0.0, 5.0]])
    assert rms(error, np.array([[NAN], [1.0], [1.0]])) == pytest.approx(5.0)
    assert rms(np.stack([error, 2 * error]), [NAN, 1.0, 1.0]).tolist() == pytest.approx([5.0, 10.0])


@pytest.mark.parametrize("truth", [1, 7, 10, 23, 400, 5000])
def test_particles_needed_is_the_smallest_number(truth):
    """Catches a bracket that ends one off, or never below its first guess."""
    tried = []

    def error(n):
        tried.append(n)
        return 0.0 if n >= truth else 1.0

    assert particles_needed(error, 0.5, factor=1.0) == truth
    assert truth <= particles_needed(error, 0.5, factor=1.1) <= max(1.1 * truth, truth + 1)
    assert max(tried) <= 2 * max(truth, 10)


def test_bad_input_is_named():
    """Catches a study of one run (no scatter), a seed for a generator, a mean where one value a run is needed."""
    with pytest.raises(ValueError, match="at least 2 runs, in batches of at least 1; got 1 and 64"):
        run(n_runs=1)
    with pytest.raises(TypeError, match=r"rng must be a numpy\.random\.Generator"):
        run(rng=1)
    with pytest.raises(ValueError, match=r"x must have one value a run, \(5, \.\.\.\); got \(\) for {'a': 3}"):
        study(lambda n, rng, a: {"x": 1.0}, [{"a": 3}], n_runs=5, rng=np.random.default_rng(1))
    with pytest.raises(ValueError, match="errors of 3 steps do not fit a record of 2 rows, 1 of them measured"):
        rms(np.zeros((3, 1)), [NAN, 1.0])
    with pytest.raises(ValueError, match="have the error nan, above"):
        particles_needed(lambda n: NAN, 0.5, most=100)
    with pytest.raises(ValueError, match="start must lie between 1 and most, got 100 and 5"):
        particles_needed(lambda n: 0.0, 0.5, start=100, most=5)
    assert particles_needed(lambda n: 100 / n, 7, start=10, most=15) == 15
    with pytest.raises(ValueError, match=r"100 particles, the most allowed, have the error 1, above 0\.5"):
        particles_needed(lambda n: 1.0, 0.5, most=100)
