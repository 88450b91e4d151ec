"""Reproducing: a recorded evaluation is played again, and one changed number of it is found."""

import json
import shutil
import subprocess
import sys

import pytest

from lab.publish import publish_run
from spikedeploy import cli, zoo
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.reproduce import CLOSE, DIFFERS, EQUAL, read_evaluation, reproduce
from spikedeploy.trainers.config import PopsanConfig
from tests import toy_stroll_env
from tests.paths import ROOT

EPISODES = 3


@pytest.fixture(autouse=True)
def _stroll(monkeypatch):
    toy_stroll_env.install(monkeypatch)


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """A zoo with a spiking policy, and another under the name `other`."""
    folder = tmp_path_factory.mktemp("published")
    with pytest.MonkeyPatch.context() as patch:
        toy_stroll_env.install(patch)
        for name, size, episodes in (("small", 6, EPISODES), ("other", 5, 1)):
            policy = PopsanConfig(hidden=(size,), populations=3)
            run = toy_stroll_env.run_folder(folder / "runs" / name, policy)
            publish_run(str(run), name, episodes=episodes, folder=folder / "zoo", processes=1)
    return folder / "zoo"


@pytest.fixture
def card(published, tmp_path):
    """A copy of the card of a published spiking policy."""
    shutil.copytree(published, tmp_path / "zoo")
    return tmp_path / "zoo/stroll/small.json"


@pytest.fixture
def shipped(tmp_path):
    """A copy of the card of a shipped policy, with its file and page."""
    for suffix in (".onnx", ".json", ".md"):
        shutil.copyfile(
            zoo.resolve("kart-steer/linear").with_suffix(suffix), tmp_path / f"linear{suffix}"
        )
    return tmp_path / "linear.json"


def again(path, episodes=None):
    return reproduce(read_evaluation(str(path)), episodes, processes=1)


def change(card, *path, to):
    """Write the card with the value at a path replaced by to(value)."""
    document = json.loads(card.read_text())
    place = document
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = to(place[path[-1]])
    card.write_text(json.dumps(document))
    return document


def test_a_published_card_is_reproduced_in_every_number(card):
    found = again(card)
    assert (found.verdict, found.equal, found.difference) == (EQUAL, True, None)
    assert (found.episodes, found.of, found.rows) == (EPISODES, EPISODES, 2)
    assert found.numbers > 80
    assert found.versions["numpy"][0] == found.versions["numpy"][1]


EDITED = {
    "seeds": ({"seeds": {"first": "x"}}, "seeds.first"),
    "file": ({"file": 5}, "file"),
    "file elsewhere": ({"file": "../x.nir"}, "beside it"),
    "options": ({"config": {"env": {"name": "stroll", "options": [1]}}}, "options"),
    "versions": ({"evaluated_with": [1]}, "evaluated_with"),
    "no world": ({"config": {}}, "config.env"),
}
EDITED_ROWS = {
    "no policy": ({"policy": None}, "policy"),
    "truths as returns": ({"returns": [True, True, True]}, "returns.0"),
    "a return that is none": ({"returns": [1.0, float("nan"), 1.0]}, "returns"),
    "digits": ({"returns": [10**400, 1, 1]}, "returns"),
    "nothing": ({"returns": [], "episodes": 0}, "0 episodes"),
    "uneven": ({"episodes": 2}, "2, 100 episodes"),
    "another row": ({"reference": "nobody"}, "no such row"),
}


@pytest.mark.parametrize("case", [*EDITED, *EDITED_ROWS])
def test_a_card_that_was_edited_is_refused_in_a_sentence(case, shipped):
    changes, word = (EDITED | EDITED_ROWS)[case]
    document = json.loads(shipped.read_text())
    for row in document["evaluation"] if case in EDITED_ROWS else [document]:
        row |= changes
    shipped.write_text(json.dumps(document))
    with pytest.raises(ConfigError, match=word) as refusal:
        read_evaluation(str(shipped))
    assert len(str(refusal.value)) < 400


def test_a_row_that_is_repeated_or_lacks_a_field_is_refused(shipped):
    (row,) = json.loads(shipped.read_text())["evaluation"]
    change(shipped, "evaluation", to=lambda rows: [row, row])
    with pytest.raises(ConfigError, match="two rows"):
        read_evaluation(str(shipped))
    for field in ("policy", "chip", "episodes", "returns"):
        less = {name: value for name, value in row.items() if name != field}
        change(shipped, "evaluation", to=lambda rows, less=less: [less])
        with pytest.raises(ConfigError, match=field):
            read_evaluation(str(shipped))


def test_every_shipped_card_is_read():
    for name in zoo.names():
        assert read_evaluation(name).card == zoo.path(name).with_suffix(".json")


WITHOUT_TORCH = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "snntorch", "safetensors", "onnx"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocked())
from spikedeploy.shipping.reproduce import read_evaluation, reproduce
print(reproduce(read_evaluation("kart-steer/linear"), 1, 1).verdict)
"""


def test_a_shipped_policy_is_reproduced_without_torch():
    words = (sys.executable, "-c", WITHOUT_TORCH)
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.stdout.strip() == EQUAL, done.stderr


def test_its_policy_file_names_the_same_card(card):
    assert again(card.with_suffix(".nir"), episodes=1).verdict == EQUAL


@pytest.fixture(scope="module")
def evaluated(published):
    """What a replay of the published card gives: rows, as `compare_policies` returns them."""
    kept = []

    def keep(*given):
        kept.append(compare_policies(*given))
        return kept[-1]

    with pytest.MonkeyPatch.context() as patch:
        toy_stroll_env.install(patch)
        patch.setattr("spikedeploy.shipping.reproduce.compare_policies", keep)
        assert again(published / "stroll/small.json").verdict == EQUAL
    return kept[0]


CHANGED = [
    (1, ("sops_per_inference",), lambda number: number * (1 + 1e-6)),
    (1, ("success_rate",), lambda number: number * 0.5 + 1e-6),
    (1, ("saturations",), lambda number: number + 10**12),
    (1, ("energy_per_inference_j", "davies2018"), lambda number: number * (1 + 1e-8)),
    (1, ("energy_interval_j", "sanafe", 0), lambda number: (number or 1.0) * (1 - 1e-8) + 1e-12),
    (1, ("return_ci95", 1), lambda number: (number or 1.0) * 1.0001),
    (1, ("footprint_packed",), lambda _: 12.0),
]


@pytest.mark.parametrize(("row", "path", "to"), CHANGED)
def test_any_number_that_was_changed_is_found(row, path, to, card, evaluated, monkeypatch):
    monkeypatch.setattr("spikedeploy.shipping.reproduce.compare_policies", lambda *_: evaluated)
    change(card, "evaluation", row, *path, to=to)
    found = again(card)
    assert found.verdict == DIFFERS
    assert (found.difference.field, found.difference.seed) == (".".join(map(str, path)), None)


def test_changed_returns_noise_and_fields_are_told_apart(card, evaluated, monkeypatch):
    monkeypatch.setattr("spikedeploy.shipping.reproduce.compare_policies", lambda *_: evaluated)
    whole, everything = card.read_text(), again(card).numbers
    change(card, "evaluation", 1, "returns", 2, to=lambda number: number + 0.01)
    found = again(card)
    assert (found.verdict, found.differing, found.difference.seed) == (DIFFERS, 1, 10_002)
    assert (found.difference.row, found.difference.field) == ("small · loihi1", "returns")
    assert found.difference.expected == pytest.approx(found.difference.found + 0.01)
    assert "episode of seed 10002, returns" in found.difference.describe()
    card.write_text(whole)
    change(card, "evaluation", 0, "returns", 0, to=lambda number: number * (1 + 1e-12))
    found = again(card)
    assert (found.verdict, found.equal, found.difference.seed) == (CLOSE, True, 10_000)
    card.write_text(whole)
    change(card, "evaluation", 0, to=lambda row: {**row, "old_metric": 1.0})
    found = again(card)  # no row has it any more
    assert (found.difference.field, found.difference.found) == ("old_metric", "nothing")
    card.write_text(whole)
    change(card, "evaluation", 0, to=lambda row: {k: v for k, v in row.items() if k != "sparsity"})
    found = again(card)  # what a card lacks is not compared
    assert (found.verdict, found.numbers) == (EQUAL, everything - 1)


def test_a_file_that_was_replaced_is_refused(card):
    shutil.copyfile(card.with_name("other.nir"), card.with_suffix(".nir"))
    with pytest.raises(ConfigError, match="sha256"):
        again(card)


def test_the_first_episodes_are_compared_in_what_is_of_them(card):
    change(card, "evaluation", 1, "sops_per_inference", to=lambda number: 2 * number)
    change(card, "evaluation", 1, "returns", 2, to=lambda number: 2 * number)
    found = again(card, episodes=2)
    assert (found.verdict, found.episodes, found.of) == (EQUAL, 2, EPISODES)
    change(card, "evaluation", 1, "returns", 1, to=lambda number: 2 * number)
    assert again(card, episodes=2).difference.seed == 10_001
    with pytest.raises(ConfigError, match="--episodes 4"):
        again(card, episodes=4)


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """A folder with a report on the shipped policies of the toy world, and their zoo."""
    folder = tmp_path_factory.mktemp("compared")
    words = (
        "spikedeploy", "compare", "stroll", "--episodes", "2", "--workers", "1", "--json",
        "-o", str(folder / "results"), "--energy", "davies2018", "--quantise", "channel",
        "--fault", "lost-spikes:3", "--chips", "loihi1,int",
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        toy_stroll_env.ship(patch, folder / "zoo")
        patch.setattr(sys, "argv", list(words))
        with pytest.raises(SystemExit, match="0"):
            cli.main()
    return folder


@pytest.fixture
def report(compared, tmp_path, monkeypatch):
    """A copy of the report, and of the policies."""
    shutil.copytree(compared, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(zoo, "FOLDER", tmp_path / "zoo")
    return tmp_path / "results"


def test_a_report_is_reproduced_with_its_setup(report):
    found = again(report)
    assert found.verdict == EQUAL
    rows = json.loads((report / "report.json").read_text())["rows"]
    assert found.rows == len(rows) > 4
    assert any("faults" in row for row in rows)
    assert again(report / "report.json", episodes=1).verdict == EQUAL


def test_a_report_of_policies_that_were_replaced_is_refused(report):
    shipped = [path for path in zoo.policies("stroll") if path.suffix == ".nir"]
    shipped[0].write_bytes(shipped[0].read_bytes() + b" ")
    with pytest.raises(ConfigError, match="has sha256"):
        again(report)


def test_a_report_with_a_setup_that_is_none_is_refused(report):
    file = report / "report.json"
    document = json.loads(file.read_text())
    for field, value, word in (
        ("setup", None, "setup"),
        ("setup", {"limits": "off"}, "other limits than the setup"),
        ("setup", {"colour": "red"}, "colour"),
        ("setup", {"specimen": "three"}, "specimen"),
        ("setup", {"fault": ["dead"]}, "--fault"),
        ("teachers", ["mine:act"], "teacher mine:act"),
    ):
        file.write_text(json.dumps({**document, field: value}))
        with pytest.raises(ConfigError, match=word):
            read_evaluation(str(report))


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("kart-steer/spars", "did you mean"),
        ("gait", "built in"),
        ("empty", "report.json"),
        ("alone.nir", "alone.json"),
        ("list.json", "no JSON object"),
        ("torn.json", "damaged"),
        ("none.json", "records no evaluation"),
    ],
)
def test_what_has_no_evaluation_is_refused_with_a_reason(name, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    shutil.copyfile(zoo.resolve("kart-steer/sparse"), tmp_path / "alone.nir")
    for stem, text in (("list", "[]"), ("torn", "{"), ("none", "{}")):
        (tmp_path / f"{stem}.json").write_text(text)
    with pytest.raises(ConfigError, match=word):
        read_evaluation(name)


def test_the_command_says_equal_or_the_first_difference(card, command):
    code, out, _ = command("reproduce", card, "--workers", 1)
    assert code == 0
    assert f"✓ {card}: equal (" in out
    code, out, err = command("reproduce", card, "kart-steer/spars", "--workers", 1)
    assert (code, out, "did you mean" in err) == (2, "", True)  # before anything is played
    change(card, "evaluation", 0, "returns", 1, to=lambda number: 2 * number)
    code, out, _ = command("reproduce", card, "--workers", 1, "--episodes", 2)
    assert code == 1
    assert f"✗ {card}: differs" in out
    assert "small · float, episode of seed 10001, returns:" in out
    assert "mujoco" in out
    code, out, _ = command("reproduce", card, card, "--workers", 1, "--json")
    documents = json.loads(out)
    assert (code, [each["equal"] for each in documents]) == (1, [False, False])
    assert documents[0]["difference"]["seed"] == 10_001
