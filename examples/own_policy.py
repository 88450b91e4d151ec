"""A policy of your own on a chip: numpy learns from a script how to race, then it spikes.

A linear policy imitates the gap follower; its numbers become spikes of relay neurons, whose readout
is the policy. In half a minute it finishes many races, not all.

    python examples/own_policy.py [FILE.nir]
"""

import sys
from itertools import pairwise
from pathlib import Path

import nir
import numpy as np

import spikedeploy as sd
from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.runtime import Artifact, Codec, Convention, Normaliser, RateEncoder, save

T = 16  # timesteps of an inference: rates of 0, 1/16 ... 1


def imitate(rounds: int = 5, steps: int = 400) -> np.ndarray:
    """Weights (actions, obs + 1) learned from what the script would do where the policy is."""
    env = sd.make("kart-gazebo")
    teacher = GapDriver.for_env(env)
    seen, taught, weight, rate = [], [], None, 0.0
    for seed in range(4 * rounds):
        obs, _ = env.reset(seed=seed)
        for _ in range(steps):
            rate = np.append(np.round(T * (np.clip(obs, -1, 1) + 1) / 2) / T, 1.0)
            seen.append(rate)
            taught.append(np.eye(4)[int(teacher.act(obs))])
            action = taught[-1] if weight is None else weight @ rate
            obs, _, crashed, late, _ = env.step(int(np.argmax(action)))
            if crashed or late:
                break
        if seed % 4 == 3:  # softmax regression on all that was seen
            x, y, weight = np.array(seen), np.array(taught), np.zeros((4, len(rate)))
            for _ in range(400):
                p = np.exp(x @ weight.T)
                weight -= 4.0 * (p / p.sum(1, keepdims=True) - y).T @ x / len(x)
    return weight


def network(weight: np.ndarray) -> nir.NIRGraph:
    """Input spikes, one relay neuron for each, and the linear policy as their readout."""
    size = weight.shape[1] - 1
    neurons = nir.LIF(*(np.full(size, v) for v in (2e-3, 2.0, 0.0, 0.5)), v_reset=np.zeros(size))
    nodes = {
        "input": nir.Input(np.array([size])),
        "one": nir.Linear(np.eye(size)),
        "relay": neurons,
        "policy": nir.Affine(weight[:, :-1], weight[:, -1]),
        "output": nir.Output(np.array([4])),
    }
    names = list(nodes)
    return nir.NIRGraph(nodes, list(pairwise(names)))


def main(file: Path, rounds: int = 5, steps: int = 400, episodes: int = 10) -> sd.ComparedPolicies:
    """Learn, write the file, and race it on Loihi 1 beside the shipped policies."""
    weight = imitate(rounds, steps)
    one = np.ones(weight.shape[1] - 1)
    codec = Codec(Normaliser(0 * one, one, 1.0), RateEncoder(-one, one), T, "argmax")
    save(Artifact(network(weight), codec, Convention(dt=1e-3)), file)
    return sd.compare("kart-gazebo", [file], episodes=episodes)


if __name__ == "__main__":
    print(main(Path(sys.argv[1] if len(sys.argv) > 1 else "own.nir")))
