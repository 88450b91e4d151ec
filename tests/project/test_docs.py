"""What the pages say works: their commands and their Python run, their paths are there."""

import ast
import re
import shlex
from pathlib import Path

import pytest
import typer

from tests.paths import ROOT

PAGES = [
    ROOT / "README.md",  # whose Python test_readme.py runs
    ROOT / "CONTRIBUTING.md",
    *sorted(ROOT.glob("docs/*.md")),
    ROOT / "results/README.md",
]
TUTORIALS = sorted(ROOT.glob("docs/tutorials/*.md"))  # which test_tutorials.py follows
ARCHITECTURE = ROOT / "docs/architecture.md"

# commands that are not run here, only checked for options that do not exist; and why
NOT_RUN = {
    r"test\b": "this suite itself",
    r"demo\b": "a minute of episodes and films",
    r"(train|tune|distill)\b": "trains for minutes or hours",
    r"export last\b": "needs a training",
    r"(play|draw)\b": "opens a window",
    r"replay\b": "opens a window, or films what a training left",
    r"compare hexapod": "minutes of episodes",
    r"run last\b": "needs a training",
    r"compare (CartPole-v1|my_module:MyEnv) last\b": "needs a training",
    r"reproduce results/": "needs results/, which no other command should be able to write",
    r".* --episodes 100\b": "minutes of episodes",
    r"sweep .* --address\b": "needs a cluster",
    r"run walker/libpolicy": "needs a build; test_native.py runs one",
    r"serve\b": "answers until it is stopped; test_server.py asks it",
    r"run .* --(rate|watch)\b": "twenty seconds by the clock; test_paced_loop.py runs one",
    r"run (policy|kept)\.nir": "needs a policy of the reader's own",
}


def blocks(page, language):
    """Code blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)


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


@pytest.mark.parametrize("page", [p for p in PAGES[1:] if blocks(p, "python")], ids=name)
def test_the_python_of_a_page_runs(page, checkout):
    for block in blocks(page, "python"):
        exec(compile(block, page.name, "exec"), {})


FOLDERS = "runtime|envs|trainers|exporters|spikedeploy|lab|tests|examples"
PATH = rf"(?<![\w/.])((?:{FOLDERS})/[\w./-]*\w/?)(?![\w*<])"
ENVIRONMENT = r"spikedeploy/\w+-v\d"


# its tables name files as they were at the commit that was measured
OF_A_COMMIT = ROOT / "docs" / "mutation-testing.md"


@pytest.mark.parametrize("page", [p for p in (*PAGES, *TUTORIALS) if p != OF_A_COMMIT], ids=name)
def test_the_paths_that_a_page_names_exist(page):
    named = set(re.findall(PATH, re.sub(ENVIRONMENT, "", page.read_text("utf-8"))))
    assert sorted(path for path in named if not (ROOT / path).exists()) == []


def beside():
    """Files beside docs/ that are on the site, whose builder is not needed to ask it."""
    tree = ast.parse((ROOT / "docs/site/repository.py").read_text("utf-8"))
    (patterns,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and node.targets[0].id == "BESIDE"
    )
    return {path for pattern in patterns for path in ROOT.glob(pattern)}


@pytest.mark.parametrize(
    "page", [*PAGES, *TUTORIALS, *sorted(ROOT.glob("results/[!R]*.md"))], ids=name
)
def test_the_links_of_a_page_lead_to_files_of_the_site(page):
    links = re.findall(r"\]\((?!https?:|#|mailto:)([^)#\s]+)", page.read_text("utf-8"))
    found = {(page.parent / link).resolve() for link in links}
    site = {*beside(), *(ROOT / "docs").rglob("*.*")}
    assert sorted(path for path in found if path.suffix != ".py" and path not in site) == []
    assert all(path.exists() for path in found)


@pytest.mark.parametrize("page", [*PAGES, *TUTORIALS], ids=name)
def test_the_modules_that_a_page_names_exist(page):
    named = re.findall(r"spikedeploy(?:\.[a-z_0-9]+)+", page.read_text("utf-8"))
    assert [name for name in named if not known(name)] == []


def known(name):
    """Whether a dotted name is a module of this repository, or something defined in one."""
    where = ROOT.joinpath(*name.split("."))
    module = where.parent.with_suffix(".py")
    package = where.parent / "__init__.py"
    if where.with_suffix(".py").exists() or where.is_dir():
        return True
    text = "".join(file.read_text("utf-8") for file in (module, package) if file.exists())
    return bool(re.search(rf"\b{where.name}\b", text))


def test_the_classes_of_the_architecture_stand_where_it_says():
    table = re.findall(r"^\| `(\w+)` \| `([\w/]+\.py)` \|", ARCHITECTURE.read_text("utf-8"), re.M)
    assert len(table) > 20
    for name, file in table:
        tree = ast.parse((ROOT / file).read_text("utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.ClassDef)}, file


def test_the_architecture_describes_every_folder_of_runtime():
    described = re.findall(r"^\| `(\w+)/` \|", ARCHITECTURE.read_text("utf-8"), re.M)
    folders = [path.parent.name for path in (ROOT / "runtime").glob("*/__init__.py")]
    assert sorted(described) == sorted(folders)
