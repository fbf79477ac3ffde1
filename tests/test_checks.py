"""The acceptance kit: what is right passes, and each wrong version of the hall of bugs fails where the page says so.

The wrong versions are those of the page itself, taken from its cells, so that page and tests cannot drift apart.
"""

import re
from functools import partial
from pathlib import Path

import nbformat
import numpy as np
import pytest

import pfedu
from pfedu import checks
from pfedu.checks import check_convergence, check_correction, check_model, check_resampler, check_unbiased
from pfedu.gaussian import log_density
from pfedu.models import growth, jump_markov, random_walk, ratio, stochastic_volatility, van_der_pol
from pfedu.resampling import SCHEMES, never

ROOT = Path(__file__).parents[1]
PAGE = nbformat.read(ROOT / "book/hall-of-bugs.ipynb", 4)
TEXT = "\n".join(cell.source for cell in PAGE.cells if cell.cell_type == "markdown")
OF_FILTERS = {"correction": check_correction, "unbiased": check_unbiased, "convergence": check_convergence}

# Every wrong version, and the checks that find it; the others pass.
RESAMPLERS = ["rest_of_weights", "one_along", "fresh", "off_the_end", "from_the_left", "centred"]
FILTERS = {
    "forgets": {"unbiased", "convergence"},
    "counts_twice": {"unbiased", "convergence"},
    "underflows": {"correction"},
    "estimates_late": {"correction"},
    "one_stage": {"unbiased", "convergence"},
    "used_twice": {"unbiased", "convergence"},
    "jitters": {"unbiased"},
    "one_step_off": {"unbiased", "convergence"},
    "patched": {"correction"},
    "plain_average": {"unbiased"},
    "sorted_states": {"unbiased", "convergence"},
}
RIGHT = {
    "bootstrap": pfedu.bootstrap_filter,
    "optimal": pfedu.optimal_filter,
    "auxiliary": pfedu.auxiliary_filter,
    "fully adapted": partial(pfedu.auxiliary_filter, look_ahead="exact"),
    "local linear": pfedu.local_linear_filter,
    "bank": pfedu.kalman_bank_filter,
}


def generator(seed=1):
    return np.random.default_rng(seed)


def hall():
    """The page's filter and its wrong versions, and what their cells import."""
    names = {}
    for cell in PAGE.cells:
        if cell.cell_type == "code" and (re.match("import|from|def sir", cell.source) or "# wrong" in cell.source):
            exec(compile(cell.source.replace("use_style()", ""), "hall-of-bugs", "exec"), names)
    return names


HALL = hall()


def found(check, thing, **options):
    """Whether a check raises AssertionError, and nothing else."""
    try:
        check(thing, rng=generator(), **options)
    except AssertionError:
        return True
    return False


# What is right


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("seed", range(5))
def test_right_resamplers_pass(name, seed):
    """Catches a check that is too strict: by chance alone one in 100 000 fails."""
    assert 0 < check_resampler(SCHEMES[name], rng=generator(seed)) < 1


@pytest.mark.parametrize("check", OF_FILTERS.values(), ids=OF_FILTERS)
@pytest.mark.parametrize("name", RIGHT)
def test_right_filters_pass(name, check):
    """Catches an exact answer that is none, and a check that only the bootstrap filter passes."""
    assert 0 <= check(RIGHT[name], rng=generator(2)) < 1


@pytest.mark.parametrize("check", OF_FILTERS.values(), ids=OF_FILTERS)
def test_the_filter_of_the_page_passes(check):
    """Catches a slip in the version that all the wrong ones are compared with."""
    assert 0 <= check(HALL["sir"], rng=generator(2)) < 1


@pytest.mark.parametrize("model", [random_walk(), growth(), ratio(), van_der_pol(), stochastic_volatility(),
                                   jump_markov(), checks.drifting()], ids=lambda m: type(m).__name__)  # fmt: skip
def test_right_models_pass(model):
    """Catches a check that holds for Gaussian noise only: the seven have one, two and more states, and five kinds."""
    assert 0 < check_model(model, rng=generator(3)) < 1


def test_an_unbiased_check_that_holds_is_at_the_scatter_of_chance():
    """Catches standard errors that are too wide, under which everything would pass.

    The largest of 22 distances, correlated, is 2.1 on average, as for about 12 independent ones; over six
    seeds its mean scatters by 0.3.
    """
    largest = [5 * check_unbiased(pfedu.bootstrap_filter, rng=generator(seed)) for seed in range(6)]
    assert 1.2 < np.mean(largest) < 3


# What is wrong


@pytest.mark.parametrize("name", RESAMPLERS)
def test_a_wrong_resampler_is_found_out(name):
    """Catches a check that a wrong resampler of the page passes."""
    assert found(check_resampler, HALL[name])


@pytest.mark.parametrize("name", FILTERS)
def test_a_wrong_filter_is_found_out(name):
    """Catches a check that finds less, or blames more, than the page says of each of its wrong filters."""
    assert {label for label, check in OF_FILTERS.items() if found(check, HALL[name])} == FILTERS[name]


@pytest.mark.parametrize("r", [0.04, 9.0])
def test_a_wrong_model_is_found_out(r):
    """Catches a likelihood with a standard deviation for its variance that passes: one too wide, one too narrow."""
    how = "not sure enough" if r < 1 else "too sure"
    with pytest.raises(AssertionError, match=f"log_likelihood is {how}"):
        check_model(HALL["confused"](checks.drifting(r=r)), rng=generator())


def test_a_transition_that_is_not_that_of_the_draws_is_found_out():
    """Catches a check that looks at the measurement only."""
    model = random_walk(q=9.0)
    model.log_transition = lambda k, x_new, x: log_density(x_new - x, 0.0, 3.0)
    with pytest.raises(AssertionError, match="log_transition is too sure: it is narrower than what propagate draws"):
        check_model(model, rng=generator())


def test_a_filter_that_never_resamples_is_right():
    """Catches resampling taken for a duty: without it a filter is wasteful, and unbiased."""
    filter = partial(pfedu.bootstrap_filter, policy=never)
    assert check_unbiased(filter, rng=generator(), n_steps=5) < 1 and check_correction(filter, rng=generator()) < 1


def test_spreading_by_a_kernel_is_found_out():
    """Catches a check without power over a bias of a few per cent, which the regularised filter has by design."""
    filter = partial(pfedu.regularized_filter, kernel="gaussian", policy=pfedu.resampling.always, bandwidth=0.3)
    assert found(check_unbiased, filter)


# What is no filter or no resampler


@pytest.mark.parametrize(
    ("resampler", "message"),
    [
        (lambda w, rng: w, "must give 8 whole numbers, it gave float64 of shape (8,)"),
        (lambda w, rng: np.arange(3), "must give 8 whole numbers, it gave int64 of shape (3,)"),
        (lambda w, rng: np.full(w.size, w.size), "ancestor 8 is none of 8 particles; the search ran off the end"),
        (lambda w, rng: np.full(w.size, -1), "ancestor -1 is none of 8 particles"),
        (lambda w, rng: np.zeros(w.size, int), "particle 0 has weight 0 and was copied"),
    ],
)
def test_ancestors_that_are_none_are_named(resampler, message):
    """Catches an index that would fail, or silently count from the end, later."""
    with pytest.raises(AssertionError, match=re.escape(message)):
        check_resampler(resampler, rng=generator())


def test_means_of_the_wrong_shape_are_named():
    """Catches a comparison that broadcasts."""
    with pytest.raises(ValueError, match=re.escape("means (1, 1) and log-likelihood increments (1,)")):
        check_correction(lambda model, y, n, rng: (np.zeros(2), np.zeros(1)), rng=generator())


def test_increments_may_be_missing_where_only_means_are_needed():
    """Catches a convergence check that asks for a likelihood."""

    def means_only(model, y, n, rng):
        means, increments = HALL["sir"](model, y, n, rng)
        return means[:, 0], np.full(increments.shape, np.nan)

    assert check_convergence(means_only, rng=generator(4)) < 1
    assert found(check_unbiased, means_only)


def test_a_filter_of_nan_fails_everywhere():
    """Catches comparisons that are false for NaN, and so let it pass."""
    nothing = lambda model, y, n, rng: (np.full(len(y), np.nan), np.full(len(y), np.nan))  # noqa: E731
    assert all(found(check, nothing) for check in OF_FILTERS.values())


def test_a_linear_model_of_ones_own():
    """Catches a check that is tied to its own model: two states, one of them measured."""
    model = pfedu.models.LinearGaussian([[1, 1], [0, 0.9]], [[1, 0]], Q=[0.1, 0.1], R=1, m0=[0, 1], P0=[1, 1])
    assert check_unbiased(pfedu.bootstrap_filter, rng=generator(5), model=model) < 1
    assert check_convergence(pfedu.bootstrap_filter, rng=generator(5), model=model) < 1


# The page


def test_every_test_that_the_page_names_exists():
    """Catches a reference to a test that was renamed or never written."""
    named = set(re.findall(r"`tests/(test_\w+)\.py::(test_\w+)`", TEXT))
    assert len(named) > 10
    for file, test in named:
        assert f"def {test}(" in (ROOT / f"tests/{file}.py").read_text(encoding="utf-8"), f"{file}.py::{test}"


def test_every_wrong_version_of_the_page_is_tested():
    """Catches a wrong function of the page (it has a line marked as wrong) that nobody puts to the test."""
    wrong = {re.match(r"def (\w+)", cell.source)[1] for cell in PAGE.cells
             if cell.cell_type == "code" and "# wrong" in cell.source and cell.source.startswith("def ")}  # fmt: skip
    elsewhere = {"confused", "mean_of_angles", "flattened"}
    assert wrong - elsewhere == {*RESAMPLERS, *FILTERS}


def test_the_mean_of_angles_across_the_seam():
    """Catches a mean of directions that depends on where angles begin to be counted, and n_eff without its squares."""
    angle, w = np.array([np.pi - 0.1, -np.pi + 0.1]), np.array([0.5, 0.5])
    assert HALL["mean_of_angles"](angle, w) == pytest.approx(0)
    assert np.abs(pfedu.weights.weighted_mean(angle[:, None], np.log(w), [True])) == pytest.approx(np.pi)
    assert HALL["flattened"](w) == 1 and pfedu.weights.effective_sample_size(np.log(w)) == pytest.approx(2)
