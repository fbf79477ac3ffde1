"""The explorers of the self-hosted book in Chromium: bytes before a touch, CPU seconds to come up, time of a change.

Run `make self-hosted` first. Positions are set as a hand would, at N = 1000; a change is timed in the page, from the
event to the painted canvas.
"""

import shutil
import statistics
from pathlib import Path

import psutil
from playwright.sync_api import sync_playwright

from pfedu.explorers import Seed, load
from pfedu.live.serve import serving

SITE = Path(__file__).parents[1] / "_build/self-hosted/_build/html"
CHANGE = """([name, control, position]) => new Promise(done => {
    const figure = document.querySelector(`[data-explorer=${name}]`), before = figure.dataset.redraws;
    const input = figure.querySelector(`[data-control=${control}]`), began = performance.now();
    const watch = new MutationObserver(() => { if (figure.dataset.redraws !== before) {
        watch.disconnect(); done([performance.now() - began, Number(figure.dataset.ms)]); } });
    watch.observe(figure, {attributes: true});
    if (input.type === 'button') input.click();
    else { input.value = position; input.dispatchEvent(new Event('input', {bubbles: true})); } })"""


def cpu_seconds():
    """CPU seconds of this process' browser so far, all its processes together."""
    total = 0.0
    for process in psutil.Process().children(recursive=True):
        try:
            total += sum(process.cpu_times()[:2])
        except psutil.NoSuchProcess:
            continue
    return total


def positions(control):
    """Fifty places to go to, none twice in a row."""
    return [(7 * i + 3) % len(control.values) for i in range(50)] if not isinstance(control, Seed) else [None] * 50


def measure(page, address, path, name):
    sizes = []
    page.on("response", lambda response: sizes.append(int(response.headers.get("content-length", 0))))
    page.goto(address + path, wait_until="networkidle")
    before = cpu_seconds()
    print(f"{path}, {name}: {sum(sizes) / 1e6:.2f} MB before a touch")
    page.locator(f"[data-explorer={name}] .pfedu-controls").dispatch_event("pointerdown")
    page.wait_for_selector(f'[data-explorer={name}][data-state="live"]', timeout=300_000)
    print(f"  up after {cpu_seconds() - before:.1f} CPU s")
    explorer, everything = load(name), []
    for control in explorer.controls:
        if control.name == "N":
            page.evaluate(CHANGE, [name, "N", control.values.index(1000)])
            continue
        times = []
        for position in positions(control):
            stands = f"[data-explorer={name}] [data-control={control.name}]"
            if position is None or str(position) != page.locator(stands).input_value():
                times.append(page.evaluate(CHANGE, [name, control.name, position]))
        whole, python = (statistics.median(column) for column in zip(*times, strict=True))
        everything += [t[0] for t in times]
        print(f"  {control.name:10s} change to picture {whole:5.0f} ms, of which Python {python:5.0f} ms")
        if not isinstance(control, Seed):
            page.evaluate(CHANGE, [name, control.name, control.values.index(control.default)])
    print(f"  all controls: median {statistics.median(everything):.0f} ms over {len(everything)} changes")


with serving(SITE) as address, sync_playwright() as play:
    chromium = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"])
    for file in sorted(SITE.rglob("*.html")):
        for part in file.read_text(encoding="utf-8").split('data-explorer="')[1:]:
            measure(chromium.new_page(), address, file.relative_to(SITE).as_posix(), part.split('"')[0])
