"""Host side of this kit; every run_*.py uses it. NumPy only.

A chip of run_*.py is a class with `run(rows)`: rows (T, M) of input spikes in, and out for each
layer {"current" | "membrane" | "spikes": (T, N)} after each timestep; states continue from call to
call. Whatever it cannot measure it leaves out. `reset()` makes all states zero, spikes that are
under way included: it is called between control steps where program.json has the state "reset".
`stop()` releases the chip.
"""

import argparse
import hashlib
import json
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from zipfile import BadZipFile

try:
    import numpy as np
except ImportError as error:
    raise SystemExit(f"{error}: install numpy; README.md has the steps") from error

from host_codec import Decoder, Encoder

HERE = Path(__file__).resolve().parent


@contextmanager
def needs(what):
    """Name the package to install where an import fails."""
    try:
        yield
    except ImportError as error:
        raise SystemExit(f"{error}: install {what}; README.md has the steps") from error


def main(make_chip, tool, options=()):
    """Run expected.json's input on a chip, or close the loop; print what differs, if anything.

    make_chip(program, arguments) builds the chip; options are (flag, help) of its own.
    """
    parser = argparse.ArgumentParser(description=f"Run this kit's program with {tool}.")
    parser.add_argument(
        "--loop",
        metavar="ENV",
        nargs="?",
        const="recorded",
        help="close the loop: a gymnasium id or module:Class; without one, "
        "the recorded observations of episode.npz",
    )
    parser.add_argument("--steps", type=int, help="control steps; timesteps if states go on")
    for flag, text in options:
        parser.add_argument(flag, action="store_true", help=text)
    arguments = parser.parse_args()
    if arguments.steps is not None and arguments.steps < 1:
        parser.error("--steps: at least 1")
    program, expected = read("program.json"), read("expected.json")
    check(program, expected)
    with needs("what the board needs"):
        chip = make_chip(program, arguments)
    try:
        if arguments.loop:
            path = HERE / f"loop_{tool}.npz"
            return close_loop(program, chip, arguments.loop, arguments.steps, path)
        return play(program, expected, chip, arguments.steps, tool, HERE / f"{tool}.json")
    finally:
        chip.stop()


def read(name):
    """The JSON object in a file of the kit."""
    try:
        return dict(json.loads((HERE / name).read_text("utf-8")))
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise SystemExit(f"{name} cannot be read ({error}); export the kit again") from error


def check(program, expected):
    """Refuse what expected.json says of another program, or in tables of another size."""
    digest = hashlib.sha256((HERE / "program.json").read_bytes()).hexdigest()
    if expected.get("program_sha256") != digest:
        raise SystemExit("expected.json is of another program.json; export both again")
    try:
        steps, width = expected["timesteps"], program["input"]["width"]
        events = np.array(expected["input_events"], np.int64).reshape(-1, 2)
        fits = steps > 0 and (events >= 0).all() and (events < [steps, width]).all()
        fits &= not resets(program) or steps % program["control_step"]["timesteps"] == 0
        for layer in program["layers"]:
            tables = expected["recorded"][layer["name"]].values()
            fits &= all(np.shape(table) == (steps, layer["neurons"]) for table in tables)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        fits = False
    if not fits:
        raise SystemExit("expected.json does not fit program.json; export the kit again")


def resets(program):
    """Return True if all states are zero at the start of each control step."""
    return program["control_step"].get("state") == "reset"


def play(program, expected, chip, steps, tool, path):
    """Run expected.json's input on the chip, and write what it did like expected.json."""
    length = program["control_step"]["timesteps"] if resets(program) else 0
    steps = min((steps or expected["timesteps"]) * max(length, 1), expected["timesteps"])
    events = np.array(expected["input_events"], np.int64).reshape(-1, 2)
    events = events[events[:, 0] < steps]
    rows = np.zeros((steps, program["input"]["width"]), np.int64)
    np.add.at(rows, tuple(events.T), 1)
    found = []
    for first in range(0, steps, length or steps):
        if first:
            chip.reset()
        found.append(chip.run(rows[first : first + (length or steps)]))
    recorded = {
        layer: {
            quantity: np.concatenate([each[layer][quantity] for each in found])
            .astype(np.int64)
            .tolist()
            for quantity in tables
        }
        for layer, tables in found[0].items()
    }
    trace = {
        **expected,
        "source": f"{tool}, run_*.py of the kit",
        "timesteps": steps,
        "input_events": events.tolist(),
        "recorded": recorded,
    }
    path.write_text(json.dumps(trace), "utf-8")
    print(f"wrote {path.name}; compare: spikedeploy verify {path.name}")
    return report(recorded, expected["recorded"], steps)


def report(recorded, expected, steps):
    """Print the first difference from what is expected; return the exit code."""
    first, count = None, 0
    for layer, tables in recorded.items():
        for quantity in (q for q in expected[layer] if q in tables):
            ours, theirs = np.array(expected[layer][quantity][:steps]), np.array(tables[quantity])
            count += ours.size
            wrong = np.argwhere(ours != theirs)
            if len(wrong) and (first is None or wrong[0][0] < first[0]):
                t, n = wrong[0]
                first = (
                    t,
                    f"timestep {t}, {layer}, neuron {n}, {quantity}: "
                    f"expected {ours[t, n]}, found {theirs[t, n]}",
                )
    equal = f"equal: {count:,} numbers of {steps} timesteps" if count else "nothing to compare"
    print(f"differs: {first[1]}" if first else equal)
    return 1 if first or not count else 0


class Codec:
    """Map an observation to rows of spikes, and the chip's output to an action."""

    def __init__(self, program):
        host = program["host"]
        if "missing" in host:
            raise SystemExit(f"the loop cannot be closed here: {host['missing']}")
        self.terms, self.timesteps = host["terms"], host["codec"]["timesteps"]
        self.encoder, self.decoder = Encoder(host["codec"]), Decoder(host)
        self.width, self.clock = program["input"]["width"], program["control_step"]

    def encode(self, observation):
        """Return the rows (T, M) to inject for one observation (obs,), one in each timestep."""
        spikes = self.encoder(observation)
        rows = np.zeros((self.clock["timesteps"], self.width), np.int64)
        rows[: len(spikes), : spikes.shape[1]] = spikes
        for axon, (first, last) in enumerate(self.clock["bias_axons"], start=spikes.shape[1]):
            rows[first:last, axon] = 1
        return rows

    def decode(self, found):
        """Return the action for the chip's output in the timesteps of a control step."""
        tables = [np.asarray(found[term["layer"]][term["reads"]]) for term in self.terms]
        firsts = [term["from"] for term in self.terms]
        windows = zip(tables, firsts, strict=True)
        return self.decoder([rows[first : first + self.timesteps] for rows, first in windows])


def environment(name):
    """spikedeploy's, module:Class, or one registered with gymnasium; and how it takes actions."""
    module, _, short = name.partition(":")
    if module == "spikedeploy":
        with needs("spikedeploy by `pip install .` in a checkout of its repository"):
            from spikedeploy.envs import make
        return make(short), lambda action: action
    with needs("that module, or put it beside host.py"):
        made = getattr(import_module(module), short, None) if short else None
    if not callable(made):
        with needs("gymnasium"):
            import gymnasium
    try:
        env = made() if callable(made) else gymnasium.make(name)
    except Exception as error:  # of somebody else's code
        raise SystemExit(f"--loop {name}: {error}") from error
    space = env.action_space
    if hasattr(space, "start"):
        return env, lambda action: int(action) + int(space.start)
    low, high = np.array(space.low, float), np.array(space.high, float)

    def scaled(action):
        """Map actions from [-1, 1] to the bounds."""
        share = (np.clip(action, -1.0, 1.0).reshape(low.shape) + 1.0) / 2.0
        return (low + share * (high - low)).astype(space.dtype)

    return env, scaled


def close_loop(program, chip, env_name, steps, path):
    """Drive the environment through the chip; compare with the episode of episode.npz."""
    codec = Codec(program)
    try:
        with (HERE / "episode.npz").open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            episode = {name: file[name] for name in ("observation", "action", "reward", "seed")}
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise SystemExit(f"episode.npz cannot be read ({error}); export the kit again") from error
    steps = min(steps or len(episode["action"]), len(episode["action"]))
    env = None
    if env_name != "recorded":
        env, units = environment(env_name)
        observation, _ = env.reset(seed=int(episode["seed"]))
        if np.shape(observation) != episode["observation"][0].shape:
            raise SystemExit(f"--loop {env_name} observes other numbers than the policy")
    actions, rewards = [], []
    for step in range(steps):
        seen = episode["observation"][step] if env is None else observation
        if step and resets(program):
            chip.reset()
        actions.append(codec.decode(chip.run(codec.encode(seen))))
        if env is not None:
            observation, reward, terminated, truncated, _ = env.step(units(actions[-1]))
            rewards.append(float(reward))
            if terminated or truncated:
                break
    np.savez(path, action=np.array(actions), reward=np.array(rewards))
    apart = np.abs(np.array(actions, float) - episode["action"][: len(actions)])
    print(f"wrote {path.name}: {len(actions)} actions, at most {apart.max():.3g} from expected")
    if env is not None:
        total, wanted = sum(rewards), float(episode["reward"][: len(rewards)].sum())
        print(f"return {total:.6f}, expected {wanted:.6f}")
    return 0 if apart.max() < 1e-9 else 1
