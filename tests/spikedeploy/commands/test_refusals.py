"""What a command refuses: one sentence, exit code 2, and nothing is played or written."""

import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import save
from tests.networks import popsan

SNN = ("run", "kart-grid/snn")
OWN = ("run", "random", "--env", "tests.own_env:Reach")
EMULATE = ("emulate", "p.nir", "--chip", "loihi1")
REFUSED = [
    (("walk",), "No such command 'walk'"),
    (("run",), "Missing argument"),
    (("envs", "--xml"), "No such option: --xml"),
    (("run", "nowhere.nir"), "no policy at 'nowhere.nir'"),
    (("run", "gait", "--env", "hexapd"), "did you mean 'hexapod'?"),
    (("run", "stroll/popsan", "--chip", "loihi9"), "did you mean 'loihi2' or 'loihi1'"),
    ((*SNN, "--set", "success=np"), "success is given with --success"),
    ((*SNN, "--set", "disturb=np"), "disturb is given with --disturb"),
    ((*SNN, "--disturb", "slope:1"), "kart has no 'slope'; it has noise, bias"),
    ((*SNN, "--disturb", "noise:5"), "no level from 0 to 3"),
    ((*SNN, "--fault", "burnt:1"), "a chip has no 'burnt'; it has dead-neurons"),
    ((*SNN, "--fault", "stuck-max:1", "--chip", "float"), "--fault is of chips"),
    ((*SNN, "--fault", "stuck-max:1", "--chip", "ideal"), "computes in floats"),
    ((*OWN, "--metric", "eror:mean"), "did you mean 'error'?"),
    ((*OWN, "--metric", "error:sum"), "mean|last|max"),
    (("run", "random", "--env", "CartPole-v1", "--set", "x=1"), "has no option 'x'"),
    (("compare", "hexapod", "--episodes", "0"), "'--episodes'"),
    (("compare", "stroll", "--seed", "0"), "evaluation starts at 10000"),
    (("compare", "CartPole-v1"), "train CartPole-v1 --recipe ppo-snn"),
    (("compare", "CartPole-v1", "--teacher-units", "own"), "goes with --teacher"),
    (("train", "hexapod-sax"), "hexapod-sac"),
    (("train", "smoke", "--resume", "last", "--seed", "3"), "leave --seed out"),
    (("train", "ppo-snn"), "name one, as in `spikedeploy train CartPole-v1 --recipe ppo-snn`"),
    (("train", "CartPole-v1", "--recipe", "hexapod-sac"), "made for hexapod, not for CartPole"),
    (("train", "CartPole-v7", "--recipe", "ppo-snn"), "did you mean 'CartPole-v"),
    (("train", "CartPole-v1", "--recipe", "sac-mlp"), "train it with a recipe of ppo"),
    (
        ("train", *OWN[3:], "--recipe", "ppo-mlp", "--set", "env.options.x=1"),
        "has no option 'x'",
    ),
    (("train", "smoke-sparse", "--budget", "macs=40"), "takes them as in --budget sops=60"),
    (("train", "smoke-sparse-mlp", "--budget", "40"), "takes them as in --budget macs=60"),
    (("train", "smoke", "--budget", "sops=40"), "recipe smoke has no budget of operations"),
    (("visualize", "."), "metrics.csv"),
    (("export", "nowhere", "--to", "nir"), "nowhere"),
    (EMULATE, "--input FILE"),
    ((*EMULATE, "--input", "shape.npy"), "shape (1, 2, 3, 4) with its batch"),
    ((*EMULATE, "--input", "two.npy"), "0 or 1"),
    ((*EMULATE, "--input", "object.npy"), "not a .npy or .npz file with plain arrays"),
]


@pytest.mark.parametrize(("words", "said"), REFUSED, ids=[" ".join(each[0]) for each in REFUSED])
def test_what_is_refused_is_one_sentence(words, said, command, tmp_path, monkeypatch, request):
    monkeypatch.chdir(tmp_path)
    if "stroll" in words[1:] or "stroll/popsan" in words:
        request.getfixturevalue("stroll")
    if "p.nir" in words:
        save(popsan(), tmp_path / "p.nir")
        np.save(tmp_path / "shape.npy", np.zeros((2, 3, 4)))
        np.save(tmp_path / "two.npy", np.full((5, 30), 2))
        np.save(tmp_path / "object.npy", np.array([{}], dtype=object), allow_pickle=True)
    before = [path for path in tmp_path.rglob("*") if path.is_file()]
    code, out, err = command(*words)
    assert (code, out) == (2, ""), err
    assert said in " ".join(err.replace("│", " ").split())
    assert "Traceback" not in err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == before
