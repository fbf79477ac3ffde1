"""Explorer of chapter 14: lines of ancestors and paths drawn backward, beside the exact smoothing distribution."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.density import particle_histogram
from pfedu.figures.style import COLORS
from pfedu.resampling import always, ratio, systematic
from pfedu.smoothing import distinct_ancestors

T, M, DOTS = 50, 100, 60  # steps, paths drawn backward, dots a time that stand for the filter's particles
EDGES = np.linspace(-4.0, 4.0, 41)  # in standard deviations of the filter
NODES = np.linspace(-4.0, 4.0, 201)
METHODS = ("ancestral lines", "backward simulation")
POLICIES = {"always": always, "below half of N": ratio(0.5)}

CONTROLS = (
    Choice("method", "smoother", METHODS, METHODS[0]),
    Slider("N", "particles N", geometric(10, 500, 18), 50),
    Choice("policy", "resample", tuple(POLICIES), "always"),
    Slider("r", "measurement noise variance r", geometric(0.5, 20.0, 17), 2.0, drawn=9),
    Slider("k", "time step k", range(T + 1), 10, drawn=18, plays=True),
    Seed("data", "new data", drawn=4),
    Seed("particles", "new particles", drawn=5),
)


@lru_cache(maxsize=16)
def _record(r, data):
    """Model, truth, record, and what is exactly known of each time by then, and in the end."""
    model = pfedu.models.random_walk(q=1.0, r=r, p0=1.0)
    x, y = model.simulate(T, np.random.default_rng([data, 14]))
    return model, x, y, pfedu.kalman_filter(model, y), pfedu.rts_smoother(model, y)


@lru_cache(maxsize=16)
def _smoothed(N, policy, r, data, particles):
    """The filter's particles, and both smoothers of them."""
    model, _, y, _, _ = _record(r, data)
    rng, rng_back = (np.random.default_rng([particles, i]) for i in (2, 3))
    track = pfedu.bootstrap_filter(model, y, N, rng=rng, policy=POLICIES[policy], keep=True)
    smooth = pfedu.genealogy_smoother(track), pfedu.backward_smoother(model, track, M, rng=rng_back)
    return track, dict(zip(METHODS, smooth, strict=True))


def build(axes):
    """Draw what stays; return the artists that move."""
    t, d, n = axes["paths"], axes["posterior"], axes["distinct"]
    exact, mine = dict(color=COLORS["exact"], ls="--"), dict(color=COLORS["particles"])
    artists = {
        "step": t.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4),
        "dots": t.plot([], [], ".", color=COLORS["light"], ms=3.2, alpha=0.5, mew=0, label="filter's particles")[0],
        "lines": t.plot([], [], lw=0.7, alpha=0.55, label="paths", **mine)[0],
        "y": t.plot([], [], "x", color=COLORS["measurement"], ms=4, label="measurement")[0],
        "truth": t.plot([], [], color=COLORS["truth"], lw=1.2, label="truth")[0],
        "exact": t.plot([], [], lw=1.6, label="exact smoothing mean", **exact)[0],
        "low": t.plot([], [], lw=0.9, label="its ±2 sd", **exact)[0],
        "high": t.plot([], [], lw=0.9, **exact)[0],
        "bars": d.fill_between([0, 1], 0, 0, step="post", color=COLORS["particles"], alpha=0.4, lw=0, label="paths"),
        "filter": d.plot([], [], color=COLORS["second"], ls=":", lw=1.8, label="exact filter")[0],
        "smoother": d.plot([], [], lw=1.6, label="exact smoother", **exact)[0],
        "truth_k": d.plot([], [], color=COLORS["truth"], lw=1.2, label="truth")[0],
        "step_n": n.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4),
        "lineage": n.plot([], [], lw=1.4, marker="o", ms=2.5, label=METHODS[0], **mine)[0],
        "backward": n.plot([], [], color=COLORS["third"], lw=1.2, marker="^", ms=3.0, label=METHODS[1])[0],
        "all": n.axhline(1, color=COLORS["measurement"], ls=":", lw=1.2, label="N"),
    }
    wide = t.figure.get_figwidth() > 5
    t.set(xlim=(-0.7, T + 0.7), xlabel="time step k", ylabel="state", title="Paths through the whole record")
    t.legend(ncols=3 if wide else 2, loc="lower center", bbox_to_anchor=(0.5, 1.12), markerscale=2,
             handlelength=1.6, columnspacing=1.0)  # fmt: skip
    d.set(xlim=(-4, 4), ylim=(0, 2.3), yticks=[0, 0.5, 1, 1.5], ylabel="density / exact peak",
          xlabel="state at step k, in sd of the filter", title="Step k, given the whole record")  # fmt: skip
    d.legend(loc="upper center", ncols=2, handlelength=1.4, columnspacing=0.8, labelspacing=0.25)
    n.set(xlim=(-0.7, T + 0.7), ylim=(0.8, 4000), yscale="log", yticks=[1, 10, 100], xlabel="time step k",
          title="Different particles on the paths")  # fmt: skip
    n.legend(loc="upper center", ncols=2, handlelength=1.4, columnspacing=0.8, labelspacing=0.25)
    return artists


def update(artists, axes, method, N, policy, r, k, data, particles):
    """Smooth, and give the artists their data."""
    _, x, y, known, exact = _record(r, data)
    track, smooth = _smoothed(N, policy, r, data, particles)
    counts = {name: distinct_ancestors(smooth[name].particles[..., 0]) for name in METHODS}
    _show_paths(artists, axes["paths"], x, y, exact, track, smooth[method], k)
    _show_posterior(artists, x[k, 0], known, exact, smooth[method], k)
    _show_counts(artists, counts, N, k)
    return _say(known, exact, smooth, counts, method, N, policy, k)


def _show_paths(artists, ax, x, y, exact, track, smooth, k):
    times, values = np.arange(T + 1), np.concatenate([x, y, exact.mean - 2 * exact.sd, exact.mean + 2 * exact.sd])
    limits = 5 * np.floor(values.min() / 5 - 0.2), 5 * np.ceil(values.max() / 5 + 0.2)
    if ax.get_ylim() != limits:
        ax.set_ylim(*limits)
    picks = systematic(np.exp(track.log_weights), np.random.default_rng(0), size=DOTS)
    artists["dots"].set_data(np.repeat(times, DOTS), np.take_along_axis(track.particles[..., 0], picks, -1).ravel())
    chosen = systematic(np.exp(smooth.log_weights[-1]), np.random.default_rng(0), size=min(DOTS, M))
    lines = np.pad(smooth.particles[:, np.unique(chosen), 0].T, [(0, 0), (0, 1)], constant_values=np.nan)
    artists["lines"].set_data(np.tile(np.append(times, T), len(lines)), lines.ravel())
    artists["y"].set_data(times, y[:, 0])
    artists["truth"].set_data(times, x[:, 0])
    for name, by in (("exact", 0), ("low", -2), ("high", 2)):
        artists[name].set_data(times, (exact.mean + by * exact.sd)[:, 0])
    artists["step"].set_xdata([k, k])


def _show_posterior(artists, truth, known, exact, smooth, k):
    """At one time, from the filter's mean and in its standard deviations, so that what smoothing gains is seen."""
    origin, unit = known.mean[k, 0], known.sd[k, 0]
    centre, sd = (exact.mean[k, 0] - origin) / unit, exact.sd[k, 0] / unit
    peak = 1.0 / (np.sqrt(2 * np.pi) * sd)
    bars = np.repeat(particle_histogram((smooth.particles[k, :, 0] - origin) / unit, smooth.log_weights[k], EDGES), 2)
    corners = np.c_[np.repeat(EDGES, 2)[1:-1], np.minimum(bars / peak, 1.72)]
    artists["bars"].set_verts([np.r_[corners, [[EDGES[-1], 0], [EDGES[0], 0]]]])
    artists["filter"].set_data(NODES, sd * np.exp(-0.5 * NODES**2))
    artists["smoother"].set_data(NODES, np.exp(-0.5 * ((NODES - centre) / sd) ** 2))
    artists["truth_k"].set_data([(truth - origin) / unit] * 2, [0.0, 1.72])


def _show_counts(artists, counts, N, k):
    for artist, name in (("lineage", METHODS[0]), ("backward", METHODS[1])):
        artists[artist].set_data(np.arange(T + 1), counts[name])
    artists["all"].set_ydata([N, N])
    artists["step_n"].set_xdata([k, k])


def _say(known, exact, smooth, counts, method, N, policy, k):
    def apart(name):
        return float(np.sqrt(np.mean(((smooth[name].mean - exact.mean) / exact.sd) ** 2)))

    one = int(np.flatnonzero(counts[METHODS[0]] == 1).max(initial=-1))  # last time with a single ancestor
    mine = smooth[method]
    numbers = {
        "exact filter sd at step k": float(known.sd[k, 0]),
        "exact smoothing sd at step k": float(exact.sd[k, 0]),
        "smoothing sd of the paths at step k": float(mine.sd[k, 0]),
        "exact smoothing mean at step k": float(exact.mean[k, 0]),
        "smoothing mean of the paths at step k": float(mine.mean[k, 0]),
        "different ancestors at step k": int(counts[METHODS[0]][k]),
        "different particles on backward paths at step k": int(counts[METHODS[1]][k]),
        "distance to the exact mean in smoothing sd, ancestral lines": apart(METHODS[0]),
        "distance to the exact mean in smoothing sd, backward simulation": apart(METHODS[1]),
        "steps before which all share one ancestor": one + 1,
    }
    shared = f"up to step {one} all of them share one ancestor" if one >= 0 else "not all of them share one ancestor"
    sentence = (
        f"{method.capitalize()}, N = {N}, resampled {'always' if policy == 'always' else 'when N_eff fell ' + policy}: "
        f"of the {N} last particles {counts[METHODS[0]][k]} different ancestors are left at step {k}, and {shared}. "
        f"The sd of the paths there is {mine.sd[k, 0]:.2f}, exactly it is {exact.sd[k, 0]:.2f} "
        f"({known.sd[k, 0]:.2f} for the filter). Over all steps the mean of the paths is {apart(method):.2f} exact sd "
        f"from the exact mean."
    )
    return Shown(sentence, numbers)


def _lines_win(params, numbers):
    lines, backward = (numbers[f"distance to the exact mean in smoothing sd, {name}"] for name in METHODS)
    return params["data"] == params["particles"] == 1 and lines < backward


def _ten_eves(params, numbers):
    return params["k"] == 0 and params["N"] <= 100 and numbers["different ancestors at step k"] >= 10


PUZZLES = (
    Puzzle(
        "Let the ancestral lines come closer to the exact mean, over all steps, than backward simulation does, with "
        "the data and the particles of the start.",
        _lines_win,
        {"N": 200, "r": 20.0},
    ),
    Puzzle(
        "At step 0 keep at least ten different ancestors of 100 particles or fewer.",
        _ten_eves,
        {"N": 100, "policy": "below half of N", "r": 20.0, "k": 0},
    ),
)


EXPLORER = Explorer(
    title="Ancestral lines and backward paths beside the exact smoother",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.2), [["paths", "paths"], ["posterior", "distinct"]]),
        "narrow": ((3.7, 7.4), [["paths"], ["posterior"], ["distinct"]]),
    },
    build=build,
    update=update,
    also=(
        *({"method": METHODS[1], "k": k} for k in (0, 25, 40, 50)),
        *({"method": METHODS[1], "N": n} for n in (10, 500)),
        {"policy": "below half of N", "r": 20.0},
        {"policy": "below half of N", "N": 500},
    ),
    puzzles=PUZZLES,
)
