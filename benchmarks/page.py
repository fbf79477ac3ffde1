"""What each explorer costs a reader: bytes before a touch, first answer, Python's start, and a change afterwards.

``make self-hosted`` first, then ``python -m benchmarks.page``: one row an explorer, in Chromium. CPU seconds are
those of the browser with all its processes, from the first touch until Python has drawn; a change is one control moved
at random, timed from the event until the picture is there. Wall-clock times are of this machine as it is now.
"""

import argparse
import contextlib
import os
import random
import statistics
import time
from pathlib import Path

import psutil
from playwright.sync_api import sync_playwright

from pfedu.explorers import load
from pfedu.live.serve import serving
from tests.conftest import FLAGS
from tests.test_browser import EXPLORERS, elsewhere

ROOT = Path(__file__).parents[1]


def processor_seconds():
    """CPU seconds of this process's browser so far, all its processes together."""
    total = 0.0
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            total += sum(process.cpu_times()[:2])
    return total


MOVE = """([name, control, to]) => new Promise(done => {
    const figure = document.querySelector(`[data-explorer='${name}']`), before = figure.dataset.redraws;
    const input = figure.querySelector(`[data-control='${control}']`), image = figure.querySelector('.pfedu-poster');
    const began = performance.now();
    const look = () => {
        const drawn = figure.dataset.redraws !== before && (image.hidden || image.complete);
        drawn ? requestAnimationFrame(() => done(performance.now() - began)) : setTimeout(look, 1);
    };
    if (input.type === 'button') { input.dataset.position = to - 1; input.click(); }
    else { input.value = to; input.dispatchEvent(new Event('input', {bubbles: true})); }
    look(); })"""


def before_a_touch(browser, address, path, name):
    """Bytes that the page asks for, and the median of the first answers, with Python out of reach."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.route(lambda url: not url.startswith(address), lambda route: route.abort())
    page, sizes = context.new_page(), []
    network = context.new_cdp_session(page)
    network.send("Network.enable")
    network.on("Network.loadingFinished", lambda event: sizes.append(event["encodedDataLength"]))
    page.goto(address + path, wait_until="networkidle")
    page.wait_for_timeout(500)
    weight = sum(sizes)
    first = []
    for control in load(name).controls:
        start = control.values.index(control.default)
        first.append(page.evaluate(MOVE, [name, control.name, elsewhere(control, start)]))
        page.locator(f'[data-explorer="{name}"] .pfedu-reset').click()
    context.close()
    return weight, statistics.median(first), max(first)


def with_python(browser, address, path, name, changes):
    """CPU seconds until Python has drawn; then times of changes in ms, whole and in Python, and their CPU."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.goto(address + path, wait_until="networkidle")
    cpu, wall = processor_seconds(), time.perf_counter()
    page.locator(f'[data-explorer="{name}"] .pfedu-controls').dispatch_event("pointerdown")
    page.wait_for_selector(f'[data-explorer="{name}"][data-state="live"]', timeout=300_000)
    cpu, wall = processor_seconds() - cpu, time.perf_counter() - wall
    dice, controls, times, inside = random.Random(1), list(load(name).controls), [], []
    for control in controls:
        if control.name == "N" and 1000 in control.values:  # many particles, and as many all the time
            page.evaluate(MOVE, [name, "N", control.values.index(1000)])
            controls.remove(control)
            break
    spent = processor_seconds()
    for _ in range(changes):
        control = dice.choice(controls)
        times.append(page.evaluate(MOVE, [name, control.name, dice.randrange(1, len(control.values))]))
        inside.append(float(page.locator(f'[data-explorer="{name}"]').get_attribute("data-ms")))
    spent = (processor_seconds() - spent) / changes * 1000
    context.close()
    return cpu, wall, times, inside, spent


def frames_weight(folder, path, name):
    """Number and bytes of the pictures drawn beforehand, and the bytes of the first one."""
    text = (folder / path).read_text(encoding="utf-8")
    key = text.split(f'data-explorer="{name}"')[1].split("_static/explorers/")[1].split("/")[0]
    files = list((folder / "_static/explorers" / key).glob("*.png"))
    start = (folder / "_static/explorers" / key / "wide-start.png").stat().st_size
    return len(files), sum(file.stat().st_size for file in files), start


def main():
    """Print one row an explorer."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--changes", type=int, default=50)
    parser.add_argument("--chromium", default=os.environ.get("CHROMIUM") or "/usr/bin/chromium")
    parser.add_argument("names", nargs="*", help="explorers (default: all)")
    given = parser.parse_args()
    folder, own = ROOT / "_build/html", ROOT / "_build/self-hosted/_build/html"
    print("| explorer | page, kB on the wire | first picture, kB | pictures (MB) | first answer, ms (median, worst) "
          "| Python up, CPU s (wall) | change, ms (median, worst) | in Python, ms | CPU ms a change |")  # fmt: skip
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    with sync_playwright() as play, serving(folder) as public, serving(own) as address:
        browser = play.chromium.launch(executable_path=given.chromium, args=FLAGS)
        for path, name in EXPLORERS:
            if given.names and name not in given.names:
                continue
            weight, first, worst = before_a_touch(browser, public, path, name)
            count, size, start = frames_weight(folder, path, name)
            cpu, wall, times, inside, spent = with_python(browser, address, path, name, given.changes)
            print(f"| {name} | {weight / 1e3:.0f} | {start / 1e3:.0f} | {count} ({size / 1e6:.1f}) "
                  f"| {first:.0f}, {worst:.0f} | {cpu:.1f} ({wall:.1f}) "
                  f"| {statistics.median(times):.0f}, {max(times):.0f} | {statistics.median(inside):.0f} "
                  f"| {spent:.0f} |", flush=True)  # fmt: skip
        browser.close()


if __name__ == "__main__":
    main()
