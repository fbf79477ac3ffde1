"""From a moved control to a picture, natively: median milliseconds of redraw and of the picture's bytes at N = 1000."""

import statistics
import time

from pfedu.explorers import load, names
from pfedu.explorers.stage import Stage
from pfedu.live.picture import quick_png


def milliseconds(work, *args):
    began = time.perf_counter()
    result = work(*args)
    return 1e3 * (time.perf_counter() - began), result


for name in names():
    explorer = load(name)
    stage = Stage(explorer)
    start = explorer.defaults() | ({"N": 1000} if "N" in explorer.defaults() else {})
    print(f"{name}: {len(explorer.controls)} controls")
    for control in explorer.controls:
        draws, codes = [], []
        for value in [v for v in control.values if v != start[control.name]][:20]:
            drawn, (pixels, _) = milliseconds(stage.draw, start | {control.name: value})
            draws.append(drawn)
            codes.append(milliseconds(quick_png, pixels)[0])
        print(
            f"  {control.name:10s} redraw {statistics.median(draws):6.1f} ms, bytes {statistics.median(codes):5.1f} ms"
        )
