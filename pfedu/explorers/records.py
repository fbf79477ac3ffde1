"""Explorer of chapter 13: a real record, filtered by particles and exactly, and the likelihood of its parameters."""

from functools import lru_cache

import numpy as np

import pfedu
from pfedu.data import nile, sp500
from pfedu.explorers.controls import Choice, Seed, Slider, geometric
from pfedu.explorers.explorer import Explorer, Puzzle, Shown
from pfedu.figures.style import COLORS
from pfedu.models import StateSpaceModel
from pfedu.resampling import always

YEAR, FLOW = nile()
_DAYS = slice(*np.searchsorted(sp500()[0], np.array(["2008-07-01", "2009-07-01"], dtype="datetime64[D]")))
DAY, CHANGE = sp500()[0][_DAYS], sp500()[1][_DAYS] - sp500()[1].mean()
NILE, RETURNS = "Nile", "S&P 500"
# Estimates: Durbin and Koopman's for the river; maximum likelihood on a grid, all 756 days, for the returns.
Q, R, PHI, MU = {NILE: 1469.1, RETURNS: 0.0247}, 15099.0, 0.9916, 0.17
DICE = ("new", "common", "common and sorted")
FLOOR, ROOF = -10.0, 3.0  # of the likelihood's picture, from the top of the exact curve

CONTROLS = (
    Choice("record", "record", (NILE, RETURNS), NILE),
    Slider("N", "particles N", geometric(20, 500, 13), 100),
    Slider("q", "process noise variance q, times its estimate", geometric(0.1, 10.0, 17), 1.0, drawn=9),
    Slider("noise", "size of the noise (r, or exp μ), times its estimate", geometric(0.25, 4.0, 17), 1.0, drawn=9),
    Choice("along", "likelihood along", ("q", "noise"), "q"),
    Choice("dice", "dice along the curve", DICE, "common"),
    Seed("particles", "new particles", drawn=5),
)
POSITIONS = {control.name: control.values for control in CONTROLS if control.name in ("q", "noise")}


@lru_cache(maxsize=64)
def _exact(record, q, noise):
    """Log-likelihood, and mean and standard deviation of the state at each time."""
    if record == NILE:
        return _river(Q[NILE] * q, R * noise)
    return _volatility(Q[RETURNS] * q, MU + np.log(noise))


def _river(q, r):
    """The Kalman filter of the local level model, in scalars: a hundred years in well under a millisecond."""
    m, P, total, means, variances = FLOW[0], r, 0.0, [FLOW[0]], [r]
    for flow in FLOW[1:]:
        S = P + q + r
        e, K = flow - m, (P + q) / S
        m, P, total = m + K * e, K * r, total - 0.5 * (np.log(2 * np.pi * S) + e * e / S)
        means.append(m)
        variances.append(P)
    return total, np.array(means), np.sqrt(variances)


def _volatility(q, mu):
    """What ``pfedu.grid_filter`` gives; the transition is the same at all times, so one matrix serves them all.

    Nodes one standard deviation of a step apart are enough: of a Gaussian, the sum is then right to 1e-8.
    """
    reach, step = 3.0 + 5.0 * np.sqrt(q / (1 - PHI**2)), min(np.sqrt(q), 0.3)
    z = np.linspace(-reach, reach, 1 + 2 * int(np.ceil(reach / step)))  # state minus mu
    h = z[1] - z[0]
    moves = np.exp(-0.5 * (z[:, None] - PHI * z) ** 2 / q) * (h / np.sqrt(2 * np.pi * q))
    p = np.exp(-0.5 * z**2 * (1 - PHI**2) / q) * (h * np.sqrt((1 - PHI**2) / (2 * np.pi * q)))
    g = np.exp(-0.5 * (np.log(2 * np.pi) + mu + z + CHANGE[:, None] ** 2 * np.exp(-mu - z)))  # (days, nodes)
    masses, sums = np.empty(g.shape), np.empty(len(g))
    for k in range(len(g)):
        p = (moves @ p if k else p) * g[k]
        sums[k] = p.sum()
        masses[k] = p = p / sums[k]
    mean = masses @ z
    return np.log(sums).sum(), mu + mean, np.sqrt(masses @ z**2 - mean**2)


@lru_cache(maxsize=32)
def _filter(record, N, q, noise, dice, particles):
    """One bootstrap filter for each pair of parameters, q and noise being tuples: a Track of len(q) runs."""
    q, noise = Q[record] * np.array(q)[:, None, None], np.array(noise)[:, None, None]  # (P, 1, 1)
    rows = 1 if dice != "new" else len(q)

    def draw(rng):
        return np.broadcast_to(rng.standard_normal((rows, N, 1)), (len(q), N, 1))

    def placed(x):
        return np.sort(x, axis=-2) if dice == "common and sorted" else x

    def comb(w, rng):
        """Systematic resampling with one offset for all, if the dice are common."""
        below = np.ceil(N * np.cumsum(w, axis=-1) - rng.random((rows, 1)))
        below[:, -1] = N
        copies = np.diff(np.clip(below, 0, N), prepend=0).astype(int)
        return np.repeat(np.tile(np.arange(N), len(q)), copies.ravel()).reshape(w.shape)

    model, y = _model(record, q, noise, draw, placed)
    y = np.broadcast_to(y[:, None], (len(q), len(y), 1))
    return pfedu.bootstrap_filter(
        model, y, N, rng=np.random.default_rng([particles, 7]), resampling=comb, policy=always
    )


def _model(record, q, noise, draw, placed):
    """The model of a record for many parameters at once, and the measurements that it takes."""
    if record == NILE:
        r = R * noise
        return StateSpaceModel(
            lambda n, rng: placed(FLOW[0] + np.sqrt(r) * draw(rng)).reshape(n, 1),
            lambda k, x, rng: placed(x + np.sqrt(q) * draw(rng)),
            lambda k, y, x: -0.5 * (np.log(2 * np.pi * r) + (y - x) ** 2 / r)[..., 0],
        ), np.append(np.nan, FLOW[1:])
    mu = MU + np.log(noise)
    return StateSpaceModel(
        lambda n, rng: placed(mu + np.sqrt(q / (1 - PHI**2)) * draw(rng)).reshape(n, 1),
        lambda k, x, rng: placed(mu + PHI * (x - mu) + np.sqrt(q) * draw(rng)),
        lambda k, y, x: -0.5 * (np.log(2 * np.pi) + x + y * y * np.exp(-x))[..., 0],
    ), CHANGE


def build(axes):
    """Draw what stays; return the artists that move."""
    t, c, e = axes["track"], axes["curve"], axes["n_eff"]
    exact = dict(color=COLORS["exact"], ls="--", lw=1.5)
    artists = {
        "band": t.fill_between([0, 1], 0, 1, color=COLORS["light"], alpha=0.35, lw=0, label="± 2 sd"),
        "y": t.plot([], [], "x", color=COLORS["measurement"], ms=3.5, label="record")[0],
        "low": t.plot([], [], color=COLORS["exact"], ls=":", lw=1.2, label="exact, ± 2 sd")[0],
        "high": t.plot([], [], color=COLORS["exact"], ls=":", lw=1.2)[0],
        "mean": t.plot([], [], color=COLORS["particles"], lw=1.5, label="particles")[0],
        "exact": t.plot([], [], label="exact", **exact)[0],
        "here": c.axvline(1.0, color=COLORS["accent"], lw=5, alpha=0.4),
        "points": c.plot([], [], "o-", color=COLORS["particles"], ms=4, lw=1.0, label="particles")[0],
        "below": c.plot([], [], "v", color=COLORS["third"], ms=6, label="further down")[0],
        "curve": c.plot([], [], label="exact", **exact)[0],
        "n_eff": e.plot([], [], color=COLORS["second"], lw=1.2, marker="o", ms=2)[0],
    }
    t.set_title("Record, and what the filter makes of it")
    wide = t.figure.get_figwidth() > 5
    t.legend(
        ncols=5 if wide else 2, loc="lower center", bbox_to_anchor=(0.5, 1.12), handlelength=1.6, columnspacing=1.0
    )
    c.set(
        xscale="log", ylim=(FLOOR - 0.6, ROOF), ylabel="log-likelihood − exact top", title="Likelihood of one parameter"
    )
    c.legend(loc="lower center", handlelength=1.6, labelspacing=0.25)
    e.set(ylim=(0, 1.05), ylabel="$N_{eff}$ / N", title="Effective share of particles")
    return artists


def update(artists, axes, record, N, q, noise, along, dice, particles):
    """Filter the record, and along the curve, and give the artists their data."""
    _, mean, sd = _exact(record, q, noise)
    values = POSITIONS[along]
    pairs = [(v, noise) if along == "q" else (q, v) for v in values]
    curve = np.array([_exact(record, *pair)[0] for pair in pairs])
    runs = _filter(record, N, *zip(*pairs, strict=True), dice, particles)
    points, here = runs.log_likelihood, pairs.index((q, noise))
    if dice == "common":  # what it would be alone, with the same dice
        fields = (runs.mean, runs.cov, runs.log_likelihood_increments, runs.n_eff)
        track = pfedu.Track(*(field[here : here + 1] for field in fields))
    else:  # the same whatever the curve shows
        track = _filter(record, N, (q,), (noise,), "new", particles)
    times = YEAR if record == NILE else np.arange(len(CHANGE))
    _show_track(artists, axes["track"], record, times, mean, sd, track)
    _show_curve(artists, axes["curve"], along, values, curve, points, q if along == "q" else noise)
    _show_n_eff(artists, axes["n_eff"], record, times, track, N)
    return _say(record, N, q, noise, along, dice, times, mean, sd, track, values, curve, points)


def _show_track(artists, ax, record, times, mean, sd, track):
    river = record == NILE
    as_seen = (lambda x: x) if river else (lambda x: np.exp(x / 2))  # the state itself, or the size of a return
    look = ((1869.5, 1971.5), (400, 1500), "year", "flow in $10^8$ m³") if river else (
        (-3, len(CHANGE) + 2), (0, 12), "trading days after 1 July 2008", "size of a return in %")  # fmt: skip
    if ax.get_xlabel() != look[2]:
        ax.set(xlim=look[0], ylim=look[1], xlabel=look[2], ylabel=look[3])
    m, s = track.mean[0, :, 0], track.sd[0, :, 0]
    low, high = as_seen(m - 2 * s), as_seen(m + 2 * s)
    artists["band"].set_verts([np.c_[np.r_[times, times[::-1]], np.r_[low, high[::-1]]]])
    artists["y"].set_data(times, FLOW if river else np.abs(CHANGE))
    artists["mean"].set_data(times, as_seen(m))
    artists["exact"].set_data(times, as_seen(mean))
    artists["low"].set_data(times, as_seen(mean - 2 * sd))
    artists["high"].set_data(times, as_seen(mean + 2 * sd))


def _show_curve(artists, ax, along, values, curve, points, here):
    label = f"{'q' if along == 'q' else 'size of the noise'}, times its estimate"
    if ax.get_xlabel() != label:
        ax.set(xlim=(values[0] / 1.12, values[-1] * 1.12), xlabel=label)
        ticks = [0.1, 0.3, 1, 3, 10] if along == "q" else [0.25, 0.5, 1, 2, 4]
        ax.set_xticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        ax.set_xticks([], minor=True)
    points, curve = points - curve.max(), curve - curve.max()
    lost = points < FLOOR
    artists["points"].set_data(values, np.maximum(points, 10 * FLOOR))
    artists["below"].set_data(np.array(values)[lost], np.full(lost.sum(), FLOOR))
    artists["curve"].set_data(values, np.maximum(curve, 10 * FLOOR))
    artists["here"].set_xdata([here, here])


def _show_n_eff(artists, ax, record, times, track, N):
    first = record == NILE  # its first year is the prior, and weighs nothing
    label = "year" if record == NILE else "trading days after 1 July 2008"
    if ax.get_xlabel() != label:
        ax.set(xlabel=label, xlim=(times[0] - 2, times[-1] + 2))
    artists["n_eff"].set_data(times[first:], track.n_eff[0, first:] / N)


def _say(record, N, q, noise, along, dice, times, mean, sd, track, values, curve, points):
    first = int(record == NILE)
    share, exact = track.n_eff[0, first:] / N, _exact(record, q, noise)[0]
    worst = first + int(share.argmin())
    apart = (track.mean[0, first:, 0] - mean[first:]) / sd[first:]
    error = points - curve
    numbers = {
        "process noise variance q": Q[record] * q,
        "size of the noise (r, or exp μ)": (R if record == NILE else np.exp(MU)) * noise,
        "log-likelihood, particles": float(track.log_likelihood[0]),
        "log-likelihood, exact": float(exact),
        "RMS distance of the means, in posterior sd": float(np.sqrt(np.mean(apart**2))),
        "N_eff / N, mean": float(share.mean()),
        "N_eff / N, lowest": float(share.min()),
        "best on the curve, exact": float(values[curve.argmax()]),
        "best on the curve, particles": float(values[points.argmax()]),
        "mean error along the curve": float(error.mean()),
        "scatter of the error between neighbours": float(np.diff(error).std()),
    }
    when = f"in {times[worst]}" if record == NILE else f"on {DAY[worst]}"
    name = along if along == "q" else "the noise"
    sentence = (
        f"{record}, N = {N}: the log-likelihood is {track.log_likelihood[0]:.1f} by particles and {exact:.1f} exactly. "
        f"Along {name} the exact curve is highest at {values[curve.argmax()]:g} times the estimate, that of the "
        f"particles at {values[points.argmax()]:g} times; with {dice} dice their error changes from one point to the "
        f"next by {np.diff(error).std():.2f} (sd). N_eff is lowest {when}, {share.min() * N:.0f} of {N}."
    )
    return Shown(sentence, numbers)


def _smooth_and_wrong(params, numbers):
    smooth = numbers["scatter of the error between neighbours"] < 0.2
    far = numbers["best on the curve, particles"] < 0.5 * numbers["best on the curve, exact"]
    return params["record"] == NILE and params["along"] == "q" and smooth and far


def _far_short(params, numbers):
    short = numbers["log-likelihood, exact"] - numbers["log-likelihood, particles"]
    return params["record"] == RETURNS and params["N"] == 500 and short >= 20


PUZZLES = (
    Puzzle(
        "Let the Nile's curve along q be smooth and wrong: from one point to the next the error of the particles "
        "changes by less than 0.2 (sd), and yet their curve is highest at less than half of the q at which the exact "
        "one is.",
        _smooth_and_wrong,
        {"dice": "common and sorted", "N": 220},
    ),
    Puzzle(
        "Find parameters for the S&P 500 at which the log-likelihood by 500 particles falls at least 20 short of the "
        "exact one.",
        _far_short,
        {"record": RETURNS, "N": 500, "q": 0.1, "noise": 0.25},
    ),
)


EXPLORER = Explorer(
    title="A real record and the likelihood of its parameters",
    controls=CONTROLS,
    layouts={
        "wide": ((7.6, 5.4), [["track", "track"], ["curve", "n_eff"]]),
        "narrow": ((3.7, 7.4), [["track"], ["curve"], ["n_eff"]]),
    },
    build=build,
    update=update,
    also=(
        *({"record": RETURNS, "q": q} for q in CONTROLS[2].frames()),
        *({"record": RETURNS, "dice": dice} for dice in DICE),
        *({"record": RETURNS, "N": N} for N in (20, 500)),
        *({"dice": dice, "N": 500} for dice in DICE),
        {"record": RETURNS, "along": "noise"},
    ),
    puzzles=PUZZLES,
)
