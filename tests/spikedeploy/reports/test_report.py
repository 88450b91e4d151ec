"""The report: data and a page that say the same, and a sentence that is true."""

import json
from html.parser import HTMLParser

import pytest

from spikedeploy.comparison.evaluation import compare_policies, line_up
from spikedeploy.reports import comparison_page as report
from spikedeploy.reports.columns import format_operations, short_columns, tables
from spikedeploy.reports.summary import describe_macs, summary
from spikedeploy.reports.table import Table, price_cell
from tests import toy_stroll_env


@pytest.fixture
def document(monkeypatch, tmp_path):
    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    entries = line_up("stroll", (), ("loihi1",))
    return report.document(compare_policies("stroll", entries, range(10_000, 10_003), processes=1))


class Links(HTMLParser):
    """Every src and href of a page."""

    def __init__(self, page):
        super().__init__()
        self.found = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found += [value for key, value in attrs if key in ("src", "href")]


def row(policy, kind, chip=None, ratio=1.0, **changes):
    """A row as `meaning` reads it."""
    plain = {
        "policy": policy, "kind": kind, "chip": chip, "return_mean": 3000 * ratio,
        "ratio_to_float_ann": ratio, "ratio_to_reference": 0.99, "reference": "x",
        "difference_mean": -20.4, "difference_ci95": (-40.0, 1.0), "success_rate": 1.0,
        "episodes": 5, "training_seeds": None if kind in ("gait", "random") else 1,
        "returns": [3000 * ratio + spread for spread in (-30, -10, 0, 10, 30)],
        "sops_per_inference": 48.4, "effective_macs": 18.0, "macs_dense": 90.0,
    }  # fmt: skip
    return {**plain, **changes}


def test_the_report_is_whole_and_stands_alone(document, tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"film")
    files = report.write(document, tmp_path / "out", tmp_path / "film.mp4")
    page = files[0].read_text(encoding="utf-8")
    assert all(file.is_file() for file in files)
    assert Links(page).found == ["data:video/mp4;base64,ZmlsbQ=="]
    assert page.count('<svg role="img"') == 2
    assert json.loads((tmp_path / "out/report.json").read_text())["rows"][0]["policy"] == "sac"


def test_the_page_holds_every_cell_of_every_table(document, tmp_path):
    page = report.write(document, tmp_path)[0].read_text(encoding="utf-8")
    rows = document["rows"]
    for columns in tables(rows).values():
        for column in columns:
            for each in rows:
                assert f">{column.cell(each)}<" in page


def test_names_of_files_are_shown_as_they_are_and_are_no_markup(document, tmp_path):
    document["rows"][0]["policy"] = "a|b\n# c <script>alert(1)</script> [d](e) f_g"
    page, _, plain = report.write(document, tmp_path)[:3]
    assert r"| a\|b \# c \<script\>alert(1)\</script\> \[d\](e) f\_g" in plain.read_text("utf-8")
    assert "<script>alert" not in page.read_text("utf-8")
    assert "&lt;script&gt;" in page.read_text("utf-8")


CONTROLS = {"effective_macs": None}
ALONE = {"foreign": True, "return_ci95": (2900.0, 3100.0)}
SENTENCES = {
    "popsan on loihi1 earns 2,955 (99.0% of the return of its float twin; -20.4 to its float twin, "
    "95% interval -40 to +1; 98.5% of the float ANN's) in 5 episodes, and succeeds in all": [
        row("sac", "ann"), row("popsan", "snn", "loihi1", 0.985)],
    "-20.4 to its float twin; 100.0% of the float ANN's) in 4 episodes, too few for an interval": [
        row("popsan", "snn", "loihi1", **ALONE, episodes=4)],
    "What the others earn: the float ANN 3,000, the gait alone 1,500, the best control (linear) "
    "1,800.": [
        row("sac", "ann"), row("gait", "gait", ratio=0.5), row("linear", "control", ratio=0.6)],
    "The smallest float policy not shown to earn less is linear: 1,386 dense MACs a control step, "
    "to 48 synaptic operations and 18 MACs of popsan. Neuron updates": [
        row("sac", "ann", effective_macs=80_000.0), row("popsan", "snn", "loihi1", 0.985),
        row("gait", "gait", ratio=0.5),
        row("linear", "control", ratio=0.99, macs_dense=1386.0, **CONTROLS),
        row("bilinear", "control", ratio=0.9, effective_macs=72.0)],
    "is mlp: 600 MACs": [
        row("sac", "ann", effective_macs=500.0, macs_effective=700.0),
        row("mlp", "ann", effective_macs=600.0), row("popsan", "snn", "loihi1", 1.0)],
    "None of the 2 float policies here earns as much.": [
        row("sac", "ann", ratio=0.97), row("linear", "control", ratio=0.9),
        row("gait", "gait", ratio=0.5), row("popsan", "snn", "loihi1", 1.1)],
    "The one float policy here is shown to earn less. The script gait is not shown": [
        row("sac", "ann", ratio=0.9), row("gait", "gait"), row("popsan", "snn", "loihi1")],
    "The script mine:pilot is not shown to earn less.": [
        row("sac", "ann", ratio=0.9), row("mine:pilot", "ann", ratio=3.0, training_seeds=None),
        row("popsan", "snn", "loihi1")],
    "mine was trained for odin, and no float twin stands beside it.": [
        row("sac", "ann"),
        row("mine", "snn", "odin", reference="sac", trained_for="odin", **ALONE)],
    "Intervals cover 5 episodes of one training each; other trainings differ: "
    "results/README.md.": [row("sac", "ann"), row("linear", "control", ratio=0.6)],
}  # fmt: skip


def test_macs_are_effective_and_all_of_them_are_dense():
    counts = {"macs_dense": 310_784.0, "effective_macs": 116_811.0, "sops_per_inference": None}
    both = row("sac", "ann", **counts)
    assert (format_operations(both), describe_macs(both)) == ("310,784 dense MACs", "116,811 MACs")
    assert describe_macs({**both, "effective_macs": None}) == "310,784 dense MACs"


@pytest.mark.parametrize("sentence", SENTENCES)
def test_the_summary_says(sentence):
    assert sentence in summary(SENTENCES[sentence])


@pytest.mark.parametrize("episodes", [1, 2, 4])
def test_of_few_episodes_the_sentence_has_no_interval_and_no_verdict(episodes):
    found = summary([
        row("sac", "ann", episodes=episodes),
        row("popsan", "snn", "loihi1", 0.985, episodes=episodes),
        row("sparse", "snn", "loihi1", 0.985, episodes=episodes),
    ])  # fmt: skip
    remark = {1: "1 episode"}.get(episodes, f"{episodes} episodes, too few for an interval")
    assert found.startswith(
        "popsan on loihi1 earns 2,955 (99.0% of the return of its float twin; -20.4 to its float "
        f"twin; 98.5% of the float ANN's) in {remark}, and succeeds in all of them. sparse on"
    )
    assert "95%" not in found
    assert "Intervals" not in found
    assert "shown" not in found
    assert found.count("Fewer than 5 episodes do not show which policies earn less.") == 1


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (2e-6, float("inf"), "≥ 2.00 µJ"),
        (0.0, None, "2.00 µJ"),
        (2e-6, 2e-6, "2.00 µJ"),
        (1.8e-6, 2.2e-6, "2.00 µJ ± 10 %"),
        (0.0, 2.5e-6, "≤ 2.50 µJ"),
        (1e-6, 8e-6, "1.00 µJ to 8.00 µJ"),
    ],
)
def test_a_price_is_printed_with_what_is_known_of_it(low, high, text):
    row = {"j": {"table": 2e-6}, "interval": {"table": [low, high]}}
    assert price_cell("j", "table", "J", "interval")(row) == text


@pytest.mark.parametrize(
    ("env", "runs", "labels"),
    [
        ("CartPole-v1", ["distill-sparse-CartPole-v1-s0-20261122-131751"], ["distill-sparse-s0"]),
        ("my_module:MyEnv", ["ppo-snn-my-module-MyEnv-s0-20261122-131751-1"], ["ppo-snn-s0"]),
        # the date alone tells them apart
        ("CartPole-v1", *[["smoke-s0-20261122-131751", "smoke-s0-20261122-131800"]] * 2),
        ("", ["my-popsan"], ["my-popsan"]),
    ],
)
def test_the_short_table_names_runs_without_date_and_environment(env, runs, labels):
    known = {"energy_per_inference_j": {}, "return_ci95": None}
    rows = [{**row(run, "spiking", "loihi1"), **known} for run in runs]
    name, *_ = short_columns(rows, env)
    assert [name.cell(row) for row in rows] == [f"{label} · loihi1" for label in labels]


def test_names_of_a_table_of_80_columns_are_not_broken(capsys):
    heads = ("policy", "return", "of ANN", "success", "operations", "energy")
    row = ("sparse · loihi1", "3,464 [3,458, 3,469]", "100.5%", "100%", "312,797 SOPs", "≥ 0.75 nJ")
    Table(heads, [row], numbers=True).print(width=80)
    long = ("distill-sparse-tuned-s1 · loihi1", *row[1:])
    Table(heads, [long], numbers=True).print(width=80)
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 80 for line in lines)
    assert "  ".join(row[:2]) in lines[2]
    assert all(any(cell in line for line in lines) for cell in long[1:])
