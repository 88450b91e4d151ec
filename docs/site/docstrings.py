"""Lists in docstrings, line by line `name  what it is` or `name: what it is`, as the site's."""

import re

import griffe

_ITEM = re.compile(r"(?P<name>[\w*.()/]+(?:, [\w*.()/]+)*)(?::| {2,}) *(?P<text>\S.*)")


class ListedFields(griffe.Extension):
    """Rewrites paragraphs in which every line is an item, or goes on with the one before."""

    def on_instance(self, *, obj: griffe.Object, **_: object) -> None:
        """A module, class, function or attribute that was read."""
        if obj.docstring:
            paragraphs = obj.docstring.value.split("\n\n")
            obj.docstring.value = "\n\n".join(map(_listed, paragraphs))


def _listed(paragraph: str) -> str:
    lines = paragraph.split("\n")
    heads = [_ITEM.fullmatch(line) for line in lines]
    if not heads[0] or not all(
        head or line[:1] == " " for head, line in zip(heads, lines, strict=True)
    ):
        return paragraph
    return "\n".join(map(_line, lines))


def _line(line: str) -> str:
    head = _ITEM.fullmatch(line)
    return f"- `{head['name']}`: {head['text']}" if head else f"    {line.strip()}"
