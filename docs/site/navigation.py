"""The navigation of the site: the sections and links of docs/README.md, in their order."""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.pages import Page


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """The sections as tabs, behind the front page."""
    index = Path(config.docs_dir, "README.md").read_text("utf-8")
    _, *sections = re.split(r"^## (.+)\n", index, flags=re.M)
    tabs = [{name: _pages(text)} for name, text in zip(sections[::2], sections[1::2], strict=True)]
    config.nav = [{"Home": "README.md"}, *tabs]
    return config


def on_page_markdown(markdown: str, page: Page, **_: object) -> None:
    """The front page has no neighbours to list beside it."""
    if page.is_homepage:
        page.meta["hide"] = ["navigation"]


def _pages(text: str) -> list[dict[str, str]]:
    links = re.findall(r"\[([^\]]+)\]\(([^)#]+\.md)\)", text)
    return [{_title(words): _path(link)} for words, link in links]


def _title(words: str) -> str:
    plain = words.replace("`", "")
    return plain[0].upper() + plain[1:]


def _path(link: str) -> str:
    return link[3:] if link.startswith("../") else f"docs/{link}"
