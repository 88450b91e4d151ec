"""Notebooks of tutorials, made from pages of docs/: one text, read as a page or run cell by cell.

`python -m tests.lab.notebooks` writes examples/notebooks anew. What a page shows under a block
is the output of its cell; the outputs of a run are not kept.
"""

import json
import re

from tests.paths import ROOT
from tests.project.tutorials import FOLDER, NOTEBOOKS, commands, parts

FILES = {name: ROOT / f"examples/notebooks/{name}.ipynb" for name in NOTEBOOKS}
_ALSO = re.compile(r"Also as a notebook:\s+\[.+?\]\(.+?\)\.")
_TOP = """# needs spikedeploy in this kernel, and its checkout, where the files are and paths begin:
# it is found above or in this folder; where the notebook was copied elsewhere, name it
CHECKOUT = ""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

here = Path(CHECKOUT).expanduser().resolve() if CHECKOUT else Path.cwd()
places = (here, *here.parents, *here.glob("*/"))
top = next((each for each in places if (each / "examples/net.nir").exists()), None)
if top is None or find_spec("spikedeploy") is None:
    raise FileNotFoundError(
        "this notebook needs a checkout of spikedeploy, and the package in this kernel: in the "
        "checkout, pip install -e '.[train]'; then write its path into CHECKOUT"
    )
os.chdir(top)
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
"""


def notebook(name):
    """The page of that name as a notebook, format 4.5."""
    cells, pieces = [], parts(FOLDER / f"{name}.md")
    for part in pieces:
        if part.kind == "text" and not part.title:
            cells[-1]["outputs"] = [{"output_type": "stream", "name": "stdout", "text": part.text}]
        elif part.kind == "python" and part.title:
            cells.append(_code(f"%%writefile {part.title}\n{part.text}"))
        elif part.kind == "python":
            cells.append(_code(part.text))
        elif part.kind == "sh" and commands(part):
            cells.append(_code(re.sub(r"^(?=\S)", "!", part.text, flags=re.M)))
        elif part.kind == "prose":
            _prose(
                cells, _linked(_ALSO.sub(rf"Made from the page [{name}.md]({name}.md).", part.text))
            )
        else:
            over = f"*{part.title}*\n\n" if part.title else ""
            _prose(cells, f"{over}```{part.kind}\n{part.text}```")
    cells.insert(1, _code(_TOP))
    numbered = [{"id": f"cell-{k}", **cell} for k, cell in enumerate(map(_stripped, cells))]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return {"cells": numbered, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


def text(name):
    """The notebook as its file is written."""
    return json.dumps(notebook(name), indent=1, ensure_ascii=False) + "\n"


def _code(source):
    return {
        "cell_type": "code", "execution_count": None, "metadata": {}, "outputs": [],
        "source": source,
    }  # fmt: skip


def _prose(cells, source):
    """A cell of Markdown, or more of the one before."""
    if not source.strip():
        return
    if cells and cells[-1]["cell_type"] == "markdown":
        cells[-1]["source"] += "\n\n" + source.strip()
    else:
        cells.append({"cell_type": "markdown", "metadata": {}, "source": source.strip()})


def _stripped(cell):
    return {**cell, "source": cell["source"].strip("\n")}


def _linked(prose):
    """Links of docs/ as links of examples/notebooks/."""
    prose = re.sub(r"\]\((?![a-z]+:|\.\./)", "](../../docs/", prose)
    return re.sub(r"\]\(\.\./(?!\.\./)", "](../../", prose)


if __name__ == "__main__":
    for name, file in FILES.items():
        file.parent.mkdir(exist_ok=True)
        file.write_text(text(name), encoding="utf-8")
