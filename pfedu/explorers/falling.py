"""Explorer of chapter 9: particles with and without a kernel beside the unscented filter, on the falling body."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.style import COLORS
from pfedu.models import falling_body
from pfedu.resampling import systematic
from pfedu.weights import ZeroLikelihoodError

T = 60
DOTS = 200  # dots that stand for the particles of a step
MANY = 4000  # particles of the reference, with shrinkage: good to about 0.1 posterior standard deviations
STATES = {"height": (0, "ft"), "velocity": (1, "ft/s"), "coefficient": (2, "1/ft")}
LIMITS = {"height": (1.0, 1e5), "velocity": (1e-2, 3e4), "coefficient": (1e-7, 0.3)}
PRIORS = {"the same": {}, "as the lecture has it": {"m0": (3e5, 2e4, 3e-5), "P0": (1e6, 4e6, 1e-4)}}
CIRCLE = 2.0 * np.stack([np.cos(np.linspace(0, 2 * np.pi, 91)), np.sin(np.linspace(0, 2 * np.pi, 91))])
WIDTHS = 0.05, 20.0  # ends of the axis of relative widths

CONTROLS = (
    Choice("state", "which state", tuple(STATES), "velocity"),
    Slider("N", "particles N", geometric(100, 4000, 17), 500, drawn=6),
    Choice("kernel", "kernel", ("none", "gaussian", "epanechnikov"), "gaussian"),
    Choice("shrink", "shrinkage", ("no", "yes"), "no"),
    Choice("prior", "prior of the unscented filter", tuple(PRIORS), "the same"),
    Slider("k", "time step k", range(1, T + 1), 15, drawn=13, plays=True),
    Seed("data", "new data", drawn=5),
    Seed("particles", "new particles", drawn=5),
)


@lru_cache(maxsize=4)
def _record(data):
    """Truth, record without its first row, and the reference: many particles with shrinkage."""
    model = falling_body()
    x, y = model.simulate(T, np.random.default_rng([data, 1]), x0=(3e5, 2e4, 1e-3))
    y[0] = np.nan  # the lecture's convention: the first measurement is not used
    return x, y, _regularized(model, y, MANY, "gaussian", True, np.random.default_rng([data, 2]), keep=True)


def _regularized(model, y, N, kernel, shrink, rng, keep=False):
    options = {"bandwidth": 0.0} if kernel == "none" else {"kernel": kernel, "shrink": shrink}
    return pfedu.regularized_filter(model, y, N, rng=rng, keep=keep, **options)


@lru_cache(maxsize=4)
def _particles(data, N, kernel, shrink, seed):
    """Track of the particles up to the step at which all of them are impossible, and that step: T + 1 if none."""
    y = _record(data)[1]

    def run(end):
        return _regularized(falling_body(), y[:end], N, kernel, shrink, np.random.default_rng([seed, 3]), keep=True)

    try:
        return run(T + 1), T + 1
    except ZeroLikelihoodError:
        alive, dead = 1, T + 1
    while dead - alive > 1:  # the same seed: a shorter record makes the same steps
        middle = (alive + dead) // 2
        try:
            run(middle)
            alive = middle
        except ZeroLikelihoodError:
            dead = middle
    return run(alive), alive


@lru_cache(maxsize=8)
def _unscented(data, prior):
    return pfedu.unscented_kalman_filter(falling_body(**PRIORS[prior]), _record(data)[1], noise="augmented")


def build(axes):
    """Draw what stays; return the artists that move."""
    e, c, w = axes["error"], axes["cloud"], axes["width"]
    mine, rival = dict(color=COLORS["particles"]), dict(color=COLORS["exact"])
    artists = {
        "step": e.axvline(1, color=COLORS["accent"], lw=5, alpha=0.4),
        "rival": e.plot([], [], "--", lw=1.4, label="unscented: 3 sd", **rival)[0],
        "rival_error": e.plot([], [], "s", ms=3, label="error", **rival)[0],
        "mine": e.plot([], [], "-", lw=1.4, label="particles: 3 sd", **mine)[0],
        "mine_error": e.plot([], [], "o", ms=3, label="error", **mine)[0],
        "cloud": c.plot([], [], ".", color=COLORS["light"], ms=2, mew=0, label=f"{MANY} particles")[0],
        "dots": c.plot([], [], "x", ms=3, mew=0.7, label="the filter's", **mine)[0],
        "ellipse": c.plot([], [], "--", lw=1.5, label="unscented, 2 sd", **rival)[0],
        "truth": c.plot([], [], "*", color=COLORS["truth"], ms=8, label="truth")[0],
        "rival_width": w.plot([], [], "--", lw=1.4, label="unscented", **rival)[0],
        "mine_width": w.plot([], [], "-", lw=1.4, label="particles", **mine)[0],
        "step_w": w.axvline(1, color=COLORS["accent"], lw=5, alpha=0.4),
    }
    e.set(xlim=(0, T + 0.7), yscale="log", ylim=LIMITS["velocity"], xlabel="time in s", ylabel="ft/s")
    wide = e.figure.get_figwidth() > 5
    e.legend(ncols=4 if wide else 2, loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=1.8, columnspacing=1.2)
    c.axvline(0, color=COLORS["measurement"], lw=0.6)
    c.axhline(0, color=COLORS["measurement"], lw=0.6)
    c.set(xlim=(-9, 9), ylim=(-9, 9), xlabel="velocity", ylabel="coefficient", title="Posterior at step k, in sd")
    c.legend(loc="upper right", handlelength=1.2, fontsize=7, markerscale=1.6)
    w.axhline(1, color=COLORS["measurement"], lw=1)
    w.set(xlim=(0, T + 0.7), yscale="log", ylim=WIDTHS, yticks=[0.1, 1, 10], yticklabels=["0.1", "1", "10"],
          xlabel="time in s", ylabel=f"sd / that of {MANY}", title="How wide each filter thinks it is")  # fmt: skip
    w.legend(loc="lower right", handlelength=1.8)
    return artists


def update(artists, axes, state, N, kernel, shrink, prior, k, data, particles):
    """Run both filters and give the artists their data."""
    x, _, many = _record(data)
    mine, end = _particles(data, N, kernel, shrink == "yes" and kernel != "none", particles)
    rival, j = _unscented(data, prior), STATES[state][0]
    if axes["error"].get_ylim() != LIMITS[state]:
        axes["error"].set(ylim=LIMITS[state], ylabel=STATES[state][1])
    for name, track in (("mine", mine), ("rival", rival)):
        times = np.arange(1, len(track.mean))
        low, high = LIMITS[state]
        error, sd = np.abs(track.mean - x[: len(track.mean)])[1:, j], track.sd[1:, j]
        artists[name].set_data(times, np.clip(3 * sd, low, high))
        artists[f"{name}_error"].set_data(times, np.clip(error, low, high))
        artists[f"{name}_width"].set_data(times, np.clip(sd / many.sd[1 : len(track.mean), j], *WIDTHS))
    artists["step"].set_xdata([k, k])
    artists["step_w"].set_xdata([k, k])
    _show_cloud(artists, x, many, mine, rival, k, end)
    return _say(x, many, mine, rival, state, N, kernel, shrink, k, end)


def _show_cloud(artists, x, many, mine, rival, k, end):
    """Velocity and coefficient of step k, from the reference mean in reference standard deviations."""
    origin, unit = many.mean[k, 1:], many.sd[k, 1:]
    sd = (rival.cov[k, 1:, 1:] + rival.cov[k, 1:, 1:].T) / 2 / np.outer(unit, unit)
    outline = ((rival.mean[k, 1:] - origin) / unit)[:, None] + np.linalg.cholesky(sd) @ CIRCLE
    artists["ellipse"].set_data(*outline)
    artists["truth"].set_data(*((x[k, 1:] - origin) / unit)[:, None])
    for name, track, shown in (("cloud", many, True), ("dots", mine, k < end)):
        artists[name].set_visible(shown)
        if shown:
            picks = systematic(np.exp(track.log_weights[k]), np.random.default_rng(0), size=DOTS)  # by their weights
            artists[name].set_data(*((track.particles[k, picks, 1:] - origin) / unit).T)


def _say(x, many, mine, rival, state, N, kernel, shrink, k, end):
    j, unit = STATES[state]
    at = min(k, end - 1)
    numbers = {"last step with particles": float(end - 1), "times resampled": float(mine.resampled.sum())}
    for name, track, step in (("particles", mine, at), ("unscented", rival, k)):
        error, sd = np.abs(track.mean - x[: len(track.mean)])[:, j], track.sd[:, j]
        numbers[f"error of the {state} at step {step}, {name}"] = float(error[step])
        numbers[f"three standard deviations, {name}"] = float(3 * sd[step])
        numbers[f"sd over that of {MANY} particles, {name}"] = float(sd[step] / many.sd[step, j])
        numbers[f"steps with the truth inside 3 sd, {name}"] = float(np.sum(error[1:] < 3 * sd[1:]))
    error, wide, ratio, inside, error_u, wide_u, ratio_u, inside_u = list(numbers.values())[2:]
    how = "no kernel" if kernel == "none" else f"{kernel} kernel, {'with' if shrink == 'yes' else 'without'} shrinkage"
    mine_says = f"the particles miss by {_read(error)} {unit} (3 sd: {_read(wide)}; {ratio:.2g} times the right width)"
    if k >= end:
        mine_says = f"the particles are gone, since at step {end} the measurement was impossible for all of them"
    sentence = (
        f"N = {N}, {how}. {state.capitalize()} at step {k}: {mine_says}, "
        f"the unscented filter misses by {_read(error_u)} {unit} "
        f"(3 sd: {_read(wide_u)}; {ratio_u:.2g} times the right width). "
        f"The truth is inside 3 sd in {inside:.0f} of {T} steps for the particles, in {inside_u:.0f} for the unscented "
        f"filter; the right width is the sd of {MANY} particles."
    )
    return Shown(sentence, numbers)


def _read(value):
    """Two digits; an estimate that ran away needs none."""
    return f"{value:.2g}" if value < 100 else f"{value:.0f}" if value < 1e6 else "over a million"


def _lost_with_kernel(params, numbers):
    """Whether particles with a kernel leave the truth outside their bounds at most steps."""
    return params["kernel"] != "none" and numbers["steps with the truth inside 3 sd, particles"] < 30


def _held_without_kernel(params, numbers):
    """Whether particles without a kernel keep the truth inside their bounds at most steps."""
    return params["kernel"] == "none" and numbers["steps with the truth inside 3 sd, particles"] > 40


PUZZLES = (
    Puzzle(
        "Keep a kernel, and lose the body all the same: the truth is inside 3 sd of the particles in fewer than 30 of "
        "the 60 steps (the state and all seeds are up to you).",
        _lost_with_kernel,
        {"N": 100, "shrink": "yes"},
    ),
    Puzzle(
        "Without a kernel, keep the truth inside 3 sd of the particles in more than 40 of the 60 steps "
        "(seeds are up to you, and you will need them).",
        _held_without_kernel,
        {"kernel": "none", "N": 4000, "particles": 3},
    ),
)


EXPLORER = Explorer(
    title="A falling body: particles and sigma points",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.4), [["error", "error"], ["cloud", "width"]]),
        "narrow": ((3.7, 7.4), [["error"], ["cloud"], ["width"]]),
    },
    build=build,
    update=update,
    also=(
        *({"kernel": "none", "particles": seed} for seed in CONTROLS[7].frames()),
        *({"kernel": "none", "k": k} for k in (10, 20, 60)),
        *({"state": "coefficient", "prior": "as the lecture has it", "k": k} for k in (5, 15)),
        *({"state": "coefficient", "k": k} for k in (5, 10)),
        *({"state": "coefficient", "prior": "as the lecture has it", "k": 5, "data": seed} for seed in (2, 3, 4)),
        {"shrink": "yes", "k": 20},
    ),
    puzzles=PUZZLES,
)
