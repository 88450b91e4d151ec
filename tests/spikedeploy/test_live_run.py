"""`run --watch`: the run of before, and what a browser is told and shows of it."""

import json
import signal
import subprocess
import sys
import threading
import urllib.request
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from spikedeploy.comparison.evaluation import run_policy
from spikedeploy.envs.rollout import rollout
from spikedeploy.live import LiveView, WatchedLoop, steps_event
from spikedeploy.make_env import make_env
from spikedeploy.policies.registry import find, open_policy
from tests.paths import ROOT
from tests.waiting import PATIENCE, wait_until

RATE = 500.0


class Kept:
    """A view that keeps what it is handed."""

    def __init__(self):
        self.begun, self.steps, self.outcomes = [], [], []

    def begin(self, head):
        self.begun.append(head)
        self.table, self.deadline = head["table"], head["deadline"]

    def step(self, step):
        self.steps.append(step)

    def over(self, outcome):
        self.outcomes.append(outcome)


def data_of(message):
    return json.loads(message.split(b"data: ")[1])


@pytest.mark.parametrize(("policy", "chip"), [("popsan", "loihi2"), ("popsan", "float"),
                                              ("sac", None)])  # fmt: skip
def test_a_watched_run_is_the_run_of_before_bit_for_bit(stroll, policy, chip):
    seeds, view = range(10_000, 10_002), Kept()
    plain = run_policy(f"stroll/{policy}", None, chip, seeds)
    loop = WatchedLoop(view, RATE, None, None)
    watched = run_policy(f"stroll/{policy}", None, chip, seeds, loop=loop)
    assert watched.as_json() == plain.as_json()
    env, candidate = make_env("stroll", {}), find(f"stroll/{policy}")
    alone = rollout(env, open_policy(candidate, chip, env), seeds[0])
    actions = np.stack([step.action for step in view.steps[:20]])
    assert actions.tobytes() == alone.action.tobytes()
    assert [each["total"] for each in view.outcomes] == plain.rows[0].returns


def test_what_is_told_adds_up_to_what_is_reported(stroll):
    view = Kept()
    loop = WatchedLoop(view, RATE, "1s", None)
    (row,) = run_policy("stroll/popsan", None, None, [10_000], loop=loop).as_json()
    assert view.table == "horowitz45-int8"
    assert [step.number for step in view.steps] == list(range(20))
    sops = [step.ledger.total("sop") for step in view.steps]
    assert sum(sops) / 20 == pytest.approx(row["sops_per_inference"])
    (begun,) = view.begun
    assert (begun["label"], begun["env"], begun["period"]) == ("popsan · loihi1", "stroll", 0.02)
    data = data_of(steps_event(view.steps[5:9], view.table, view.deadline))
    assert (data["first"], data["steps"], data["missed"]) == (5, 4, view.steps[8].missed)
    assert data["actions"]["shape"] == [4, 2]
    assert data["tracks"][0]["unit"] == "%"
    names = [layer["name"] for layer in data["network"]["layers"]]
    assert names == ["input", "n2", "n4", "n6"]


def test_the_rate_is_the_environments_and_large_layers_are_left_out_by_name(stroll):
    view = Kept()
    run_policy("stroll/popsan", None, None, [0], loop=WatchedLoop(view, None, None, None))
    assert (view.begun[-1]["rate"], view.deadline) == (50.0, 1 / 50)
    step = view.steps[0]
    wide = {**step.inference.spikes, "input": np.zeros((5, 9000), np.uint8)}
    inference = replace(step.inference, spikes=wide)
    data = data_of(steps_event([replace(step, inference=inference, ledger=None)], view.table, 1.0))
    assert data["network"]["left_out"] == ["input: 9,000 neurons"]
    assert data["network"]["sops"] is None


def test_the_command_says_where_to_look_and_json_stays_json(stroll, command):
    code, out, err = command("run", "stroll/popsan", "--watch", "--rate", RATE, "--json")
    assert code == 0
    assert json.loads(out)["real_time"]["steps"] == 20
    assert "watch at http://127.0.0.1:" in err


@pytest.mark.parametrize(("words", "why"), [
    (["--port", "8000"], "--port goes with --watch"),
    (["--watch", "--video", "x.mp4"], "leave --video out"),
    (["--watch", "--deadline", "soon"], "is no time"),
    (["--watch", "--rate", "0"], "--rate"),
])  # fmt: skip
def test_options_that_make_no_sense_are_refused(stroll, command, words, why):
    code, _, err = command("run", "stroll/popsan", *words)
    assert code == 2
    assert why in " ".join(err.split())


PATIENT = f"""
from spikedeploy import cli, live
live._GOODBYE = {PATIENCE}  # two seconds may be too few on a busy core
cli.main()
"""


def test_ctrl_c_ends_the_run_while_a_browser_listens():
    line = ["run", "hexapod/sparse", "--watch", "--episodes", "9"]
    process = subprocess.Popen(
        [sys.executable, "-c", PATIENT, *line], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    try:
        address = process.stderr.readline().split()[-1]
        with urllib.request.urlopen(f"{address}events", timeout=PATIENCE) as stream:
            wait_until(lambda: stream.readline() == b"event: begin\n")
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 130
            assert b"event: end\n" in stream.read()
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def test_the_page_draws_the_run_and_keeps_its_last_picture(stroll, browser):
    from selenium.webdriver.support.ui import WebDriverWait

    def state(name, wanted):
        script = f"return document.documentElement.dataset.{name}"
        WebDriverWait(browser, PATIENCE).until(lambda found: found.execute_script(script) == wanted)

    size = {"width": 390, "height": 900, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    with closing(LiveView()) as view:
        browser.get(view.address)
        assert view.wait(PATIENCE)
        loop = WatchedLoop(view, 100.0, None, None)
        playing = threading.Thread(
            target=run_policy, args=("stroll/popsan", None, None, range(3)), kwargs={"loop": loop}
        )
        playing.start()
        state("ready", "3")
        playing.join()
    state("state", "ended")
    WebDriverWait(browser, PATIENCE).until(
        lambda found: found.find_element("id", "now").text == "0.38 s, control step 19"
    )
    shown = browser.find_element("tag name", "main").text
    assert "popsan · loihi1 in stroll" in shown
    assert "episode 3, seed 2" in shown
    assert "by horowitz45-int8" in shown
    assert "time limit" in shown
    titles = [each.text for each in browser.find_elements("css selector", ".strip span")]
    for wanted in ("input spikes", "membranes of", "synaptic operations", "time of the policy"):
        assert any(title.startswith(wanted) for title in titles), wanted
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    browser.find_element("tag name", "body").send_keys("\ue012" * 4)  # arrow left looks back
    assert browser.find_element("id", "now").text == "0.30 s, control step 15"
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
