"""The entry test of hexapod-tiles in its smallest size, and what its page concludes."""

from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest

from lab.experiments import tiles, tiles_trainings
from lab.experiments.eye_map import NOT_PRUNED
from lab.experiments.runner import run_experiment
from lab.experiments.tiles import Scripts, TilesDesign, policy_facts, verdicts
from lab.experiments.tiles_trainings import KEPT, pack
from lab.experiments.training import read_rows
from spikedeploy import make
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.sparse.config import SparseConfig

FEW = ("legs-0", "legs-gru", "blind-legs-64-64", "legs-snn")
SIZE = (
    "budget", "levels", "batch", "window", "burn_in", "step", "penalty", "penalty_floor", "bits",
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _few_networks():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tiles, "_ROWS", {name: tiles._ROWS[name] for name in FEW})
        patch.setattr(tiles, "VIEWS", ("around",))
        yield


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    runs = str(tmp_path_factory.mktemp("tiles") / "runs")
    small = {"settings": ("policy.hidden=4", "policy.deep=2")}
    with pytest.MonkeyPatch.context() as patch:
        rows = tiles._ROWS["legs-snn"] | small
        patch.setattr(tiles, "_ROWS", {**tiles._ROWS, "legs-snn": rows})
        patch.setattr("spikedeploy.trainers.sparse.sparse._ENV_COPIES", 2)
        yield TilesDesign(1, runs, episodes=2, quick=True, limit=60)


@pytest.fixture(scope="module")
def results(design, ran):
    folder = Path(design.runs).parent / "results"
    outcome = run_experiment(design, (), 1, folder)
    assert (outcome.done, outcome.of, outcome.failed) == (10, 10, {})
    assert ran[-1] == "legs-snn-around-s0"
    return folder


def table(results):
    return read_rows(results / "hexapod-tiles.csv", tiles._TEXT)


def test_each_row_holds_its_episodes_and_counts_what_it_did(results):
    rows = [r for r in table(results) if not str(r["place"]).startswith("int8") and not r["ground"]]
    found = {(r["network"], r["level"]): r for r in rows}
    assert {r["network"] for r in table(results) if r["place"] == "int8"} == {*FEW} - {"legs-snn"}
    assert all(len(row["success"]) == len(row["missteps"]) == 2 for row in found.values())
    assert found["script", None]["operations"] > 1_000
    assert found["gait", None]["operations"] is None
    # 51 inputs of three actions, in six copies; an input that is 0 takes nothing
    linear = found["legs-0", NOT_PRUNED]
    assert linear["weights"] <= 51 * 3
    assert 100 < linear["operations"] < 6 * linear["weights"]
    assert found["legs-gru", NOT_PRUNED]["operations"] > 10 * linear["operations"]
    # readouts to which nothing comes are idle
    spiking = found["legs-snn", NOT_PRUNED]
    updates = 4 * (6 * (4 + 2) + 2 * 18)  # timesteps
    assert spiking["neuron_updates"] + spiking["neuron_idle"] == pytest.approx(updates, rel=0.02)


def test_policies_and_the_script_also_walk_on_rough_ground(results):
    rough = [(r["ground"], r["network"], r["level"]) for r in table(results) if r["ground"]]
    of_each = [("script", None), ("legs-snn", NOT_PRUNED)]
    grounds = ("bumps", "steps", "stairs")
    assert sorted(rough, key=str) == sorted(
        ((ground, *each) for ground in grounds for each in of_each), key=str
    )
    page = (results / "hexapod-tiles.md").read_text()
    assert "| stairs | legs-snn |" in page


def test_what_is_done_is_not_done_again_and_rows_of_elsewhere_stay(design, results, ran):
    before, count = (results / "hexapod-tiles.csv").read_bytes(), len(ran)
    run_experiment(design, (), 1, results)
    assert len(ran) == count
    replace(design, runs=str(results / "none")).write(results)
    assert (results / "hexapod-tiles.csv").read_bytes() == before
    page = (results / "hexapod-tiles.md").read_text()
    assert "## around" in page
    assert "Not trained" not in page


def test_all_networks_learn_from_as_many_walks_for_as_many_updates():
    def effort(row):
        made = resolve(SparseConfig, row["recipe"], overrides=row["settings"], seed=0)
        return made.model_dump(exclude={"policy", "recipe", "env", *SIZE})

    whole = tiles.DESIGNS["hexapod-tiles"]["networks"]
    first, *others = (effort(row) for row in whole.values())
    assert len(others) == 20
    for each in others:
        assert each == first


def test_a_run_is_that_of_one_training_alone(monkeypatch):
    monkeypatch.setattr(tiles, "_ROWS", tiles.DESIGNS["hexapod-tiles"]["networks"])
    monkeypatch.setattr(tiles, "VIEWS", ("around", "ahead"))
    jobs, runs = TilesDesign(seeds=1).trainings(), []
    for job in jobs:
        made = job.planned().model_dump(mode="json")
        runs.append(made | ({"teacher_walks": 0} if job.parents else {}))
    for job in jobs:
        alone = replace(job, parents={})
        assert [o.name for o, run in zip(jobs, runs, strict=True) if alone._is_of(run)] == [
            job.name
        ]


def test_the_gait_is_the_script_that_does_not_look():
    env = make("hexapod-tiles")
    seen, _ = env.reset(seed=3)
    scan = env.unwrapped.OBSERVATION["scan"]
    free = seen.copy()
    free[scan] = 0.0
    looks, blind = Scripts("around", looks=True), Scripts("around", looks=False)
    for scripts in (looks, blind):
        scripts.reset(2)
    assert np.array_equal(blind.act_batch(np.stack([seen, free])), looks.act_batch([free, free]))


def row(network, success, operations=4_000.0, updates=None, level=NOT_PRUNED):
    return {
        "network": network, "view": "around", "seed": 0, "level": level, "weights": 10,
        "place": "float32" if updates is None else "loihi1",
        "operations": operations, "neuron_updates": updates, "success": success,
        "observations": 287.0, "constants": 18.0, "events": 60.0,
        "missteps": [0.01] * len(success), "distance": [3.0] * len(success),
        "fall": [0] * len(success),
    }  # fmt: skip


def test_verdicts_say_who_succeeds_and_for_how_many_operations():
    every = [
        policy_facts([row("legs-0", [0, 0, 0, 1])]),
        policy_facts([row("legs-gru", [1, 1, 1, 1], operations=20_000.0)]),
        policy_facts([row("legs-snn", [1, 1, 1, 0], operations=2_000.0, updates=900.0)]),
    ]
    small, large, spiking = verdicts(every)
    assert "at most 20%: no, legs-0" in small
    assert "in 90%: yes; legs-gru with 100.0%" in large
    assert spiking.startswith("legs-snn at 2,000 SOPs and 900 neuron updates has 75.0%")
    assert spiking.endswith("of legs-gru at 20,000 MACs.")
    cheaper = policy_facts([row("legs-0", [1, 1, 1, 1], operations=1_900.0)])
    assert "it succeeds in 75.0%" in [*verdicts([*every, cheaper])][-1]
    assert (
        "with no more operations legs-0 at 1,900 MACs in 100.0%"
        in [*verdicts([*every, cheaper])][-1]
    )
    others = [
        policy_facts([row("legs-0", won, operations=1_800.0) | {"place": place}])
        for place, won in (("delta 0.01", [1, 1, 1, 1]), ("int8", [1, 0, 0, 0]))
    ]
    said = [*verdicts([*every, *others])][-1]
    assert "operations legs-0 (delta 0.01) at 1,800 MACs in 100.0%" in said
    assert "of 8 bits legs-0 (int8) at 1,800 MACs in 25.0%" in said
    nothing = policy_facts([row("legs-snn", [0, 0, 0, 0], updates=9.0)])
    assert "succeeds in no field, legs-gru" in [*verdicts([*every[:2], nothing])][-1]
    nobody = [policy_facts([row("legs-gru", [0, 0])]), every[2]]
    assert "legs-gru succeeds in no field" in [*verdicts(nobody)][-1]
    energy = every[2]["energy"]
    assert len(energy) == 2
    assert energy[0] < energy[1]  # sums in registers, in memory
    assert all(some < every for some, every in energy)


def test_verdicts_on_pruned_networks_and_on_memory_stand_apart():
    pruned = row("legs-gru", [1, 1, 0, 0], operations=4_500.0, level="ops-4500")
    rows = [row("legs-0", [0, 0, 0, 0]), pruned]
    rows += [
        row(name, success) | {"view": "ahead"}
        for name, success in (("legs-0", [0, 1, 0, 0]), ("legs-gru", [1, 1, 1, 1]))
    ]
    found = list(verdicts([policy_facts([each]) for each in rows]))
    assert "succeed in at most 20%: those that are here do" in found[0]
    assert "that were pruned to them succeed in at most 20%: no, legs-gru at 4,500" in found[1]
    assert found[-1].startswith("On `ahead`, without memory, legs-0 at 4,000 MACs has 25.0%")
    assert found[-1].endswith("of legs-gru at 4,000 MACs.")


def test_what_was_packed_is_trained_where_it_is_unpacked(design, results, tmp_path, monkeypatch):
    monkeypatch.setattr(tiles_trainings, "TilesDesign", lambda runs: replace(design, runs=runs))
    packed = pack(Path(design.runs), tmp_path / "archives")
    assert [file.stem for file in packed] == ["evaluations", *(f"{n}-around-s0" for n in FEW)]
    there = tmp_path / "there"
    assert all(KEPT.unpack(file, there) for file in packed)
    again = replace(design, runs=str(there))
    assert [t.name for t in again.trainings() if not t.is_trained] == ["walks-around"]
    assert sum(len(list(part.found)) for part in again.parts()) == len(table(results))


def test_evaluations_of_an_archive_are_written_in_their_folder():
    assert KEPT.name.fullmatch("evaluations/a-ops-1e+06/b=2.json")
    for name in ("evaluations/../x.json", "evaluations/..x.json", "evaluations/a/../x.json"):
        assert not KEPT.name.fullmatch(name)


def test_archives_of_the_results_can_be_unpacked():
    found = sorted(KEPT.folder.glob("*.zip"))
    names = [name for file in found for name in ZipFile(file).namelist()]
    assert names
    assert [name for name in names if not KEPT.name.fullmatch(name)] == []
