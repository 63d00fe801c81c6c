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


class Opened:
    """A page in the browser, with its messages and its requests for addresses not its own."""

    def __init__(self, browser, address, own, width=1400, **looks):
        # The page's own content security policy is bypassed, as it would keep axe out.
        self.context = browser.new_context(
            viewport={"width": width, "height": 900}, bypass_csp=True, **looks
        )
        self.page = self.context.new_page()
        self.messages = []
        self.page.on("console", lambda message: self.messages.append(message.text))
        self.page.on("pageerror", lambda error: self.messages.append(str(error)))
        self.own = "data:", "blob:", own
        self.page.on("request", self._asked)
        self.page.goto(address)

    def _asked(self, request):
        if not request.url.startswith(self.own):
            self.messages.append(request.url)

    def unfold(self):
        self.page.evaluate(
            "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
        )

    def part(self, name):
        return self.page.locator(f'[data-part="{name}"]')

    def drawn(self, name):
        """Count the pixels of a canvas that are not empty."""
        script = """canvas => canvas.getContext("2d").getImageData(0, 0, canvas.width,
            canvas.height).data.filter((value, i) => i % 4 === 3 && value).length"""
        return int(self.part(name).evaluate(script))


@pytest.fixture
def opened(browser, pages):
    made = []

    def make(kind, **screen):
        if kind in SITE:
            if not (DOCS / "index.html").exists():
                missing("the site", "docs")
            made.append(Opened(browser, f"{DOCS.as_uri()}/{SITE[kind]}", DOCS.as_uri(), **screen))
        else:
            made.append(Opened(browser, pages[kind].as_uri(), pages[kind].as_uri(), **screen))
            made[-1].page.wait_for_selector("#player[data-ready]", state="attached")
        return made[-1]

    yield make
    for one in made:
        one.context.close()


@pytest.mark.parametrize("kind", KINDS)
def test_the_player_runs_without_a_message_or_a_request(kind, opened):
    page = opened(kind)
    page.page.wait_for_timeout(200)  # a few frames
    assert page.drawn("view1") > 0
    assert (page.drawn("scene") > 0) == (kind != "refused")
    play, time = page.part("play"), page.part("time")
    if play.inner_text() == "Pause":  # the page of results plays by itself
        play.click()
    before = time.input_value()
    play.press("Space")
    page.page.wait_for_function(
        "before => document.querySelector('[data-part=\"time\"]').value !== before", arg=before
    )
    play.click()
    page.page.emulate_media(reduced_motion="reduce")  # the offset jumps, without an animation
    if kind != "refused":
        means_px = []
        for button in ("before", "after"):
            page.part(button).click()
            page.page.wait_for_timeout(100)
            means_px.append(float(page.part("mean").inner_text().split()[0]))
        assert means_px[1] <= means_px[0]
    if kind == "several":
        page.page.locator("#pair").select_option("2")
        assert page.part("name1").inner_text() == "Camera 2"
        assert page.part("name2").inner_text() == "Camera 3"
    assert page.messages == []


@pytest.mark.parametrize("kind", KINDS)
def test_the_keyboard_reaches_and_moves_all_controls(kind, opened):
    page = opened(kind)
    page.unfold()
    controls = page.page.locator("button:visible, input:visible, select:visible, summary:visible")
    wanted, reached = controls.count(), set()
    name = """() => { const one = document.activeElement;
        if (!one.matches("button, input, select, summary")) return "";
        one.dataset.number ??= String(window.reached = (window.reached ?? 0) + 1);
        return one.dataset.number; }"""
    for _ in range(10 * wanted):
        page.page.keyboard.press("Tab")
        reached.add(page.page.evaluate(name))
        if len(reached - {""}) == wanted:
            break
    assert len(reached - {""}) == wanted
    for part in ("slider", "time", *(("turn", "tilt") if kind != "refused" else ())):
        one = page.part(part)
        one.focus()
        before, key = one.input_value(), "Home" if int(one.input_value()) else "End"
        page.page.keyboard.press(key)
        page.page.wait_for_timeout(50)
        assert one.input_value() != before
    assert page.messages == []


@pytest.mark.parametrize(("kind", "width", "scheme"), LOOKS)
def test_all_readers_can_read_it(kind, width, scheme, opened):
    if not AXE.exists():
        missing("axe")
    # Motion is reduced, as animations would be redrawn for as long as axe runs.
    page = opened(kind, width=width, color_scheme=scheme, reduced_motion="reduce")
    page.unfold()
    assert page.page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.messages == []
    page.page.evaluate(AXE.read_text(encoding="utf-8"))
    # No preload, as pages on a disk may not read their style sheets again.
    found = page.page.evaluate("axe.run(document, { resultTypes: ['violations'], preload: false })")
    said = [
        f"{one['id']}: {one['nodes'][0]['html'][:200]}: {one['nodes'][0]['failureSummary']}"
        for one in found["violations"]
    ]
    assert said == []


def test_a_search_begins_with_the_page_that_answers(opened):
    page = opened("search")
    page.page.get_by_text("Search finished").wait_for()
    found = page.page.locator("#search-results li a")
    assert (found.first.get_attribute("href") or "").startswith("docs/refusal.html")
    assert page.messages == []


@pytest.mark.parametrize("kind", ["index", "tour"])
def test_a_figure_opens_and_closes_by_keyboard(kind, opened):
    page = opened(kind)
    page.page.locator("button.figure").first.press("Enter")
    dialog = page.page.locator("dialog")
    dialog.wait_for()
    page.page.keyboard.press("Escape")
    dialog.wait_for(state="detached")
    # Links show the titles of their pages, and not the names of files.
    assert not re.search(r"\bdocs/\w+\.md\b", page.page.locator("article").inner_text())


def test_nothing_is_skipped_where_all_could_be_installed(monkeypatch):
    monkeypatch.setenv("SSAC_BROWSER", "required")
    with pytest.raises(pytest.fail.Exception, match="make browser"):
        missing("axe")
