"""The Python interface: a network from a file, run or trained on a chip; policies compared.

    import spikedeploy as sd

    net = sd.load("net.nir").on("loihi1")
    out = net.run(raster)
    out.spikes, out.energy, out.ledger, out.plot()

Each name does what a command does, by the same functions: `run` what `emulate` does, `compare` and
`train` what is called so. They are imported when they are first used, through `spikedeploy`.
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias, overload

import numpy as np

from spikedeploy.emulation.design_report import DesignReport, network_path, report_of
from spikedeploy.emulation.raster_emulation import Emulation, emulate_artifact
from spikedeploy.emulation.rasters import Raster, as_raster, read_rasters
from spikedeploy.evaluation_setup import OnChip, Reading, Setup
from spikedeploy.policies.registry import FLOAT
from spikedeploy.runtime.artifact import artifact as files
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.choices import Floor, Integrator, Reset, SpikeCondition, State
from spikedeploy.runtime.codec.codec import GIVE_CODEC
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.running_network import chip_or_float
from spikedeploy.runtime.errors import ArtifactError, ConfigError
from spikedeploy.runtime.graph.ports import ports
from spikedeploy.seeds import EVALUATION

if TYPE_CHECKING:
    import gymnasium
    from matplotlib.figure import Figure
    from torch import nn

    from spikedeploy.reports.table import Table
    from spikedeploy.trainers.adapt import Adaptation
    from spikedeploy.trainers.progress import Interrupt
    from spikedeploy.trainers.through_chip import ChipModule

    # a class, a function that makes one, or an instance
    EnvLike: TypeAlias = Callable[..., "gymnasium.Env[Any, Any]"] | gymnasium.Env[Any, Any]


@dataclass(frozen=True, eq=False)
class LoadedNetwork:
    """A network or policy from a `.nir` file, on a chip or in float.

    path: path of the file
    artifact: the network, its codec if it drives a robot, its convention
    chip: name as on the command line, or "float"
    on_chip: settings with which it is compiled for that chip
    reading: options by which the file was read, beside what it states
    """

    path: Path
    artifact: Artifact
    chip: str = FLOAT
    on_chip: OnChip = OnChip()  # noqa: RUF009 - it is frozen
    reading: Mapping[str, Any] = field(default_factory=dict)

    def on(self, chip: str, **options: Any) -> "LoadedNetwork":  # noqa: ANN401
        """Return the network on another chip, such as "loihi1", or in "float".

        options: fields of evaluation_setup.OnChip, as in quantise="channel", limits="off"
        """
        chip_or_float(chip)  # a wrong name is refused here
        return replace(self, chip=chip, on_chip=OnChip(**options))

    def run(self, raster: "Raster | Mapping[str, Raster] | str | Path") -> "NetworkRun":
        """Run the network on spikes (T, *shape), or (B, T, *shape), each from zero states.

        All arrays of the run have the axis B then, and its counts are of all inferences.

        raster: an array, one for each Input node by name, or a file of them
        """
        if isinstance(raster, str | Path):
            rows: Raster | Mapping[str, Raster] = read_rasters(Path(raster))
        elif isinstance(raster, Mapping):
            rows = {name: as_raster(each) for name, each in raster.items()}
        else:
            rows = as_raster(raster)
        given = rows if isinstance(rows, Mapping) else {"": rows}
        shapes = [port.shape for port in ports(self.artifact.graph.inputs)]
        axes = {each.ndim for each in given.values()}
        # of several inputs a wrong one is refused by name
        batched = axes == {len(shapes[0]) + 2} and len({*map(len, shapes)}) == 1
        found = emulate_artifact(
            self.artifact, self.chip, rows, batched=batched, **self.on_chip.arguments()
        )
        return NetworkRun(**vars(found))

    def check(self, *chips: str) -> DesignReport:
        """Return True if the network fits on chips, rule by rule; by default on its own."""
        named = chips or (self.chip,)
        return report_of(str(self.path), self.artifact, named, self.path, self.reading)

    def controller(self, sampled: bool = False) -> SpikingController:
        """A robot's controller: an observation in, an action out; the file must hold a codec."""
        return SpikingController(
            self.artifact,
            chip_or_float(self.chip),
            "total",
            sampled,
            **self.on_chip.arguments(),
        )

    def __repr__(self) -> str:
        read = self.artifact.convention.describe()
        return f"<{self.path.name} on {self.chip}: {self._size()}; {read}>"

    def _size(self) -> str:
        """`3 × CubaLIF, 4 × Affine`."""
        nodes = [type(node).__name__ for node in self.artifact.graph.nodes.values()]
        kinds = [kind for kind in dict.fromkeys(nodes) if kind not in ("Input", "Output")]
        return ", ".join(f"{nodes.count(kind)} × {kind}" for kind in kinds)


@dataclass(frozen=True, repr=False)
class NetworkRun(Emulation):
    """Inferences over a raster: fields of Emulation, energies as numbers, and a picture."""

    @property
    def energy(self) -> dict[str, float]:
        """Energy table -> [J] of the inference; `energies` has the intervals."""
        return {name: each.value for name, each in self.energies.items()}

    def plot(self, path: str | Path | None = None) -> "Figure":
        """The spikes of every layer as a figure of matplotlib; needs no display.

        path: PNG to write
        """
        from spikedeploy.reports.plots import raster_figure, save

        # of several inferences the first
        spikes = {n: rows if self.batch is None else rows[0] for n, rows in self.spikes.items()}
        figure = raster_figure(spikes)
        if path is not None:
            save(figure, Path(path))
        return figure


@dataclass(frozen=True, repr=False)
class ComparedPolicies:
    """A comparison on the same seeds: what `spikedeploy compare --json` prints.

    document: the report as data
    """

    document: Mapping[str, Any]

    @property
    def rows(self) -> list[dict[str, Any]]:
        """One for each policy and chip."""
        return list(self.document["rows"])

    @property
    def meaning(self) -> str:
        """The result in a few sentences."""
        return str(self.document["meaning"])

    def write(self, folder: str | Path) -> list[Path]:
        """Write report.json, report.html, report.md and plots; return the files."""
        from spikedeploy.reports import comparison_page as report

        return report.write(self.document, Path(folder))

    def __repr__(self) -> str:
        return "\n".join([*self._table().lines(120), self.meaning])

    def _table(self) -> "Table":
        from spikedeploy.reports.columns import short_columns
        from spikedeploy.reports.table import Table

        return Table.from_records(short_columns(self.rows), self.rows)


def load(
    path: str | Path,
    *,
    written_by: str | None = None,
    like: str | None = None,
    dt: float | None = None,
    reset: Reset | None = None,
    integrator: Integrator | None = None,
    delay: int | None = None,
    state: State | None = None,
    spikes: SpikeCondition | None = None,
    floor: Floor | None = None,
) -> LoadedNetwork:
    """Return the network of a `.nir` file, a run folder, or a shipped spiking policy, in float.

    path: path of the file; a run folder or "last" is exported first
    written_by: the tool that exported the file, as whose author meant it: `--from`
    like: the tool as whose import reads it
    dt: [s]; like what follows an option of Convention, and precedes the file
    """
    if not isinstance(path, str | Path):
        raise ConfigError(
            f"load takes the path of a file, or the name of a shipped policy; found a "
            f"{type(path).__name__}. Write a graph with nir.write(path, graph) first."
        )
    from spikedeploy.shipping.exported_run import runnable

    file = network_path(runnable(str(path)))
    reading = Reading(dt, reset, integrator, delay, spikes, floor, state, like, written_by)
    options = reading.arguments()
    return LoadedNetwork(file, files.load(file, **options), reading=options)


def compare(
    env: "str | EnvLike",
    policies: "str | Path | LoadedNetwork | Sequence[str | Path | LoadedNetwork]" = (),
    *,
    teacher: object = None,
    chips: str | Sequence[str] = (),
    episodes: int = 20,
    seed: int = EVALUATION,
    workers: int = 1,
    options: Mapping[str, Any] = MappingProxyType({}),
    **setup: Any,  # noqa: ANN401
) -> ComparedPolicies:
    """Compare policies on the same seeds; the float ANN, built-in players and controls are added.

    env: a name, a class, a function that makes one, or an instance
    policies: one or several: names of shipped ones, files, run folders or "last"; all that are
        shipped by default
    teacher: a teacher as a further row, as in `distill`
    chips: for those that spike; by default those of loaded networks, else what each was trained
        for, else loihi1
    seed: the first; from 10,000 on, which no training uses
    workers: processes; with several, a script needs `if __name__ == "__main__"`
    options: options of the environment
    setup: fields of spikedeploy.evaluation_setup.Setup, as in fault=("dead-neurons:2",)
    """
    from spikedeploy.comparison.evaluation import compare_policies, line_up
    from spikedeploy.objects import env_target, teacher_target
    from spikedeploy.policies.scripts import teacher_candidate
    from spikedeploy.reports import comparison_page as report
    from spikedeploy.shipping.exported_run import runnable

    policies = [policies] if isinstance(policies, str | Path | LoadedNetwork) else policies
    chips = chips.split(",") if isinstance(chips, str) else chips
    env, names = env_target(env), [runnable(_named(policy)) for policy in policies]
    taught = None if teacher is None else teacher_candidate(runnable(teacher_target(teacher)))
    networks = [policy for policy in policies if isinstance(policy, LoadedNetwork)]
    chips = chips or tuple(dict.fromkeys(each.chip for each in networks if each.chip != FLOAT))
    evaluated = Setup.with_options(options, **setup).check()
    entries = line_up(env, names, tuple(chips) or None, taught, evaluated)
    comparison = compare_policies(env, entries, range(seed, seed + episodes), workers)
    words = ["spikedeploy", "compare", env, *names]
    words += ["--chip", ",".join(chips)] if chips else []
    words += ["--teacher", teacher_target(teacher)] if taught else []
    words += ["--episodes", str(episodes), "--seed", str(seed), *evaluated.words()]
    return ComparedPolicies({**report.document(comparison), "command": shlex.join(words)})


def _named(policy: "str | Path | LoadedNetwork") -> str:
    """A policy as the command line names it."""
    if not isinstance(policy, LoadedNetwork):
        return str(policy)
    if policy.artifact.codec is None:
        raise ArtifactError(
            f"{policy.path} holds no codec, so it cannot drive a robot. {GIVE_CODEC}"
        )
    if files.digest(policy.artifact) != files.digest(files.load(policy.path)):
        raise ArtifactError(
            f"{policy.path} was loaded with other options than it states, and is compared as the "
            "file says: save the artifact with spikedeploy.runtime.save, and compare that file"
        )
    return str(policy.path)


def on_chip(
    network: "nn.Module | LoadedNetwork | Artifact | str | Path",
    chip: str,
    input_shape: Sequence[int] | None = None,
    **options: Any,  # noqa: ANN401
) -> "ChipModule":
    """Return a torch module whose forward pass is the chip, with the network's parameters.

    network: a torch module with neurons of snnTorch, Norse, sinabs or SpikingJelly, or a `.nir`
        file
    input_shape: of a torch module: of one timestep of one sample, as in (64,) or (2, 34, 34)
    options: of trainers.through_chip.on_chip: dt, limits, surrogate_name, surrogate_width
    """
    from spikedeploy.trainers import through_chip

    return through_chip.on_chip(_network_of(network), chip, input_shape, **options)


def adapt(
    network: "nn.Module | LoadedNetwork | Artifact | str | Path",
    chip: str,
    raster: "Raster | Mapping[str, Raster] | str | Path",
    labels: "Raster | str | Path | None" = None,
    *,
    input_shape: Sequence[int] | None = None,
    limits: bool = True,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    interrupt: "Interrupt | None" = None,
    quiet: bool = False,
    **settings: Any,  # noqa: ANN401
) -> "Adaptation":
    """Train a network on through a chip's integers; return it with scores before and after.

    network: a `.nir` file, or a torch module, which has the best numbers afterwards
    raster: (B, T, *shape) spikes
    labels: (B,) whole numbers; without them it is trained towards its float twin's outputs
    input_shape: of a torch module, of one timestep of one sample
    limits: refuse what breaks a design rule of the chip
    checkpoint: file that is written while it is trained; `resume` goes on from it
    interrupt: requests a stop, for a caller that catches signals itself
    settings: settings of trainers.adapt.AdaptationSettings: epochs, batch, rate, patience,
        held_out, seed
    """
    from spikedeploy.runtime.schema import validate
    from spikedeploy.trainers import adapt as adapting

    rows = read_rasters(Path(raster)) if isinstance(raster, str | Path) else raster
    if isinstance(rows, Mapping):
        if len(rows) != 1:
            raise ConfigError(
                f"the raster has arrays for {', '.join(sorted(rows))}; a network is trained with "
                "one input. Give the array of this input."
            )
        (rows,) = rows.values()
    classes = read_rasters(Path(labels)) if isinstance(labels, str | Path) else labels
    if isinstance(classes, Mapping):
        raise ConfigError("the labels are several arrays: give one, (B,), as .npy")
    return adapting.adapt(
        _network_of(network), chip, as_raster(rows),
        None if classes is None else np.asarray(classes), input_shape=input_shape, limits=limits,
        settings=validate(adapting.AdaptationSettings, settings, "adapt"), resume=resume,
        interrupt=interrupt, quiet=quiet,
        checkpoint=None if checkpoint is None else Path(checkpoint),
    )  # fmt: skip


def _network_of(
    network: "nn.Module | LoadedNetwork | Artifact | str | Path",
) -> "nn.Module | Artifact":
    """The torch module, or what a file holds."""
    if isinstance(network, str | Path):
        network = load(network)
    return network.artifact if isinstance(network, LoadedNetwork) else network


@overload
def export(
    network: "nn.Module | ChipModule",
    path: str | Path,
    input_shape: Sequence[int] | None = None,
    dt: float = 1e-3,
) -> LoadedNetwork: ...
@overload
def export(
    network: str | Path | LoadedNetwork,
    path: str | Path | None = None,
    *,
    to: str,
    **options: Any,  # noqa: ANN401
) -> Path: ...
def export(
    network: "nn.Module | ChipModule | LoadedNetwork | str | Path",
    path: str | Path | None = None,
    input_shape: Sequence[int] | None = None,
    dt: float = 1e-3,
    to: str | None = None,
    **options: Any,
) -> LoadedNetwork | Path:
    """Export a torch module as a NIR file, and load it; or a run or file in another format.

    network: with neurons as `on_chip` takes them, or what `on_chip` made of one; or a run folder,
        "last", a `.nir` file
    path: path of the file, or of the folder of c, verilog and program
    input_shape: of one timestep of one sample, where `on_chip` did not have it
    dt: [s] of a timestep
    to: format of a run or file: "nir", "onnx", "c", "verilog" or "program"
    options: of the export: chip, env, force, and those of `spikedeploy export`

    Raises ConfigError where the written file does not do what the policy does.
    """
    if isinstance(network, str | Path | LoadedNetwork):
        from spikedeploy.objects import env_target
        from spikedeploy.shipping.export import export as export_policy

        if options.get("env") is not None:
            options["env"] = env_target(options["env"])
        name = _named(network) if isinstance(network, LoadedNetwork) else str(network)
        written = export_policy(name, to, None if path is None else Path(path), **options)
        return written.require_passed(name).path
    if path is None or to not in (None, "nir"):
        raise ConfigError(
            "a torch module is exported as a .nir file: name it, as in "
            "sd.export(net, 'net.nir', input_shape=(64,)); other formats are made of that file"
        )
    if options:
        raise ConfigError(
            f"{', '.join(options)} of a torch module: they are of other formats, which are made of "
            "the .nir file"
        )
    from spikedeploy.trainers.from_torch import artifact_from_torch
    from spikedeploy.trainers.through_chip import ChipModule

    if isinstance(network, ChipModule):
        artifact = network.artifact()
    else:
        artifact = artifact_from_torch(network, input_shape, dt)
    files.save(artifact, path)
    return load(path)


def train(
    what: "str | EnvLike | None",
    *,
    recipe: str | None = None,
    network: "str | Path | nn.Module | type[nn.Module] | None" = None,
    chip: str | None = None,
    overrides: "Mapping[str, Any] | Sequence[str]" = (),
    **options: Any,  # noqa: ANN401
) -> Path:
    """Train a policy, as the command `train` does; return the run folder.

    what: a recipe; with `recipe`, `network` or `chip` the environment: a name, a class, a function
        that makes one, or an instance
    recipe: a recipe for any environment; with a network "ppo-network" by default
    network: a network of the user: torch module, its class, or `.nir` file; docs/own-policy.md
    chip: chip in whose integers it is trained; without a network a policy that fits it
    overrides: settings: {"steps": 50_000, "policy": {"timesteps": 4}}, or text as `--set` takes it
    options: of trainers.train.train: seed, budget, resume, runs, quiet
    """
    from spikedeploy.objects import env_target, overrides_of, target
    from spikedeploy.trainers import train as training
    from spikedeploy.training_settings import chip_student, own_network

    given = overrides_of(overrides)
    if network is not None:
        recipe, given = recipe or "ppo-network", [*own_network(target(network), chip), *given]
    elif chip is not None:
        if what is None or recipe is not None:
            raise ConfigError("chip goes with an environment alone, or with a network")
        recipe, given = "for-chip", [*chip_student(env_target(what), chip, given), *given]
    if recipe is None and not isinstance(what, str | None):
        raise ConfigError("an environment of yours needs a recipe, such as recipe='ppo-snn'")
    if recipe is not None and what is not None:
        options["env"] = env_target(what)
    return training.train(recipe or what, overrides=given, **options)  # type: ignore[arg-type]


def distill(
    env: "str | EnvLike",
    teacher: object,
    *,
    network: "str | Path | nn.Module | type[nn.Module] | None" = None,
    chip: str | None = None,
    size: str | None = None,
    encoder: str | None = None,
    timesteps: int | None = None,
    budget: str | None = None,
    dense: bool = False,
    overrides: "Mapping[str, Any] | Sequence[str]" = (),
    **options: Any,  # noqa: ANN401
) -> Path:
    """Train a spiking student that imitates a teacher, as the command does; return the run folder.

    env: a name, a class, a function that makes one, or an instance
    teacher: a file, a run folder, a shipped policy, a function of an observation, or a model of
        Stable-Baselines3
    network: the student, of the user: a torch module, its class, or a `.nir` file
    chip: chip in whose integers it is trained
    size, encoder, timesteps, budget, dense: as on the command line
    overrides, options: as in `train`
    """
    from spikedeploy.objects import env_target, overrides_of, target, teacher_target
    from spikedeploy.trainers import train as training
    from spikedeploy.training_settings import student

    own = None if network is None else target(network)
    recipe, settings = student(
        teacher_target(teacher), own, chip, size, encoder, timesteps, budget, dense
    )
    given = [*settings, *overrides_of(overrides)]
    return training.train(recipe, env=env_target(env), overrides=given, budget=budget, **options)


def make(env: str, **options: Any) -> "gymnasium.Env[Any, Any]":  # noqa: ANN401
    """Make the environment of a short name or id, with its options."""
    from spikedeploy import envs

    return envs.make(env, **options)
