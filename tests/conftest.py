"""One thread for each process of the suite: more only wait for each other on small matrices."""

import os
import shutil
import signal
import sys
from pathlib import Path

import hypothesis
import pytest

LAB = Path(__file__).parent / "lab"

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")


# a busy machine is slow: that an example took long says nothing
hypothesis.settings.register_profile(
    "suite", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("suite")


# in the background a shell ignores them, and what tests start would inherit that
for ignored, usual in (
    (signal.SIGINT, signal.default_int_handler),
    (signal.SIGHUP, signal.SIG_DFL),
):
    if signal.getsignal(ignored) is signal.SIG_IGN:
        signal.signal(ignored, usual)


def pytest_addoption(parser):
    """`--lab` runs the tests of the lab too; a path in their folder does so without it.

    `--fpga` runs those that take minutes of synthesis and simulation, `--record` those that compare
    the bits of floats with files, which another processor rounds otherwise.
    """
    parser.addoption("--lab", action="store_true", help="the tests of the lab too")
    parser.addoption("--fpga", action="store_true", help="long tests of FPGAs too")
    parser.addoption("--record", action="store_true", help="bits of the machine of record too")


def pytest_collection_modifyitems(config, items):
    """Skip the long tests of FPGAs, and those of one machine, where nobody asks for them."""
    reasons = {
        "fpga": "minutes of synthesis: --fpga runs it",
        "record": "bits of floats, which are one machine's: --record compares them",
    }
    for name, reason in reasons.items():
        if not config.getoption(f"--{name}"):
            for item in items:
                if item.get_closest_marker(name):
                    item.add_marker(pytest.mark.skip(reason=reason))


def pytest_ignore_collect(collection_path, config):
    """Leave out the tests of the lab where nobody asks for them."""
    asked = (Path(config.invocation_params.dir, word.partition("::")[0]) for word in config.args)
    wanted = config.getoption("--lab") or any(path.is_relative_to(LAB) for path in asked)
    return True if collection_path == LAB and not wanted else None


@pytest.fixture(autouse=True)
def curves(monkeypatch):
    """Leave learning curves out, a third of a short training; tests/trainers/test_runs.py draws."""
    from spikedeploy.trainers import metrics_file

    monkeypatch.setattr(metrics_file, "draw_curve", lambda *_: None)


@pytest.fixture
def command(monkeypatch, capsys):
    """Run a command line; its exit code, stdout and stderr.

    Where it names no number of processes it uses this one: starting others takes seconds.
    """
    from spikedeploy import cli, jobs

    monkeypatch.setattr(jobs, "cores", lambda: 1)

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["spikedeploy", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        out, err = capsys.readouterr()
        return stop.value.code or 0, out, err

    return call


@pytest.fixture
def stroll(monkeypatch, tmp_path):
    """The folder that commands run in; the zoo beside it has the policies of a toy walker."""
    from tests import toy_stroll_env

    toy_stroll_env.ship(monkeypatch, tmp_path / "zoo")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def chromium():
    """One Chromium without a window for all tests, whose console is read; or they are skipped."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium")
    binary, service = shutil.which("chromium"), shutil.which("chromedriver")
    if not (binary and service):
        pytest.skip("needs chromium and chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for each in ("--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1280,1000"):
        options.add_argument(each)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(service))
    yield driver
    driver.quit()


@pytest.fixture
def browser(chromium):
    """The browser as it began: an empty page of its own size and colours, nothing logged."""
    chromium.get("about:blank")
    chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    chromium.get_log("browser")
    return chromium
