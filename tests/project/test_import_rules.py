"""Who may import whom: packages, folders of `runtime`, libraries. No circles anywhere."""

import ast
import builtins
import subprocess
import sys

import pytest

from tests.paths import ROOT

# our packages, and those of them that each may import
PACKAGES = {
    "envs": set(),
    "runtime": set(),
    "trainers": {"envs", "runtime"},
    "exporters": {"trainers", "runtime"},
    "spikedeploy": {"envs", "runtime", "trainers", "exporters"},
}
# folders of runtime, and those that each may import; errors, metadata and convention are for all
RUNTIME = {
    "graph": set(),
    "codec": set(),
    "chips": set(),
    "artifact": {"graph", "codec"},
    "float_model": {"artifact", "graph"},
    "design_rules": {"artifact", "chips", "graph"},
    "compiler": {"design_rules", "float_model", "artifact", "chips", "graph"},
    "faults": {"compiler", "chips"},
    "emulator": {"faults", "compiler", "float_model", "artifact", "codec", "chips", "graph"},
    "families": {"traces", "emulator", "compiler", "chips"},
    "metrics": {"emulator", "compiler", "float_model", "chips"},
    "analysis": {"emulator", "compiler", "float_model", "artifact", "chips"},
    "traces": {"metrics", "emulator", "compiler", "chips"},
}
# libraries that each package may import
LIBRARIES = {
    "envs": {"numpy", "gymnasium", "mujoco", "pymunk", "pygame"},
    "runtime": {"numpy", "nir", "h5py", "numba"},
    "trainers": {
        "numpy", "torch", "snntorch", "pydantic", "safetensors", "tomli", "gymnasium",
        "matplotlib", "onnxruntime", "rich",
        "nir",  # the graph of an event-driven policy, which chips validate while it is trained
    },
    "exporters": {"numpy", "torch", "nir", "onnx", "onnxruntime"},
    "spikedeploy": {
        "numpy", "typer", "rich", "matplotlib", "onnxruntime", "av", "PIL", "gymnasium", "torch",
        "pygame", "optuna", "ray", "sqlalchemy", "tomli", "zmq", "markdown_it",
        "tensorboard",  # films of trainings, where somebody has it
    },
}  # fmt: skip


def dotted(path):
    """Name of a module or package as it is imported."""
    parts = [p for p in path.relative_to(ROOT).with_suffix("").parts if p != "__init__"]
    return ".".join(parts if parts[0] == "spikedeploy" else ["spikedeploy", *parts])


def sources():
    """Files of every package, where they stand and not through a link; scripts of kits are data."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            linked = any(parent.is_symlink() for parent in path.parents)
            if not linked and path.parent != ROOT / "exporters" / "kit":
                yield path


MODULES = {dotted(path): path for path in sources()}
TREES = {name: ast.parse(path.read_text("utf-8")) for name, path in MODULES.items()}


def imports(tree):
    """(module, line) of every import, wherever it stands; of our own, the file that is meant."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield (whole if whole in MODULES else node.module), node.lineno


def ours(name):
    """Our modules that a module imports."""
    return {found for found, _ in imports(TREES[name]) if found in MODULES and found != name}


def package(name):
    """The package of a module of this repository."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in PACKAGES else "spikedeploy"


def folder(name):
    """The folder of a module; files at the root of a package count each for itself."""
    if MODULES[name].name == "__init__.py":
        return name
    above = name.rpartition(".")[0]
    return name if above.rpartition(".")[2] in PACKAGES else above


def circle(arrows):
    """Some circle in a graph {node: its targets}, or None."""
    left = {node: set(targets) - {node} for node, targets in arrows.items()}
    while leaves := [node for node, targets in left.items() if not targets & left.keys()]:
        for node in leaves:
            del left[node]
    if not left:
        return None
    way = [next(iter(left))]
    while way[-1] not in way[:-1]:
        way.append(min(left[way[-1]] & left.keys()))
    return way[way.index(way[-1]) :]


def loaded_by(code, *suspects):
    """Which of the suspects are loaded after the code ran in a fresh interpreter."""
    report = f"import sys; print(sorted({set(suspects)!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{report}"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return ast.literal_eval(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("name", MODULES)
def test_a_module_imports_only_what_its_package_may(name):
    own = package(name)
    near = {own} | PACKAGES[own]
    far = LIBRARIES[own] | sys.stdlib_module_names
    for found, line in imports(TREES[name]):
        allowed = package(found) in near if found in MODULES else found.split(".")[0] in far
        assert allowed, f"{MODULES[name]}:{line} imports {found}"


@pytest.mark.parametrize("name", [name for name in MODULES if package(name) == "runtime"])
def test_a_module_of_runtime_imports_only_what_its_folder_may(name):
    own = name.split(".")[2:3]
    if not own or own[0] not in RUNTIME:  # errors, metadata, convention and the table of contents
        assert not any(found.split(".")[2] in RUNTIME for found in ours(name))
        return
    reached = {found.split(".")[2] for found in ours(name) if len(found.split(".")) > 2}
    assert reached & RUNTIME.keys() <= RUNTIME[own[0]] | set(own)


def test_every_folder_of_runtime_stands_in_the_table():
    found = {p.name for p in (ROOT / "runtime").iterdir() if (p / "__init__.py").exists()}
    assert found == RUNTIME.keys()


def test_no_files_import_each_other_in_a_circle():
    assert circle({name: ours(name) for name in MODULES}) is None


def test_no_folders_import_each_other_in_a_circle():
    arrows = {folder(name): set() for name in MODULES}
    for name in MODULES:
        arrows[folder(name)] |= {folder(found) for found in ours(name)}
    assert circle(arrows) is None


def test_runtime_stays_small_and_flat():
    entries = [p for p in (ROOT / "runtime").iterdir() if p.name != "__pycache__"]
    files = [path for name, path in MODULES.items() if package(name) == "runtime"]
    assert len(entries) <= 17  # the last is faults
    # 94, four for readouts: the host, their scale, their drift, what the host computes; and one
    # for sigma-delta neurons; eight for faults: damage, six of the folder, the backend with upsets;
    # two for accounting: the terms of an energy, the break-even lines; six for the files of other
    # tools: three for what they mean, the batch axis, NIRData, the float neurons with all resets;
    # two for files of strangers: limits of their containers, parameters in whole numbers; five for
    # chips with open RTL: their rules, the queue of spikes, three for recorded simulations;
    # and one for how much a replay of a recorded run computes; two for exported programs: their
    # numbers, and recorded runs of them
    assert len([path for path in files if path.name != "__init__.py"]) <= 127
    assert max(len(path.relative_to(ROOT).parts) - 1 for path in files) <= 3


def test_every_class_name_stands_once():
    names = [
        (node.name, name)
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    ]
    first = dict(reversed(names))
    assert [(name, here, first[name]) for name, here in names if first[name] != here] == []


def test_no_public_name_of_ours_hides_one_of_pythons():
    hidden = [
        f"{name}: {node.name}"
        for name, tree in TREES.items()
        for node in tree.body
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and node.name in dir(builtins)
    ]
    assert hidden == []


@pytest.mark.parametrize("name", MODULES)
def test_a_module_imports_by_absolute_names(name):
    relative = [n for n in ast.walk(TREES[name]) if isinstance(n, ast.ImportFrom) and n.level]
    assert not relative


def at_once(tree):
    """Libraries and packages that are imported when the module is loaded."""
    for node in tree.body:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if not isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield from (found for found, _ in imports(node))


def loaded_with(name, seen):
    """Libraries that loading a module of ours imports, itself or through others of ours."""
    for found in at_once(TREES[name]):
        if found not in MODULES:
            yield found.split(".")[0]
        elif found not in seen:
            seen.add(found)
            yield from loaded_with(found, seen)


# what `spikedeploy --help` loads; it waits for nothing else
FRONT = ["spikedeploy", "spikedeploy.cli", *(n for n in MODULES if ".commands." in n)]
LIGHT = {"typer", "rich", *sys.stdlib_module_names}


@pytest.mark.parametrize("name", FRONT)
def test_a_command_imports_what_is_heavy_inside_its_function(name):
    assert set(loaded_with(name, {name})) <= LIGHT


def test_help_loads_nothing_heavy():
    code = """
import sys
from spikedeploy.cli import main
sys.argv = ["spikedeploy", "--help"]
try:
    main()
except SystemExit as stop:
    if stop.code:
        raise
"""
    assert loaded_by(code, "torch", "mujoco", "pygame", "numpy", "matplotlib") == []


def test_the_whole_runtime_loads_without_torch_and_without_physics():
    names = [name for name in MODULES if package(name) == "runtime"]
    code = f"import importlib\nfor name in {names}: importlib.import_module(name)"
    last = "spikedeploy.runtime.artifact.artifact"
    assert loaded_by(code, "torch", "mujoco", "pymunk", last) == [last]


@pytest.mark.parametrize("name", ["envs", "runtime"])
def test_a_package_loads_nothing_heavy_until_it_is_used(name):
    code = f"import spikedeploy.{name}"
    assert loaded_by(code, "torch", "mujoco", "nir", "h5py", "matplotlib") == []


def test_every_name_of_the_public_interface_exists():
    code = "from spikedeploy import runtime; [getattr(runtime, name) for name in runtime.__all__]"
    assert loaded_by(code, "torch") == []
