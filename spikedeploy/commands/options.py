"""A function as a command: its parameters are options, its docstring is their help.

A docstring has a line for each option, `name: text`, and a heading of its panel, `Panel:`, above
lines that are indented. `(default: text)` at the end of a line is shown in place of the default. A
parameter that is a dataclass is a group of options, whose docstring is that of the class.
"""

import copy
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer
from typer.models import OptionInfo

from spikedeploy.evaluation_setup import Switch

# options that several commands share, with their help
Json = Annotated[
    bool,
    typer.Option(
        help="Print JSON for machines, and nothing else, on stdout.", rich_help_panel="Output"
    ),
]
Force = Annotated[
    bool,
    typer.Option(help="Replace files that this command did not write.", rich_help_panel="Output"),
]
Tables = Annotated[
    Literal["one", "all"],
    typer.Option(
        help="Print one table of 80 columns, or all: agreement, sizes, energies.",
        rich_help_panel="Output",
    ),
]
OutputPath = Annotated[Path, typer.Option("-o", "--output", rich_help_panel="Output")]
ReportFolder = Annotated[
    Path,
    typer.Option(
        "-o", "--output", help="Folder for report.html and report.json.", rich_help_panel="Output"
    ),
]
Seed = Annotated[
    int, typer.Option(help="The first seed; episode k plays seed + k. Evaluation starts at 10000.")
]
TrainingSeed = Annotated[int, typer.Option(min=0, max=4999, help="Seed of the training.")]
Workers = Annotated[
    int, typer.Option(help="Processes that play episodes.", show_default="all cores", min=1)
]
EnergyTables = Annotated[
    list[str],
    typer.Option(
        metavar="TABLE",
        help="Energy table to price by, may be repeated; `energy` lists them.",
        show_default="the chip's own",
    ),
]
Settings = Annotated[list[str], typer.Option("--set", metavar="KEY=VALUE")]
EnvOptions = Annotated[
    list[str],
    typer.Option(
        "--set", metavar="OPTION=VALUE", help="Option of the environment: --set track=small_S."
    ),
]
ChipName = Annotated[
    str,
    typer.Option(
        help="Chip of a spiking policy; 'float' for its float twin.",
        show_default="what it was trained for, else loihi1",
    ),
]
TrainedFor = Annotated[str, typer.Option("--for", metavar="CHIP")]
EnvArgument = Annotated[
    str,
    typer.Argument(
        metavar="ENV",
        help="Environment; `envs` lists ours; or an id of gymnasium, or module:Class.",
    ),
]
EnvName = Annotated[str, typer.Option(metavar="ENV")]
PolicyName = Annotated[str, typer.Argument(metavar="FILE")]
PolicyNames = Annotated[list[str], typer.Argument(metavar="[FILE]…")]
OwnNetwork = Annotated[str, typer.Option("--network", "--start", metavar="module:Class|FILE.nir")]
File = Annotated[Path, typer.Option(exists=True, dir_okay=False)]
NetworkFile = Annotated[Path, typer.Argument(metavar="FILE.nir", exists=True, dir_okay=False)]
Folder = Annotated[Path, typer.Option(metavar="FOLDER", exists=True, file_okay=False)]
Limits = Annotated[
    Switch,
    typer.Option(
        help="Refuse what breaks a design rule of the chip; 'off' emulates its arithmetic alone.",
        rich_help_panel="The emulated chip",
    ),
]
Resume = Annotated[
    str,
    typer.Option(metavar="RUN|last", help="Resume a run, or the newest."),
]
RunsFolder = Annotated[Path, typer.Option(help="Folder in which the run folder is made.")]
Checkpoint = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Checkpoint of the run, such as last or ops-480.",
        show_default="best, else last",
    ),
]

_SYNONYMS = {"chips": "chip"}  # accepted in every command, as reports have them; not in the help
_PANEL = re.compile(r"(\w[^:]*):")
_FIELD = re.compile(r"( *)(\w+): (.*)")
_DEFAULT = re.compile(r" \(default: (.*)\)")


def one_word(name: str) -> str:
    """Return the name of an option for one of its synonyms; any other name as it is."""
    return _SYNONYMS.get(name, name)


def as_command(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function as typer understands it, with a parameter for each option."""
    hints = get_type_hints(function)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters = list(_options(function))
    several = {each.name for each in parameters if get_origin(_plain(each.annotation)) is tuple}

    @wraps(function)
    def command(**given: Any) -> object:  # noqa: ANN401
        given |= {name: tuple(given[name] or ()) for name in several}
        for name, group in groups.items():
            given[name] = group(**{f.name: given.pop(f.name) for f in fields(group)})
        return function(**given)

    for each in several:
        place = next(k for k, found in enumerate(parameters) if found.name == each)
        kind, info = get_args(parameters[place].annotation)
        listed: Any = list.__class_getitem__(get_args(kind)[0])
        parameters[place] = parameters[place].replace(
            annotation=Annotated[listed | None, info], default=None
        )
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    command.__doc__, _ = _read_docstring(function, set(hints))
    return command


def _options(owner: Any) -> Iterator[inspect.Parameter]:  # noqa: ANN401
    """Yield the options of a function, then those of its groups; or those of a dataclass."""
    hints = get_type_hints(owner, include_extras=True)
    if is_dataclass(owner):
        defaults = {f.name: f.default for f in fields(owner)}
    else:
        found = inspect.signature(owner).parameters.values()
        defaults = {p.name: MISSING if p.default is p.empty else p.default for p in found}
    texts: dict[str, tuple[str, str | None]] = {}
    for each in reversed(getattr(owner, "__mro__", (owner, object))[:-1]):
        texts |= _read_docstring(each, set(defaults))[1]
    groups = [hints[name] for name in defaults if is_dataclass(hints[name])]
    for name, default in defaults.items():
        if not is_dataclass(hints[name]):
            yield _option(name, hints[name], default, *texts.get(name, ("", None)))
    for group in groups:
        yield from _options(group)


def _option(
    name: str,
    hint: Any,  # noqa: ANN401
    default: Any,  # noqa: ANN401
    text: str,
    panel: str | None,
) -> inspect.Parameter:
    """Return a parameter whose annotation has typer's words for an option."""
    kind, found = _split(hint)
    info = copy.copy(found) if found is not None else typer.Option()
    if text:
        if shown := _DEFAULT.search(text):
            info.show_default = shown[1]
        text = _DEFAULT.sub("", text).replace("[", r"\[")
        info.help = text[:1].upper() + text[1:]
    info.rich_help_panel = panel or info.rich_help_panel
    if isinstance(info, OptionInfo):  # typer takes the first flag for a default
        flags = (info.default, *(info.param_decls or ()))
        info.param_decls = tuple(each for each in flags if isinstance(each, str))
        info.default = ...
        if not info.param_decls and default is not True:  # of which typer makes --no-… too
            info.param_decls = (f"--{name.strip('_').replace('_', '-')}",)
    none = inspect.Parameter.empty if default is MISSING else default
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=none, annotation=Annotated[kind, info]
    )


def _split(hint: Any) -> tuple[Any, Any]:  # noqa: ANN401
    """Return a type without what is said of it, and that: of `Annotated[T, info] | None` too."""
    if get_origin(hint) is Annotated:
        return _plain(hint), hint.__metadata__[0]
    for part in get_args(hint):
        if get_origin(part) is Annotated:
            return _plain(part) | None, part.__metadata__[0]
    return hint, None


def _plain(hint: Any) -> Any:  # noqa: ANN401
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def _read_docstring(
    owner: Any,  # noqa: ANN401
    names: set[str],
) -> tuple[str, dict[str, tuple[str, str | None]]]:
    """Return a docstring without its options; and option -> its text and its panel."""
    rest: list[str] = []
    texts: dict[str, tuple[str, str | None]] = {}
    panel, last = None, ""
    for line in (inspect.getdoc(owner) or "").splitlines():
        field = _FIELD.fullmatch(line)
        if field and field[2] in names and len(field[1]) in (0, 4):
            last = field[2]
            texts[last] = field[3], panel if field[1] else None
        elif last and line.startswith("    "):
            texts[last] = f"{texts[last][0]} {line.strip()}", texts[last][1]
        elif found := _PANEL.fullmatch(line):
            panel = found[1]
        else:
            last = ""
            rest.append(line)
    return "\n".join(rest).strip(), texts
