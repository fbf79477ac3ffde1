"""Explorer of chapter 11: Gaussians on particles against plain particles, beside all sequences of modes."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.explorers.controls import Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.density import particle_histogram
from pfedu.figures.style import COLORS

T, R, D = 10, 0.5, 8  # steps, variance of the measurement noise, the most dimensions
NODES = np.linspace(-6.0, 6.0, 241)
EDGES = np.linspace(-6.0, 6.0, 61)
FLOOR = 1e-5  # of the logarithmic axis

CONTROLS = (
    Slider("d", "dimensions of z, d", (1, 2, 3, 4, 6, 8), 4),
    Slider("N_rb", "particles, Rao-Blackwellised", geometric(10, 1000, 13), 100),
    Slider("N_bs", "particles, bootstrap", geometric(100, 10000, 13), 1000),
    Slider("stay", "probability that the mode stays", (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99), 0.9),
    Slider("q", "process noise variance q", geometric(0.05, 2.0, 9), 0.5),
    Slider("k", "time step k", range(1, T + 1), 5, plays=True),
    Seed("data", "new data", drawn=4),
    Seed("particles", "new particles", drawn=4),
)


@lru_cache(maxsize=8)
def _record(d, stay, q, data):
    """Model, truth and record; more dimensions are added to those that are there, and the modes stay."""
    x, y = pfedu.models.jump_markov(d=D, q=q, r=R, stay=stay).simulate(T, np.random.default_rng([data, 11]))
    model, y = pfedu.models.jump_markov(d=d, q=q, r=R, stay=stay), y[:, :d]
    return model, x[:, : 1 + d], y, _all_sequences(model, y)


def _all_sequences(model, y):
    """Exact: probability of each sequence of modes, its last mode, the mean of z along it, and the common variance.

    The sign that z had at time 0 does not matter, so one Gaussian stands for both modes there.
    """
    a, q, r, d = model.A[0, 0, 0], model.Q[0, 0, 0], model.R[0, 0, 0], model.n_z
    P = r / (1.0 + r)
    m, log_p, last, steps = (1.0 - P) * y[:1], np.zeros(1), np.zeros(1, dtype=int), []
    for k in range(1, len(y)):
        jump = np.full((1, 2), -np.log(2.0)) if k == 1 else np.log(model.Pi[last])
        P = a * a * P + q
        S, K = P + r, P / (P + r)
        m = (m[:, None, :] * np.array([[a], [-a]])).reshape(-1, d)
        e = y[k] - m
        log_p = (log_p[:, None] + jump).ravel() - 0.5 * np.sum(e * e, axis=-1) / S
        log_p = log_p - np.logaddexp.reduce(log_p)
        m, P, last = m + K * e, P * (1 - K), np.tile([0, 1], len(last))
        steps.append((np.exp(log_p), last, m, P))
    return steps


@lru_cache(maxsize=8)
def _filter(name, N, d, stay, q, data, particles):
    model, _, y, _ = _record(d, stay, q, data)
    run = {"rb": pfedu.rao_blackwellized_filter, "bs": pfedu.bootstrap_filter}[name]
    return run(model, y, N, rng=np.random.default_rng([particles, 12]), keep=True)


def build(axes):
    """Draw what stays; return the artists that move."""
    p, z, e = axes["mode"], axes["posterior"], axes["error"]
    exact = dict(color=COLORS["exact"], ls="--", lw=1.8)
    ours, blind = dict(color=COLORS["particles"], lw=1.3), dict(color=COLORS["second"], lw=1.0)
    artists = {
        "step": p.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4),
        "truth": p.plot([], [], "s", color=COLORS["truth"], ms=6, mfc="none", label="true mode")[0],
        "p_exact": p.plot([], [], label="exact", **exact)[0],
        "p_rb": p.plot([], [], "o", ms=4.5, label="Rao-Blackwellised", **ours)[0],
        "p_bs": p.plot([], [], "^", ms=4.5, label="bootstrap", **blind)[0],
        "bars": z.fill_between([0, 1], 0, 0, color=COLORS["second"], alpha=0.4, lw=0),
        "z_rb": z.plot([], [], "-", color=COLORS["particles"], lw=2.2)[0],
        "z_exact": z.plot([], [], **exact)[0],
        "z_true": z.axvline(0, color=COLORS["truth"], lw=1.2),
        "step_e": e.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4),
        "e_rb": e.plot([], [], "o-", ms=4.5, **ours)[0],
        "e_bs": e.plot([], [], "^-", ms=4.5, **blind)[0],
    }
    p.set(xlim=(0.4, T + 0.6), ylim=(-0.08, 1.08), yticks=[0, 0.5, 1], xlabel="time step k",
          ylabel="probability", title="Probability of mode 1 (z turns about)")  # fmt: skip
    wide = p.figure.get_figwidth() > 5
    p.legend(ncols=4 if wide else 2, loc="lower center", bbox_to_anchor=(0.5, 1.14), handlelength=1.8)
    z.set(xlim=(-6, 6), ylim=(0, 1.5), yticks=[0, 0.5, 1, 1.5], xlabel="first component of z",
          ylabel="density / exact peak", title="Posterior at step k")  # fmt: skip
    e.set(xlim=(0.4, T + 0.6), ylim=(FLOOR, 3), yscale="log", xlabel="time step k", ylabel="RMS over components",
          title="Mean of z: distance to exact")  # fmt: skip
    return artists


def update(artists, axes, d, N_rb, N_bs, stay, q, k, data, particles):
    """Run both filters and give the artists their data."""
    _, x, _, exact = _record(d, stay, q, data)
    setting = (d, stay, q, data, particles)
    rb, bs = _filter("rb", N_rb, *setting), _filter("bs", N_bs, *setting)
    times = np.arange(1, T + 1)
    mean = np.array([p @ m for p, _, m, _ in exact])
    mode = np.array([p @ last for p, last, _, _ in exact])
    artists["truth"].set_data(times, x[1:, 0])
    artists["p_exact"].set_data(times, mode)
    far = {}
    for name, track in (("rb", rb), ("bs", bs)):
        artists[f"p_{name}"].set_data(times, track.mean[1:, 0])
        far[name] = np.sqrt(np.mean((track.mean[1:, 1:] - mean) ** 2, axis=-1))
        artists[f"e_{name}"].set_data(times, np.maximum(far[name], FLOOR))
    for name in ("step", "step_e"):
        artists[name].set_xdata([k, k])
    _show_posterior(artists, exact[k - 1], rb, bs, x, k)
    return _say(far, mode, rb, bs, d, N_rb, N_bs, k)


def _show_posterior(artists, exact, rb, bs, x, k):
    p, _, m, P = exact
    density = _mixture(p, m[:, 0], P)
    peak = density.max()
    ours = _mixture(np.exp(rb.log_weights[k]), rb.particles[k, :, 1], P)
    bars = np.repeat(particle_histogram(bs.particles[k, :, 1], bs.log_weights[k], EDGES), 2) / peak
    artists["z_exact"].set_data(NODES, density / peak)
    artists["z_rb"].set_data(NODES, ours / peak)
    artists["bars"].set_verts([np.r_[np.c_[np.repeat(EDGES, 2)[1:-1], bars], [[EDGES[-1], 0], [EDGES[0], 0]]]])
    artists["z_true"].set_xdata([x[k, 1]] * 2)


def _mixture(w, m, P):
    """Density at the nodes of Gaussians with weights w, means m and one variance P."""
    heavy = w > 1e-6 * w.max()
    return np.exp(-0.5 * (NODES[:, None] - m[heavy]) ** 2 / P) @ w[heavy] / np.sqrt(2 * np.pi * P)


def _say(far, mode, rb, bs, d, N_rb, N_bs, k):
    rms = {name: float(np.sqrt(np.mean(value**2))) for name, value in far.items()}
    numbers = {
        "RMS distance to the exact mean, Rao-Blackwellised": rms["rb"],
        "RMS distance to the exact mean, bootstrap": rms["bs"],
        "probability of mode 1 at step k, exact": float(mode[k - 1]),
        "the same, Rao-Blackwellised": float(rb.mean[k, 0]),
        "the same, bootstrap": float(bs.mean[k, 0]),
        "N_eff at step k, Rao-Blackwellised": float(rb.n_eff[k]),
        "N_eff at step k, bootstrap": float(bs.n_eff[k]),
        "numbers drawn a step, Rao-Blackwellised": N_rb,
        "numbers drawn a step, bootstrap": N_bs * (1 + d),
    }
    winner, loser = ("Rao-Blackwellised filter", "bs") if rms["rb"] < rms["bs"] else ("bootstrap filter", "rb")
    times = rms[loser] / max(min(rms.values()), 1e-12)
    sentence = (
        f"d = {d}: the mean of z is off the exact one by {rms['rb']:.2g} with {N_rb} Rao-Blackwellised particles "
        f"and by {rms['bs']:.2g} with {N_bs} of the bootstrap filter (RMS over {T} steps); "
        f"on this record the {winner} is {times:.1f} times closer. "
        f"At step {k} mode 1 has a probability of {mode[k - 1]:.3f}; they say {rb.mean[k, 0]:.3f} and "
        f"{bs.mean[k, 0]:.3f}, with N_eff of {rb.n_eff[k]:.0f} and {bs.n_eff[k]:.0f}."
    )
    return Shown(sentence, numbers)


def _bootstrap_wins(params, numbers):
    """Whether plain particles come three times closer in the most dimensions that there are."""
    rb, bs = (numbers[f"RMS distance to the exact mean, {name}"] for name in ("Rao-Blackwellised", "bootstrap"))
    return params["d"] == D and rb > 3 * bs


def _ten_beat_a_thousand(params, numbers):
    """Whether ten particles with a Gaussian each come closer than a thousand plain ones, even for a single z."""
    rb, bs = (numbers[f"RMS distance to the exact mean, {name}"] for name in ("Rao-Blackwellised", "bootstrap"))
    fair = params["data"] == params["particles"] == 1 and params["N_rb"] == 10 and params["N_bs"] >= 1000
    return params["d"] == 1 and fair and rb < bs


PUZZLES = (
    Puzzle(
        "Give z its 8 dimensions, and let the bootstrap filter come at least three times closer to the exact mean than "
        "the Rao-Blackwellised filter all the same (RMS over the steps).",
        _bootstrap_wins,
        {"d": 8, "N_rb": 10, "N_bs": 10000},
    ),
    Puzzle(
        "With d = 1, let 10 Rao-Blackwellised particles come closer to the exact mean than 1000 or more of the "
        "bootstrap filter, on the data and the particles of the start.",
        _ten_beat_a_thousand,
        {"d": 1, "N_rb": 10, "stay": 0.99},
    ),
)


EXPLORER = Explorer(
    title="Rao-Blackwellised and plain particles beside all sequences of modes",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.0), [["mode", "mode"], ["posterior", "error"]]),
        "narrow": ((3.7, 6.2), [["mode"], ["posterior"], ["error"]]),
    },
    build=build,
    update=update,
    also=(
        *({"d": d, "N_bs": 10000} for d in CONTROLS[0].frames()),
        *({"d": 1, "N_rb": n} for n in (10, 1000)),
    ),
    puzzles=PUZZLES,
)
