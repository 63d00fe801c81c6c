"""Tests the HTML pages in a real browser: messages, requests, use by keyboard, accessibility.

`make browser` installs what they need: Playwright's Python package, Chromium and axe; `make docs`
builds the site. A test whose tools are missing is skipped, with the reason, or fails where
SSAC_BROWSER is "required", as in `.ci/run`.
"""

import os
import re
import shutil
from pathlib import Path

import pytest

import ssac
from experiments.report.report import make_animation, read_results, report_page
from ssac.camera import Camera
from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import save_track
from tests.experiments.reported import made_up_runs, record_flight, write_results
from tests.ssac.synthetic import HEIGHT, WIDTH, K
from tests.ssac.tracks import frame_track


def missing(what, command="browser"):
    """Skip the test, or fail it where SSAC_BROWSER is "required"."""
    reason = f"needs {what}: make {command}"
    if os.environ.get("SSAC_BROWSER") == "required":
        pytest.fail(reason)
    pytest.skip(reason, allow_module_level=True)


try:
    from playwright import sync_api as playwright
except ImportError:
    missing("Playwright")

ROOT = Path(__file__).parents[1]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
AXE = ROOT / "out/node_modules/axe-core/axe.min.js"
DOCS = ROOT / "out/docs"
SCREENS = [(width, scheme) for width in (1400, 400) for scheme in ("light", "dark")]
KINDS = ("answered", "refused", "several", "results")
SITE = {
    "index": "index.html",
    "sync": "docs/sync.html",
    "tour": "docs/generated/tour/tour.html",
    "reference": "docs/generated/api/ssac.search.html",
    "tables": "results/README.html",
    "search": "search.html?q=refusal",
}
LOOKS = [(kind, *screen) for kind in KINDS for screen in SCREENS]
LOOKS += [(kind, *screen) for kind in SITE for screen in (SCREENS[0], SCREENS[-1])]


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        missing("Chromium")
    with playwright.sync_playwright() as running:
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []  # as in a container
        browser = running.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def pages(recorded, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    pair, rig = [Path(file) for file in recorded.pair], recorded / "rig.yaml"
    found = {kind: folder / f"{kind}.html" for kind in KINDS}
    ssac.sync(*pair, rig).report(found["answered"])
    events = ssac.load_events(pair[1]).events
    save_events_h5(folder / "few.h5", events[::400], WIDTH, HEIGHT)
    refused = ssac.sync(pair[0], folder / "few.h5", rig)
    assert not refused.has_offset
    refused.report(found["refused"])
    save_track(folder / "cam3.csv", frame_track(recorded.scene, 2, 30.0))
    several = ssac.sync([*pair, folder / "cam3.csv"], [Camera(K, WIDTH, HEIGHT)] * 3)
    several.report(found["several"])
    record_flight(folder / "flight")
    write_results(folder, made_up_runs(flights=2))
    page = report_page(read_results(folder), make_animation(folder / "flight"))
    found["results"].write_text(page, encoding="utf-8")
    return found


@pytest.fixture
def opened(browser, pages):
    """Opens pages, which keep their messages and their requests for addresses not their own."""
    made = []

    def make(kind, width=1400, **looks):
        if kind in SITE and not (DOCS / "index.html").exists():
            missing("the site", "docs")
        own = DOCS.as_uri() if kind in SITE else pages[kind].as_uri()
        # The page's own content security policy is bypassed, as it would keep axe out.
        size = {"width": width, "height": 900}
        page = browser.new_page(viewport=size, bypass_csp=True, **looks)
        made.append(page)
        page.messages = said = []
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        is_own = ("data:", "blob:", own)
        page.on("request", lambda one: one.url.startswith(is_own) or said.append(one.url))
        page.goto(f"{own}/{SITE[kind]}" if kind in SITE else own)
        if kind not in SITE:
            page.wait_for_selector("#player[data-ready]", state="attached")
        return page

    yield make
    for page in made:
        page.close()


def part(page, name):
    return page.locator(f'[data-part="{name}"]')


def drawn(page, name):
    """Count the pixels of a canvas that are not empty."""
    script = """canvas => canvas.getContext("2d").getImageData(0, 0, canvas.width,
        canvas.height).data.filter((value, i) => i % 4 === 3 && value).length"""
    return int(part(page, name).evaluate(script))


def unfold(page):
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")


@pytest.mark.parametrize("kind", KINDS)
def test_the_player_runs_without_a_message_or_a_request(kind, opened):
    page = opened(kind)
    page.wait_for_timeout(200)  # a few frames
    assert drawn(page, "view1") > 0
    assert (drawn(page, "scene") > 0) == (kind != "refused")
    play, time = part(page, "play"), part(page, "time")
    if play.inner_text() == "Pause":  # the page of results plays by itself
        play.click()
    before = time.input_value()
    play.press("Space")
    page.wait_for_function(
        "before => document.querySelector('[data-part=\"time\"]').value !== before", arg=before
    )
    play.click()
    page.emulate_media(reduced_motion="reduce")  # the offset jumps, without an animation
    if kind != "refused":
        means_px = []
        for button in ("before", "after"):
            part(page, button).click()
            page.wait_for_timeout(100)
            means_px.append(float(part(page, "mean").inner_text().split()[0]))
        assert means_px[1] <= means_px[0]
    if kind == "several":
        page.locator("#pair").select_option("2")
        assert part(page, "name1").inner_text() == "Camera 2"
        assert part(page, "name2").inner_text() == "Camera 3"
    assert page.messages == []


@pytest.mark.parametrize("kind", KINDS)
def test_the_keyboard_reaches_and_moves_all_controls(kind, opened):
    page = opened(kind)
    unfold(page)
    controls = page.locator("button:visible, input:visible, select:visible, summary:visible")
    wanted, reached = controls.count(), set()
    number = """() => { const one = document.activeElement;
        if (!one.matches("button, input, select, summary")) return "";
        one.dataset.number ??= String(window.reached = (window.reached ?? 0) + 1);
        return one.dataset.number; }"""
    for _ in range(10 * wanted):
        page.keyboard.press("Tab")
        reached.add(page.evaluate(number))
        if len(reached - {""}) == wanted:
            break
    assert len(reached - {""}) == wanted
    for name in ("slider", "time", *(("turn", "tilt") if kind != "refused" else ())):
        one = part(page, name)
        one.focus()
        before, key = one.input_value(), "Home" if int(one.input_value()) else "End"
        page.keyboard.press(key)
        page.wait_for_timeout(50)
        assert one.input_value() != before
    assert page.messages == []


@pytest.mark.parametrize(("kind", "width", "scheme"), LOOKS)
def test_all_readers_can_read_it(kind, width, scheme, opened):
    if not AXE.exists():
        missing("axe")
    # Motion is reduced, as animations would be redrawn for as long as axe runs.
    page = opened(kind, width=width, color_scheme=scheme, reduced_motion="reduce")
    unfold(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.messages == []
    page.evaluate(AXE.read_text(encoding="utf-8"))
    # No preload, as pages on a disk may not read their style sheets again.
    found = page.evaluate("axe.run(document, { resultTypes: ['violations'], preload: false })")
    said = [
        f"{one['id']}: {one['nodes'][0]['html'][:200]}: {one['nodes'][0]['failureSummary']}"
        for one in found["violations"]
    ]
    assert said == []


def test_a_search_begins_with_the_page_that_answers(opened):
    page = opened("search")
    page.get_by_text("Search finished").wait_for()
    found = page.locator("#search-results li a")
    assert (found.first.get_attribute("href") or "").startswith("docs/refusal.html")
    assert page.messages == []


@pytest.mark.parametrize("kind", ["index", "tour"])
def test_a_figure_opens_and_closes_by_keyboard(kind, opened):
    page = opened(kind)
    page.locator("button.figure").first.press("Enter")
    dialog = page.locator("dialog")
    dialog.wait_for()
    page.keyboard.press("Escape")
    dialog.wait_for(state="detached")
    # Links show the titles of their pages, and not the names of files.
    assert not re.search(r"\bdocs/\w+\.md\b", page.locator("article").inner_text())


def test_nothing_is_skipped_where_all_could_be_installed(monkeypatch):
    monkeypatch.setenv("SSAC_BROWSER", "required")
    with pytest.raises(pytest.fail.Exception, match="make browser"):
        missing("axe")
