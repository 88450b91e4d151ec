"""Valid files that fuzzing starts from, besides networks: of every other format that is read."""

import json
import shutil
from pathlib import Path

import nir
import numpy as np
import torch
from onnx import TensorProto, helper, numpy_helper

from spikedeploy import envs, zoo
from spikedeploy.envs.ghosts import Ghost, Ghosts
from spikedeploy.envs.rollout import Rollout
from spikedeploy.trainers.policies import MlpPolicy
from spikedeploy.trainers.ppo.config import PpoConfig
from spikedeploy.trainers.resolve import resolve
from spikedeploy.trainers.run_folder import RunFolder

ROOT = Path(__file__).resolve().parents[1]


def write_records(folder: Path) -> None:
    """Write the files."""
    traces = {name: loihi_trace(name) for name in ("lava", "brian2", "nengo", "loihi2")}
    for name, trace in {**traces, "xylo": xylo_trace()}.items():
        (folder / f"{name}.trace").write_text(json.dumps(trace))
    track = Path(envs.__file__).parent / "kart" / "tracks" / "small_S.json"
    (folder / "track.track").write_bytes(track.read_bytes())
    rasters(folder)
    drives(folder / "drives.ghosts")
    numbers = {"x": np.zeros(2), "y": np.ones(2)}
    episode = (np.zeros((3, 4)), np.ones((2, 1)), np.ones(2), True, False, numbers)
    Rollout("spikedeploy/Hexapod-v0", 1, *episode, {"slope": 1}).save(folder / "walk.rollout")
    tables = ("steps = 1000", "[env]", "count = 2", "[policy]", "hidden = [8, 8]")
    (folder / "settings.toml").write_text("\n".join(tables))
    policy(folder / "policy.onnx")
    json_files(folder)
    for model in sorted((ROOT / "tests/golden/sb3").glob("*.zip")):
        shutil.copy(model, folder)
    run(folder / "kart.run")


def rasters(folder: Path) -> None:
    """Spikes in every format that is read."""
    np.save(folder / "raster.npy", np.tile(np.eye(2, dtype=np.uint8), (2, 1)))
    np.savez_compressed(folder / "rasters.npz", input=np.eye(2))
    np.savez(folder / "recorded.npz", input=np.eye(2), output=np.ones((2, 2)))
    grid = nir.TimeGriddedData(np.ones((1, 4, 2), bool), 1e-3)
    times = np.array([[0.0, 1e-3]])
    events = nir.ValuedEventData(
        idx=np.array([[0, 1]]), time=times, value=times, n_neurons=2, t_max=4e-3
    )
    for name, data in (("grid", grid), ("events", events)):
        nodes = {"input": nir.NIRNodeData({"spikes": data})}
        nir.write_data(folder / f"{name}.h5", nir.NIRGraphData(nodes))


def drives(path: Path) -> None:
    """A ghost file."""
    poses, reward = np.zeros((3, 3), np.float32), np.ones(2, np.float32)
    drive = Ghost(poses, poses[:, 0], np.array([1, 2]), reward, True, False, 1)
    Ghosts("spikedeploy/KartSteer-v0", [drive, drive], {"track": "big_S"}).save(path)


def json_files(folder: Path) -> None:
    """A codec, a card, a report, a draft of a track, and the configuration of a run."""
    made = {
        "codec": {
            "timesteps": 16, "squash": "argmax",
            "normaliser": {"mean": [0, 0], "std": [1, 2], "clip": 3},
            "encoder": {"kind": "rate", "mode": "regular", "low": [-1, -1], "high": [1, 1]},
        },
        "draft": {
            "name": "a", "walls": [[[0, 0], [1, 1]]], "gates": [[[0, 0], [1, 0]]], "sway": 0.0,
            "start": {"position": [0, 0], "spread": 1.0, "heading": [0.0, 1.0]},
        },
        "config": resolve(PpoConfig, "kart-grid-ann", seed=0).model_dump(mode="json"),
    }  # fmt: skip
    card = json.loads((zoo.FOLDER / "kart-steer/linear.json").read_text(encoding="utf-8"))
    made["card"] = {**card, "file": "file.policy.onnx"}
    report = json.loads((ROOT / "results/kart-steer/report.json").read_text(encoding="utf-8"))
    made["report"] = {**report, "rows": report["rows"][:3]}
    for name, tree in made.items():
        (folder / f"{name}.json").write_text(json.dumps(tree))


def run(folder: Path) -> None:
    """A run folder with two checkpoints and ghosts."""
    overrides = ["policy.hidden=[8]", "steps=2000"]
    made = RunFolder.create(
        folder.parent, resolve(PpoConfig, "kart-grid-ann", overrides=overrides, seed=0)
    )
    made.path.rename(folder)
    made = RunFolder(folder)
    torch.manual_seed(0)
    driver = MlpPolicy(12, 5, [8], head="discrete")
    for name in ("last", "best"):
        state = {"env_steps": 1000, "finished": False, "share": 0.5}
        made.save(name, driver, state, {"moments.0": torch.ones(8)})
    rows = ("env_steps,episode_return,eval_return", "500,1.0,", "1000,2.5,3.0")
    made.metrics.write_text("\n".join(rows) + "\n")
    (folder / "ghosts").mkdir()
    drives(folder / "ghosts" / "00001.npz")


def policy(path: Path) -> None:
    """A float policy with our metadata."""
    names = {"w": np.ones((4, 300), np.float32), "v": np.ones((300, 2), np.float32)}
    nodes = [
        helper.make_node("MatMul", ["x", "w"], ["h"]),
        helper.make_node("Relu", ["h"], ["r"]),
        helper.make_node("MatMul", ["r", "v"], ["y"]),
    ]
    x, y, r = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["B", width])
        for name, width in (("x", 4), ("y", 2), ("r", 300))
    )
    constants = [numpy_helper.from_array(array, name) for name, array in names.items()]
    graph = helper.make_graph(nodes, "policy", [x], [y, r], constants)
    opsets = [helper.make_opsetid("", 17)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=8)
    helper.set_model_props(model, {"env": "spikedeploy/Hexapod-v0", "macs": "1800", "seed": "0"})
    path.write_bytes(model.SerializeToString())


def loihi_trace(source: str) -> dict[str, object]:
    """Two Loihi neurons, three presynaptic axons, four timesteps."""
    zeros = [[0, 0]] * 4
    return {
        "source": source,
        "input_spikes": [[1, 0, 1], [0, 1, 0], [1, 1, 1], [0, 0, 0]],
        "weights": [[10, -20, 30], [40, 50, -60]],
        "du": 2047, "dv": 1024, "vth": 150, "bias_mant": 3, "bias_exp": 1,
        "u": zeros, "v": zeros, "s": zeros,
    }  # fmt: skip


def xylo_trace() -> dict[str, object]:
    """Two hidden neurons and an output of Xylo for two timesteps."""
    return {
        "source": "xylosim",
        "input_counts": [[1, 0], [0, 2]],
        "weights_in": [[[10], [20]], [[30], [-40]]],
        "weights_out": [[5], [6]],
        "dash_mem": [1, 1], "dash_syn": [1, 1], "dash_mem_out": [1], "dash_syn_out": [1],
        "threshold": [5, 5], "threshold_out": [5],
        "v_mem": [[0, 0], [0, 0]], "out_spikes": [[0], [0]],
    }  # fmt: skip
