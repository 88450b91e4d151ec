"""The pages of the commands: what stands on them, and how they look in a browser."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from spikedeploy.campaign.sweep import run_sweep
from spikedeploy.campaign.sweep_grid import SweepGrid
from spikedeploy.emulation.design_report import report_of
from spikedeploy.emulation.drift_report import drift_report, random_inputs
from spikedeploy.policies import run_record
from spikedeploy.reports.design import design_page
from spikedeploy.reports.drift_page import drift_page
from spikedeploy.reports.plots import curves_figure
from spikedeploy.reports.runs import LivePage, run_page, scores, write_run_page
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import PopsanConfig
from tests import toy_stroll_env
from tests.networks import popsan

EVIL = '<b id="evil">&"x".nir'
ROWS = "env_steps,episode_return,eval_return,eval_finish,sparsity_lif1,operations\n" + "".join(
    f"{10 * k},{k - 900.0 * (k == 1)},{2 * k},{k / 20},0.9,{40 - k}\n" for k in range(1, 21)
)


@pytest.fixture(scope="module")
def network():
    return popsan(obs=3, act=2, hidden=(16, 12))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        toy_stroll_env.install(patch)
        policy = PopsanConfig(hidden=(6,), populations=3)
        made = toy_stroll_env.run_folder(tmp_path_factory.mktemp("runs"), policy)
        made.joinpath("metrics.csv").write_text(ROWS)
        yield made


def of_drift(network, run, folder):
    return drift_page(
        drift_report(EVIL, network, chip("loihi1"), random_inputs(network, 0.3, 10, 0))
    )


def of_check(network, run, folder):
    return design_page(report_of(EVIL, network, ["loihi1"], Path(EVIL), {}))


def of_check_everywhere(network, run, folder):
    return design_page(report_of(EVIL, network, ["all"], Path(EVIL), {}))


def of_training(network, run, folder):
    return run_page(scores(run))


def of_sweep(network, run, folder):
    save(replace(network, provenance=Provenance(toy_stroll_env.ID, "none")), folder / "a.nir")
    with pytest.MonkeyPatch.context() as patch:
        toy_stroll_env.install(patch)
        grid = SweepGrid(EVIL, env=("stroll",), policy=(f"{folder}/a.nir", "random"), episodes=2)
        found = run_sweep(grid, folder / "out")
    return found.files[0].read_text(encoding="utf-8")


MAKERS = [of_drift, of_check, of_check_everywhere, of_training, of_sweep]


@pytest.fixture(scope="module", params=MAKERS, ids=lambda maker: maker.__name__)
def page(request, network, run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    file = folder / "report.html"
    file.write_text(request.param(network, run, folder), encoding="utf-8")
    return file


def test_every_page_is_small_needs_no_network_and_shows_names_as_words(page):
    text = page.read_text(encoding="utf-8")
    assert len(text) < 3_000_000
    assert "<b id=" not in text
    assert "src=" not in text
    assert all(len(svg.partition('aria-label="')[2]) > 20 for svg in text.split("<svg")[1:])
    for colour in ("#d55e00", "#0072b2", "#e69f00"):
        drawn = "".join(part.partition("</svg>")[0] for part in text.split("<svg")[1:])
        assert colour not in drawn.lower()


def test_every_page_fits_phones_and_desktops_in_light_and_dark_and_on_paper(browser, page):
    for width, scheme in ((390, "dark"), (1280, "light")):
        size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        feature = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", feature)
        browser.get(page.as_uri())
        browser.execute_script(
            "document.querySelectorAll('details').forEach((each) => { each.open = true; })"
        )
        colour, wide, loaded = browser.execute_script(
            "return [getComputedStyle(document.body).backgroundColor,"
            "document.documentElement.scrollWidth, performance.getEntriesByType('resource').length]"
        )
        assert (colour == "rgb(18, 22, 28)") is (scheme == "dark")
        assert wide <= width
        assert loaded == 0
    assert browser.find_element("tag name", "h1").text
    browser.refresh()
    assert len(browser.execute_cdp_cmd("Page.printToPDF", {})["data"]) > 10_000
    folded = "return document.querySelectorAll('details:not([open])').length"
    assert browser.execute_script(folded) == 0
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_a_value_far_away_does_not_squash_the_curve(run):
    figure = curves_figure([{"env_steps": k, "episode_return": float(k)} for k in range(1, 40)])
    assert figure.axes[0].get_ylim()[0] < 1.1
    rows = [{"env_steps": k, "episode_return": k - 1e6 * (k == 1)} for k in range(1, 40)]
    assert curves_figure(rows).axes[0].get_ylim()[0] > -100


def test_a_run_that_is_trained_reloads_its_page_and_a_finished_one_does_not(run):
    assert 'http-equiv="refresh"' in run_page(scores(run), live=True)
    assert 'http-equiv="refresh"' not in run_page(scores(run))


def test_a_run_that_was_stopped_says_how_to_go_on(run):
    state = json.dumps({"finished": False, "share": 0.43, "env_steps": 5})
    last = run / "checkpoints/last.json"
    last.write_text(state)
    found = run_page(scores(run))
    last.unlink()
    assert "stopped at 43%" in found
    assert f"spikedeploy train --resume {run}" in found


def test_a_live_page_is_written_rarely_and_survives_a_full_disk(run, monkeypatch):
    live, written = LivePage(), []

    def full(path, live):
        written.append(path)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("spikedeploy.reports.runs.write_run_page", full)
    for _ in range(3):
        live(run)
    assert written == [run]


def test_a_page_has_the_scores_of_the_checkpoint_that_is_deployed(run):
    file = run / "checkpoints/best.json"
    before = file.read_text()
    file.write_text(json.dumps({**json.loads(before), "eval_return": 17.5, "eval_operations": 42}))
    text = write_run_page(run).read_text()
    file.write_text(before)
    assert "17.5" in text
    assert "42 SOPs" in text
    assert run_record.settings(run)["recipe"] in text
