"""Reports in a real browser, as `make pages` looks at them: nothing fails, nothing is cut, all can read.

Needs Playwright (`tests/browser/requirements.lock`) and a Chromium on PATH.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from matplotlib.figure import Figure
from support import command_line, injection_payloads
from support.case_tables import run_cases

from bayesdrill.report import style
from bayesdrill.report.render import as_html
from bayesdrill.report.section import Link, Picture, Section

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent.parent
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
QUIET = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync")
SIZES = {
    "desktop": (1280, 900),
    "laptop": (1200, 800),
    "tablet": (800, 1100),
    "phone": (390, 844),
    "narrow": (320, 640),
}

DRAWN = ("output: {predictive_draws: 10, figures: []}", "output: {predictive_draws: 10}")
WORSE = (
    "w_1: {column: w_1, unit: rad/s, sigma: 0.05}",
    "w_1: {column: w_1, unit: rad/s, sigma: 0.01}",
)
SHORT = ("n_tau: 5, ess: 100, max_steps: 500", "n_tau: 500, ess: 100, max_steps: 100")
TINY = (
    "output: {",
    "calibration: {refits: 10, draws: 19, n_tau: 5, ess: 50, max_steps: 600}\noutput: {",
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    playwright = pytest.importorskip("playwright.sync_api")
    if not CHROMIUM:
        pytest.skip("there is no chromium on PATH")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=list(QUIET))
        yield found
        found.close()


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Of a run that is sound, of one that does not fit, of one that stopped early, of a calibration."""
    made = {}
    kinds = {"sound": (DRAWN,), "worse": (DRAWN, WORSE), "short": (DRAWN, SHORT)}
    for name, changes in kinds.items():
        place = tmp_path_factory.mktemp(name)
        config = command_line.small_config(place, *changes)
        command_line.cli("posterior", config, "-o", place / "out", "--processes", "1")
        made[name] = place / "out" / "report.html"
    place = tmp_path_factory.mktemp("calibration")
    config = command_line.small_config(place, TINY)
    command_line.cli("calibrate", config, "-o", place / "out", "--processes", "1")
    made["calibration"] = place / "out" / "report.html"
    paper = ROOT / "results" / "paper" / "report.html"
    return made | ({"paper": paper} if paper.exists() else {})


NAMES = ("sound", "worse", "short", "calibration", "paper")


@pytest.fixture(params=NAMES)
def path(pages: dict[str, Path], request: pytest.FixtureRequest) -> Path:
    if request.param not in pages:
        pytest.skip("`make paper` was not run here")
    return pages[request.param]


@dataclass
class Heard:
    """What a page says aloud, and whom it asks for something."""

    messages: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)


def opened(browser: Browser, path: Path, size: str, scheme: Any = "light") -> tuple[Page, Heard]:
    width, height = SIZES[size]
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme, offline=True
    )
    page, heard = context.new_page(), Heard()
    page.on("console", lambda message: heard.messages.append(message.text))
    page.on("pageerror", lambda error: heard.messages.append(str(error)))
    page.on("request", lambda request: heard.asked.append(request.url))
    page.goto(path.as_uri())
    page.wait_for_load_state()
    return page, heard


@run_cases("size", SIZES)
def test_nothing_fails_and_nothing_is_cut(browser: Browser, path: Path, size: str) -> None:
    page, heard = opened(browser, path, size)
    assert not heard.messages
    assert [url for url in heard.asked if not url.startswith("data:")] == [path.as_uri()]
    loaded = (
        "[...document.querySelectorAll('figure img')].map(i => i.complete && i.naturalWidth > 100)"
    )
    images = page.evaluate(loaded)
    assert images
    assert all(images)
    assert page.evaluate("document.documentElement.scrollWidth") <= SIZES[size][0]
    beyond = """[...document.querySelectorAll('h1, h2, p, li, figure')].filter(
        e => e.offsetParent && e.getBoundingClientRect().right > innerWidth + 1).length"""
    assert page.evaluate(beyond) == 0
    wide = """[...document.querySelectorAll('.scroll')].filter(
        e => e.scrollWidth > e.clientWidth + 1).map(e => e.getAttribute('aria-label'))"""
    assert page.evaluate(wide) == []


@run_cases("inches", [3.4, 5.0, 7.0])
@run_cases("size", SIZES)
def test_points_that_link_lie_over_the_points_of_the_picture(
    browser: Browser, tmp_path: Path, size: str, inches: float
) -> None:
    """Narrow figures are shown in a part of the page's width, and their links with them."""
    style.save(Figure(figsize=(inches, 2.0)), tmp_path, "runs", {}, formats=("png",))
    picture = Picture("runs", "runs", "png", (Link(0.5, 0.5, "run_1", ""),))
    path = tmp_path / "page.html"
    path.write_text(as_html("t", "campaign", [Section("s", (picture,))], tmp_path))
    boxes = """['.zoom img', '.links'].map(e => document.querySelector(e).getBoundingClientRect())
        .map(b => [b.left, b.top, b.width, b.height])"""
    page, _ = opened(browser, path, size)
    shown, links = page.evaluate(boxes)
    assert links == pytest.approx(shown, abs=0.5)


@run_cases("scheme", ["light", "dark"])
@run_cases("size", ["desktop", "phone"])
def test_all_can_read_it(browser: Browser, path: Path, size: str, scheme: str) -> None:
    """By the rules of axe: contrast, names, landmarks, what can be reached by keyboard."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page, _ = opened(browser, path, size, scheme)
    found = axe.run(page)
    assert found.violations_count == 0, found.generate_report()


def test_a_dark_scheme_has_light_text_on_dark_paper(browser: Browser, path: Path) -> None:
    paper = "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3).map(Number)"
    light, dark = (
        sum(opened(browser, path, "desktop", scheme)[0].evaluate(paper))
        for scheme in ("light", "dark")
    )
    assert dark < 150 < 600 < light


@run_cases("size", ["desktop", "phone"])
def test_a_figure_opens_at_its_full_size_and_closes_by_keyboard(
    browser: Browser, path: Path, size: str
) -> None:
    page, heard = opened(browser, path, size)
    button = page.locator("button.zoom").first
    width = button.locator("img").evaluate("i => i.naturalWidth")
    button.focus()
    page.keyboard.press("Enter")
    dialog = page.locator("dialog")
    assert dialog.is_visible()
    assert dialog.locator("img").evaluate("i => i.getBoundingClientRect().width") == width
    page.keyboard.press("Escape")
    assert not dialog.is_visible()
    assert not heard.messages


@pytest.fixture(scope="module")
def hostile_pages(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Of every kind that shows texts of users: a run, a maximum, a calibration, runs side by side."""
    place = tmp_path_factory.mktemp("hostile") / injection_payloads.RUNS
    config = injection_payloads.small(place)
    config.write_text(config.read_text().replace("output: {", TINY[1]))
    runs = [place / f"{name} {injection_payloads.FILE}" for name in ("one", "two")]
    for run in runs:
        command_line.cli("posterior", config, "-o", run, "--processes", "1")
    for command in ("map", "calibrate"):
        command_line.cli(command, config, "-o", place / command, "--processes", "1")
    for command in ("report", "compare"):
        command_line.cli(command, *runs, "-o", place / command)
    folders = [*runs, *(place / name for name in ("map", "calibrate", "report", "compare"))]
    return [folder / "report.html" for folder in folders]


def test_no_text_of_a_user_runs(browser: Browser, hostile_pages: list[Path]) -> None:
    """And the script of the page does."""
    for path in hostile_pages:
        page, heard = opened(browser, path, "desktop")
        assert page.evaluate("window.owned") is None, path
        assert page.title().split(" · ")[0] == page.locator("h1").inner_text()
        assert page.evaluate("document.querySelectorAll('img[src=x], [onerror]').length") == 0
        page.locator("button.zoom").first.click()
        assert page.locator("dialog").is_visible()
        page.locator("dialog form button").click()
        assert not page.locator("dialog").is_visible()
        assert not heard.messages, (path, heard.messages)


def test_a_page_runs_no_script_but_its_own(browser: Browser, pages: dict[str, Path]) -> None:
    """Were text taken for HTML after all, by what the page itself forbids."""
    html = pages["sound"].read_text(encoding="utf-8")
    bad = "<img src=x onerror='window.owned=1'><script>window.owned=1</script><p style='color:red'>"
    path = pages["sound"].with_name("bad.html")
    path.write_text(html.replace("<main>", f"<main>{bad}"), encoding="utf-8")
    page, heard = opened(browser, path, "desktop")
    assert page.evaluate("window.owned") is None
    assert len([message for message in heard.messages if "Content Security Policy" in message]) >= 3
    page.locator("button.zoom").first.click()
    assert page.locator("dialog").is_visible()


def test_it_prints_on_paper_with_nothing_beyond_its_edge(browser: Browser, path: Path) -> None:
    page, _ = opened(browser, path, "desktop")
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 688, "height": 1000})  # A4 between its margins
    beyond = """[...document.querySelectorAll('table, figure img, pre, p, li')]
        .filter(e => e.offsetParent && e.getBoundingClientRect().right > 690)
        .map(e => e.outerHTML.slice(0, 80))"""
    assert page.evaluate(beyond) == []
    assert page.pdf(prefer_css_page_size=True).startswith(b"%PDF")


def test_a_run_not_to_be_believed_says_so_before_all_else(
    browser: Browser, pages: dict[str, Path]
) -> None:
    for name, words in {"worse": "does not fit", "short": "not converged"}.items():
        page, _ = opened(browser, pages[name], "phone")
        mark = page.locator(".marks .bad").first
        assert mark.inner_text() == words
        box = mark.bounding_box()
        assert box is not None
        assert box["y"] < SIZES["phone"][1]
