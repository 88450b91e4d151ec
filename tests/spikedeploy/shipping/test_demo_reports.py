"""The demo's first page replays an episode of the first task and leads to the pages of all."""

import re

from spikedeploy import parallel
from spikedeploy.shipping import demo_reports


def test_the_first_page_replays_the_first_task_and_leads_to_all(stroll, monkeypatch):
    monkeypatch.setattr(demo_reports, "_TASKS", {"stroll": 2})
    monkeypatch.setattr(parallel, "cores", lambda: 1)  # others do not know the toy walker
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
