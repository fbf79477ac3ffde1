"""Explorer of chapter 7: the auxiliary filter beside the bootstrap and the fully adapted filter, with an outlier."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.density import particle_histogram
from pfedu.figures.style import COLORS
from pfedu.resampling import always

T = 40
OUTLIER = 20  # the step whose measurement is off
EDGES = np.linspace(-5.0, 5.0, 41)  # of the histogram, in posterior standard deviations
ERRORS = (1e-3, 3e1)  # ends of the axis of errors, in posterior standard deviations
WEIGHTS = (1e-4, 2e3)  # ends of the axis of weights times N
NAMES = {"plain": "bootstrap", "ahead": "auxiliary", "adapted": "fully adapted"}

CONTROLS = (
    Slider("q", "process noise variance q", geometric(0.01, 10.0, 19), 0.1),
    Slider("outlier", f"outlier at step {OUTLIER}, standard deviations of the sensor", range(9), 6),
    Slider("N", "particles N", geometric(10, 2000, 24), 500, drawn=6),
    Choice("look", "look ahead by", ("mean", "draw", "exact"), "mean"),
    Slider("k", "time step k", range(1, T + 1), OUTLIER, plays=True),
    Seed("data", "new data", drawn=4),
    Seed("particles", "new particles", default=3, drawn=4),
)


@lru_cache(maxsize=16)
def _record(q, outlier, data):
    """Model, record without its first row, and the exact answer; r = 1, so that the outlier is in units of its sd."""
    model = pfedu.models.random_walk(q=q)
    _, y = model.simulate(T, np.random.default_rng(data))
    y[0], y[OUTLIER] = np.nan, y[OUTLIER] + outlier
    return model, y, pfedu.kalman_filter(model, y)


@lru_cache(maxsize=12)
def _filter(q, outlier, data, N, look, particles):
    """One filter, resampled at every step; no look is the bootstrap filter. The seed moves all of them alike."""
    model, y, _ = _record(q, outlier, data)
    how = dict(rng=np.random.default_rng([particles, 7]), policy=always, keep=True)
    if look is None:
        return pfedu.bootstrap_filter(model, y, N, **how)
    return pfedu.auxiliary_filter(model, y, N, look_ahead=look, **how)


def build(axes):
    """Draw what stays; return the artists that move."""
    n, e, f, s = (axes[name] for name in ("n_eff", "error", "first", "second"))
    looks = {
        "plain": dict(color=COLORS["second"], ls="-.", marker="s", ms=2.5, lw=1.3),
        "ahead": dict(color=COLORS["particles"], ls="-", marker="o", ms=2.8, lw=1.5),
        "adapted": dict(color=COLORS["third"], ls=":", marker="^", ms=3.0, lw=1.3),
    }
    exact = dict(color=COLORS["exact"], ls="--", lw=1.6)
    artists = {"step_n": n.axvline(1, color=COLORS["accent"], lw=5, alpha=0.4)}
    artists["step_e"] = e.axvline(1, color=COLORS["accent"], lw=5, alpha=0.4)
    for key, look in looks.items():
        artists[f"n_{key}"] = n.plot([], [], label=NAMES[key], **look)[0]
        artists[f"e_{key}"] = e.plot([], [], **look)[0]
    artists["before"] = f.plot([], [], color=COLORS["measurement"], ls=":", lw=1.6, label="exact, before $y_k$")[0]
    artists["after"] = f.plot([], [], label="exact, with $y_k$", **exact)[0]
    artists["copied"] = f.fill_between([0, 1], 0, 0, color=COLORS["light"], alpha=0.6, lw=0, label="copied")
    dots = dict(ls="", mew=0, alpha=0.6)
    for key, marker, color, label in (("plain", "s", "second", "bootstrap"), ("ahead", "o", "particles", "auxiliary")):
        artists[f"w_{key}"] = s.plot([], [], marker, color=COLORS[color], ms=3.4, label=label, **dots)[0]
    _dress(n, e, f, s)
    return artists


def _dress(n, e, f, s):
    """Titles, limits and legends, which never change."""
    n.set(xlim=(0.3, T + 0.7), ylim=(0, 1.08), xlabel="time step k", ylabel="$N_{eff}$ / N",
          title="Effective share of particles")  # fmt: skip
    e.set(xlim=(0.3, T + 0.7), ylim=ERRORS, yscale="log", xlabel="time step k", ylabel="posterior sd",
          title="Distance of the mean to the exact mean")  # fmt: skip
    f.set(xlim=(-5, 5), ylim=(0, 2.4), xlabel="state at k−1, minus exact mean, in sd", ylabel="density / exact peak",
          title="First stage: who is copied for step k")  # fmt: skip
    s.set(xlim=(-7, 7), ylim=(WEIGHTS[0], 1e5), yscale="log", ylabel="weight × N",
          xlabel="state at k, minus exact mean, in sd", title="Second stage: weights at step k")  # fmt: skip
    s.axhline(1.0, color=COLORS["measurement"], lw=0.8)
    wide = n.figure.get_figwidth() > 5
    n.legend(ncols=3 if wide else 2, loc="lower center", bbox_to_anchor=(0.5, 1.14), handlelength=2.0, columnspacing=1)
    f.legend(ncols=2, loc="upper center", handlelength=1.6, columnspacing=1)
    s.legend(ncols=2, loc="upper center", handlelength=1.0, columnspacing=1, markerscale=1.6)


def update(artists, axes, q, outlier, N, look, k, data, particles):
    """Run the filters and give the artists their data."""
    _, y, exact = _record(q, outlier, data)
    wanted = {"plain": None, "ahead": look, "adapted": "exact"}
    tracks = {key: _filter(q, outlier, data, N, way, particles) for key, way in wanted.items()}
    times, errors = np.arange(1, T + 1), {}
    for key, track in tracks.items():
        errors[key] = np.abs(track.mean - exact.mean)[1:, 0] / exact.sd[1:, 0]
        artists[f"n_{key}"].set_data(times, track.n_eff[1:] / N)
        artists[f"e_{key}"].set_data(times, errors[key].clip(*ERRORS))
    for step in ("step_n", "step_e"):
        artists[step].set_xdata([k, k])
    _show_first(artists, tracks["ahead"], exact, y, q, k)
    for key in ("plain", "ahead"):
        x = (tracks[key].particles[k, :, 0] - exact.mean[k, 0]) / exact.sd[k, 0]
        artists[f"w_{key}"].set_data(x, (N * np.exp(tracks[key].log_weights[k])).clip(*WEIGHTS))
    return _say(tracks, exact, errors, q, outlier, N, look, k)


def _show_first(artists, track, exact, y, q, k):
    """Particles of step k-1 that were copied, and the exact density of x_{k-1} before and after y_k is known."""
    m, P = exact.mean[k - 1, 0], exact.cov[k - 1, 0, 0]
    sd, S = np.sqrt(P), P + q + 1.0
    mean, var = sd * (y[k, 0] - m) / S, 1 - P / S  # of (x - m) / sd, given y_k as well
    nodes = np.linspace(-5.0, 5.0, 201)
    artists["before"].set_data(nodes, np.sqrt(var) * np.exp(-0.5 * nodes**2))
    artists["after"].set_data(nodes, np.exp(-0.5 * (nodes - mean) ** 2 / var))
    x = (track.particles[k - 1, :, 0][track.ancestors[k]] - m) / sd
    bars = particle_histogram(x, np.full(x.shape, -np.log(x.size)), EDGES) * np.sqrt(2 * np.pi * var)
    heights = np.repeat(bars, 2)
    artists["copied"].set_verts([np.r_[np.c_[np.repeat(EDGES, 2)[1:-1], heights], [[EDGES[-1], 0], [EDGES[0], 0]]]])


def _say(tracks, exact, errors, q, outlier, N, look, k):
    numbers = {}
    for key, track in tracks.items():
        name = NAMES[key]
        numbers |= {
            f"N_eff at step k, {name}": float(track.n_eff[k]),
            f"mean N_eff over the steps, {name}": float(track.n_eff[1:].mean()),
            f"distance at step k in sd, {name}": float(errors[key][k - 1]),
            f"RMS distance in sd, {name}": float(np.sqrt(np.mean(errors[key] ** 2))),
            f"different particles copied for step k, {name}": float(np.unique(track.ancestors[k]).size),
            f"heaviest weight times N at step k, {name}": float(N * np.exp(track.log_weights[k].max())),
            f"error of the log-likelihood, {name}": float(track.log_likelihood - exact.log_likelihood),
        }
    n = [numbers[f"N_eff at step k, {name}"] for name in NAMES.values()]
    d = [numbers[f"RMS distance in sd, {name}"] for name in NAMES.values()]
    copied = numbers["different particles copied for step k, auxiliary"]
    same = ", which here is the fully adapted filter" if look == "exact" else ""
    off = f"an outlier of {outlier} sd at step {OUTLIER}" if outlier else "no outlier"
    sentence = (
        f"Random walk with q = {q:g}, r = 1 and {off}; N = {N}, looking ahead by {'a ' * (look == 'draw')}"
        f"{'the ' * (look == 'mean')}{look if look != 'exact' else 'the exact density'}{same}. "
        f"At step {k}, N_eff is {n[0]:.0f} (bootstrap), {n[1]:.0f} (auxiliary) and {n[2]:.0f} (fully adapted), "
        f"and the auxiliary filter made its particles from {copied:.0f} different ones. "
        f"Over all steps their means are {d[0]:.2f}, {d[1]:.2f} and {d[2]:.2f} posterior sd from the exact mean (RMS)."
    )
    return Shown(sentence, numbers)


def _last_gain(params, numbers):
    """Whether the look ahead raises the mean N_eff at this q, and no longer at the next larger one."""
    q, sizes = params["q"], CONTROLS[0].values
    if params["look"] != "mean" or params["outlier"] != 0 or q == sizes[-1]:
        return False
    rest = [params[name] for name in ("outlier", "data", "N")]

    def gain(q):
        ahead, plain = (_filter(q, *rest, look, params["particles"]).n_eff[1:].mean() for look in ("mean", None))
        return ahead - plain

    return gain(q) > 0 >= gain(sizes[sizes.index(q) + 1])


def _even_weights_few_ancestors(params, numbers):
    """Whether the auxiliary filter's weights look even although few different particles were copied."""
    few = numbers["different particles copied for step k, auxiliary"] < 0.15 * params["N"]
    return params["look"] == "mean" and few and numbers["N_eff at step k, auxiliary"] > 0.5 * params["N"]


PUZZLES = (
    Puzzle(
        "Without an outlier, looking ahead by the mean: find the largest q at which the auxiliary filter still has a "
        "larger N_eff than the bootstrap filter, on average over the steps; at the next position of q it has none.",
        _last_gain,
        {"q": 0.46, "outlier": 0},
    ),
    Puzzle(
        "Looking ahead by the mean: find a position where at step k the auxiliary filter reports an N_eff of more than "
        "half of N, although fewer than 15 % of the particles before it were copied.",
        _even_weights_few_ancestors,
        {"q": 0.01, "outlier": 8},
    ),
)


EXPLORER = Explorer(
    title="Ask the next measurement whom to copy",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.2), [["n_eff", "error"], ["first", "second"]]),
        "narrow": ((3.7, 8.4), [["n_eff"], ["error"], ["first"], ["second"]]),
    },
    build=build,
    update=update,
    also=(
        *({"q": q, "look": look} for q in (1.0, 10.0) for look in ("draw", "exact")),
        *({"q": q, "outlier": 0, "k": 10} for q in CONTROLS[0].frames()),
        {"q": 10.0, "particles": 1},
        *({"outlier": 0, "q": q} for q in (0.01, 1.0, 10.0)),
    ),
    puzzles=PUZZLES,
)
