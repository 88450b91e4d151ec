"""The tutorials as prose and blocks, and whether a block prints what they show.

A tutorial is the part of a page of docs/ above the comment `end of the tutorial`.

A block of `text` behind another shows lines of what that one prints: all in their order, maybe not
all that there are, white space aside and numbers within 5 %. With a title it is only shown: of a
training that tests cut short. A block of Python, C or TOML with a title is a file. Other programs,
as compilers, run where they are installed; elsewhere what stands behind them is passed over.
"""

import re
import shlex
from dataclasses import dataclass

from tests.paths import ROOT

FOLDER = ROOT / "docs"
END = "<!-- end of the tutorial -->"
PAGES = [page for page in sorted(FOLDER.glob("*.md")) if END in page.read_text("utf-8")]
NOTEBOOKS = ("python", "own-network", "own-robot")

TOOLS = ("make", "cc", "arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")
_BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.M | re.S)
_NUMBER = r"-?\d[\d,]*\.?\d*"
_VALIDATION = ["validation.episodes=1", "validation.limit=40"]
# settings with which a recipe trains for seconds
_SHORT = {
    "ppo-snn": [
        "steps=256", "env.count=2", "horizon=32", "minibatch=32", "epochs=1", "critic_hidden=[16]",
        "checkpoint_every=128", "validation.every=128",
    ],
    "sac-mlp": [
        "steps=240", "warm_up=80", "update_every=4", "batch=16", "policy.hidden=[16,16]",
        "critic_hidden=[16]", "log_every=80", "checkpoint_every=120", "validation.every=120",
    ],
    "distill-sparse": [
        "patience=1", "shrink=0.1", "teacher_walks=2", "noisy_walks=1", "walks=1",
        "dense_updates=20", "dense_rounds=1", "level_updates=20", "polish=1",
        "polish_updates=10", "prune_every=5",
        "batch=8", "log_every=5", "checkpoint_every=20", "validation.every=10",
    ],
    "distill-sparse-tuned": [
        "iterations=2", "warm_up=1", "episodes=2", "window=16", "burn_in=4", "batch=4", "epochs=1",
        "critic_hidden=[16]", "critic_epochs=1", "checkpoint_every=1", "validation.every=1",
    ],
}  # fmt: skip


@dataclass(frozen=True)
class Part:
    """A piece of a page.

    kind   "prose", or the language of a block
    text   without the fences
    title  of a block, or ""
    """

    kind: str
    text: str
    title: str = ""


def parts(page):
    """Prose and blocks, in order."""
    text, found, end = page.read_text("utf-8").partition(END)[0], [], 0
    for block in _BLOCK.finditer(text):
        found += [
            Part("prose", text[end : block.start()]),
            Part(block[1], block[3], block[2] or ""),
        ]
        end = block.end()
    return [*found, Part("prose", text[end:])]


def commands(block):
    """Lines of a shell block with a command of this tool."""
    return [line for line in _lines(block) if line.startswith("spikedeploy ")]


def programs(block):
    """The words of its other lines, if they are of programs that a reader of C has; else none."""
    lines = [shlex.split(line) for line in _lines(block) if line and not line.startswith("#")]
    known = [words for words in lines if words[0] in TOOLS or words[0].startswith("kart/")]
    return known if len(known) + len(commands(block)) == len(lines) else []


def _lines(block):
    return block.text.replace("\\\n", " ").splitlines()


def fails(line):
    """Whether the page says that a command ends with exit code 1."""
    return line.endswith("# exit code 1")


def short(line):
    """A command line, whose training takes seconds; what it trained is compared in one episode."""
    words = shlex.split(line, comments=True)
    if words[1] == "compare" and "last" in words:
        return re.sub(r"--episodes \d+", "--episodes 1", line)
    if words[1] not in ("train", "distill"):
        return line
    trained = words[1] == "train"
    recipe = words[words.index("--recipe") + 1] if trained else "distill-sparse"  # with --budget
    settings = [*_SHORT[recipe], *_VALIDATION]
    return shlex.join([*words, *(word for each in settings for word in ("--set", each))])


def missing(shown, printed):
    """The first line of what is shown that was not printed behind the lines before, or None."""
    printed = " ".join(printed.split())
    for line in filter(None, map(str.strip, shown.splitlines())):
        words = " ".join(line.split())
        pattern = re.escape(re.sub(_NUMBER, "\0", words)).replace("\0", f"({_NUMBER})")
        wanted = _numbers(re.findall(_NUMBER, words))
        found = (hit for hit in re.finditer(pattern, printed) if _near(wanted, hit.groups()))
        if (hit := next(found, None)) is None:
            return line
        printed = printed[hit.end() :]
    return None


def _numbers(words):
    return [float(word.replace(",", "").rstrip(".")) for word in words]


def _near(wanted, words):
    pairs = zip(wanted, _numbers(words), strict=True)
    return all(abs(a - b) <= 0.05 * abs(a) + 1e-9 for a, b in pairs)
