"""Pages in a real browser: they complain of nothing, ask for nothing, and do what they offer."""

from __future__ import annotations

import json

import pytest
from report_browser import opened, started

from orchestrator.report.make import report


@pytest.fixture(scope="module")
def browser():
    with started() as one:
        yield one


@pytest.fixture(scope="module")
def line_page(line_run, tmp_path_factory):
    path = tmp_path_factory.mktemp("pages") / "line.html"
    path.write_text(report([line_run]), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def space_page(space_run, tmp_path_factory):
    path = tmp_path_factory.mktemp("pages") / "space.html"
    path.write_text(report([space_run]), encoding="utf-8")
    return path


def column(page, table: str, index: int) -> list[float]:
    cells = page.locator(f"{table} tbody tr td:nth-child({index})")
    return [float(one) for one in cells.all_text_contents()]


def until(page, true) -> None:
    """Wait for what a page comes to; the page's policy keeps the browser's own way of waiting out."""
    for _ in range(300):
        if true():
            return
        page.wait_for_timeout(100)
    raise AssertionError("the page did not come to it within 30 s")


def test_key_numbers_are_those_of_the_summary(browser, line_run, line_page):
    summary = json.loads((line_run / "summary.json").read_text(encoding="utf-8"))
    with opened(browser, line_page) as page:
        for number, contact in enumerate(summary["contacts"], 1):
            row = page.locator(f'tr[data-key="contacts.{number}"] td[data-value]')
            values = [float(one.get_attribute("data-value")) for one in row.all()]
            assert values == [number, *(value for value in contact.values() if not isinstance(value, str))]
        row = page.locator('tr[data-key="ideal.first_peak_force"] td')
        assert float(row.nth(1).get_attribute("data-value")) == summary["ideal"]["first_peak_force"]
        assert row.nth(2).text_content() == "N"
        assert page.locator(".headline").text_content().startswith("Done: 2 s in 4000 steps of 0.5 ms.")


def test_tables_sort_both_ways_and_by_keyboard(browser, line_page):
    with opened(browser, line_page) as page:
        table = "#contacts + .wide table"
        button = page.locator(f"{table} thead button", has_text="rebound velocity ratio")
        before = column(page, table, 5)
        button.click()
        assert column(page, table, 5) == sorted(before) != before
        assert button.locator("..").get_attribute("aria-sort") == "ascending"
        button.focus()
        page.keyboard.press("Enter")
        assert column(page, table, 5) == sorted(before, reverse=True)


def test_zoom_moves_the_axis_of_all_plots_and_values_are_read(browser, line_page):
    with opened(browser, line_page) as page:
        charts = page.locator(".chart")
        assert charts.count() >= 3
        for index in (0, 1):
            charts.nth(index).scroll_into_view_if_needed()
            charts.nth(index).locator(".u-over").wait_for()

        def span(index: int) -> tuple[float, float]:
            data = charts.nth(index).evaluate("one => [one.dataset.low, one.dataset.high]")
            return float(data[0]), float(data[1])

        charts.nth(0).scroll_into_view_if_needed()
        assert span(0) == pytest.approx((0.0, 2.0))
        box = charts.nth(0).locator(".u-over").bounding_box()
        y = box["y"] + box["height"] / 2
        page.mouse.move(box["x"] + 0.25 * box["width"], y)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.5 * box["width"], y, steps=4)
        page.mouse.up()
        page.wait_for_timeout(200)
        assert span(0) == pytest.approx((0.5, 1.0), abs=0.02)
        assert span(1) == span(0), "plots share their time"
        page.keyboard.down("Shift")
        page.mouse.down()
        page.mouse.move(box["x"] + 0.25 * box["width"], y, steps=4)
        page.mouse.up()
        page.keyboard.up("Shift")
        page.wait_for_timeout(200)
        assert span(0) == pytest.approx((0.625, 1.125), abs=0.02), "panned by a quarter of what is shown"
        page.mouse.move(box["x"] + 0.5 * box["width"], y)
        read = charts.nth(0).locator(".u-legend .u-value").first
        assert float(read.text_content()) == pytest.approx(0.875, abs=0.02)
        charts.nth(0).locator(".live").focus()
        page.keyboard.press("0")
        page.wait_for_timeout(200)
        assert span(0) == pytest.approx((0.0, 2.0))


def test_energies_are_plotted_and_a_paced_run_shows_its_histogram(browser, paced_run, tmp_path):
    path = tmp_path / "paced.html"
    path.write_text(report([paced_run]), encoding="utf-8")
    with opened(browser, path) as page:
        for title in ("Energy created by the coupling", "Energy exchanged"):
            chart = page.locator(".chart", has_text=title)
            chart.scroll_into_view_if_needed()
            chart.locator(".u-over").wait_for()
        missed = page.locator('tr[data-key="realtime.missed"] td[data-value]').get_attribute("data-value")
        figure = page.locator("#figure-realtime svg")
        assert f"{missed} of 1000 deadlines missed" in figure.text_content()
        assert figure.bounding_box()["width"] > 400


def test_traces_are_switched_off_and_on_by_keyboard(browser, line_page):
    with opened(browser, line_page) as page:
        page.locator(".chart").nth(0).scroll_into_view_if_needed()
        head = page.locator(".chart").nth(0).locator(".u-legend th[role=checkbox]").first
        head.scroll_into_view_if_needed()
        assert head.get_attribute("aria-checked") == "true"
        head.focus()
        page.keyboard.press("Enter")
        assert head.get_attribute("aria-checked") == "false"
        page.keyboard.press("Enter")
        assert head.get_attribute("aria-checked") == "true"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_motion_plays_and_turns(browser, space_page, scheme):
    with opened(browser, space_page, color_scheme=scheme) as page:
        canvas = page.locator("#scene canvas")
        canvas.scroll_into_view_if_needed()
        picture = "one => one.toDataURL()"
        # Of a copy: a canvas that is read often is slower, of which the browser warns.
        colours = """one => {
            const {width, height} = one;
            const copy = Object.assign(document.createElement("canvas"), {width, height});
            const context = copy.getContext("2d", {willReadFrequently: true});
            context.drawImage(one, 0, 0);
            return new Set(new Uint32Array(context.getImageData(0, 0, width, height).data.buffer)).size;
        }"""
        assert canvas.evaluate(colours) > 20, "the canvas is not blank"
        first = canvas.evaluate(picture)
        slider = page.locator("#scene input")
        before = slider.input_value()
        page.locator("#scene .play").click()
        until(page, lambda: slider.input_value() != before)
        page.locator("#scene .play").click()
        assert canvas.evaluate(picture) != first
        slider.fill("10")
        until(page, lambda: page.locator("#scene output").text_content().startswith("0.005"))
        still = canvas.evaluate(picture)
        canvas.focus()
        page.keyboard.press("ArrowLeft")
        until(page, lambda: canvas.evaluate(picture) != still)
        page.locator("#scene select[name=view]").select_option("bodies")
        page.wait_for_timeout(300)
        assert canvas.evaluate(colours) > 20


def test_the_page_fits_a_narrow_screen(browser, line_page):
    with opened(browser, line_page) as page:
        page.set_viewport_size({"width": 390, "height": 800})
        page.wait_for_timeout(300)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_without_scripts_the_page_still_tells_and_shows(browser, line_page):
    with opened(browser, line_page, java_script_enabled=False) as page:
        assert page.locator(".headline").is_visible()
        assert page.locator(".chart .static svg").first.is_visible()
        assert not page.locator("#scene").is_visible()
        assert page.locator(".graph svg").is_visible()


def test_runs_are_compared(browser, line_run, space_run, tmp_path):
    path = tmp_path / "both.html"
    path.write_text(report([line_run, space_run]), encoding="utf-8")
    with opened(browser, path) as page:
        assert page.locator(".headline").text_content() == "2 runs, all done."
        row = page.locator('tr[data-key="numbers.line"] td[data-value]').first
        assert float(row.get_attribute("data-value")) == 0.0005
        page.locator(".chart").first.scroll_into_view_if_needed()
        page.locator(".chart .u-over").first.wait_for()
