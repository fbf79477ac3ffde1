"""Explorer of chapter 5: the online object driven step by step, an oscillator and a heading that crosses the seam."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.style import COLORS
from pfedu.models.van_der_pol import van_der_pol
from pfedu.resampling import systematic
from pfedu.weights import normalize, weighted_mean, wrap

T = 100
TIMES = np.arange(T + 1)
DOTS = 40  # dots a time step that stand for the particles
CLOUD = 300  # and at step k
Q = {"oscillator": 0.025**2, "heading": 0.03**2}
R = {"oscillator": 0.04**2, "heading": 0.6**2}
TURN = 2 * np.pi / 50  # of the heading, in radians a step
START = np.pi - 10 * TURN  # so that it comes to the seam about step 10, and again about step 60
NODES = np.linspace(-np.pi, np.pi, 720, endpoint=False)
FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)

CONTROLS = (
    Choice("system", "system", ("oscillator", "heading"), "oscillator"),
    Slider("k", "time step k", range(T + 1), 60, drawn=21, plays=True),
    Slider("N", "particles N", geometric(10, 5000, 28), 1000, drawn=9),
    Slider("r", "variance r in the likelihood, times that of the measurements", FACTORS[2:], 1.0),
    Slider("q", "variance q of the process noise, times the usual one", FACTORS[:-2], 1.0),
    Choice("estimate", "estimate", ("mean", "maxweight"), "mean"),
    Slider("every", "a measurement every so many steps", (1, 2, 3, 5, 10, 20), 1),
    Seed("data", "new data", drawn=5),
    Seed("particles", "new particles", drawn=5),
)


def rate(x):
    """Time derivative of the oscillator, (..., 2)."""
    return np.stack([x[..., 1], (1 - x[..., 0] ** 2) * x[..., 1] - x[..., 0]], axis=-1)


@lru_cache(maxsize=1)
def oscillation(substeps=20):
    """The oscillator's path without any noise, (T+1, 2), by Runge-Kutta steps of 0.05/20."""
    x, h = np.array([2.0, 0.0]), 0.05 / substeps
    path = [x]
    for _ in range(T):
        for _ in range(substeps):
            a = rate(x)
            b = rate(x + h / 2 * a)
            c = rate(x + h / 2 * b)
            x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))
        path.append(x)
    return np.array(path)


@lru_cache(maxsize=16)
def _record(system, data, every):
    """Truth (T+1, n_x) and measurements (T+1,), NaN where there are none."""
    rng_move, rng_measure = np.random.default_rng(data).spawn(2)
    if system == "oscillator":
        x = oscillation()
    else:
        noise = np.sqrt(Q[system]) * rng_move.standard_normal(T)
        x = wrap(START + np.cumsum(np.r_[0.0, TURN + noise]))[:, None]
    y = x[:, 0] + np.sqrt(R[system]) * rng_measure.standard_normal(T + 1)
    y = y if system == "oscillator" else wrap(y)
    return x, np.where(TIMES % every == 0, y, np.nan)


@lru_cache(maxsize=8)
def _exact(system, data, every, q, r):
    """Mean (T+1, n_x) and standard deviation of the first state (T+1,) of the answer to compare with."""
    _, y = _record(system, data, every)
    q, r = q * Q[system], r * R[system]
    if system == "oscillator":
        track = pfedu.extended_kalman_filter(van_der_pol(q=q, r=r), y[:, None])
        return track.mean, track.sd[:, 0]
    turns = 2 * np.pi * np.arange(-3, 4)[:, None]
    step = np.fft.rfft(np.exp(-((NODES + np.pi - TURN + turns) ** 2) / (2 * q)).sum(axis=0))
    p, means, sds = np.full(NODES.size, 1 / NODES.size), [], []
    for k in TIMES:
        if k > 0:
            p = np.maximum(np.fft.irfft(step * np.fft.rfft(p), NODES.size), 0.0)
        if np.isfinite(y[k]):
            p = p * np.exp(-(wrap(y[k] - NODES) ** 2) / (2 * r))
        p = p / p.sum()
        means.append(np.arctan2(p @ np.sin(NODES), p @ np.cos(NODES)))
        sds.append(np.sqrt(p @ wrap(NODES - means[-1]) ** 2))
    return np.array(means)[:, None], np.array(sds)


def new_filter(system, N, q, r, particles):
    """The online object of either system, initialized."""
    q, r = q * Q[system], r * R[system]
    rng = np.random.default_rng([particles, 5])
    if system == "oscillator":
        model = van_der_pol(q=q, r=r)
        pf = pfedu.ParticleFilter(
            lambda x, rng: model.propagate(0, x, rng), lambda x, y: model.log_likelihood(0, y, x), rng=rng, log=True
        )
        pf.initialize(N, model.m0, model.P0)
        return pf
    pf = pfedu.ParticleFilter(
        lambda x, rng: x + TURN + np.sqrt(q) * rng.standard_normal(x.shape),
        lambda x, y: -(wrap(y - x) ** 2) / (2 * r),
        rng=rng, log=True,
    )  # fmt: skip
    pf.initialize(N, bounds=[(-np.pi, np.pi)], circular=[True])
    return pf


@lru_cache(maxsize=4)
def _drive(system, data, every, N, q, r, particles):
    """Drive the object over the whole record; what it said at each step, as arrays over time."""
    _, y = _record(system, data, every)
    pf = new_filter(system, N, q, r, particles)
    said = []
    for k in TIMES:
        if k > 0:
            pf.predict()
        before, log_w = pf.particles, np.log(pf.weights[:, 0])
        if np.isfinite(y[k]):
            log_w = log_w + np.ravel(pf.likelihood(before, y[k]))
            pf.correct(y[k])
        said.append((before, log_w, pf.state[0], np.sqrt(pf.covariance[0, 0]), pf.n_eff, pf.resampled))
    x, log_w, mean, sd, n_eff, resampled = (np.array(column) for column in zip(*said, strict=True))
    log_w = normalize(log_w)[0]
    heaviest = x[TIMES, log_w.argmax(axis=-1)]
    picks = systematic(np.exp(log_w), np.random.default_rng(0), size=CLOUD)  # dots as dense as the weights
    after = np.take_along_axis(x, picks[..., None], axis=1)
    before = x[:, :: max(1, N // CLOUD)][:, :CLOUD]
    return mean, sd, heaviest, weighted_mean(x, log_w), before, after, n_eff, resampled


def build(axes):
    """Draw what stays; return the artists that move."""
    t, c, e = axes["track"], axes["cloud"], axes["error"]
    truth, exact = dict(color=COLORS["truth"], lw=1.2), dict(color=COLORS["exact"], ls="--", lw=1.5)
    mine, naive = dict(color=COLORS["particles"], lw=1.5), dict(color=COLORS["third"], ls="-.", lw=1.5)
    head = dict(markevery=[-1], zorder=3)
    artists = {
        "step": t.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4),
        "seam": t.plot([], [], ":", color=COLORS["second"], lw=1.4)[0],
        "dots": t.plot([], [], ".", color=COLORS["light"], ms=3, alpha=0.5, mew=0, label="particles")[0],
        "y": t.plot([], [], "x", color=COLORS["measurement"], ms=4, label="measurement")[0],
        "truth": t.plot([], [], label="truth", **truth)[0],
        "exact": t.plot([], [], label="exact or EKF", **exact)[0],
        "mean": t.plot([], [], label="estimate", **mine)[0],
        "naive": t.plot([], [], label="as numbers", **naive)[0],
        "orbit": c.plot([], [], color=COLORS["measurement"], lw=0.8)[0],
        "before": c.plot([], [], "x", color=COLORS["accent"], ms=3, alpha=0.5, mew=0.8, label="predicted")[0],
        "after": c.plot([], [], ".", color=COLORS["particles"], ms=4, alpha=0.5, mew=0, label="corrected")[0],
        "truth_k": c.plot([], [], marker="*", ms=9, **truth, **head)[0],
        "exact_k": c.plot([], [], marker="D", mfc="none", ms=6, **exact, **head)[0],
        "mean_k": c.plot([], [], marker="o", mec="white", ms=6, **mine, **head)[0],
        "naive_k": c.plot([], [], marker="^", ms=6, **naive, **head)[0],
        "band": e.fill_between([0, 1], 0, 1, color=COLORS["light"], alpha=0.35, lw=0),
        "step_e": e.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4),
        "error_exact": e.plot([], [], **exact)[0],
        "error": e.plot([], [], **mine)[0],
    }
    t.set(xlim=(-1, T + 1), title="State over time, known up to step k")
    wide = t.figure.get_figwidth() > 5
    t.legend(ncols=6 if wide else 2, loc="lower center", bbox_to_anchor=(0.5, 1.12), markerscale=1.6,
             handlelength=1.8, columnspacing=1.0)  # fmt: skip
    c.set_title("Particles at step k")
    c.legend(loc="upper right", ncols=2, markerscale=2.5, handletextpad=0.1, columnspacing=0.6, borderaxespad=0.1)
    e.axhline(0, color=COLORS["truth"], lw=0.8)
    e.set(xlim=(-1, T + 1), xlabel="time step k", title="Error of the estimate, and ±2 sd")
    return artists


def update(artists, axes, system, k, N, r, q, estimate, every, data, particles):
    """Drive the filter and give the artists their data."""
    x, y = _record(system, data, every)
    exact, exact_sd = _exact(system, data, every, q, r)
    mean, sd, heaviest, naive, before, after, n_eff, resampled = _drive(system, data, every, N, q, r, particles)
    shown = mean if estimate == "mean" else heaviest
    _show_track(artists, axes["track"], system, k, x, y, exact, shown, naive, after)
    _show_cloud(artists, axes["cloud"], system, k, x, exact, shown, naive, before, after)
    error, error_exact = _difference(system, shown, x)[:, 0], _difference(system, exact, x)[:, 0]
    _show_error(artists, axes["error"], system, k, error, error_exact, sd, estimate)
    return _say(system, k, N, y, x, shown, exact, naive, sd, error, error_exact, exact_sd, n_eff, resampled, estimate)


def _difference(system, a, b):
    return wrap(a - b) if system == "heading" else a - b


def _show_track(artists, ax, system, k, x, y, exact, shown, naive, after):
    heading = system == "heading"
    limits, label = ((-4.0, 4.0), "heading (rad)") if heading else ((-3.0, 3.0), "state $x_1$")
    if ax.get_ylim() != limits:
        ax.set(ylim=limits, ylabel=label)
    artists["seam"].set_data([0, T, np.nan, 0, T], [np.pi, np.pi, np.nan, -np.pi, -np.pi] if heading else [np.nan] * 5)
    cloud = after[: k + 1, :: CLOUD // DOTS, 0][:, :DOTS]
    artists["dots"].set_data(np.repeat(TIMES[: k + 1], cloud.shape[1]), cloud.ravel())
    artists["y"].set_data(TIMES[: k + 1], y[: k + 1])
    for name, values in {"truth": x, "exact": exact, "mean": shown}.items():
        artists[name].set_data(*_broken(values[: k + 1, 0]))
    artists["naive"].set_data(TIMES[: k + 1], naive[: k + 1, 0] if heading else np.full(k + 1, np.nan))
    artists["step"].set_xdata([k, k])


def _broken(angle):
    """Times and values of a line that is not drawn across the seam."""
    jumps = np.flatnonzero(np.abs(np.diff(angle)) > np.pi) + 1
    return np.insert(TIMES[: len(angle)].astype(float), jumps, np.nan), np.insert(angle, jumps, np.nan)


def _show_cloud(artists, ax, system, k, x, exact, shown, naive, before, after):
    heading = system == "heading"
    limits = (-1.8, 1.8, -1.25, 1.7) if heading else (-0.3, 0.3, -1.0, 1.2)
    if (*ax.get_xlim(), *ax.get_ylim()) != limits:
        names = ("cosine", "sine") if heading else ("$x_1$ minus truth", "$x_2$ minus truth")
        ax.set(xlim=limits[:2], ylim=limits[2:], xlabel=names[0], ylabel=names[1])
    points = {"truth_k": x, "exact_k": exact, "mean_k": shown, "naive_k": naive}
    if heading:
        ring = np.linspace(-np.pi, np.pi, 181)
        artists["orbit"].set_data(np.cos(ring), np.sin(ring))
        for name, cloud, radius in (("before", before[k], 0.72), ("after", after[k], 0.92)):
            rho = radius + 0.06 * np.cos(2.4 * np.arange(len(cloud)))  # set apart, so that dots do not cover each other
            artists[name].set_data(rho * np.cos(cloud[:, 0]), rho * np.sin(cloud[:, 0]))
        for name, angle in points.items():
            artists[name].set_data([0, 1.1 * np.cos(angle[k, 0])], [0, 1.1 * np.sin(angle[k, 0])])
        return
    artists["orbit"].set_data(*(x - x[k]).T)
    artists["before"].set_data(*(before[k] - x[k]).T)
    artists["after"].set_data(*(after[k] - x[k]).T)
    for name, state in points.items():
        artists[name].set_data(*(state[[k]] - x[k]).T if name != "naive_k" else ([], []))


def _show_error(artists, ax, system, k, error, error_exact, sd, estimate):
    reach = max(2 * sd[3:].max(), np.abs(error[3:]).max(), np.abs(error_exact[3:]).max())
    steps = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
    limit = next((s for s in steps if s >= reach), steps[-1])
    label = "heading (rad)" if system == "heading" else "state $x_1$"
    if (ax.get_ylim(), ax.get_ylabel()) != ((-limit, limit), label):
        ax.set(ylim=(-limit, limit), yticks=[-limit, 0, limit], ylabel=label)
    times = TIMES[: k + 1]
    artists["error"].set_data(times, error[: k + 1])
    artists["error_exact"].set_data(times, error_exact[: k + 1])
    band = 2 * sd[: k + 1]
    artists["band"].set_verts([np.c_[np.r_[times, times[::-1]], np.r_[-band, band[::-1]]]])
    artists["band"].set_visible(estimate == "mean")  # the heaviest particle claims nothing
    artists["step_e"].set_xdata([k, k])


def _say(system, k, N, y, x, shown, exact, naive, sd, error, error_exact, exact_sd, n_eff, resampled, estimate):
    corrections, picked = int(np.isfinite(y[: k + 1]).sum()), int(resampled[: k + 1].sum())
    numbers = {
        "estimate of the first state": float(shown[k, 0]),
        "truth": float(x[k, 0]),
        "standard deviation, particles": float(sd[k]),
        "standard deviation, to compare with": float(exact_sd[k]),
        "RMS error of the estimate so far": _rms(error[: k + 1]),
        "RMS error of the mean to compare with, so far": _rms(error_exact[: k + 1]),
        "RMS standard deviation as claimed so far": _rms(sd[: k + 1]),
        "corrections so far": corrections,
        "times resampled so far": picked,
        "N_eff at step k": float(n_eff[k]),
    }
    doubt = f" ± {sd[k]:.3f}" if estimate == "mean" else " (the heaviest particle)"
    if system == "oscillator":
        numbers |= {"estimate of the second state": float(shown[k, 1]), "truth of the second state": float(x[k, 1])}
        where = (f"Oscillator at step {k}: the filter puts x1 at {shown[k, 0]:.3f}{doubt}, "
                 f"where it is {x[k, 0]:.3f}")  # fmt: skip
        rival = "the extended Kalman filter, which is nearly exact here,"
    else:
        numbers["averaged as numbers"] = float(naive[k, 0])
        where = (f"Heading at step {k}: the filter says {shown[k, 0]:.2f} rad{doubt.replace('rad', '')}, "
                 f"truth {x[k, 0]:.2f}; averaged as mere numbers the particles say {naive[k, 0]:.2f}")  # fmt: skip
        rival = "the exact mean direction"
    sentence = (
        f"{where}. {corrections} corrections so far, {picked} of them resampled; N_eff is {n_eff[k]:.0f} of {N}. "
        f"So far the estimate missed by {_rms(error[: k + 1]):.3f} (RMS), {rival} by {_rms(error_exact[: k + 1]):.3f}."
    )
    return Shown(sentence.replace(" -", " −"), numbers)


def _rms(values):
    return float(np.sqrt(np.mean(values**2)))


def _too_sure(params, numbers):
    """Whether a filter with the right variances claims less than half of its error over the whole record."""
    right = params["r"] == 1 and params["q"] == 1 and params["estimate"] == "mean" and params["k"] == T
    claim, error = numbers["RMS standard deviation as claimed so far"], numbers["RMS error of the estimate so far"]
    return right and claim < error / 2


def _wrong_far_from_seam(params, numbers):
    """Whether numbers fail and directions do not where the heading is far from the seam."""
    if params["system"] != "heading":
        return False
    names, k = ("system", "data", "every", "N", "q", "r", "particles"), params["k"]
    mean, _, _, naive, *_ = _drive(*(params[name] for name in names))
    truth = _record("heading", params["data"], params["every"])[0][k, 0]
    off, naive_off = np.abs(wrap(np.array([mean[k, 0], naive[k, 0]]) - truth))
    return np.abs(truth) < np.pi - 1 and naive_off > 1 and off < 0.2


PUZZLES = (
    Puzzle(
        "Leave both variances right (factor 1) and the estimate at mean, and make the filter far too sure: at step "
        "100 the standard deviation that it claimed (RMS so far) is less than half of its error (RMS so far).",
        _too_sure,
        {"k": 100, "N": 10, "particles": 2},
    ),
    Puzzle(
        "Take the heading, and find a step at which the truth is more than 1 rad away from the seam, and the "
        "particles averaged as numbers are off by more than 1 rad all the same, while their mean direction is off by "
        "less than 0.2 rad.",
        _wrong_far_from_seam,
        {"system": "heading", "r": 100.0, "k": 20},
    ),
)


_HEADING_STEPS = (5, 8, 9, 10, 11, 12, 15, 55, 57, 58, 59, 61, 62, 63, 65)

EXPLORER = Explorer(
    title="Driving a particle filter, step by step",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.0), [["track", "track"], ["error", "cloud"]]),
        "narrow": ((3.7, 6.4), [["track"], ["error"], ["cloud"]]),
    },
    build=build,
    update=update,
    also=(
        *({"system": "heading", "k": k} for k in _HEADING_STEPS),
        {"k": 100, "r": 10.0},
        {"k": 100, "q": 0.1},
        {"k": 0, "estimate": "maxweight"},
        *({"every": 20, "k": k} for k in (30, 39, 40)),
    ),
    puzzles=PUZZLES,
)
