"""The reference of the site: a page for each package, from the docstrings of its modules."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

PACKAGES = ("runtime", "envs", "trainers", "exporters")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """A tab of its own, behind the others."""
    pages = [{name.removeprefix("spikedeploy."): _file(name)} for name, _ in _packages(config)]
    config.nav.append({"API": pages})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The pages, which exist in the site alone."""
    for name, modules in _packages(config):
        first, *others = [f"::: {module}\n" for module in modules]
        page = "\n".join([first + "    options:\n      heading_level: 1\n", *others])
        files.append(File.generated(config, _file(name), content=page))
    return files


def _packages(config: MkDocsConfig) -> list[tuple[str, list[str]]]:
    """Each package with its modules, the package itself first."""
    top = Path(config.config_file_path).parent
    folders = [p.parent for name in PACKAGES for p in sorted(top.glob(f"{name}/**/__init__.py"))]
    found = [("spikedeploy", ["spikedeploy.api"])]
    for folder in folders:
        name = ".".join(("spikedeploy", *folder.relative_to(top).parts))
        modules = sorted(p.stem for p in folder.glob("*.py") if not p.stem.startswith("_"))
        found.append((name, [name, *(f"{name}.{module}" for module in modules)]))
    return found


def _file(package: str) -> str:
    return f"reference/{package}.md"
