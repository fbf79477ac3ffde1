"""The built book in a real browser: what a reader sees before, while and after Python comes up, and what may go wrong.

The network is closed in all of these tests: whatever a page asks of another site is refused and recorded.
"""

import io
import itertools
import json
import re
import zipfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from pfedu.explorers import Seed, load
from pfedu.live.browser import render
from pfedu.live.page import PYODIDE

TimeoutError = pytest.importorskip("playwright.sync_api").TimeoutError
pytestmark = pytest.mark.browser

UP = 180_000  # ms that Python may take to come up on a slow machine


@contextmanager
def reading(chromium, address, mathematics=True, **options):
    """A page with everything it asks of others, and every error, recorded; without mathematics it is up sooner."""
    context = chromium.new_context(**{"viewport": {"width": 1280, "height": 900}} | options)
    page = context.new_page()
    page.foreign, page.errors, page.asked = [], [], []

    def guard(route):
        page.foreign.append(route.request.url)
        route.abort()

    if not mathematics:
        context.route("**/mathjax/startup.js", lambda route: route.fulfill(body="", content_type="text/javascript"))
    context.route(lambda url: not url.startswith((address, "data:", "blob:", "file:")), guard)
    page.on("request", lambda request: page.asked.append(request.url))
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.on("console", lambda message: message.type == "error" and page.errors.append(message.text))
    try:
        yield page
    finally:
        context.close()


BOOK = Path(__file__).parents[1] / "book"
EXPLORERS = [  # (page, name) of every explorer that the book's notebooks ask for
    (f"book/{file.stem}.html", name)
    for file in sorted(BOOK.glob("*.ipynb"))
    for cell in json.loads(file.read_text(encoding="utf-8"))["cells"]
    if cell["cell_type"] == "code"
    for name in re.findall(r'^explore\("(\w+)"', "".join(cell["source"]), re.M)
]
every_explorer = pytest.mark.parametrize(("path", "name"), EXPLORERS, ids=[name for _, name in EXPLORERS])


def all_pages(folder):
    """Every page but index.html, which only leads on to the first."""
    found = [file.relative_to(folder) for file in sorted(Path(folder).rglob("*.html"))]
    own = [file for file in found if not {"_static", "_modules"} & {*file.parts}]
    return [file.as_posix() for file in own if file.as_posix() != "index.html"]


def figure(page, name):
    return page.locator(f'.pfedu-explorer[data-explorer="{name}"]').first


def words(page, name):
    return figure(page, name).locator(".pfedu-sentence").inner_text()


def positions(page, name):
    return figure(page, name).evaluate(
        "e => Object.fromEntries([...e.querySelectorAll('[data-control]')].map("
        "i => [i.dataset.control, Number(i.dataset.position ?? i.value)]))"
    )


def said_natively(page, name):
    return json.loads(render(name, "wide", json.dumps(positions(page, name)))[1])


def move(page, name, control, position):
    """Put a control where it is wanted, as a hand would, and wait for no answer."""
    figure(page, name).locator(f'[data-control="{control}"]').evaluate(
        "(i, to) => { if (i.type === 'button') i.click(); else { i.value = to;"
        " i.dispatchEvent(new Event('input', {bubbles: true})); } }", position)  # fmt: skip


def shows(page, name, sentence, timeout=20_000):
    """Wait until the explorer says this sentence."""
    try:
        page.wait_for_function(
            "([name, sentence]) => sentence === document.querySelector("
            "`[data-explorer='${name}'] .pfedu-sentence`).textContent",
            arg=[name, sentence], timeout=timeout)  # fmt: skip
    except TimeoutError:
        status = figure(page, name).locator(".pfedu-status").inner_text()
        pytest.fail(f"wanted: {sentence}\nshown: {words(page, name)}\nstatus: {status}")


def wake(page, name):
    """Touch the controls and wait until Python has drawn."""
    figure(page, name).locator(".pfedu-controls").dispatch_event("pointerdown")
    page.wait_for_selector(f'.pfedu-explorer[data-explorer="{name}"][data-state="live"]', timeout=UP)


def elsewhere(control, start):
    """A position of a control, drawn beforehand, that is not where it starts."""
    if isinstance(control, Seed):
        return start + 1
    drawn = [control.values.index(value) for value in control.frames()]
    return next(i for i in reversed(drawn) if i != start)


def typeset(page):
    """Wait until every formula of the page has been set."""
    page.wait_for_function(
        "document.querySelectorAll('mjx-container').length >= document.querySelectorAll('.math').length"
    )


# ---- every page ---------------------------------------------------------------------------------------------------


def test_index_leads_to_the_preface(chromium, book):
    with reading(chromium, book) as page:
        page.goto(book)
        page.wait_for_url("**/preface.html")
        assert "Particle Filters" in page.title()


def pages_of_the_source():
    """Every page that is written, by its source: known before the book is built."""
    listed = re.findall(r"(?:root|file): (\S+)", (BOOK.parent / "_toc.yml").read_text(encoding="utf-8"))
    return [f"{name}.html" for name in [*listed, "genindex", "prf-prf", "py-modindex", "search"]]


LIGHT = {"light": {}}
DARK = {"light": {}, "dark": {"runOnly": ["color-contrast"]}}
DARK_TOO = {
    f"book/{name}.html" for name in ("preface", "notation", "03-sir", "hall-of-bugs", "api/filters", "glossary")
}


@pytest.mark.parametrize("path", pages_of_the_source())
def test_page_is_sound_fits_every_screen_and_stands_in_nobodys_way(chromium, book, path):
    """One visit: errors, other sites, formulas, pictures, three widths, axe-core; a page of each kind in the dark."""
    with reading(chromium, book, reduced_motion="reduce") as page:
        page.goto(book + path, wait_until="load")
        typeset(page)
        page.evaluate("document.querySelectorAll('article img').forEach(i => { i.loading = 'eager' })")
        page.wait_for_function("[...document.querySelectorAll('article img')].every(i => i.complete)")
        raw = page.evaluate("document.querySelectorAll('mjx-merror, .problematic').length")
        assert raw == 0, "mathematics or a reference that did not resolve"
        bad = page.evaluate(
            "[...document.querySelectorAll('article img')].filter(i => !i.naturalWidth"
            " || !(i.getAttribute('alt') || '').trim() || /^\\.\\.|_images/.test(i.alt)).map(i => i.src)"
        )
        assert bad == []
        for width in (1280, 640, 390):  # a desk, the same at 200 %, a phone
            page.set_viewport_size({"width": width, "height": 800})
            page.wait_for_timeout(200)
            over = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
            assert over <= 0, f"{over} px wider than a screen of {width}"
        assert page.errors == []
        assert page.foreign == []
        page.set_viewport_size({"width": 1280, "height": 800})
        assert _serious(page, DARK if path in DARK_TOO else LIGHT) == []


def _serious(page, themes):
    """What axe-core finds serious: names, roles, order, contrast in these themes. Formulas are MathJax's own."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    found = []
    page.add_style_tag(content="* { transition: none !important }")  # or colours are seen on their way
    for theme, rules in themes.items():
        page.evaluate("theme => Object.assign(document.documentElement.dataset, {mode: theme, theme})", theme)
        page.wait_for_timeout(400)  # until the colours have settled
        options = {"resultTypes": ["violations"], "preload": False, **rules}
        for v in axe.run(page, {"exclude": [["mjx-container"]]}, options).response["violations"]:
            if v["impact"] in {"serious", "critical"}:
                found.append(f"{theme}: {v['id']}, {len(v['nodes'])} times: {v['help']}: {v['nodes'][0]['html'][:150]}")
    return found


def test_every_page_of_the_site_was_visited(book_folder):
    """A page that the tests above do not know of."""
    own = {path for path in all_pages(book_folder) if "_static" not in path}
    assert own == set(pages_of_the_source())


def test_nothing_moves_for_readers_who_asked_for_that(chromium, book):
    with reading(chromium, book, reduced_motion="reduce") as page:
        page.goto(book + "book/preface.html", wait_until="load")
        slow = page.evaluate(
            "[...document.querySelectorAll('*')].map(e => getComputedStyle(e)).filter(s =>"
            " [s.transitionDuration, s.animationDuration].some(d => parseFloat(d) > 0.001)"
            " || s.scrollBehavior === 'smooth').length"
        )
        assert slow == 0


# ---- before any script, and without Python ------------------------------------------------------------------------


@every_explorer
def test_picture_without_script_from_a_file_and_on_paper(chromium, book_folder, path, name):
    with reading(chromium, "file://", java_script_enabled=False) as page:
        page.goto((Path(book_folder) / path).as_uri())
        poster = figure(page, name).locator(".pfedu-poster")
        size = Path(book_folder) / path  # natural size cannot be asked without script: the screenshot shows it
        assert size.exists() and len(poster.screenshot()) > 20_000
        assert load(name).defaults() and len(poster.get_attribute("alt")) > 60
        assert not figure(page, name).locator(".pfedu-controls").is_visible()
        page.emulate_media(media="print")
        assert poster.is_visible() and not figure(page, name).locator(".pfedu-controls").is_visible()


@every_explorer
def test_frames_answer_the_first_drag_though_python_cannot_be_had(chromium, book, path, name):
    with reading(chromium, book, mathematics=False) as page:
        page.goto(book + path)
        assert page.foreign == []
        for control in load(name).controls:
            start = positions(page, name)
            move(page, name, control.name, elsewhere(control, start[control.name]))
            shows(page, name, said_natively(page, name)["sentence"])
            picture = figure(page, name).locator(".pfedu-poster")
            assert picture.get_attribute("src").endswith(f"-{control.name}-{positions(page, name)[control.name]}.png")
            page.wait_for_function("i => i.complete && i.naturalWidth > 0", arg=picture.element_handle())
            figure(page, name).locator(".pfedu-reset").click()
            assert positions(page, name) == start
        page.wait_for_selector('.pfedu-explorer[data-python="failed"]')
        status = figure(page, name).locator(".pfedu-status").inner_text()
        assert "Python could not be loaded" in status and "still answer" in status
        assert page.foreign and all(url.startswith(PYODIDE) for url in page.foreign)
        assert figure(page, name).get_attribute("data-state") == "frame"


@every_explorer
def test_nearest_frame_says_so_and_two_controls_moved_do_not_lie(chromium, book, path, name):
    with reading(chromium, book, mathematics=False) as page:
        page.goto(book + path)
        controls = [c for c in load(name).controls if not isinstance(c, Seed)]
        start = positions(page, name)
        status = figure(page, name).locator(".pfedu-status")
        for control in controls:
            drawn = {control.values.index(value) for value in control.frames()}
            between = [i for i in range(len(control.values)) if i not in drawn]
            if between:
                move(page, name, control.name, between[0])
                assert "nearest position drawn beforehand" in status.inner_text()
                move(page, name, control.name, start[control.name])
        before = words(page, name)
        first, second = _pair_without_a_frame(load(name), controls, start)
        move(page, name, first.name, elsewhere(first, start[first.name]))
        shown = words(page, name)
        move(page, name, second.name, elsewhere(second, start[second.name]))
        assert shown != before and words(page, name) == shown
        assert re.search("Several controls have been moved", status.inner_text())


def _pair_without_a_frame(explorer, controls, start):
    """Two controls whose combination was not drawn beforehand."""
    values = {c.name: c.values[start[c.name]] for c in explorer.controls}
    drawn = list(explorer.beforehand(values))
    for pair in itertools.combinations(controls, 2):
        if values | {c.name: c.values[elsewhere(c, start[c.name])] for c in pair} not in drawn:
            return pair
    raise AssertionError("every pair of controls is drawn beforehand")


@every_explorer
def test_time_runs_and_stops_by_keyboard_without_python(chromium, book, path, name):
    with reading(chromium, book, mathematics=False) as page:
        page.goto(book + path)
        play = figure(page, name).locator(".pfedu-play")
        if not play.count():
            assert not any(getattr(c, "plays", False) for c in load(name).controls)
            return
        control = next(c for c in load(name).controls if getattr(c, "plays", False))
        play.focus()
        page.keyboard.press("Enter")
        began = positions(page, name)[control.name]
        page.wait_for_function(
            "([name, control, began]) => document.querySelector("
            "`[data-explorer='${name}'] [data-control='${control}']`).value != began",
            arg=[name, control.name, began],
        )
        assert play.get_attribute("aria-pressed") == "true" and "Pause" in play.inner_text()
        page.keyboard.press("Space")
        stood = positions(page, name)
        assert play.get_attribute("aria-pressed") == "false"
        assert control.values[stood[control.name]] in control.frames()  # every step has its own picture
        shows(page, name, said_natively(page, name)["sentence"])
        page.wait_for_timeout(1000)
        assert positions(page, name) == stood, "paused, and time runs on"


@every_explorer
def test_controls_are_labelled_and_answer_to_the_keyboard(chromium, book, path, name):
    with reading(chromium, book, mathematics=False) as page:
        page.goto(book + path)
        for control in load(name).controls:
            if isinstance(control, Seed):
                assert figure(page, name).get_by_role("button", name=control.label, exact=True).count() == 1
            else:
                assert figure(page, name).get_by_label(re.compile("^" + re.escape(control.label))).count() == 1
        slider = figure(page, name).locator("input[type=range]").first
        slider.focus()
        before = slider.input_value()
        page.keyboard.press("ArrowRight")
        assert int(slider.input_value()) == int(before) + 1
        texts = load(name).controls[[c.name for c in load(name).controls].index(slider.get_attribute("data-control"))]
        assert slider.get_attribute("aria-valuetext") == texts.text(texts.values[int(before) + 1])


@every_explorer
def test_a_phone_gets_the_narrow_picture(chromium, book, path, name):
    with reading(chromium, book, mathematics=False, viewport={"width": 390, "height": 800}) as page:
        page.goto(book + path)
        poster = figure(page, name).locator(".pfedu-poster")
        assert "/narrow-" in poster.evaluate("i => i.currentSrc")
        assert poster.evaluate("i => i.clientWidth") > 300
        controls = figure(page, name).locator(".pfedu-control")
        last = controls.nth(min(4, controls.count() - 2))
        last.evaluate("control => control.scrollIntoView({block: 'end'})")
        page.wait_for_timeout(300)
        box = figure(page, name).locator(".pfedu-picture").bounding_box()
        in_sight = box["y"] > 0 and box["y"] + box["height"] < 800
        assert in_sight, "the picture is out of sight while its controls are moved"


@every_explorer
def test_opened_as_a_file_it_says_why_python_does_not_start(chromium, book_folder, path, name):
    with reading(chromium, "file://") as page:
        page.goto((Path(book_folder) / path).as_uri())
        control = load(name).controls[0]
        move(page, name, control.name, elsewhere(control, positions(page, name)[control.name]))
        shows(page, name, said_natively(page, name)["sentence"])
        page.wait_for_selector('.pfedu-explorer[data-python="failed"]')
        assert "Python could not be loaded" in figure(page, name).locator(".pfedu-status").inner_text()


# ---- Python in the page -------------------------------------------------------------------------------------------


@every_explorer
def test_python_comes_slowly_and_answers_every_control_with_the_native_numbers(chromium, own_book, path, name):
    with reading(chromium, own_book, mathematics=False) as page:
        held = []
        page.context.route("**/pyodide.asm.wasm", lambda route: held.append(route))
        page.goto(own_book + path)
        _frames_answer_while_python_is_slow(page, name)
        held[0].continue_()
        page.wait_for_selector(f'.pfedu-explorer[data-explorer="{name}"][data-state="live"]', timeout=UP)
        _native_numbers_are_shown(page, name)
        figure(page, name).locator(".pfedu-reset").click()
        _each_control_alone(page, name)
        for control in load(name).controls:  # on top of each other
            move(page, name, control.name, elsewhere(control, positions(page, name)[control.name]))
            _native_numbers_are_shown(page, name)
        _newest_position_wins(page, name)
        _puzzles_are_marked(page, name)
        assert figure(page, name).get_attribute("data-state") == "live"
        assert page.errors == [] and page.foreign == []
        assert sum("worker.js" in url for url in page.asked) == 1


def _frames_answer_while_python_is_slow(page, name):
    control = next(c for c in load(name).controls if not isinstance(c, Seed))
    move(page, name, control.name, elsewhere(control, positions(page, name)[control.name]))
    shows(page, name, said_natively(page, name)["sentence"])
    status = figure(page, name).locator(".pfedu-status")
    status.filter(has_text=re.compile("Loading Python.*MB")).wait_for()
    assert figure(page, name).get_attribute("data-state") == "frame"


def _each_control_alone(page, name):
    canvas = figure(page, name).locator("canvas")
    _native_numbers_are_shown(page, name)
    start = words(page, name)
    for control in load(name).controls:
        before = canvas.evaluate("c => c.toDataURL()")
        move(page, name, control.name, elsewhere(control, positions(page, name)[control.name]))
        _native_numbers_are_shown(page, name)
        moved = canvas.evaluate("c => c.toDataURL()") != before
        assert moved, f"{name}: {control.name} moved and the picture did not"
        figure(page, name).locator(".pfedu-reset").click()
        shows(page, name, start)


def _native_numbers_are_shown(page, name):
    """The numbers that came from the worker equal the native ones; the table shows them to six digits."""
    native = said_natively(page, name)
    shows(page, name, native["sentence"])
    page_numbers = figure(page, name).evaluate("e => e.shown.numbers")
    assert list(page_numbers) == list(native["numbers"])
    assert list(page_numbers.values()) == pytest.approx(list(native["numbers"].values()), rel=1e-8, abs=1e-11)
    shown = figure(page, name).locator(".pfedu-numbers td").all_text_contents()
    assert [float(text) for text in shown] == pytest.approx(list(native["numbers"].values()), rel=1e-5, abs=1e-9)
    listed = figure(page, name).locator(".pfedu-numbers tbody th").all_text_contents()
    assert listed == list(native["numbers"])


def _newest_position_wins(page, name):
    """Sixty moves within a moment: fewer redraws, and the last position shown at the end."""
    slider = figure(page, name).locator("input[type=range]").last
    top = int(slider.get_attribute("max"))
    before = int(figure(page, name).get_attribute("data-redraws"))
    slider.evaluate(
        """async (i, top) => { for (let n = 0; n < 60; n++) {
            i.value = n % (top + 1);
            i.dispatchEvent(new Event('input', {bubbles: true}));
            await new Promise(r => setTimeout(r, 2)); } }""", top)  # fmt: skip
    shows(page, name, said_natively(page, name)["sentence"])
    assert int(figure(page, name).get_attribute("data-redraws")) - before < 60


def _puzzles_are_marked(page, name):
    explorer, figure_ = load(name), figure(page, name)
    for i, puzzle in enumerate(explorer.puzzles):
        line = figure_.locator(".pfedu-puzzles li").nth(i)
        figure_.locator(".pfedu-reset").click()
        for control in explorer.controls:
            if control.name in puzzle.answer:
                to = control.values.index(puzzle.answer[control.name])
                figure_.locator(f'[data-control="{control.name}"]').evaluate(
                    "(i, to) => { if (i.type === 'button') i.dataset.position = to - 1; }", to)  # fmt: skip
                move(page, name, control.name, to)
        shows(page, name, said_natively(page, name)["sentence"])
        assert line.inner_text().startswith("✓ Solved"), puzzle.text


def _broken_archive(folder, name):
    """The page's package, with a redraw that fails where that control stands at 0."""
    archive = next(Path(folder).rglob("pfedu.zip"))
    out = io.BytesIO()
    with zipfile.ZipFile(archive) as old, zipfile.ZipFile(out, "w") as new:
        for item in old.namelist():
            text = old.read(item)
            if item == "pfedu/explorers/stage.py":
                old_line = b"shown = self.explorer.update("
                assert old_line in text
                trap = b"if params['%s'] == 0: raise ValueError('broken on purpose')\n        " % name
                text = text.replace(old_line, trap + old_line)
            new.writestr(item, text)
    return out.getvalue()


def test_an_error_in_a_redraw_is_said_and_the_explorer_goes_on(chromium, own_book, book_folder):
    path, name = next(pair for pair in EXPLORERS if pair[1] == "sir")
    slider = next(c for c in load(name).controls if 0 in c.values and 1 in c.values)
    with reading(chromium, own_book, mathematics=False) as page:
        archive = _broken_archive(book_folder, slider.name.encode())
        page.route("**/pfedu.zip*", lambda route: route.fulfill(body=archive, content_type="application/zip"))
        page.goto(own_book + path)
        wake(page, name)
        canvas = figure(page, name).locator("canvas")
        picture, sentence = canvas.evaluate("c => c.toDataURL()"), words(page, name)
        move(page, name, slider.name, slider.values.index(0))
        page.wait_for_selector(".pfedu-status:has-text('broken on purpose')")
        assert "The last picture stays" in figure(page, name).locator(".pfedu-status").inner_text()
        assert canvas.evaluate("c => c.toDataURL()") == picture and words(page, name) == sentence
        move(page, name, slider.name, slider.values.index(1))
        shows(page, name, said_natively(page, name)["sentence"])
        assert "Live" in figure(page, name).locator(".pfedu-status").inner_text()
