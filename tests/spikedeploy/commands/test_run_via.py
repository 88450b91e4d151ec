"""`run --via`: a core in simulation drives; what they print and refuse."""

import json
from hashlib import sha256

import pytest

from spikedeploy import zoo
from spikedeploy.shipping.verilog import VerilogFolder, write_folder
from tests.emulated_hardware import makefile

POLICY, CHIP = "kart-steer/sparse-gated", "loihi1:clock=gated"


def exported(folder, wrong=None, policy=POLICY, **texts):
    """A folder as an export leaves it, whose simulation is the interpreter."""
    file = zoo.path(policy)
    texts = {"Makefile": makefile(file, CHIP, wrong), "synapses.hex": "0\n", **texts}
    found = VerilogFolder(
        folder=folder, policy=policy, sha256=zoo.sha256(file), chip=CHIP, board="icebreaker",
        files={name: sha256(text.encode()).hexdigest() for name, text in texts.items()},
    )  # fmt: skip
    write_folder(texts, found)
    return folder


def test_the_return_is_the_emulated_chips_to_the_last_bit_and_every_state_is_compared(
    command, tmp_path
):
    folder = exported(tmp_path / "core")
    code, out, err = command("run", POLICY, "--via", folder, "--json")
    assert code == 0, err
    found = json.loads(out)
    (row,), drove = found["rows"], found["hardware"]
    assert (row["policy"], row["chip"]) == ("sparse-gated in RTL", CHIP)
    assert (drove["equal"], drove["differing"]) == (True, 0)
    assert drove["numbers"] > 60 * drove["timesteps"] > 0
    assert drove["returns"] == drove["emulated_returns"] == row["returns"]
    code, out, _ = command("run", POLICY, "--chip", CHIP, "--json")
    (emulated,) = json.loads(out)["rows"]
    assert emulated["returns"] == row["returns"]


def test_a_core_that_is_not_the_chips_equal_is_named_and_exits_with_1(command, tmp_path):
    folder = exported(tmp_path / "core", wrong=(5, 0))
    code, out, _ = command("run", POLICY, "--via", folder)
    assert code == 1
    assert "First difference: timestep 5: the membrane of neuron 0 of layer" in " ".join(
        out.split()
    )


def test_the_page_of_a_run_replays_the_spikes_of_the_core(command, tmp_path):
    folder = exported(tmp_path / "core")
    code, _, err = command("run", POLICY, "--via", folder, "-o", tmp_path / "report")
    assert code == 0, err
    assert (tmp_path / "report/report.html").is_file()
    assert json.loads((tmp_path / "report/report.json").read_text())["hardware"]["equal"] is True


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--chip", "loihi1"), "leave --chip out"),
        (("--backend", "auto"), "leave --backend out"),
        (("--rate", "10"), "leave --rate out"),
        (("--fault", "dead-neurons:1"), "leave --fault out"),
        (("--quantise", "channel"), "leave --quantise out"),
    ],
)
def test_options_that_the_export_has_decided_are_refused(command, tmp_path, words, said):
    code, _, err = command("run", POLICY, "--via", exported(tmp_path / "core"), *words)
    assert (code, said in err) == (2, True), err


def test_a_folder_of_another_policy_or_a_damaged_one_is_refused_in_a_sentence(command, tmp_path):
    folder = exported(tmp_path / "core")
    code, _, err = command("run", "kart-steer/sparse", "--via", folder)
    assert (code, "is another file" in err, err.count("\n")) == (2, True, 1)
    code, _, err = command("run", "kart-steer/linear", "--via", folder)
    assert (code, "is no spiking policy" in err) == (2, True)
    (folder / "synapses.hex").write_text("1\n")
    code, _, err = command("run", POLICY, "--via", folder)
    assert (code, "is another program" in err, err.count("\n")) == (2, True, 1)
    (tmp_path / "empty").mkdir()
    code, _, err = command("run", POLICY, "--via", tmp_path / "empty")
    assert (code, "is no folder that" in err, err.count("\n")) == (2, True, 1)


def test_a_simulation_that_ends_by_itself_is_a_sentence(command, tmp_path):
    ends = "policy_sim:\n\t@printf '#!/bin/sh\\nexit 1\\n' >policy_sim && chmod +x policy_sim\n"
    folder = exported(tmp_path / "core", Makefile=ends)
    code, _, err = command("run", POLICY, "--via", folder)
    assert (code, "has ended by itself" in err) == (2, True), err
