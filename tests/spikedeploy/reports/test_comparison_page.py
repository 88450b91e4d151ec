"""The page of a comparison: what it leads with, and how it behaves in a browser."""

import re

import pytest
from matplotlib.colors import to_hex

from spikedeploy.comparison.evaluation import compare_policies, line_up
from spikedeploy.reports import comparison_page as report
from spikedeploy.reports.page import asset
from spikedeploy.reports.plots import energy_figure, returns_figure
from spikedeploy.reports.summary import headline, main_row
from tests import toy_stroll_env
from tests.pages import now, ready


def row(policy, kind, chip=None, earned=3000.0, sops=None, macs=None, joules=None, **changes):
    plain = {
        "policy": policy, "kind": kind, "chip": chip, "return_mean": earned, "episodes": 5,
        "return_ci95": (earned - 10, earned + 10), "reference": None, "ratio_to_reference": None,
        "ratio_to_float_ann": None, "sops_per_inference": sops, "macs_dense": macs,
        "energy_per_inference_j": {"horowitz45-int8": joules} if joules else {},
        "returns": [earned - 1, earned, earned, earned, earned + 1], "training_seeds": 1,
    }  # fmt: skip
    return {**plain, **changes}


ANN = row("sac", "ann", macs=300_000, joules=480e-9)
CHIP = {"reference": "popsan · float", "ratio_to_reference": 0.985, "ratio_to_float_ann": 0.97,
        "difference_mean": -45.0, "difference_ci95": (-60.0, -30.0)}  # fmt: skip


def test_a_page_is_about_the_cheapest_policy_that_is_as_good_as_the_float_ann():
    dense = row("popsan", "snn", "loihi1", 3000, sops=300_000)
    sparse = row("sparse", "snn", "loihi1", 2860, sops=50)
    broken = row("tiny", "snn", "loihi1", 2000, sops=5)
    assert main_row([ANN, dense, sparse, broken]) is sparse
    assert main_row([ANN, broken]) is broken
    assert main_row([ANN, row("popsan", "snn", "float")]) is ANN


def test_three_numbers_lead_with_what_they_are_beside():
    sparse = row("popsan", "snn", "loihi1", 2910, sops=48.3, joules=0.75e-9, **CHIP)
    baselines = [ANN, row("mlp-8", "control", macs=700, joules=1.1e-9)]
    kept, operations, energy = headline(
        [*baselines, row("tiny", "control", None, 900, macs=9), sparse]
    )
    assert kept.number == "98.5%"
    assert kept.beside == (
        "2,910 [2,900, 2,920] in 5 episodes",
        "-45 [-60, -30] to popsan · float",
        "97.0% of the float ANN",
    )
    assert (operations.number, energy.number) == ("48 SOPs", "0.75 nJ")
    assert operations.beside == (
        "mlp-8: 700 dense MACs, 14 times as many",
        "sac: 300,000 dense MACs, 6,211 times as many",
    )
    assert energy.beside == (
        "by horowitz45-int8, which prices float networks too",
        "mlp-8: 1.10 nJ, 1.5 times as much",
        "sac: 0.48 µJ, 640 times as much",
    )


def test_numbers_say_what_they_leave_out():
    tables = {"energy_per_inference_j": {"davies2018": 33e-9, "horowitz45-int8": 0.75e-9}}
    sparse = row("popsan", "snn", "loihi1", 2910, sops=48.3, **CHIP, **tables)
    sac = row("sac", "ann", macs=300_000, joules=480e-9, macs_effective=116_811)
    _, operations, energy = headline([sac, sparse])
    assert "sac: 116,811 MACs of 300,000 dense, 2,418 times as many" in operations.beside
    assert energy.number == "0.75 nJ"
    assert energy.beside[-1] == "by loihi1's own tables: 33.00 nJ (davies2018)"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    with pytest.MonkeyPatch.context() as patch:
        toy_stroll_env.ship(patch, folder / "zoo")
        compared = compare_policies(
            "stroll", line_up("stroll", (), ("loihi1",)), range(10_000, 10_003), processes=1
        )
        document = report.document(compared)
        episodes = report.recordings(compared, document["rows"], {})
        return report.write(document, folder / "out", episodes=episodes)[0]


def test_the_page_is_small_and_its_names_cannot_end_the_script(page):
    text = page.read_text(encoding="utf-8")
    assert len(text) < 3_000_000
    data = text.split('id="episodes-data">')[1].split("</script>")[0]
    assert "<" not in data


def test_png_plots_have_the_colours_of_the_page_by_day():
    kinds = {"ann": ("ann", None), "snn": ("snn", "float"), "chip": ("snn", "loihi1"),
             "control": ("control", None)}  # fmt: skip
    rows = [row(name, *kind, joules=1e-9) for name, kind in kinds.items()]
    by_day = dict(re.findall(r"--(\w+): (#\w+);", asset("page.css").partition("@media")[0]))
    for figure in (returns_figure(rows), energy_figure(rows)):
        dots = [each for each in figure.axes[0].collections if len(each.get_offsets())]
        found = [to_hex(colour) for each in dots for colour in each.get_facecolors()]
        assert list(dict.fromkeys(found)) == [by_day[name] for name in kinds]


def shade(browser):
    """How light the middle of the picture is."""
    return browser.execute_script(
        "const s = document.getElementById('stage');"
        "return s.getContext('2d').getImageData(s.width / 2, s.height / 2, 1, 1).data[0]"
    )


def test_one_cursor_moves_through_the_page(browser, page):
    browser.get(page.as_uri())
    ready(browser)
    assert now(browser) == "0.00 s, control step 0 of 20"
    names = [each.text.split("\n")[0] for each in browser.find_elements("class name", "strip")]
    assert names[0].startswith("input spikes")
    assert {"2 actions", "synaptic operations", "reward"} <= set(names)
    body = browser.find_element("tag name", "body")
    before = shade(browser)
    body.send_keys("\ue014" * 3)  # arrow right
    assert now(browser) == "0.06 s, control step 3 of 20"
    body.send_keys("\ue010")  # end
    assert now(browser).endswith("step 19 of 20")
    assert before == pytest.approx(0, abs=5)
    assert shade(browser) == pytest.approx(10 * 20, abs=5)  # the film's last picture
    cursors = browser.execute_script(
        "return [...document.querySelectorAll('.strip i')].map((each) => each.style.left)"
    )
    assert set(cursors) == {"95%"}
    browser.find_element("id", "first").click()
    place = browser.find_element("id", "first-said").text
    assert f"control step {now(browser).split()[-3]}," in place
    browser.find_elements("css selector", "#episodes button")[-1].click()
    ready(browser, "1")
    assert now(browser).startswith("0.00 s, control step 0")
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_a_link_leads_to_a_step_of_an_episode(browser, page):
    browser.get(f"{page.as_uri()}#episode=1&step=7")
    ready(browser, "1")
    assert now(browser) == "0.14 s, control step 7 of 20"
    browser.get("about:blank")
    browser.get(f"{page.as_uri()}#episode=99&step=x")
    ready(browser, "1")
    assert now(browser).endswith("control step 0 of 20")
