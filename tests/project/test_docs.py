"""What the pages say works: their commands and their Python run, their paths are there."""

import re
import shlex
from pathlib import Path

import pytest
import typer

from tests.paths import ROOT
from tests.project.tutorials import END

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(ROOT.glob("docs/*.md")),
    ROOT / "results/README.md",
]

# commands that are not run here, only checked for options that do not exist; and why
NOT_RUN = {
    r"test\b": "this suite itself",
    r"demo\b": "a minute of episodes and films",
    r"(train|tune|distill|adapt)\b": "trains for minutes or hours",
    r"export last\b": "needs a training",
    r"play\b": "opens a window",
    r"compare hexapod": "minutes of episodes",
    r"run last\b": "needs a training",
    r"compare \S+ last\b": "needs a training",
    r"reproduce results/": "needs results/, which no other command should be able to write",
    r".* --episodes 100\b": "minutes of episodes",
    r"run walker/libpolicy": "needs a build; test_native.py runs one",
    r"run hexapod/sparse --via": "needs a build; test_export_verilog.py runs one",
    r"sweep .* --retry\b": "the sweep before it, which left nothing to retry",
    r"serve\b": "answers until it is stopped; test_server.py asks it",
    r"run .* --(rate|watch)\b": "twenty seconds by the clock; test_paced_loop.py runs one",
    r"run (policy|kept)\.nir": "needs a policy of the reader's own",
}


def blocks(page, language):
    """Code blocks of a language, in order; test_tutorials.py has those of tutorials."""
    above, end, below = page.read_text("utf-8").partition(END)
    text = below if end else above
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.M | re.S)


def lines(page):
    """Command lines of this tool in the shell blocks of a page, as words without its name."""
    for block in blocks(page, "sh"):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words and words[0] in ("spikedeploy", "./spike"):
                yield words[1:]


def name(page):
    """A page from the top of the repository."""
    return str(page.relative_to(ROOT))


ALL = [(name(page), words) for page in PAGES for words in lines(page)]


def reason(words):
    """Why a command is not run, or None."""
    text = " ".join(words)
    return next((why for pattern, why in NOT_RUN.items() if re.match(pattern, text)), None)


def unique(wanted):
    """Commands (page, words), each once: several pages show the same."""
    found = {tuple(words): page for page, words in ALL if wanted(words)}
    return [
        pytest.param(list(words), id=f"{page}: {' '.join(words)}") for words, page in found.items()
    ]


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A folder with what the commands of the pages read, and room for what they write."""
    for name in ("examples", "spikedeploy", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    for name in ("net.nir", "raster.npy"):
        (tmp_path / name).symlink_to(ROOT / "examples" / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def expanded(words):
    """Words with their patterns of files replaced, as a shell does."""
    for word in words:
        yield from sorted(map(str, Path().glob(word))) if "*" in word else [word]


@pytest.mark.parametrize("words", unique(lambda words: not reason(words)))
def test_a_command_of_the_pages_runs(words, checkout, command):
    code, _, err = command(*expanded(words))
    assert code == 0, err


@pytest.mark.parametrize("words", unique(lambda words: reason(words) and words[0] != "test"))
def test_a_command_that_is_not_run_has_options_that_exist(words):
    from spikedeploy.cli import app

    verb = typer.main.get_command(app).commands[words[0]]
    with verb.make_context(words[0], [], resilient_parsing=True) as context:
        verb.make_parser(context).parse_args(words[1:])  # raises for an option that is unknown


@pytest.mark.parametrize("pattern", NOT_RUN)
def test_every_exception_is_needed(pattern):
    assert any(re.match(pattern, " ".join(words)) for _, words in ALL)


def test_the_readmes_python_lets_the_robot_walk(checkout, capsys):
    own_network, example = blocks(PAGES[0], "python")
    exec(own_network, {})
    assert Path("trained.nir").is_file()
    exec(example, {})
    total, sops = map(float, capsys.readouterr().out.split())
    assert total > 2500
    assert 0 < sops < 748_544 * 5
    assert (checkout / "walk.npz").exists()


@pytest.mark.parametrize("page", [p for p in PAGES[1:] if blocks(p, "python")], ids=name)
def test_the_python_of_a_page_runs(page, checkout):
    for block in blocks(page, "python"):
        exec(compile(block, page.name, "exec"), {})


def test_the_tests_that_a_page_names_exist():
    for page in PAGES:
        for path, name in re.findall(r"(tests/[\w/]+\.py)::(test_\w+)", page.read_text("utf-8")):
            assert f"def {name}(" in (ROOT / path).read_text("utf-8"), (page.name, path, name)


def test_every_page_of_results_is_in_the_navigation():
    """docs/site/navigation.py makes it from the links of docs/README.md."""
    linked = re.findall(
        r"\]\(\.\./(results/[^)#]+\.md)\)", (ROOT / "docs/README.md").read_text("utf-8")
    )
    assert {name(page) for page in ROOT.glob("results/*.md")} - {*linked} == set()
