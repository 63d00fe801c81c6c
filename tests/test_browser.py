"""The HTML pages in a real browser: no message, no network, all by keyboard, and for all readers.

`make browser` installs what they need: Playwright's Python package, Chromium and axe. Where one is
missing they are skipped, with the reason.
"""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import ssac
from experiments.report.report import make_animation, read_results, report_page
from ssac.camera import Camera
from ssac.files.hdf5 import save_events_h5
from ssac.files.track_files import save_track
from tests.experiments.reported import made_up_runs, record_flight, write_results
from tests.ssac.synthetic import HEIGHT, WIDTH, K
from tests.ssac.tracks import frame_track

playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright: make browser")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
AXE = Path(__file__).parents[1] / "out/node_modules/axe-core/axe.min.js"
SCREENS = [(width, scheme) for width in (1400, 400) for scheme in ("light", "dark")]
KINDS = ("answered", "refused", "several", "results")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("needs Chromium: make browser")
    with playwright.sync_playwright() as running:
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []  # as in a container
        browser = running.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def pages(recorded, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    pair, rig = [Path(file) for file in recorded.pair], recorded / "rig.yaml"
    found = {kind: folder / f"{kind}.html" for kind in KINDS}
    ssac.sync(*pair, rig).report(found["answered"])
    events = ssac.load_events(pair[1]).events
    save_events_h5(folder / "few.h5", events[::400], WIDTH, HEIGHT)
    refused = ssac.sync(pair[0], folder / "few.h5", rig)
    assert not refused.has_offset
    refused.report(found["refused"])
    tracks = [folder / f"cam{k}.csv" for k in (1, 2, 3)]
    for k, track in enumerate(tracks):
        save_track(track, frame_track(recorded.scene, min(k + 1, 2), 30.0 + k))
    ssac.sync(tracks, [Camera(K, WIDTH, HEIGHT)] * 3).report(found["several"])
    record_flight(folder / "flight")
    write_results(folder, made_up_runs(flights=2))
    page = report_page(read_results(folder), make_animation(folder / "flight"))
    found["results"].write_text(page, encoding="utf-8")
    return found


class Opened:
    """A page in the browser, and what it said and asked for since."""

    def __init__(self, browser: Any, page: Path, width: int = 1400, **looks: str) -> None:
        # Without its own policy, under which axe could not be put into it.
        self.context = browser.new_context(
            viewport={"width": width, "height": 900}, bypass_csp=True, **looks
        )
        self.page = self.context.new_page()
        self.messages: list[str] = []
        self.page.on("console", lambda message: self.messages.append(message.text))
        self.page.on("pageerror", lambda error: self.messages.append(str(error)))
        self.page.on("request", self._asked)
        self.page.goto(page.as_uri())
        self.page.wait_for_selector("#player[data-ready]", state="attached")

    def _asked(self, request: Any) -> None:
        if not request.url.startswith(("data:", "blob:", "file:")):
            self.messages.append(request.url)

    def part(self, name: str) -> Any:
        return self.page.locator(f'[data-part="{name}"]')

    def drawn(self, name: str) -> int:
        """How many pixels of a canvas are not empty."""
        script = """canvas => canvas.getContext("2d").getImageData(0, 0, canvas.width,
            canvas.height).data.filter((value, i) => i % 4 === 3 && value).length"""
        return int(self.part(name).evaluate(script))


@pytest.fixture
def opened(browser: Any, pages: dict[str, Path]) -> Iterator[Any]:
    made: list[Opened] = []

    def make(kind: str, **screen: Any) -> Opened:
        made.append(Opened(browser, pages[kind], **screen))
        return made[-1]

    yield make
    for one in made:
        one.context.close()


@pytest.mark.parametrize("kind", KINDS)
def test_the_player_runs_without_a_message_or_a_request(kind: str, opened: Any) -> None:
    page = opened(kind)
    page.page.wait_for_timeout(200)  # a few frames
    assert page.drawn("view1") > 0
    assert (page.drawn("scene") > 0) == (kind != "refused")
    play, time = page.part("play"), page.part("time")
    if play.inner_text() == "Pause":  # the page of results plays by itself
        play.click()
    before = time.input_value()
    play.click()
    page.page.wait_for_function(
        "before => document.querySelector('[data-part=\"time\"]').value !== before", arg=before
    )
    play.click()
    page.page.emulate_media(reduced_motion="reduce")  # the offset jumps, and need not be waited for
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
def test_the_keyboard_reaches_and_moves_all_controls(kind: str, opened: Any) -> None:
    page = opened(kind)
    controls = page.page.locator("button:visible, input:visible, select:visible, summary:visible")
    wanted, reached = controls.count(), set[str]()
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


@pytest.mark.parametrize(("width", "scheme"), SCREENS)
@pytest.mark.parametrize("kind", KINDS)
def test_all_readers_can_read_it(kind: str, width: int, scheme: str, opened: Any) -> None:
    if not AXE.exists():
        pytest.skip("needs axe: make browser")
    # What moves would be drawn anew all the while that axe looks at it.
    page = opened(kind, width=width, color_scheme=scheme, reduced_motion="reduce")
    page.page.evaluate(
        "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
    )
    page.page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.page.evaluate("axe.run(document, { resultTypes: ['violations'] })")
    said = [
        f"{one['id']}: {one['nodes'][0]['html'][:200]}: {one['nodes'][0]['failureSummary']}"
        for one in found["violations"]
    ]
    assert said == []
    assert page.page.evaluate("document.documentElement.scrollWidth") <= width
