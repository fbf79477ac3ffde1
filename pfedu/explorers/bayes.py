"""Explorer of chapter 1: the Bayesian recursion on a grid, half a step at a time."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

import pfedu
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.style import COLORS

T = 15
# Nodes dense about zero, where one step of the growth model moves neighbours 25 times apart.
_U, _DU = np.linspace(-np.arcsinh(85.0 / 8.0), np.arcsinh(85.0 / 8.0), 801, retstep=True)
GRID, DX = 8.0 * np.sinh(_U), 8.0 * np.cosh(_U) * _DU  # the integral of p is p @ DX
PERIOD = 220.0  # of the Fourier series of a prediction: wider than the grid, so that nothing comes round
SHOWN = np.linspace(-60.0, 60.0, 481)  # nodes that are drawn
LAMPS = np.array([-12.0, -7.0, 4.0, 15.0])
WALK, GROWTH, CORRIDOR = "random walk", "growth model", "lamps in a corridor"
MISSING = {"none": (), "every second": tuple(range(1, T + 1, 2)), "times 5 to 9": tuple(range(5, 10))}

CONTROLS = (
    Choice("model", "model", (GROWTH, WALK, CORRIDOR), GROWTH),
    Slider("t", "time (… .5: on the way to the next)", tuple(i / 2 for i in range(-1, 2 * T + 1)), 7.0, drawn=32,
           plays=True),
    Slider("q", "process noise variance q", geometric(1.0, 20.0, 14), 10.0, drawn=5),
    Slider("r", "measurement noise variance r", geometric(0.5, 20.0, 17), 1.0, drawn=5),
    Choice("missing", "missing measurements", tuple(MISSING), "none"),
    Seed("data", "new data", drawn=4),
)  # fmt: skip


class _Exact(NamedTuple):
    """A record and what the recursion makes of it; row k is time k."""

    x: np.ndarray  # (T+1,), the truth
    y: np.ndarray  # (T+1,), NaN where missing
    prior: np.ndarray  # (T+1, G), a priori densities
    posterior: np.ndarray  # (T+1, G)
    increments: np.ndarray  # (T+1,)
    kalman: tuple  # means and variances, a priori and a posteriori, each (T+1,); empty for a nonlinear model


def brightness(k, x):
    """Light of the four lamps at a place."""
    return 10.0 * np.exp(-0.5 * ((x - LAMPS) / 2.0) ** 2).sum(axis=-1, keepdims=True)


def _system(model, q, r):
    if model == CORRIDOR:
        return pfedu.models.AdditiveGaussian(lambda k, x: x + 1.5, brightness, Q=q, R=r, m0=-12.0, P0=80.0)
    return {GROWTH: pfedu.models.growth, WALK: pfedu.models.random_walk}[model](q=q, r=r)


@lru_cache(maxsize=32)
def _filter(model, q, r, missing, data):
    r"""What ``pfedu.grid_filter`` gives on GRID, many times faster, and with the predictions.

    A prediction is the sum of Gaussians N(x; f(k, x_j), q) with the masses of the nodes. The sum of their Fourier
    transforms is a short one, and what f(k, x) adds at time k only turns its phases, so two tables serve all steps.
    """
    system, zero = _system(model, q, r), np.zeros(1)
    x, y = system.simulate(T, np.random.default_rng(data))
    y[list(MISSING[missing])] = np.nan
    omega = np.arange(np.ceil(6.5 * PERIOD / (2 * np.pi * np.sqrt(q)))) * (2 * np.pi / PERIOD)
    weight = np.exp(-0.5 * q * omega**2) * np.where(omega == 0, 1.0, 2.0) / PERIOD
    shift = [system.f(k, zero)[0] for k in range(T + 1)]  # f(k, x) = f(0, x) - f(0, 0) + shift[k]
    leave = np.exp(-1j * omega[:, None] * (system.f(0, GRID[:, None])[:, 0] - shift[0]))  # (frequencies, nodes)
    arrive = np.exp(1j * GRID[:, None] * omega) * weight  # (nodes, frequencies)
    p, priors, posteriors, increments = np.exp(system.log_initial(GRID[:, None])), [], [], []
    for k in range(T + 1):
        if k > 0:
            p = np.maximum((arrive @ (np.exp(-1j * omega * shift[k]) * (leave @ (p * DX)))).real, 0.0)
        priors.append(p)
        joint = p if np.isnan(y[k, 0]) else p * np.exp(system.log_likelihood(k, y[k], GRID[:, None]))
        p = joint / (joint @ DX)
        posteriors.append(p)
        increments.append(0.0 if np.isnan(y[k, 0]) else np.log(joint @ DX))
    kalman = _kalman(system, y) if model == WALK else ()
    return _Exact(x[:, 0], y[:, 0], np.array(priors), np.array(posteriors), np.array(increments), kalman)


def _kalman(system, y):
    track = pfedu.kalman_filter(system, y)
    m, P = track.mean[:, 0], track.cov[:, 0, 0]
    return np.r_[system.m0, m[:-1]], np.r_[system.P0[0], P[:-1] + system.Q[0]], m, P


@lru_cache(maxsize=32)
def _expected(model, q, r, missing, data):
    """Values of y, and the density with which each time expects them: (B,), (T+1, B)."""
    exact, h = _filter(model, q, r, missing, data), _system(model, q, r).h(0, GRID[:, None])[:, 0]
    mean = exact.prior @ (DX * h)
    sd = np.sqrt(exact.prior @ (DX * h * h) - mean**2 + r)
    ends = np.r_[mean - 2.5 * sd, mean + 2.5 * sd, exact.y[np.isfinite(exact.y)]]
    low = ends.min() if model == WALK else h.min() - 3 * np.sqrt(r)  # the others measure nothing below zero
    y = np.linspace(5 * np.floor(low / 5), 5 * np.ceil(ends.max() / 5), 201)
    return y, exact.prior @ (DX[:, None] * _gauss(y - h[:, None], r))


def _gauss(d, variance):
    return np.exp(-0.5 * d * d / variance) / np.sqrt(2 * np.pi * variance)


def build(axes):
    """Draw what stays; return the artists that move."""
    d, e, s = (axes[name] for name in ("density", "expected", "strip"))
    new, old = dict(color=COLORS["exact"], lw=1.8), dict(color=COLORS["light"], lw=1.6, ls="--")
    dots = dict(color=COLORS["second"], ls="", marker="o", ms=3.5, mfc="none")
    artists = {
        "last": d.plot([], [], label="a posteriori, a step before", color=COLORS["third"], lw=1.4, ls="-.")[0],
        "shade": d.fill_between([0, 1], 0, 0, color=COLORS["light"], alpha=0.25, lw=0),
        "prior": d.plot([], [], label="a priori", **old)[0],
        "likelihood": d.plot([], [], label="likelihood (scaled)", color=COLORS["measurement"], lw=2.0, ls=":")[0],
        "posterior": d.plot([], [], label="a posteriori", **new)[0],
        "kalman": d.plot([], [], label="Kalman filter", **dots)[0],
        "truth": d.plot([], [], "^", color=COLORS["truth"], ms=6, label="truth")[0],
        "bar": d.plot([], [], color=COLORS["particles"], lw=2.0, marker="|", ms=7, label="mean ± 2 sd")[0],
        "mean": d.plot([], [], "s", color=COLORS["particles"], ms=4.5)[0],
        "expected": e.plot([], [], **old)[0],
        "evidence": e.plot([], [], color=COLORS["exact"], lw=1.4, marker="o", ms=5, markevery=[1])[0],
        "past": s.fill_betweenx([0, 1], 0, 0, fc=COLORS["exact"], ec=COLORS["exact"], alpha=0.45, lw=0.8),
        "now": s.fill_betweenx([0, 1], 0, 0, fc=COLORS["light"], ec=COLORS["light"], alpha=0.45, lw=0.8, hatch="////"),
        "path": s.plot([], [], "^", color=COLORS["truth"], ms=4)[0],
        "lamps": s.plot([], [], color=COLORS["accent"], ls=":", lw=1.4)[0],
        "y": s.plot([], [], "x", color=COLORS["measurement"], ms=4)[0],
        "step": s.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4),
    }
    wide = d.figure.get_figwidth() > 5
    d.set(ylim=(-0.2, 1.08), yticks=[0, 0.5, 1], xlabel="state", ylabel="density / tallest", title="The density now")
    d.legend(loc="lower center", bbox_to_anchor=(0.5, 1.13), ncols=3 if wide else 2, columnspacing=1.0, handlelength=2)
    e.set(xlabel="measurement", title="The measurement expected", ylabel="density", ylim=(0, 1))
    s.set(
        xlim=(-0.7, T + 1.2),
        xticks=range(0, T + 1, 5 if not wide else 1),
        xlabel="time k",
        ylabel="state",
        title="A posteriori densities so far (▲ truth)",
    )
    return artists


def update(artists, axes, model, t, q, r, missing, data):
    """Run the recursion and give the artists their data."""
    exact, k = _filter(model, q, r, missing, data), int(np.ceil(t))
    corrected = t == k
    y, expected = _expected(model, q, r, missing, data)
    reach = 40.0 if model == CORRIDOR else 5 * np.ceil(0.2 * (np.abs(exact.x).max() + 8.0))
    top = 1.1 * expected.max()
    if axes["density"].get_xlim() != (-reach, reach):
        axes["density"].set_xlim(-reach, reach)
        axes["strip"].set_ylim(-reach, reach)
    if (axes["expected"].get_xlim(), axes["expected"].get_ylim()) != ((y[0], y[-1]), (0, top)):
        axes["expected"].set(xlim=(y[0], y[-1]), ylim=(0, top))
    seen = corrected and np.isfinite(exact.y[k])
    _show_density(artists, exact, _system(model, q, r), k, corrected, seen)
    artists["expected"].set_data(y, expected[k])
    height = np.exp(exact.increments[k])
    artists["evidence"].set_data([exact.y[k]] * 2 if seen else [], [0, height] if seen else [])
    _show_strip(artists, model, exact, k, corrected)
    return _say(model, missing, exact, k, corrected)


def _show_density(artists, exact, system, k, corrected, seen):
    prior, posterior = (np.interp(SHOWN, GRID, p[k]) for p in (exact.prior, exact.posterior))
    last = np.interp(SHOWN, GRID, exact.posterior[k - 1]) if k > 0 and not corrected else 0 * SHOWN
    tallest = max(prior.max(), posterior.max() if corrected else last.max())
    artists["prior"].set_data(SHOWN, prior / tallest)
    artists["shade"].set_verts([np.c_[SHOWN, prior / tallest]])
    artists["last"].set_data(SHOWN, last / tallest)
    artists["last"].set_visible(k > 0 and not corrected)
    artists["posterior"].set_data(SHOWN, posterior / tallest if corrected else 0 * SHOWN)
    artists["posterior"].set_visible(corrected)
    log_g = system.log_likelihood(k, exact.y[k : k + 1], SHOWN[:, None]) if seen else 0 * SHOWN
    artists["likelihood"].set_data(SHOWN, 0.97 * np.exp(log_g - log_g.max()) * seen)
    artists["likelihood"].set_visible(seen)
    if exact.kalman:
        m, P = (exact.kalman[i + 2 * corrected][k] for i in (0, 1))
        at = m + np.sqrt(P) * np.linspace(-3, 3, 13)
        artists["kalman"].set_data(at, _gauss(at - m, P) / tallest)
    else:
        artists["kalman"].set_data([], [])
    mean, sd = _moments((exact.posterior if corrected else exact.prior)[k])
    artists["bar"].set_data([mean - 2 * sd, mean + 2 * sd], [-0.07, -0.07])
    artists["mean"].set_data([mean], [-0.07])
    artists["truth"].set_data([exact.x[k]], [-0.15])


def _show_strip(artists, model, exact, k, corrected):
    whole, nothing = exact.posterior[: k + corrected], np.full((3, 2), -0.7)
    artists["past"].set_verts([_ridge(i, p) for i, p in enumerate(whole)] or [nothing])
    artists["past"].set_visible(len(whole) > 0)
    artists["now"].set_verts([nothing if corrected else _ridge(k, exact.prior[k])])
    artists["now"].set_visible(not corrected)
    artists["path"].set_data(np.arange(k + 1), exact.x[: k + 1])
    artists["step"].set_xdata([k, k])
    lit = LAMPS if model == CORRIDOR else np.empty(0)
    artists["lamps"].set_data(np.tile([-0.7, T + 1.2, np.nan], lit.size), np.repeat(lit, 3))
    y = np.where(np.arange(T + 1) < k + corrected, exact.y, np.nan)
    states = {WALK: [y], CORRIDOR: [np.full(T + 1, np.nan)]}.get(model)
    if states is None:
        root = np.sqrt(20 * np.maximum(y, 0))
        states = [root, -root]
    artists["y"].set_data(np.tile(np.arange(T + 1), len(states)), np.concatenate(states))


def _ridge(k, p):
    """A density as a shape that stands on the line of time k."""
    p = np.interp(SHOWN, GRID, p / p.max())
    held = p > 1e-3
    x = SHOWN[held]
    return np.r_[np.c_[k + 0.85 * p[held], x], [[k, x[-1]], [k, x[0]]]]


def _moments(p):
    mean = p @ (DX * GRID)
    return float(mean), float(np.sqrt(p @ (DX * (GRID - mean) ** 2)))


def count_peaks(p):
    """Peaks above a twentieth of the tallest: ripples do not count."""
    hills = np.r_[0.0, np.where(p > 0.05 * p.max(), p, 0.0), 0.0]
    rises = np.diff(hills) > 0
    return int(np.sum(rises[:-1] & ~rises[1:] & (np.diff(hills)[1:] < 0)))


def _say(model, missing, exact, k, corrected):
    before, now = (
        (exact.prior[k], exact.posterior[k]) if corrected else (exact.posterior[max(k - 1, 0)], exact.prior[k])
    )
    before = exact.prior[0] if k == 0 else before
    (old_mean, old_sd), (mean, sd) = _moments(before), _moments(now)
    used = exact.increments[: k + corrected]
    lost = bool(corrected and np.isnan(exact.y[k]))
    m, P = (exact.kalman[i + 2 * corrected][k] for i in (0, 1)) if exact.kalman else (0.0, 0.0)
    numbers = {
        "mean of the density now": mean,
        "its standard deviation": sd,
        "its peaks": count_peaks(now),
        "mean half a step before": old_mean,
        "standard deviation half a step before": old_sd,
        "evidence of the measurement used here (1 if none)": float(np.exp(exact.increments[k])) if corrected else 1.0,
        "sum of the log-likelihood increments so far": float(used.sum()),
        "truth": float(exact.x[k]),
        "mean of the Kalman filter (0 if the model is not linear)": float(m),
        "standard deviation of the Kalman filter (the same)": float(np.sqrt(P)),
    }
    return Shown(_sentence(model, exact, k, corrected, lost, numbers), numbers)


def _sentence(model, exact, k, corrected, lost, numbers):
    mean, sd, peaks, _, old_sd, evidence, _, truth, m, s = numbers.values()
    if lost:
        what = "no measurement came, and the a posteriori density is the a priori one"
    elif corrected:
        word = "shrank" if sd <= old_sd else "grew"
        what = (f"corrected with y = {exact.y[k]:.1f}, which had the evidence {evidence:.3g}; the standard deviation "
                f"{word} from {old_sd:.2f} to {sd:.2f}")  # fmt: skip
    elif k == 0:
        what = f"nothing is measured yet, and the standard deviation is {sd:.2f}"
    else:
        what = (f"predicted, but not yet corrected; the motion took the standard deviation from {old_sd:.2f} "
                f"to {sd:.2f}")  # fmt: skip
    many = f"{peaks} peak{'s' if peaks != 1 else ''}"
    kalman = f" The Kalman filter says {m:.2f} ± {s:.2f}." if exact.kalman else ""
    return (f"{model.capitalize()}, time {k}: {what}. The density has {many}, mean {mean:.2f} and sd {sd:.2f}; "
            f"the truth is {truth:.2f}.{kalman}")  # fmt: skip


def _share_left(numbers):
    """What the last half step has left of the variance."""
    return (numbers["its standard deviation"] / numbers["standard deviation half a step before"]) ** 2


def _half_is_taken(params, numbers):
    """Whether a correction of the settled random walk leaves one half of the variance, to three digits."""
    if (params["model"], params["missing"]) != (WALK, "none") or params["t"] < 10 or params["t"] % 1:
        return False
    return abs(_share_left(numbers) - 0.5) < 5e-4


def _less_sure(params, numbers):
    """Whether a correction after time 0 makes the standard deviation half as large again."""
    return params["model"] == GROWTH and params["t"] > 0 and params["t"] % 1 == 0 and _share_left(numbers) >= 1.5**2


PUZZLES = (
    Puzzle(
        "Take the random walk with nothing missing, and find q and r with which every correction from time 10 on takes "
        "away one half of the variance, exact to three digits.",
        _half_is_taken,
        {"model": WALK, "t": 10.0, "q": 4.0, "r": 8.0},
    ),
    Puzzle(
        "Take the growth model, and find a correction after time 0 that makes the standard deviation at least half as "
        "large again.",
        _less_sure,
        {"t": 12.0, "q": 20.0, "data": 5},
    ),
)

_LINEAR = {"model": WALK}
EXPLORER = Explorer(
    title="Predict and correct, half a step at a time",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.2), [[*["density"] * 3, *["expected"] * 2], ["strip"] * 5]),
        "narrow": ((3.7, 7.2), [["density"], ["expected"], ["strip"]]),
    },
    build=build,
    update=update,
    also=(
        *(_LINEAR | {"t": t} for t in (-0.5, 0.0, 0.5, 1.0, 1.5, 2.0)),
        *(_LINEAR | {"missing": "times 5 to 9", "t": t} for t in (4.0, 5.0, 7.0, 9.0, 10.0, 11.0)),
        *({"model": CORRIDOR, "q": q, "t": t} for q in (1.0, 10.0) for t in (0.0, 4.0, 8.0, 15.0)),
    ),
    puzzles=PUZZLES,
)
