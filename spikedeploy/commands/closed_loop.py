"""`run` and `compare`: policies that act in their environments."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import (
    Backend,
    Deadline,
    Delay,
    Disturb,
    Dt,
    Energy,
    EnvOptions,
    FaultsOption,
    Floor,
    Force,
    From,
    Headroom,
    Json,
    Lasting,
    LimitsOption,
    Metrics,
    PolicyChip,
    Quantise,
    Rate,
    Reset,
    Rounding,
    Seed,
    Specimen,
    Spikes,
    Success,
    Tables,
    TeacherUnits,
    Thresholds,
    Watch,
    WatchPort,
    WeightShift,
    Workers,
    quantisation,
)


def run(
    policy: Annotated[
        str, typer.Argument(metavar="FILE", help="A .onnx or .nir file, run folder, shipped name.")
    ],
    env: Annotated[
        str | None,
        typer.Option(
            help="Environment: short name, id of gymnasium, or module:Class.",
            show_default="the one it was made for",
        ),
    ] = None,
    chip: PolicyChip = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes.")] = 1,
    seed: Seed = seeds.EVALUATION,
    sampled: Annotated[
        bool,
        typer.Option("--sampled", help="Draw actions by their probability, not the likeliest."),
    ] = False,
    set_: EnvOptions = None,
    success: Success = None,
    metric: Metrics = None,
    disturb: Disturb = None,
    fault: FaultsOption = None,
    specimen: Specimen = 0,
    video: Annotated[Path | None, typer.Option(help="MP4 of the first episode.")] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for report.html, which replays episodes."),
    ] = None,
    limits: LimitsOption = "on",
    energy: Energy = None,
    quantise: Quantise = "layer",
    rounding: Rounding = None,
    headroom: Headroom = "none",
    thresholds: Thresholds = None,
    weight_shift: WeightShift = 0,
    from_: From = None,
    native: Annotated[
        bool,
        typer.Option("--native", help="FILE is a .so that you built; its code runs as you."),
    ] = False,
    codec: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="With --from: .json, how observations become spikes and output actions.",
        ),
    ] = None,
    dt: Dt = None,
    reset: Reset = None,
    delay: Delay = None,
    spikes: Spikes = None,
    floor: Floor = None,
    backend: Backend = "numpy",
    rate: Rate = None,
    deadline: Deadline = None,
    lasting: Lasting = None,
    shown: Tables = "one",
    watch: Watch = False,
    port: WatchPort = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run one policy in its environment: returns, successes and costs."""
    from dataclasses import replace
    from functools import partial

    from spikedeploy.comparison.evaluation import run_policy
    from spikedeploy.comparison.metrics import checked_metrics
    from spikedeploy.console import print_json
    from spikedeploy.envs import spec
    from spikedeploy.live import loop_of_run
    from spikedeploy.make_env import parse_options
    from spikedeploy.outputs import check_output, check_output_folder, mark, marked
    from spikedeploy.policies.nir import adopt, check_fits
    from spikedeploy.reports import comparison as report
    from spikedeploy.reports.terminal import print_run
    from spikedeploy.runtime.faults import faults
    from spikedeploy.runtime.metrics.energy import checked_table_names
    from spikedeploy.shipping.exported_run import runnable, trained_in

    if native:
        from spikedeploy.policies.native import permit

        permit(Path(policy))
    if video:
        check_output("--video", video, (policy,), force, lambda path: marked(path, mark("run")))
    if output:
        if sampled:
            raise typer.BadParameter("-o replays greedy episodes: leave --sampled out")
        check_output_folder("-o", output, report.FILES, (policy,), force, report.is_report)
    tables = checked_table_names(energy or ())
    metrics = checked_metrics(metric or ())
    if video and (watch or rate is not None):
        by = "--watch" if watch else "--rate"
        raise typer.BadParameter(f"{by} is by the clock, and a film is not: leave --video out")
    if lasting and episodes > 1:
        raise typer.BadParameter("--duration plays as many episodes as fit: leave --episodes out")
    if port is not None and not watch:
        raise typer.BadParameter("--port goes with --watch")
    numbers = range(seed, seed + episodes)
    rounded = quantisation(quantise, rounding, headroom, thresholds, weight_shift)
    convention = {"dt": dt, "reset": reset, "delay": delay, "spikes": spikes, "floor": floor}
    given = [*(name for name, value in convention.items() if value is not None)]
    given += [] if codec is None else ["codec"]
    if from_ is not None:
        if env is not None:
            spec(env)  # refuses an unknown one before a file is written
        fits = partial(check_fits, chip, limits == "on", rounded)
        policy = str(adopt(policy, codec, force, fits, written_by=from_, **convention))
    elif given:
        raise typer.BadParameter(f"--{given[0]} goes with --from: other policies state it")
    options = parse_options(set_ or (), disturb or (), success)
    with loop_of_run(watch, port, rate, deadline, lasting, tables) as loop:
        comparison = run_policy(
            runnable(policy),
            env or trained_in(policy),
            chip,
            numbers,
            video,
            sampled,
            options,
            limits == "on",
            rounded,
            faults(fault or (), specimen),
            metrics,
            loop,
            backend,
        )
    document = report.document(replace(comparison, tables=tables))
    if loop:
        document["real_time"] = loop.measured().as_json()
    if output:
        recorded = report.recordings(comparison, document["rows"], options)
        report.write(document, output, episodes=recorded)
    if json:
        print_json(document)
    else:
        print_run(document, shown == "all")
        if video:
            typer.echo(f"wrote {video}")
        if output:
            typer.echo(f"wrote {output / 'report.html'}")


def compare(
    env: Annotated[
        str,
        typer.Argument(
            metavar="ENV",
            help="Environment; `envs` lists ours; or an id of gymnasium, or module:Class.",
        ),
    ],
    files: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[FILE]…",
            help="Policies: .onnx, .nir, run folders, shipped names. The float ANN, the "
            "built-in players and the controls are added.",
            show_default="all that are shipped",
        ),
    ] = None,
    chips: Annotated[
        list[str] | None,
        typer.Option(
            help="Chips for the spiking policies, separated by commas, or the option again.",
            show_default="what each was trained for, else loihi1",
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each row.")] = 20,
    seed: Seed = seeds.EVALUATION,
    teacher: Annotated[
        str | None,
        typer.Option(
            metavar="TEACHER",
            help="A row for a teacher, as `distill` takes it; a function of yours runs as your "
            "code.",
        ),
    ] = None,
    teacher_units: Annotated[
        TeacherUnits | None,
        typer.Option(help="Units of its actions.", show_default="those of its kind"),
    ] = None,
    set_: EnvOptions = None,
    success: Success = None,
    metric: Metrics = None,
    disturb: Disturb = None,
    fault: FaultsOption = None,
    specimen: Specimen = 0,
    energy: Energy = None,
    workers: Workers = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for report.json, report.html and plots."),
    ] = None,
    limits: LimitsOption = "on",
    quantise: Quantise = "layer",
    rounding: Rounding = None,
    headroom: Headroom = "none",
    thresholds: Thresholds = None,
    weight_shift: WeightShift = 0,
    tables: Tables = "one",
    force: Force = False,
    json: Json = False,
) -> None:
    """Compare policies on the same seeds: returns, agreement, spikes, operations, energy."""
    from dataclasses import replace

    from spikedeploy.comparison.evaluation import compare_policies
    from spikedeploy.comparison.lineup import line_up, on_another_chip
    from spikedeploy.comparison.metrics import checked_metrics
    from spikedeploy.console import print_json, say
    from spikedeploy.make_env import parse_options
    from spikedeploy.outputs import check_output_folder
    from spikedeploy.policies.scripts import teacher_candidate
    from spikedeploy.reports import comparison as report
    from spikedeploy.reports.terminal import print_comparison
    from spikedeploy.runtime.chips.chip import listed
    from spikedeploy.runtime.faults import faults
    from spikedeploy.runtime.metrics.energy import checked_table_names
    from spikedeploy.shipping.exported_run import runnable

    if teacher_units and teacher is None:
        raise typer.BadParameter("--teacher-units goes with --teacher")
    if output:
        inputs = [*(files or ()), *([teacher] if teacher else ())]
        check_output_folder("-o", output, report.FILES, inputs, force, report.is_report)
    prices = checked_table_names(energy or ())
    metrics = checked_metrics(metric or ())
    rounded = quantisation(quantise, rounding, headroom, thresholds, weight_shift)
    broken = faults(fault or (), specimen)
    policies = [runnable(file) for file in files or ()]
    taught = teacher and teacher_candidate(runnable(teacher), teacher_units)
    asked = listed(",".join(chips)) if chips else None
    entries = line_up(env, policies, asked, limits == "on", rounded, broken, taught or None)
    for remark in filter(None, map(on_another_chip, entries)):
        say(remark)
    options = parse_options(set_ or (), disturb or (), success)
    numbers = range(seed, seed + episodes)
    comparison = compare_policies(env, entries, numbers, workers, options, metrics)
    document = report.document(replace(comparison, tables=prices))
    if output:
        recorded = report.recordings(comparison, document["rows"], options)
        report.write(document, output, episodes=recorded)
    if json:
        print_json(document)
    else:
        print_comparison(document, tables == "all")
        if output:
            typer.echo(f"wrote {output / 'report.html'}")
