"""Explorer of chapter 12: what each filter costs and how far it is from the exact answer, on four systems."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.explorers.controls import Choice, Seed, Slider
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.style import COLORS
from pfedu.models import AdditiveGaussian, growth, random_walk

T, RUNS = 30, 8  # the longest record, and how many of them each point stands for
FACTORS = (0.25, 0.5, 1, 2, 4)  # on the variances
CURVE = (10, 56, 320)  # sizes along the line of the bootstrap filter, besides N
FLOOR, CEILING = 1e-3, 30.0  # ends of the axis of distances
GOOD = 0.1  # a distance that adds half a per cent to the error
# evaluations of f, h or a derivative, a step: of a Kalman filter, or of each particle
COSTS = {"EKF": 4, "UKF": 6, "bootstrap": 2, "auxiliary": 4, "local linear": 6}
PARTICLES = ("bootstrap", "auxiliary", "local linear")
LOOKS = {"EKF": ("s", "exact"), "UKF": ("D", "accent"), "bootstrap": ("o", "particles"), "auxiliary": ("^", "third"),
         "local linear": ("v", "second")}  # fmt: skip
REACH = {"random walk": 15.0, "outliers": 6.0, "bearing": 14.0, "growth model": 40.0}  # of the axis of states
SYSTEMS = tuple(REACH)

CONTROLS = (
    Choice("system", "system", SYSTEMS, "growth model"),
    Slider("q", "process noise variance, times", FACTORS, 1),
    Slider("r", "measurement noise variance, times", FACTORS, 1),
    Slider("N", "particles N", (10, 20, 30, 50, 70, 100, 150, 200, 300, 400, 500), 100, drawn=7),
    Slider("steps", "steps of the record", (5, 10, 20, 30), 30),
    Choice("shown", "filter shown in the record", tuple(COSTS), "UKF"),
    Seed("data", "new data", drawn=4),
    Seed("particles", "new particles", drawn=4),
)


def _system(name, q, r):
    """Model with process and measurement noise of q and r times the usual variance."""
    if name == "random walk":
        return random_walk(q=q, r=r)
    if name == "growth model":
        return growth(q=10.0 * q, r=1.0 * r)
    if name == "bearing":
        return AdditiveGaussian(
            lambda k, x: 0.95 * x, lambda k, x: np.arctan(x / 10.0), Q=q, R=0.01 * r, m0=0.0, P0=10.0,
            jacobian_f=lambda k, x: np.full((*x.shape, 1), 0.95),
            jacobian_h=lambda k, x: (10.0 / (100.0 + x * x))[..., None],
        )  # fmt: skip
    model, scale = random_walk(q=0.1 * q, r=3.0 * r, p0=1.0), r
    # Student t with three degrees of freedom: its variance is three times the square of its scale
    model.measure = lambda k, x, rng: x + np.sqrt(scale) * rng.standard_t(3, x.shape)
    model.log_likelihood = lambda k, y, x: -2.0 * np.log1p((y - x)[..., 0] ** 2 / (3.0 * scale))
    return model


def _nodes(name, q, r):
    """Nodes for the exact posterior, and the weight of each in an integral."""
    if name == "growth model":  # dense about zero, where one step moves neighbours 25 times apart
        u, du = np.linspace(-np.arcsinh(50.0 / 8.0), np.arcsinh(50.0 / 8.0), 801, retstep=True)
        return 8.0 * np.sinh(u), 8.0 * np.cosh(u) * du
    if name == "bearing":
        reach, sd = 8.0 * np.sqrt(10.0 + 5.0 * q), np.sqrt(q * r / (q + r))
    else:
        reach, sd = 6.0 * np.sqrt(1.0 + 0.1 * T * q), np.sqrt(0.1 * q * r / (0.1 * q + r))
    nodes, dx = np.linspace(-reach, reach, int(2.0 * reach / (0.8 * sd)) + 2, retstep=True)
    return nodes, np.full(nodes.shape, dx)


@lru_cache(maxsize=8)
def _record(name, q, r, data):
    """Model, truths, records, and the exact mean and variance at all times: (runs, T+1)."""
    model = _system(name, q, r)
    x, y = model.simulate(T, np.random.default_rng([data, 21]), n_runs=RUNS)
    if name == "random walk":
        exact = pfedu.kalman_filter(model, y)
        return model, x, y, exact.mean[..., 0], exact.cov[..., 0, 0]
    return model, x, y, *_exact(model, y, *_nodes(name, q, r))


def _exact(model, y, nodes, weights):
    """Grid filter of several records at once.

    A prediction is a sum of Gaussians of variance q about f(k, nodes). Its Fourier transform is short, and what
    changes with k, a shift that all nodes share, only turns its phases.
    """
    q, period = model.Q[0, 0], 1.4 * (nodes[-1] - nodes[0])
    omega = np.arange(np.ceil(6.5 * period / (2 * np.pi * np.sqrt(q)))) * (2 * np.pi / period)
    weight = np.exp(-0.5 * q * omega**2) * np.where(omega == 0, 1.0, 2.0) / period
    shift = [model.f(k, np.zeros(1))[0] for k in range(T + 1)]  # f(k, x) = f(0, x) - f(0, 0) + shift[k]
    leave = np.exp(-1j * omega[:, None] * (model.f(0, nodes[:, None])[:, 0] - shift[0])) * weights
    arrive = np.exp(1j * nodes[:, None] * omega) * weight  # (nodes, frequencies)
    real, imaginary = arrive.real.copy(), arrive.imag.copy()
    p, means, variances = np.exp(model.log_initial(nodes[:, None])), [], []
    for k in range(T + 1):
        if k > 0:
            turned = np.exp(-1j * omega * shift[k]) * (p @ leave.T)  # (runs, frequencies)
            p = np.maximum(turned.real @ real.T - turned.imag @ imaginary.T, 0.0)
        p = p * np.exp(model.log_likelihood(k, y[:, k, None, :], nodes[:, None]))
        p = p / (p @ weights)[:, None]
        means.append(p @ (weights * nodes))
        variances.append(p @ (weights * nodes**2) - means[-1] ** 2)
    return np.stack(means, -1), np.stack(variances, -1)


@lru_cache(maxsize=64)
def _filter(kind, N, seed, *setting):
    """Mean and standard deviation of one filter for all records: (runs, T+1)."""
    model, _, y, *_ = _record(*setting)
    rng = np.random.default_rng([seed, 22])
    if kind == "EKF":
        track = pfedu.extended_kalman_filter(model, y)
    elif kind == "UKF":
        track = pfedu.unscented_kalman_filter(model, y)
    elif kind == "local linear":
        track = pfedu.local_linear_filter(model, y, N, proposal="ukf", rng=rng)
    else:
        run = {"bootstrap": pfedu.bootstrap_filter, "auxiliary": pfedu.auxiliary_filter}[kind]
        track = run(model, y, N, rng=rng)
    return track.mean[..., 0], track.sd[..., 0]


def build(axes):
    """Draw what stays; return the artists that move."""
    t, a, s = axes["record"], axes["tradeoff"], axes["inside"]
    wide = t.figure.get_figwidth() > 5
    exact = dict(color=COLORS["measurement"], ls="--", lw=1.5)
    artists = {
        "band": t.fill_between([0, 1], 0, 1, color=COLORS["light"], alpha=0.35, lw=0),
        "truth": t.plot([], [], color=COLORS["truth"], lw=1.2, label="truth")[0],
        "exact": t.plot([], [], label="exact mean", **exact)[0],
        "mean": t.plot([], [], color=COLORS["particles"], lw=1.5, label="filter shown, ±2 sd")[0],
        "line": a.plot([], [], ":", color=COLORS["particles"], lw=1.3, label="bootstrap, any N")[0],
        "bars": a.plot([], [], "-", color=COLORS["measurement"], lw=1.0)[0],
        "inside_exact": s.axvline(95, **exact),
    }
    for row, (name, (marker, color)) in enumerate(LOOKS.items()):
        look = dict(color=COLORS[color], ms=7, mec=COLORS["truth"], mew=0.5)
        artists[name] = a.plot([], [], marker, **look)[0]
        artists[f"inside {name}"] = s.plot([], [], marker, **look)[0]
        s.axhline(row, color=COLORS["measurement"], lw=0.4, alpha=0.5)
    artists["ring"] = a.plot([], [], "o", color=COLORS["truth"], mfc="none", ms=13, mew=1.0)[0]
    t.set(xlabel="time step k", ylabel="state", title="One of the records")
    t.legend(
        ncols=3 if wide else 2, loc="lower center", bbox_to_anchor=(0.5, 1.12), handlelength=1.6, columnspacing=1.0
    )
    a.axhspan(FLOOR / 2, GOOD, color=COLORS["second"], alpha=0.10, lw=0)
    a.axhline(1.0, color=COLORS["measurement"], lw=0.8)
    a.set(xscale="log", yscale="log", xlim=(2.5, 5e3), ylim=(FLOOR / 1.5, CEILING * 1.3),
          xlabel="model evaluations a step", ylabel="distance to exact mean, in sd",
          title="Accuracy against cost")  # fmt: skip
    a.legend(loc="upper right", handlelength=1.6)
    a.set_yticks([1e-3, 1e-2, 0.1, 1, 10], labels=["≤ 0.001", "0.01", "0.1", "1", "10"])
    s.set(xlim=(0, 103), ylim=(len(COSTS) - 0.5, -0.5), xlabel="% of steps",
          title="Truth inside ±2 sd (dashed: exact)")  # fmt: skip
    s.set_yticks(range(len(COSTS)), labels=list(COSTS))
    return artists


def update(artists, axes, system, q, r, N, steps, shown, data, particles):
    """Run all filters and give the artists their data."""
    setting = (system, q, r, data)
    _, x, _, mean, var = _record(*setting)
    size = {name: N if name in PARTICLES else 0 for name in COSTS}
    seed = {name: particles if name in PARTICLES else 0 for name in COSTS}
    found = {name: _filter(name, size[name], seed[name], *setting) for name in COSTS}
    square = {name: _square(m, mean, var, steps) for name, (m, _) in found.items()}  # (runs,)
    sizes = np.array(sorted({*CURVE, N}))
    line = [_square(_filter("bootstrap", n, particles, *setting)[0], mean, var, steps).mean() for n in sizes.tolist()]
    artists["line"].set_data(COSTS["bootstrap"] * sizes, _distance(np.array(line)))
    _show_tradeoff(artists, square, N, shown)
    reach = REACH[system] * (1.0 if system == "growth model" else np.sqrt(q))
    if (axes["record"].get_xlim(), axes["record"].get_ylim()) != ((-0.7, steps + 0.7), (-reach, reach)):
        axes["record"].set(xlim=(-0.7, steps + 0.7), ylim=(-reach, reach))
    _show_record(artists, x[0, :, 0], mean[0], found[shown], steps)
    inside = {name: _inside(x, *pair, steps) for name, pair in found.items()}
    inside_exact = _inside(x, mean, np.sqrt(var), steps)
    for row, name in enumerate(COSTS):
        artists[f"inside {name}"].set_data([inside[name]], [row])
    artists["inside_exact"].set_xdata([inside_exact] * 2)
    rmse = np.sqrt(np.mean((mean - x[..., 0])[:, : steps + 1] ** 2))
    return _say(square, inside, inside_exact, rmse, system, N, steps)


def _square(m, mean, var, steps):
    """Squared distance to the exact mean in units of the exact variance, of each record."""
    return np.mean((m - mean)[:, : steps + 1] ** 2, axis=-1) / np.mean(var[:, : steps + 1])


def _distance(square):
    """Root, within the axis."""
    return np.clip(np.sqrt(square), FLOOR, CEILING)


def _inside(x, m, sd, steps):
    """Share of steps with the truth within two standard deviations, in per cent."""
    return 100.0 * float(np.mean((np.abs(x[..., 0] - m) <= 2.0 * sd)[:, : steps + 1]))


def _cost(name, N):
    return COSTS[name] * (N if name in PARTICLES else 1)


def _show_tradeoff(artists, square, N, shown):
    ends = []
    for name, value in square.items():
        at, error = _cost(name, N), value.std(ddof=1) / np.sqrt(RUNS)
        low, high = (_distance(np.maximum(value.mean() + s * error, 0.0)) for s in (-1, 1))
        ends += [[at, low], [at, high], [np.nan, np.nan]]
        artists[name].set_data([at], [_distance(value.mean())])
    artists["bars"].set_data(*np.array(ends).T)
    artists["ring"].set_data(*artists[shown].get_data())


def _show_record(artists, x, mean, found, steps):
    times, (m, sd) = np.arange(steps + 1), (row[0, : steps + 1] for row in found)
    artists["truth"].set_data(times, x[: steps + 1])
    artists["exact"].set_data(times, mean[: steps + 1])
    artists["mean"].set_data(times, m)
    artists["band"].set_verts([np.c_[np.r_[times, times[::-1]], np.r_[m - 2 * sd, (m + 2 * sd)[::-1]]]])


def _say(square, inside, inside_exact, rmse, system, N, steps):
    far = {name: float(np.sqrt(value.mean())) for name, value in square.items()}
    numbers = {f"distance to the exact mean in sd, {name}": far[name] for name in COSTS}
    numbers |= {f"model evaluations a step, {name}": float(_cost(name, N)) for name in COSTS}
    numbers |= {f"% of steps with the truth inside 2 sd, {name}": inside[name] for name in COSTS}
    numbers |= {"the same, exact": inside_exact, "RMSE of the exact mean against the truth": float(rmse)}
    good = sorted((_cost(name, N), name) for name in COSTS if far[name] <= GOOD)
    verdict = f"Cheapest within {GOOD} sd: {good[0][1]}" if good else f"None of them is within {GOOD} sd"
    each = ", ".join(f"{name} {_read(far[name])} ({_cost(name, N)})" for name in COSTS)
    sentence = (
        f"{system.capitalize()}, N = {N}, {RUNS} records of {steps} steps: distance to the exact mean in posterior sd, "
        f"and model evaluations a step in brackets: {each}. {verdict}. "
        f"The truth is inside ±2 sd in {inside['EKF']:.0f} % of the steps for the EKF, {inside['UKF']:.0f} % for the "
        f"UKF, {inside['bootstrap']:.0f} % for the bootstrap filter and {inside_exact:.0f} % for the exact answer."
    )
    return Shown(sentence, numbers)


def _read(value):
    return "0" if value < 1e-6 else f"{value:.2g}" if value < 100 else f"{value:.0f}"


def _good(numbers):
    """The filters in the shaded region."""
    return [name for name in COSTS if numbers[f"distance to the exact mean in sd, {name}"] <= GOOD]


def _points_but_no_tangent(params, numbers):
    """Whether sigma points follow the bearing and a tangent does not."""
    good = _good(numbers)
    return params["system"] == "bearing" and "UKF" in good and "EKF" not in good


def _only_local_linear(params, numbers):
    """Whether local linearisation alone is good on the growth model."""
    return params["system"] == "growth model" and _good(numbers) == ["local linear"]


PUZZLES = (
    Puzzle(
        "Choose the bearing, and find noises with which the UKF is in the shaded region and the EKF is not.",
        _points_but_no_tangent,
        {"system": "bearing", "q": 4},
    ),
    Puzzle(
        "On the growth model, find a setting with which local linearisation is in the shaded region and every other "
        "filter outside.",
        _only_local_linear,
        {"q": 0.5, "N": 300},
    ),
)


EXPLORER = Explorer(
    title="What each filter costs, and how far it is from the exact answer",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.6), [["record", "record"], ["tradeoff", "inside"]]),
        "narrow": ((3.7, 7.6), [["record"], ["tradeoff"], ["inside"]]),
    },
    build=build,
    update=update,
    also=(
        *({"system": system, "r": r} for system in ("random walk", "bearing") for r in FACTORS if r != 1),
        *({"system": system, "N": n} for system in ("random walk", "bearing", "outliers") for n in (10, 500)),
        *({"system": "outliers", "shown": shown} for shown in ("EKF", "bootstrap")),
        *({"shown": "EKF", "data": seed} for seed in (2, 3)),
        {"system": "bearing", "q": 4},
    ),
    puzzles=PUZZLES,
)
