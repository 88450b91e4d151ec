"""Who may import whom, which libraries, and what is loaded when.

The order of our packages, of the folders of `runtime`, and that nothing imports in circles are
contracts in pyproject.toml, `[tool.importlinter]`; `lint-imports` prints each with its chains.
"""

import ast
import subprocess
import sys

import grimp
import pytest

from tests.paths import ROOT

# libraries that each package may import; `runtime` computes with NumPy alone, and pydantic,
# filelock and tomli are those of its `schema` and `files`
LIBRARIES = {
    "envs": {"numpy", "gymnasium", "mujoco", "pymunk", "pygame"},
    "runtime": {"numpy", "nir", "h5py", "numba", "pydantic", "filelock", "tomli"},
    "trainers": {
        "numpy", "torch", "pydantic", "safetensors", "tomli", "gymnasium",
        "matplotlib", "onnxruntime", "rich",
        "nir",  # the graph of an event-driven policy, which chips validate while it is trained
    },
    "exporters": {"jinja2", "numpy", "torch", "nir", "onnx"},
}  # fmt: skip


@pytest.fixture(scope="module")
def imports():
    """Every import statement of the packages."""
    return grimp.build_graph("spikedeploy", include_external_packages=True, cache_dir=None)


def loaded_by(code, *suspects):
    """Which of the suspects are loaded after the code ran in a fresh interpreter."""
    report = f"import sys; print(sorted({set(suspects)!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{report}"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return ast.literal_eval(done.stdout.splitlines()[-1])


def test_imports_keep_the_contracts():
    code = "from importlinter.cli import lint_imports; raise SystemExit(lint_imports())"
    done = subprocess.run(
        [sys.executable, "-c", code, "--no-cache"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("package", LIBRARIES)
def test_a_package_imports_only_libraries_of_its_list(package, imports):
    own = f"spikedeploy.{package}"
    modules = {own, *imports.find_descendants(own)}
    assert len(modules) > 10
    found = {
        other.partition(".")[0]
        for module in modules
        for other in imports.find_modules_directly_imported_by(module)
    }
    assert found - sys.stdlib_module_names - {"spikedeploy"} == LIBRARIES[package]


def test_commands_load_nothing_heavy_until_they_run():
    paths = (ROOT / "spikedeploy/commands").glob("*.py")
    names = ["spikedeploy.cli", *(f"spikedeploy.commands.{path.stem}" for path in paths)]
    code = f"import importlib\nfor name in {names}: importlib.import_module(name)"
    heavy = ("numpy", "matplotlib", "torch", "gymnasium", "mujoco", "h5py", "onnxruntime")
    assert loaded_by(code, *heavy, "typer") == ["typer"]


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


def test_the_whole_runtime_loads_without_torch_and_without_physics(imports):
    names = sorted(imports.find_descendants("spikedeploy.runtime"))
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
