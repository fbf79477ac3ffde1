"""The built book in a real browser: what a reader sees before, while and after Python comes up, and what may go wrong.

The network is closed in all of these tests: whatever a page asks of another site is refused and recorded.
"""

import io
import json
import re
import zipfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from pfedu.explorers import Seed, load
from pfedu.live.browser import render
from pfedu.live.page import PYODIDE

pytestmark = pytest.mark.browser

UP = 180_000  # ms that Python may take to come up on a slow machine


@contextmanager
def reading(chromium, address, **options):
    """A page with everything it asks of others, and every error, recorded."""
    context = chromium.new_context(**{"viewport": {"width": 1280, "height": 900}} | options)
    page = context.new_page()
    page.foreign, page.errors, page.asked = [], [], []

    def guard(route):
        page.foreign.append(route.request.url)
        route.abort()

    context.route(lambda url: not url.startswith((address, "data:", "blob:", "file:")), guard)
    page.on("request", lambda request: page.asked.append(request.url))
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.on("console", lambda message: message.type == "error" and page.errors.append(message.text))
    try:
        yield page
    finally:
        context.close()


def explorer_pages(folder):
    """(page, name) of every explorer in the built book."""
    found = []
    for file in sorted(Path(folder).rglob("*.html")):
        text = file.read_text(encoding="utf-8")
        found += [(file.relative_to(folder).as_posix(), name) for name in re.findall(r'data-explorer="(\w+)"', text)]
    return found


def all_pages(folder):
    """Every page but index.html, which only leads on to the first."""
    found = [file.relative_to(folder) for file in sorted(Path(folder).rglob("*.html"))]
    own = [file for file in found if not {"_static", "_modules"} & {*file.parts}]
    return [file.as_posix() for file in own if file.as_posix() != "index.html"]


@pytest.fixture(scope="session")
def explorers(book_folder):
    found = explorer_pages(book_folder)
    assert found, "the book has no explorer"
    return found


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
    page.wait_for_function(
        "([name, sentence]) => sentence === document.querySelector("
        "`[data-explorer='${name}'] .pfedu-sentence`).textContent",
        arg=[name, sentence], timeout=timeout)  # fmt: skip


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


# ---- every page ---------------------------------------------------------------------------------------------------


def test_no_page_errs_or_asks_another_site(chromium, book_folder, book):
    for path in all_pages(book_folder):
        with reading(chromium, book) as page:
            page.goto(book + path, wait_until="load")
            page.wait_for_timeout(700)
            assert page.errors == [], path
            assert page.foreign == [], path
            raw = page.evaluate("document.querySelectorAll('mjx-merror, .problematic').length")
            assert raw == 0, f"{path}: mathematics or a reference that did not resolve"


def test_index_leads_to_the_preface(chromium, book):
    with reading(chromium, book) as page:
        page.goto(book)
        page.wait_for_url("**/preface.html")
        assert "Particle Filters" in page.title()


def test_every_picture_is_there_and_has_words(chromium, book_folder, book):
    for path in all_pages(book_folder):
        with reading(chromium, book) as page:
            page.goto(book + path, wait_until="load")
            bad = page.evaluate(
                "[...document.querySelectorAll('article img')].filter(i => !i.naturalWidth"
                " || !(i.getAttribute('alt') || '').trim() || /^\\.\\.|_images/.test(i.alt)).map(i => i.src)"
            )
            assert bad == [], path


@pytest.mark.parametrize("width", [390, 1280])
def test_no_page_scrolls_sideways(chromium, book_folder, book, width):
    for path in all_pages(book_folder):
        with reading(chromium, book, viewport={"width": width, "height": 800}) as page:
            page.goto(book + path, wait_until="load")
            page.wait_for_timeout(500)
            over = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
            assert over <= 0, f"{path} is {over} px wider than the screen"


# ---- before any script, and without Python ------------------------------------------------------------------------


def test_picture_without_script_from_a_file_and_on_paper(chromium, book_folder, explorers):
    for path, name in explorers:
        with reading(chromium, "file://", java_script_enabled=False) as page:
            page.goto((Path(book_folder) / path).as_uri())
            poster = figure(page, name).locator(".pfedu-poster")
            size = Path(book_folder) / path  # natural size cannot be asked without script: the screenshot shows it
            assert size.exists() and len(poster.screenshot()) > 20_000
            assert load(name).defaults() and len(poster.get_attribute("alt")) > 60
            assert not figure(page, name).locator(".pfedu-controls").is_visible()
            page.emulate_media(media="print")
            assert poster.is_visible() and not figure(page, name).locator(".pfedu-controls").is_visible()


def test_frames_answer_the_first_drag_though_python_cannot_be_had(chromium, book, explorers):
    for path, name in explorers:
        with reading(chromium, book) as page:
            page.goto(book + path)
            assert page.foreign == []
            for control in load(name).controls:
                start = positions(page, name)
                move(page, name, control.name, elsewhere(control, start[control.name]))
                shows(page, name, said_natively(page, name)["sentence"])
                picture = figure(page, name).locator(".pfedu-poster")
                assert picture.get_attribute("src").endswith(
                    f"-{control.name}-{positions(page, name)[control.name]}.png"
                )
                page.wait_for_function("i => i.complete && i.naturalWidth > 0", arg=picture.element_handle())
                figure(page, name).locator(".pfedu-reset").click()
                assert positions(page, name) == start
            page.wait_for_selector('.pfedu-explorer[data-python="failed"]')
            status = figure(page, name).locator(".pfedu-status").inner_text()
            assert "Python could not be loaded" in status and "still answer" in status
            assert page.foreign and all(url.startswith(PYODIDE) for url in page.foreign)
            assert figure(page, name).get_attribute("data-state") == "frame"


def test_nearest_frame_says_so_and_two_controls_moved_do_not_lie(chromium, book, explorers):
    for path, name in explorers:
        with reading(chromium, book) as page:
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
            first, second = controls[:2]
            move(page, name, first.name, elsewhere(first, start[first.name]))
            shown = words(page, name)
            move(page, name, second.name, elsewhere(second, start[second.name]))
            assert shown != before and words(page, name) == shown
            assert re.search("Several controls have been moved", status.inner_text())


def test_controls_are_labelled_and_answer_to_the_keyboard(chromium, book, explorers):
    for path, name in explorers:
        with reading(chromium, book) as page:
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
            texts = load(name).controls[
                [c.name for c in load(name).controls].index(slider.get_attribute("data-control"))
            ]
            assert slider.get_attribute("aria-valuetext") == texts.text(texts.values[int(before) + 1])


def test_a_phone_gets_the_narrow_picture(chromium, book, explorers):
    for path, name in explorers:
        with reading(chromium, book, viewport={"width": 390, "height": 800}) as page:
            page.goto(book + path)
            poster = figure(page, name).locator(".pfedu-poster")
            assert "/narrow-" in poster.evaluate("i => i.currentSrc")
            assert poster.evaluate("i => i.clientWidth") > 300
            last = figure(page, name).locator(".pfedu-control").nth(4)
            last.evaluate("control => control.scrollIntoView({block: 'end'})")
            page.wait_for_timeout(300)
            top = figure(page, name).locator(".pfedu-picture").evaluate("p => p.getBoundingClientRect().top")
            assert 0 < top < 100, "the picture is out of sight while its controls are moved"


def test_opened_as_a_file_it_says_why_python_does_not_start(chromium, book_folder, explorers):
    path, name = explorers[0]
    with reading(chromium, "file://") as page:
        page.goto((Path(book_folder) / path).as_uri())
        control = load(name).controls[0]
        move(page, name, control.name, elsewhere(control, positions(page, name)[control.name]))
        shows(page, name, said_natively(page, name)["sentence"])
        page.wait_for_selector('.pfedu-explorer[data-python="failed"]')
        assert "Python could not be loaded" in figure(page, name).locator(".pfedu-status").inner_text()


# ---- Python in the page -------------------------------------------------------------------------------------------


def test_python_answers_every_control_with_the_native_numbers(chromium, own_book, explorers):
    for path, name in explorers:
        with reading(chromium, own_book) as page:
            page.goto(own_book + path)
            wake(page, name)
            canvas, controls = figure(page, name).locator("canvas"), load(name).controls
            for control in controls:  # alone
                before, start = canvas.evaluate("c => c.toDataURL()"), words(page, name)
                move(page, name, control.name, elsewhere(control, positions(page, name)[control.name]))
                _native_numbers_are_shown(page, name)
                moved = canvas.evaluate("c => c.toDataURL()") != before
                assert moved, f"{name}: {control.name} moved and the picture did not"
                figure(page, name).locator(".pfedu-reset").click()
                shows(page, name, start)
            for control in controls:  # on top of each other
                move(page, name, control.name, elsewhere(control, positions(page, name)[control.name]))
                _native_numbers_are_shown(page, name)
            assert figure(page, name).get_attribute("data-state") == "live"
            assert page.errors == [] and page.foreign == []
            assert sum("worker.js" in url for url in page.asked) == 1


def _native_numbers_are_shown(page, name):
    native = said_natively(page, name)
    shows(page, name, native["sentence"])
    table = [float(text) for text in figure(page, name).locator(".pfedu-numbers td").all_text_contents()]
    assert table == pytest.approx(list(native["numbers"].values()), rel=1e-5, abs=1e-9)


def test_numbers_of_the_page_equal_the_native_ones(chromium, own_book, explorers):
    """Straight from the worker, without rounding: the same bits in, the same numbers out."""
    path, name = explorers[0]
    with reading(chromium, own_book) as page:
        page.goto(own_book + path)
        for shift in (0, 3):
            where = {c.name: (c.values.index(c.default) + shift) % len(c.values) for c in load(name).controls}
            numbers = page.evaluate(
                """([name, positions]) => new Promise((done, fail) => {
                    const script = document.querySelector('script[data-pyodide]');
                    const at = f => new URL(f, script.src).href;
                    const worker = new Worker(at('worker.js'));
                    worker.onmessage = ({data}) => {
                        if (data.ready) worker.postMessage({id: 1, name, layout: 'wide', positions});
                        if (data.failed || data.error) fail(new Error(data.failed || data.error));
                        if (data.id) { worker.terminate(); done(data.words.numbers); }
                    };
                    worker.postMessage({start: {pyodide: at(script.dataset.pyodide), pfedu: at('pfedu.zip')}});
                })""",
                [name, where],
            )
            native = json.loads(render(name, "wide", json.dumps(where))[1])["numbers"]
            assert list(numbers) == list(native)
            assert list(numbers.values()) == pytest.approx(list(native.values()), rel=1e-9)


def test_newest_position_wins_and_nothing_queues_up(chromium, own_book, explorers):
    path, name = explorers[0]
    with reading(chromium, own_book) as page:
        page.goto(own_book + path)
        wake(page, name)
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


def test_an_error_in_a_redraw_is_said_and_the_explorer_goes_on(chromium, own_book, book_folder, explorers):
    path, name = explorers[0]
    slider = next(c for c in load(name).controls if 0 in c.values and 1 in c.values)
    with reading(chromium, own_book) as page:
        archive = _broken_archive(book_folder, slider.name.encode())
        page.route("**/pfedu.zip*", lambda route: route.fulfill(body=archive, content_type="application/zip"))
        page.goto(own_book + path)
        wake(page, name)
        canvas = figure(page, name).locator("canvas")
        picture, sentence = canvas.evaluate("c => c.toDataURL()"), words(page, name)
        move(page, name, slider.name, slider.values.index(0))
        page.wait_for_function("document.querySelector('.pfedu-status').textContent.includes('broken on purpose')")
        assert "The last picture stays" in figure(page, name).locator(".pfedu-status").inner_text()
        assert canvas.evaluate("c => c.toDataURL()") == picture and words(page, name) == sentence
        move(page, name, slider.name, slider.values.index(1))
        shows(page, name, said_natively(page, name)["sentence"])
        assert "Live" in figure(page, name).locator(".pfedu-status").inner_text()


def test_slow_python_shows_progress_and_frames_meanwhile(chromium, own_book, explorers):
    path, name = explorers[0]
    with reading(chromium, own_book) as page:
        page.goto(own_book + path)
        held = []
        page.context.route("**/pyodide.asm.wasm", lambda route: held.append(route))
        control = next(c for c in load(name).controls if not isinstance(c, Seed))
        move(page, name, control.name, elsewhere(control, positions(page, name)[control.name]))
        shows(page, name, said_natively(page, name)["sentence"])
        page.wait_for_function("/Loading Python.*MB/.test(document.querySelector('.pfedu-status').textContent)")
        assert figure(page, name).get_attribute("data-state") == "frame"
        held[0].continue_()
        page.wait_for_selector('.pfedu-explorer[data-state="live"]', timeout=UP)
        shows(page, name, said_natively(page, name)["sentence"])
