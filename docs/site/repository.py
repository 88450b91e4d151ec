"""Pages of the site lie where they lie in the repository, so that their links lead there too."""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

# what the pages of docs/ link to beside it
BESIDE = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "results/**/*.md",
    "results/**/*.png",
    "results/**/*.csv",
    "results/*.json",
    "examples/notebooks/*.ipynb",
    "examples/*/README.md",
)
# a link to a source file, which becomes a page that shows it
SOURCE = re.compile(r"\]\(((?:\.\./)*(?:[\w-]+/)*\w[\w-]*\.(?:py|toml))\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """All files with their paths in the repository, those beside docs/, and sources."""
    top = Path(config.config_file_path).parent
    for file in [file for file in files if file.src_dir == config.docs_dir]:
        files.remove(file)
        _place(files, config, Path(config.docs_dir, file.src_uri), top)
    for pattern in BESIDE:
        for path in sorted(top.glob(pattern)):
            _place(files, config, path, top)
    named = {name for page in files.documentation_pages() for name in _sources(page)}
    for name in sorted(named):
        files.append(File.generated(config, f"{name}.md", content=_shown(top, name)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links to sources lead to the pages that show them."""
    return SOURCE.sub(r"](\1.md)", markdown)


def _place(files: Files, config: MkDocsConfig, path: Path, top: Path) -> None:
    name = path.relative_to(top).as_posix()
    files.append(File.generated(config, name, abs_src_path=str(path)))


def _sources(page: File) -> list[str]:
    folder = posixpath.dirname(page.src_uri)
    found = SOURCE.findall(page.content_string)
    return [posixpath.normpath(posixpath.join(folder, name)) for name in found]


def _shown(top: Path, name: str) -> str:
    text, language = (top / name).read_text("utf-8"), name.rpartition(".")[2]
    return f"---\nsearch:\n  exclude: true\n---\n# {name}\n\n```{language}\n{text}```\n"
