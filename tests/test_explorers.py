"""Every explorer, natively: each corner of its controls, each control alone, and what a redraw must not miss."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import to_hex

import pfedu
from pfedu.explorers import Choice, Explorer, Seed, Shown, Slider, load, names
from pfedu.explorers.controls import geometric
from pfedu.explorers.stage import Stage
from pfedu.figures import COLORS

EXPLORERS = names()


class _Stages(dict):
    """A stage for each explorer, built when it is asked for."""

    def __missing__(self, name):
        return self.setdefault(name, Stage(load(name), dpi=40))


@pytest.fixture(scope="module")
def stages():
    return _Stages()


def _sound(pixels, shown, params):
    assert pixels.dtype == np.uint8 and pixels.shape[-1] == 4
    assert len(np.unique(pixels.reshape(-1, 4), axis=0)) > 10, f"an empty picture at {params}"
    assert shown.sentence.endswith("."), shown.sentence
    assert "nan" not in shown.sentence and "inf" not in shown.sentence, shown.sentence
    assert all(np.isfinite(v) for v in shown.numbers.values()), (params, shown.numbers)


@pytest.mark.parametrize("name", EXPLORERS)
def test_every_corner(stages, name):
    """A division by zero, an empty array or a range exceeded at an extreme position."""
    explorer = load(name)
    controls = [c for c in explorer.controls if not isinstance(c, Seed)]  # a seed has no extremes
    for corner in itertools.product(*(dict.fromkeys((c.values[0], c.values[-1])) for c in controls)):
        params = explorer.defaults() | dict(zip([c.name for c in controls], corner, strict=True))
        _sound(*stages[name].draw(params), params)


@pytest.mark.parametrize("name", EXPLORERS)
def test_every_position_of_each_control_alone(stages, name):
    """A position between the extremes that breaks, or a value of a list that is never handled."""
    explorer = load(name)
    for control in explorer.controls:
        for value in control.frames() if isinstance(control, Seed) else control.values:
            params = explorer.defaults() | {control.name: value}
            _sound(*stages[name].draw(params), params)


@pytest.mark.parametrize("name", EXPLORERS)
@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_any_position(stages, name, data):
    """A combination of positions that only a reader would find."""
    params = {c.name: data.draw(st.sampled_from(c.values), label=c.name) for c in load(name).controls}
    _sound(*stages[name].draw(params), params)


@pytest.mark.parametrize("name", EXPLORERS)
def test_every_puzzle_has_an_answer_and_does_not_start_there(stages, name):
    """A puzzle nobody can solve, or that is solved before anything is moved."""
    explorer = load(name)
    for i, puzzle in enumerate(explorer.puzzles):
        assert puzzle.text.endswith(".") and puzzle.answer
        start, there = explorer.defaults(), explorer.check(puzzle.answer)
        assert not explorer.solved(start, stages[name].draw(start)[1])[i], puzzle.text
        assert explorer.solved(there, stages[name].draw(there)[1])[i], puzzle.text


@pytest.mark.parametrize("name", EXPLORERS)
def test_every_control_changes_the_picture(stages, name):
    """A broken redraw: an artist that is not given its new data leaves the picture as it was."""
    explorer = load(name)
    for control in explorer.controls:
        before = stages[name].draw(explorer.defaults())[0].copy()
        others = [v for v in control.values if v != control.default]
        seen = [stages[name].draw(explorer.defaults() | {control.name: value})[0].copy() for value in others[::7]]
        assert any((pixels != before).any() for pixels in seen), f"{name}: moving {control.name} changes nothing"


def _state(artist):
    """What an artist would draw."""
    if hasattr(artist, "get_xydata"):
        data = artist.get_xydata()
    elif hasattr(artist, "get_paths"):
        data = np.concatenate([path.vertices for path in artist.get_paths()])
    else:
        data = artist.get_text()
    return repr(np.asarray(data).tolist()) + str(artist.get_visible())


@pytest.mark.parametrize("name", EXPLORERS)
def test_every_artist_that_should_move_moves(stages, name):
    """A redraw that forgets one artist: its old data would stay beside the new ones."""
    explorer, stage = load(name), stages[name]
    stage.draw(explorer.defaults())
    before, moved = {key: _state(artist) for key, artist in stage.artists.items()}, set()
    for params in explorer.beforehand(explorer.defaults()):
        stage.draw(params)
        moved |= {key for key, artist in stage.artists.items() if _state(artist) != before[key]}
    assert moved == set(before), f"never given new data: {set(before) - moved}"


@pytest.mark.parametrize("layout", ["wide", "narrow"])
@pytest.mark.parametrize("name", EXPLORERS)
def test_redraw_equals_a_fresh_drawing(name, layout):
    """A redraw by blitting that leaves something of the last picture behind."""
    explorer = load(name)
    reused = Stage(explorer, layout, dpi=60)
    rng = np.random.default_rng(1)
    for _ in range(3):
        params = {c.name: c.values[rng.integers(len(c.values))] for c in explorer.controls}
        pixels, shown = reused.draw(params)
        other = Stage(explorer, layout, dpi=60)
        other.draw(params)
        other._background = None  # everything drawn anew: axes, ticks, titles
        fresh, said = other.draw(params)
        assert shown == said
        np.testing.assert_array_equal(pixels, fresh)


@pytest.mark.parametrize("name", EXPLORERS)
def test_same_position_same_picture(stages, name):
    """State that leaks from one redraw into the next."""
    explorer = load(name)
    first, said = stages[name].draw(explorer.defaults())
    first = first.copy()
    for control in explorer.controls:
        stages[name].draw(explorer.defaults() | {control.name: control.values[-1]})
    again, says = stages[name].draw(explorer.defaults())
    assert said == says
    np.testing.assert_array_equal(first, again)


def _mark(artist):
    """What tells an artist from its neighbours where colours cannot be told apart."""
    if hasattr(artist, "get_xydata"):
        return "line", artist.get_linestyle(), artist.get_marker(), round(artist.get_linewidth(), 1)
    return type(artist).__name__, getattr(artist, "get_hatch", lambda: None)()


@pytest.mark.parametrize("name", EXPLORERS)
def test_pictures_can_be_read_without_colour(stages, name):
    """Two curves of one legend that only their colours tell apart; a colour from outside the palette."""
    palette = {to_hex(colour) for colour in COLORS.values()}
    for ax in stages[name].axes.values():
        artists, labels = ax.get_legend_handles_labels()
        marks = {label: _mark(artist) for artist, label in zip(artists, labels, strict=True)}
        assert len(set(marks.values())) == len(marks), f"told apart by colour alone: {marks}"
        faces = (face for collection in ax.collections for face in collection.get_facecolor())
        used = {to_hex(colour) for colour in (*(line.get_color() for line in ax.lines), *faces)}
        assert used <= palette, f"not of the palette: {used - palette}"


@pytest.mark.parametrize("name", EXPLORERS)
def test_every_explorer_is_labelled(name):
    """An explorer without words for those who cannot see it."""
    explorer = load(name)
    assert explorer.title and set(explorer.layouts) == {"wide", "narrow"}
    assert all(control.label for control in explorer.controls)
    assert len({control.name for control in explorer.controls}) == len(explorer.controls)


def test_sir_common_random_numbers():
    """A control that changes more than it names."""
    from pfedu.explorers.sir import _filter, _record

    base = dict(model="random walk", q=10.0, r=1.0, data=1)
    _, x, y, _ = _record(**base)
    _, x_other_r, y_other_r, _ = _record(**base | {"r": 5.0})
    np.testing.assert_array_equal(x, x_other_r)  # measurement noise does not touch the truth
    np.testing.assert_allclose((y_other_r - x)[1:], np.sqrt(5.0) * (y - x)[1:])  # and is scaled, not drawn again
    _, x_other_q, y_other_q, _ = _record(**base | {"q": 40.0})
    np.testing.assert_allclose(np.diff(x_other_q, axis=0), 2.0 * np.diff(x, axis=0))
    np.testing.assert_allclose((y_other_q - x_other_q)[1:], (y - x)[1:], atol=1e-12)

    run = dict(base, N=200, policy="never", threshold=0.0, particles=1)
    free = _filter(**run, scheme="systematic")
    other = _filter(**run, scheme="multinomial")
    np.testing.assert_array_equal(free.particles, other.particles)
    seldom = _filter(**run | {"policy": "every 5th step"}, scheme="systematic")
    np.testing.assert_array_equal(free.particles[:6], seldom.particles[:6])  # the first resampling is after step 5
    moved = seldom.particles[7] - seldom.particles[6]  # no resampling between: the same noise moves them
    np.testing.assert_allclose(moved, free.particles[7] - free.particles[6])


def test_sir_sentence_counts():
    """A sentence that says something else than the track."""
    explorer = load("sir")
    _, shown = Stage(explorer, dpi=40).draw(explorer.defaults() | {"policy": "never"})
    assert shown.numbers["times resampled"] == 0
    assert "resampled 0 times" in shown.sentence


def test_controls_refuse_what_they_do_not_have():
    with pytest.raises(ValueError, match="starts at 7, which is none of"):
        Slider("a", "a", (1, 2), 7)
    explorer = load("sir")
    with pytest.raises(ValueError, match="no control 'n': there are model, N"):
        explorer.check({"n": 1})
    with pytest.raises(ValueError, match="control 'N' has no position 11"):
        explorer.check({"N": 11})
    with pytest.raises(ValueError, match="no explorer 'nonesuch': there are"):
        load("nonesuch")


def test_geometric_positions_hold_both_ends_and_are_round():
    values = geometric(10, 5000, 28)
    assert values[0] == 10 and values[-1] == 5000 and list(values) == sorted(set(values))
    assert 500 in values and 1000 in values


def test_beforehand_is_each_control_alone_and_what_is_asked_for():
    explorer = Explorer("t", (Slider("a", "a", range(5), 2), Choice("b", "b", ("x", "y"), "x"), Seed("s", "s")),
                        {}, lambda axes: {}, lambda *a, **k: Shown("."), also=({"a": 4, "b": "x"},))  # fmt: skip
    start = {"a": 1, "b": "y", "s": 1}
    keys = [explorer.key(start, params) for params in explorer.beforehand(start)]
    assert keys == ["start", "a-0", "a-2", "a-3", "a-4", "b-0", *(f"s-{i}" for i in range(1, 6)), "a-4-b-0"]


@pytest.mark.parametrize(("q", "r", "data"), [(10.0, 1.0, 1), (1.0, 0.5, 2), (1.0, 20.0, 4), (40.0, 0.5, 3)])
def test_sir_exact_answer_is_that_of_a_fine_grid(q, r, data):
    """An "exact" curve that is not: at q = 1 a spacing of 0.3 is off by more than a standard deviation."""
    from pfedu.explorers.sir import _record

    system, _, y, exact = _record("growth model", q, r, data)
    fine = pfedu.grid_filter(system, y, np.linspace(-60, 60, 4001))
    np.testing.assert_allclose(exact.mean, fine.mean, atol=1e-4)
    np.testing.assert_allclose(exact.sd, fine.sd, atol=1e-4)
    np.testing.assert_allclose(exact.log_likelihood_increments, fine.log_likelihood_increments, atol=1e-5)


@pytest.mark.parametrize(("q", "noise"), [(0.1, 0.25), (1.0, 1.0), (10.0, 4.0)])
def test_the_exact_returns_of_the_records_are_those_of_the_grid(q, noise):
    """A grid of the explorer that is too coarse or too short: 1e-4 beside a finer and longer one."""
    from pfedu.explorers import records

    q, mu = records.Q[records.RETURNS] * q, records.MU + np.log(noise)
    model = pfedu.models.stochastic_volatility(mu=mu, phi=records.PHI, q=q)
    half = 5 + 6 * np.sqrt(q / (1 - records.PHI**2))
    nodes = mu + np.linspace(-half, half, 1 + 2 * int(np.ceil(half / min(0.8 * np.sqrt(q), 0.25))))
    exact = pfedu.grid_filter(model, records.CHANGE, nodes)
    log_z, mean, sd = records._volatility(q, mu)
    assert abs(log_z - exact.log_likelihood) < 1e-4
    np.testing.assert_allclose(mean, exact.mean[:, 0], atol=1e-4)
    np.testing.assert_allclose(sd, exact.sd[:, 0], atol=1e-4)


def test_the_track_of_the_records_does_not_depend_on_the_dice(stages):
    """A track taken from another run of the curve: with common dice it is read off, else run alone."""
    explorer = load("records")
    for moved in ({}, {"q": 0.1}, {"along": "noise", "noise": 0.5}):
        shown = [
            stages["records"].draw(explorer.check(moved | {"dice": dice}))[1].numbers for dice in ("new", "common")
        ]
        for name in ("log-likelihood, particles", "N_eff / N, lowest", "RMS distance of the means, in posterior sd"):
            assert shown[0][name] == pytest.approx(shown[1][name], rel=1e-9)
