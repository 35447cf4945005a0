"""Pages in a real browser as wide as a phone and a screen: nothing outside, nothing fetched, all moves."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from helpers import REPOSITORY

pytestmark = pytest.mark.check

WIDTHS = (390, 1300)
#: Longest page [bytes].
LARGEST = 5_000_000
#: Commands that write the pages, in order: the first one writes the log that others read.
COMMANDS = {
    "log": "drive --scenario track --seed 3 --duration 24 --log {out}/run.csv --out {out}",
    "demo": "demo --quick --only soil drive --out {out}",
    "replay": "replay {out}/run.csv --structure full grid --out {out}",
    "diagnosis": "diagnose {out}/run.csv --out {out}",
    "benchmark": "benchmark --tasks speed --agents nominal conservative aware oracle --episodes 2 "
    "--forms matched --no-policies --out {out}",
    "table1": "reproduce table1 --rows 1 --seeds 1 --out {out}",
}
PAGES = tuple(name for name in COMMANDS if name != "log")
#: A study plays no drive back.
PLAYED = tuple(name for name in PAGES if name != "table1")
#: Elements outside the screen that no scrollable box holds.
OUTSIDE = """() => [...document.body.querySelectorAll("*")].filter(element => {
  const box = element.getBoundingClientRect();
  const held = element.parentElement.closest(".wide, .picture");  // boxes that can be scrolled
  if (!box.width || !box.height || held) return false;
  return box.right > innerWidth + 1 || box.left < -1;
}).map(element => `${element.tagName} ${element.className} ${element.textContent.slice(0, 40)}`)"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Name -> path of each page, made by its command."""
    out = tmp_path_factory.mktemp("pages")
    for words in COMMANDS.values():
        command = [sys.executable, "-m", "agents.commands.cli", *words.format(out=out).split()]
        done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    return {name: out / f"{name}.html" for name in PAGES}


@pytest.fixture
def opened(browser, pages):
    """Opens a page at a width; what it asks the network for is listed as ``requests``."""
    contexts = []

    def open_page(name: str, width: int):
        context = browser.new_context(viewport={"width": width, "height": 844}, offline=True)
        contexts.append(context)
        page = context.new_page()
        page.requests, page.errors = [], []
        page.on("request", lambda request: page.requests.append(request.url))
        page.on("pageerror", lambda error: page.errors.append(str(error)))
        page.goto(Path(pages[name]).as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()


def drawn(page, name: str) -> str:
    """What a canvas of the first playback shows."""
    return page.eval_on_selector(f".playback canvas.{name}", "canvas => canvas.toDataURL()")


@pytest.mark.parametrize("name", PAGES)
def test_a_page_has_five_megabytes_at_most(pages, name):
    assert pages[name].stat().st_size <= LARGEST


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", PAGES)
def test_nothing_lies_outside_the_screen_and_nothing_is_fetched(opened, name, width):
    page = opened(name, width)
    page.eval_on_selector_all("details", "all => all.forEach(one => { one.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate(OUTSIDE) == []
    assert [url for url in page.requests if not url.startswith(("file:", "data:"))] == []
    assert page.errors == []


@pytest.mark.parametrize("name", PAGES)
def test_a_page_begins_with_its_verdict(opened, name):
    page = opened(name, 390)
    verdict = page.locator(".verdict p")
    assert verdict.inner_text().endswith(".")
    assert verdict.bounding_box()["y"] < 400.0  # seen without scrolling


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", PLAYED)
def test_the_scrubber_moves_the_vehicle_and_turns_the_wheels(opened, name, width):
    page = opened(name, width)
    before, place = (
        {view: drawn(page, view) for view in ("above", "wheels")},
        page.locator(".where").inner_text(),
    )
    slider = page.locator(".playback input[type=range]")
    slider.fill(str(int(slider.get_attribute("max")) // 2))
    assert page.locator(".where").inner_text() != place
    assert all(drawn(page, view) != picture for view, picture in before.items())


def test_the_button_plays_and_stops(opened):
    page = opened("demo", 1300)
    button, slider = page.locator(".bar button"), page.locator(".playback input[type=range]")
    button.click()
    page.wait_for_function("document.querySelector('.playback').player.index > 3")
    button.click()
    held = slider.input_value()
    page.wait_for_timeout(200)
    assert slider.input_value() == held != "0"


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", PLAYED)
def test_a_zoom_of_one_chart_zooms_all(opened, name, width):
    page = opened(name, width)
    chart = page.locator(".playback canvas.chart").nth(1)
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 60.0)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 60.0, steps=4)
    page.mouse.up()
    stretches = "all => [...new Set(all.map(one => `${one.dataset.from} ${one.dataset.to}`))]"
    (zoomed,) = page.eval_on_selector_all(".playback canvas.chart", stretches)
    begin, end = map(float, zoomed.split())
    whole = page.evaluate("document.querySelector('.playback').player.whole[1]")
    assert 0.2 * whole < end - begin < 0.45 * whole
    assert begin > 0.2 * whole
    chart.dblclick()
    (again,) = page.eval_on_selector_all(".playback canvas.chart", stretches)
    assert again == f"0 {whole:g}" or float(again.split()[1]) == whole
