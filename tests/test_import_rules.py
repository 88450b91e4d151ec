"""The house: who may import whom. The table is the one in the README's map."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
OURS = {"envs", "runtime", "trainers", "exporters", "spikedeploy"}

# package -> our packages that it may import
NEIGHBOURS = {
    "envs": set(),
    "runtime": set(),
    "trainers": {"envs", "runtime"},
    "exporters": {"trainers", "runtime"},
    "spikedeploy": OURS,
}
# package -> third-party packages that it may import
STRANGERS = {
    "envs": {"numpy", "gymnasium", "mujoco", "pymunk", "pygame"},
    "runtime": {"numpy", "nir", "h5py", "numba"},
    "trainers": {
        "numpy", "torch", "snntorch", "pydantic", "safetensors", "tomli", "gymnasium",
        "matplotlib", "onnxruntime", "rich",
    },
    "exporters": {"numpy", "torch", "nir", "onnx", "onnxruntime"},
    "spikedeploy": {
        "numpy", "typer", "rich", "matplotlib", "onnxruntime", "av", "PIL", "gymnasium", "torch",
        "pygame",
    },
}  # fmt: skip

MODULES = sorted(path for package in OURS for path in (ROOT / package).rglob("*.py"))
# what `spikedeploy --help` loads; it waits for nothing else
FRONT = [ROOT / "spikedeploy/__init__.py", ROOT / "spikedeploy/cli.py"]
FRONT += sorted((ROOT / "spikedeploy/commands").glob("*.py"))
LIGHT = {"spikedeploy", "typer", "rich", *sys.stdlib_module_names}


def name(path):
    return path.relative_to(ROOT).as_posix()


def imported(tree):
    """Top-level package and line of every import, wherever it stands."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name.split(".")[0], node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module.split(".")[0], node.lineno


def imported_at_once(tree):
    """The imports that run when the module is loaded."""
    for node in tree.body:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if not isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield from imported(node)


def loaded_by(code, *suspects):
    """Which of the suspects are loaded after the code ran in a fresh interpreter."""
    report = f"import sys; print(sorted({set(suspects)!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{report}"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return ast.literal_eval(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_a_module_imports_only_what_its_package_may(path):
    package = path.relative_to(ROOT).parts[0]
    allowed = {package} | NEIGHBOURS[package] | STRANGERS[package] | sys.stdlib_module_names
    broken = [
        f"{name(path)}:{line} imports {found}"
        for found, line in imported(ast.parse(path.read_text("utf-8")))
        if found not in allowed
    ]
    assert not broken


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_a_module_imports_by_absolute_names(path):
    tree = ast.parse(path.read_text("utf-8"))
    relative = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.level]
    assert not relative


@pytest.mark.parametrize("path", FRONT, ids=name)
def test_a_command_imports_what_is_heavy_inside_its_function(path):
    tree = ast.parse(path.read_text("utf-8"))
    assert {found for found, _ in imported_at_once(tree)} <= LIGHT


def test_the_whole_runtime_loads_without_torch_and_without_physics():
    code = """
import importlib, pathlib
for path in sorted(pathlib.Path("runtime").rglob("*.py")):
    importlib.import_module(".".join(path.with_suffix("").parts).removesuffix(".__init__"))
"""
    assert loaded_by(code, "torch", "mujoco", "pymunk", "runtime.artifact") == ["runtime.artifact"]


@pytest.mark.parametrize("package", ["envs", "runtime"])
def test_a_package_loads_nothing_heavy_until_it_is_used(package):
    assert loaded_by(f"import {package}", "torch", "mujoco", "nir", "h5py", "matplotlib") == []


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


@pytest.mark.parametrize("table", ["runtime"])
def test_every_name_of_a_table_of_contents_exists(table):
    code = f"import {table}; [getattr({table}, name) for name in {table}.__all__]"
    assert loaded_by(code, "torch") == []
