"""The demo's first page replays an episode of each task and leads to the pages of all."""

import json
import re
import sys

import pytest

from spikedeploy import jobs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping import demo_reports
from tests.pages import now, ready


def test_the_first_page_replays_each_task_and_leads_to_all(stroll, monkeypatch):
    monkeypatch.setattr(demo_reports, "_TASKS", {"stroll": 2})
    monkeypatch.setattr(jobs, "cores", lambda: 1)  # others do not know the toy walker
    (document,) = demo_reports.write_demo(stroll / "demo", quiet=True)
    index = (stroll / "demo/index.html").read_text()
    assert index.count('id="episodes-data"') == 1
    assert index.count('id="stage"') == 1
    assert "no chip took part" in index.lower()
    replay, link = re.findall(r'href="([^"]+)"', index)
    data = json.loads(index.split('id="episodes-data">')[1].split("</script>")[0])
    assert [each["title"] for each in data] == ["stroll"]
    assert replay == "#episode=0"
    assert index.index('id="stage"') < index.index("<h2>")
    assert (stroll / "demo" / link).read_text().count('id="episodes-data"') == 1
    assert f"{document['rows'][0]['episodes']} episodes of each policy" in index
    told = re.findall(r"<tr class=[^>]*><td[^>]*>([^<]*)", index)
    assert any("loihi1" in name for name in told)
    assert not any("float" in name for name in told)


def test_the_page_opens_at_rest_on_a_phone_with_the_robot_in_its_first_screen(
    browser, stroll, monkeypatch
):
    monkeypatch.setattr(demo_reports, "_TASKS", {"stroll": 2})
    monkeypatch.setattr(jobs, "cores", lambda: 1)
    demo_reports.write_demo(stroll / "demo", quiet=True)
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    browser.get((stroll / "demo/index.html").as_uri())
    ready(browser)
    assert now(browser) == "0.08 s, control step 4 of 20"
    stage = browser.find_element("id", "stage").rect
    assert stage["height"] > 200
    assert stage["y"] + stage["height"] < 664  # what toolbars leave of a small phone
    assert browser.execute_script("return document.documentElement.scrollWidth") == 390
    start = browser.find_element("id", "start")
    assert start.text == "▶ Play"
    step = browser.execute_async_script(
        "const $ = (id) => document.getElementById(id), done = arguments[0];"
        "$('speed').value = '0.1'; $('speed').dispatchEvent(new Event('change'));"
        "$('start').click();"
        "requestAnimationFrame(() => requestAnimationFrame(() => done(Number($('time').value))));"
    )
    assert step < 4  # it begins at the beginning
    assert not start.is_displayed()
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


@pytest.mark.parametrize(("name", "linked"), [("index.html", True), ("stroll/report.html", False)])
def test_a_demo_replaces_only_what_a_demo_wrote(name, linked, stroll, monkeypatch):
    monkeypatch.setattr(demo_reports, "_TASKS", {"stroll": 1})
    monkeypatch.setattr(sys, "argv", ["spikedeploy", "demo"])  # which the report names
    monkeypatch.setattr(jobs, "cores", lambda: 1)
    mine, place = stroll / "mine", stroll / "demo" / name
    place.parent.mkdir(parents=True)
    mine.write_text("mine")
    place.symlink_to(mine) if linked else place.write_text("mine")
    with pytest.raises(ConfigError, match="--force"):
        demo_reports.write_demo(stroll / "demo", quiet=True)
    assert place.read_text() == "mine"
    place.unlink()
    for _ in range(2):  # the second finds its own
        demo_reports.write_demo(stroll / "demo", quiet=True)
    assert mine.read_text() == "mine"
