"""Explorer of chapter 8: the proposal that a small Kalman filter makes for each particle, and what it is worth."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.style import COLORS
from pfedu.kalman import linearised
from pfedu.resampling import always
from pfedu.unscented import Unscented, sampled

T = 50
SQUARE, CUBE = "growth model, x²/20", "linear motion, x³/20"
FILTERS = ("bootstrap", "EKF", "UKF")
ERRORS = (1e-3, 1e2)  # ends of the axis of errors
Z = np.linspace(-4.0, 4.0, 121)

CONTROLS = (
    Choice("model", "model and measurement", (SQUARE, CUBE), SQUARE),
    Slider("N", "particles N", geometric(10, 2000, 24), 200, drawn=6),
    Slider("r", "measurement noise variance r", geometric(0.01, 10.0, 13), 1.0, drawn=7),
    Slider("defensive", "defensive share", (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0), 0.0, drawn=8),
    Slider("k", "time step k", range(1, T + 1), 22, plays=True),
    Seed("data", "new data", drawn=4),
    Seed("particles", "new particles", drawn=4),
    Seed("which", "another particle of step k−1", drawn=5),
)


def _system(model, r):
    if model == SQUARE:
        return pfedu.models.growth(r=r)
    return pfedu.models.AdditiveGaussian(
        0.9, lambda k, x: x**3 / 20, Q=1.0, R=r, m0=0.0, P0=1.0,
        jacobian_h=lambda k, x: 3 * x[..., None] ** 2 / 20,
    )  # fmt: skip


@lru_cache(maxsize=16)
def _record(model, r, data):
    """Model, record without its first row, the exact posterior means and standard deviations."""
    system = _system(model, r)
    _, y = system.simulate(T, np.random.default_rng(data))
    y[0] = np.nan  # the lecture's convention: the first measurement is not used
    return system, y, *_exact(system, y[:, 0], *_nodes(model, r))


@lru_cache(maxsize=32)
def _nodes(model, r):
    """Nodes at whole numbers of a function u, and the weights of their integral.

    The slope of u asks for two nodes in the standard deviation that the measurement leaves; where the growth model's
    motion is steep, for nodes whose images are less than q^(1/2) apart; and for some where nothing else does.
    """
    root = np.sqrt(r)
    if model == SQUARE:
        x = np.linspace(-70.0, 70.0, 20_001)

        def slope(x):
            return np.sqrt(1 + x * x) / (5 * root) + (0.5 + 25 / (1 + x * x)) / 2.0 + 1.0

        u = (x * np.sqrt(1 + x * x) + np.arcsinh(x)) / (10 * root) + (0.5 * x + 25 * np.arctan(x)) / 2.0 + x
    else:
        x = np.linspace(-16.0, 16.0, 20_001)

        def slope(x):
            return 0.3 * x * x / root + 3.0

        u = 0.1 * x**3 / root + 3.0 * x
    nodes = np.interp(np.arange(np.ceil(u[0]), u[-1]), u, x)
    return nodes, 1 / slope(nodes)


def _exact(system, y, x, dx):
    """Means and standard deviations as ``pfedu.grid_filter`` has them, at each step only on nodes that y allows."""
    q, r, h = system.Q[0, 0], system.R[0, 0], system.h(0, x[:, None])[:, 0]
    mass = np.exp(system.log_initial(x[:, None])) * dx
    held = mass > 1e-14 * mass.max()
    old, mass = x[held], mass[held]
    mass = mass / mass.sum()
    moments = [(mass @ old, np.sqrt(mass @ (old - mass @ old) ** 2))]
    for k in range(1, y.size):
        near = np.abs(y[k] - h) < 7.5 * np.sqrt(r)
        new = x[near]
        move = np.exp(-0.5 * (new[:, None] - system.f(k, old[:, None])[:, 0]) ** 2 / q)
        mass = (move @ mass) * dx[near] * np.exp(-0.5 * (y[k] - h[near]) ** 2 / r)
        mass = mass / mass.sum()
        old, mass = new[mass > 1e-14], mass[mass > 1e-14]
        moments.append((mass @ old, np.sqrt(mass @ (old - mass @ old) ** 2)))
    return np.array(moments).T


@lru_cache(maxsize=8)
def _filter(name, model, r, data, N, defensive, particles):
    system, y, _, _ = _record(model, r, data)
    how = dict(rng=np.random.default_rng([particles, 8]), policy=always, keep=True)
    if name == "bootstrap":
        return pfedu.bootstrap_filter(system, y, N, **how)
    return pfedu.local_linear_filter(system, y, N, proposal=name.lower(), defensive=defensive, **how)


def build(axes):
    """Draw what stays; return the artists that move."""
    look = {
        "bootstrap": dict(color=COLORS["second"], ls="-.", lw=1.4),
        "EKF": dict(color=COLORS["third"], ls=(0, (5, 1.5)), lw=1.6),
        "UKF": dict(color=COLORS["particles"], ls="-", lw=1.6),
    }
    o, e, d = (axes[name] for name in ("one", "n_eff", "error"))
    artists = {
        "optimal": o.fill_between([0, 1], 0, 0, color=COLORS["exact"], alpha=0.25, lw=0, label="optimal, exact"),
        "likelihood": o.plot([], [], color=COLORS["measurement"], ls=":", lw=2.0, label="likelihood of $y_k$")[0],
        "transition": o.plot([], [], label="transition", **look["bootstrap"])[0],
        "EKF": o.plot([], [], label="EKF", **look["EKF"])[0],
        "UKF": o.plot([], [], label="UKF", **look["UKF"])[0],
    }
    for name, marker in zip(FILTERS, "s^o", strict=True):
        artists[f"n_eff {name}"] = e.plot([], [], label=name, marker=marker, ms=2.5, **look[name])[0]
        artists[f"error {name}"] = d.plot([], [], label=name, marker=marker, ms=2.5, **look[name])[0]
        artists[f"rms {name}"] = d.axhline(1.0, color=look[name]["color"], ls=look[name]["ls"], lw=0.9)
    for ax in (e, d):
        artists[f"step {ax.get_label()}"] = ax.axvline(0, color=COLORS["accent"], lw=5, alpha=0.4)
        ax.set(xlim=(-0.7, T + 0.7), xlabel="time step k")
    wide = o.figure.get_figwidth() > 5
    o.set(ylim=(0, 1.3 if wide else 1.75), yticks=[0, 0.5, 1], ylabel="each over its peak")
    o.set(xlabel="state minus $f(x_{k-1}^{(i)})$", title="One particle's step to time k")
    e.set(ylim=(0, 1.3), yticks=[0, 0.5, 1], ylabel="$N_{eff}$ / N", title="Effective share of particles")
    d.set(ylim=ERRORS, yscale="log", ylabel="|error|", title="Distance to the exact mean (flat: RMS)")
    for ax, columns in ((o, 5 if wide else 2), (e, 3), (d, 3)):
        ax.legend(loc="upper left", ncols=columns, handlelength=2.2, columnspacing=0.9, borderaxespad=0.1)
    return artists


def update(artists, axes, model, N, r, defensive, k, data, particles, which):
    """Run the three filters and give the artists their data."""
    system, y, mean, sd = _record(model, r, data)
    tracks = {name: _filter(name, model, r, data, N, defensive * (name != "bootstrap"), particles) for name in FILTERS}
    one = _particle(system, tracks["bootstrap"], y[k], k, which)
    _show_particle(artists, axes["one"], model, system, y[k], k, one)
    errors = {name: np.abs(track.mean[:, 0] - mean) for name, track in tracks.items()}
    for name, track in tracks.items():
        artists[f"n_eff {name}"].set_data(np.arange(T + 1), track.n_eff / N)
        artists[f"error {name}"].set_data(np.arange(1, T + 1), np.clip(errors[name][1:], *ERRORS))
        artists[f"rms {name}"].set_ydata([np.clip(_rms(errors[name]), *ERRORS)] * 2)
    for name in ("n_eff", "error"):
        artists[f"step {name}"].set_xdata([k, k])
    return _say(model, N, r, defensive, k, y, mean, sd, tracks, errors, one)


def _particle(system, track, y, k, which):
    """A particle of step k-1, as likely as its weight, and the two Gaussians that are made for its step."""
    cumulative = np.cumsum(np.exp(track.log_weights[k - 1]))
    i = min(np.searchsorted(cumulative, (which * 0.6180339887) % 1.0 * cumulative[-1]), cumulative.size - 1)
    x = track.particles[k - 1, i]
    f = system.f(k, x)
    one = {"x": x[0], "f": f[0]}
    for name, (_, correct) in (("EKF", linearised(system)), ("UKF", sampled(system, Unscented()))):
        m, P, _ = correct(k, f, system.Q, y)
        one[name] = m[0], np.sqrt(P[0, 0])
    return one


def _show_particle(artists, ax, model, system, y, k, one):
    root = np.sqrt(system.Q[0, 0])
    ends = (abs(one[name][0] - one["f"]) + 3 * one[name][1] for name in ("EKF", "UKF"))
    reach = root * 2.0 ** np.ceil(np.log2(max(4 * root, *ends) / root))  # seldom changes
    if ax.get_xlim() != (-reach, reach):
        ax.set_xlim(-reach, reach)
    fine = _nodes(model, system.R[0, 0])[0]
    x = np.sort(np.r_[one["f"] + np.linspace(-reach, reach, 301), fine[np.abs(fine - one["f"]) < reach]])
    log_g = system.log_likelihood(k, y, x[:, None])
    log_p = log_g - 0.5 * ((x - one["f"]) / root) ** 2
    artists["likelihood"].set_data(x - one["f"], np.exp(log_g - log_g.max()))
    optimal = np.exp(log_p - log_p.max())
    artists["optimal"].set_verts([np.r_[np.c_[x - one["f"], optimal], [[reach, 0], [-reach, 0]]]])
    for name, (center, width) in {"transition": (one["f"], root), "EKF": one["EKF"], "UKF": one["UKF"]}.items():
        artists[name].set_data(center - one["f"] + width * Z, np.exp(-0.5 * Z * Z))


def _say(model, N, r, defensive, k, y, mean, sd, tracks, errors, one):
    rms = {name: _rms(error) for name, error in errors.items()}
    n_eff = {name: float(track.n_eff[1:].mean()) for name, track in tracks.items()}
    numbers = {f"RMS distance to the exact mean, {name}": value for name, value in rms.items()}
    numbers |= {f"mean N_eff, {name}": value for name, value in n_eff.items()}
    numbers |= {f"N_eff at step k, {name}": float(track.n_eff[k]) for name, track in tracks.items()}
    numbers |= {f"log-likelihood, {name}": float(track.log_likelihood) for name, track in tracks.items()}
    numbers |= {
        "exact mean at step k": float(mean[k]),
        "exact standard deviation at step k": float(sd[k]),
        "measurement at step k": float(y[k, 0]),
        "the particle at step k−1": float(one["x"]),
        "f of the particle": float(one["f"]),
    }
    for name in ("EKF", "UKF"):
        numbers |= {f"mean of its {name} proposal": float(one[name][0]), f"sd of the same, {name}": float(one[name][1])}
    sentence = (
        f"{model[0].upper() + model[1:]}, r = {r:g}, N = {N}, defensive share {defensive:g}: RMS distance to the "
        f"exact mean {rms['bootstrap']:.3f} for the bootstrap filter, {rms['EKF']:.3f} with EKF and "
        f"{rms['UKF']:.3f} with UKF proposals; N_eff averages {n_eff['bootstrap']:.0f}, {n_eff['EKF']:.0f} and "
        f"{n_eff['UKF']:.0f}. At step {k} the particle shown would move to {one['f']:.2f}; the measurement says "
        f"{y[k, 0]:.2f}, and the proposals are {one['EKF'][0]:.2f} ± {one['EKF'][1]:.2f} (EKF) and "
        f"{one['UKF'][0]:.2f} ± {one['UKF'][1]:.2f} (UKF)."
    )
    return Shown(sentence, numbers)


def _rms(error):
    """Over steps 1 to T: no measurement is used at step 0."""
    return float(np.sqrt(np.mean(error[1:] ** 2)))


def _even_and_wrong(params, numbers):
    """Whether EKF proposals have the more even weights and by far the larger error."""
    more = numbers["mean N_eff, EKF"] > 1.5 * numbers["mean N_eff, bootstrap"]
    far = numbers["RMS distance to the exact mean, EKF"] > 5 * numbers["RMS distance to the exact mean, bootstrap"]
    return more and far


def _blind_tangent(params, numbers):
    """Whether the best sensor leaves the EKF proposal of the particle shown as wide as the transition."""
    width = np.sqrt(_system(params["model"], params["r"]).Q[0, 0])
    return params["r"] == min(CONTROLS[2].values) and numbers["sd of the same, EKF"] > 0.98 * width


PUZZLES = (
    Puzzle(
        "Find a position where EKF proposals have more than 1.5 times the mean N_eff of the bootstrap filter, and "
        "more than 5 times its RMS distance to the exact mean.",
        _even_and_wrong,
        {"r": 0.32},
    ),
    Puzzle(
        "Take the best sensor, r = 0.01, and find a particle to whose EKF it says next to nothing: the EKF proposal is "
        "at most 2 % narrower than the transition.",
        _blind_tangent,
        {"model": CUBE, "r": 0.01, "k": 34},
    ),
)


_SHARP = {"model": CUBE, "r": 0.01}
EXPLORER = Explorer(
    title="A small Kalman filter in every particle",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.0), [["one", "one"], ["n_eff", "error"]]),
        "narrow": ((3.7, 6.6), [["one"], ["n_eff"], ["error"]]),
    },
    build=build,
    update=update,
    also=(
        *({"model": CUBE, "r": r} for r in (0.01, 0.1, 10.0)),
        *(_SHARP | {"defensive": share} for share in CONTROLS[3].frames()),
        *(_SHARP | {"which": seed} for seed in CONTROLS[7].frames()),
        *(_SHARP | {"data": seed} for seed in CONTROLS[5].frames()),
    ),
    puzzles=PUZZLES,
)
