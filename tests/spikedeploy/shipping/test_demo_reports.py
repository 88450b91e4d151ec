"""The demo's first page replays an episode of the first task and leads to the pages of all."""

import re
import sys

import pytest

from spikedeploy.jobs import pool
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping import demo_reports


def test_the_first_page_replays_the_first_task_and_leads_to_all(stroll, monkeypatch):
    monkeypatch.setattr(demo_reports, "_TASKS", {"stroll": 2})
    monkeypatch.setattr(pool, "cores", lambda: 1)  # others do not know the toy walker
    (document,) = demo_reports.write_demo(stroll / "demo", quiet=True)
    index = (stroll / "demo/index.html").read_text()
    assert index.count('id="episodes-data"') == 1
    assert index.count('id="stage"') == 1
    assert "no chip took part" in index.lower()
    (link,) = re.findall(r'href="([^"]+)"', index)
    assert (stroll / "demo" / link).read_text().count('id="episodes-data"') == 1
    assert f"{document['rows'][0]['episodes']} episodes of each policy" in index
    told = re.findall(r"<tr class=[^>]*><td[^>]*>([^<]*)", index)
    assert any("loihi1" in name for name in told)
    assert not any("float" in name for name in told)


@pytest.mark.parametrize(("name", "linked"), [("index.html", True), ("stroll/report.html", False)])
def test_a_demo_replaces_only_what_a_demo_wrote(name, linked, stroll, monkeypatch):
    monkeypatch.setattr(demo_reports, "_TASKS", {"stroll": 1})
    monkeypatch.setattr(sys, "argv", ["spikedeploy", "demo"])  # which the report names
    monkeypatch.setattr(pool, "cores", lambda: 1)
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
