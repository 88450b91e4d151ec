"""What draws is not touched until something is drawn, and where it fails its variable is named."""

import os
import subprocess
import sys

import pytest

from tests.paths import ROOT

PLAY = """
from spikedeploy import envs
env = envs.make({env!r}, render_mode={mode!r})
env.reset(seed=0)
env.step(env.action_space.sample())
{more}
"""
DRAW = """
from spikedeploy.runtime.errors import EnvError
try:
    print("drawn", env.render().shape)
except EnvError as error:
    print("EnvError", error)
"""


def play(env, mode=None, more="", **variables):
    """What a process prints that makes and steps an environment."""
    code = PLAY.format(env=env, mode=mode, more=more)
    names = ("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "SDL_VIDEODRIVER", "MUJOCO_GL")
    clean = {name: value for name, value in os.environ.items() if name not in names}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**clean, **variables},
        check=True,
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize("env", ["hexapod", "InvertedPendulum-v5"])
@pytest.mark.parametrize("name", ["nonsense", "OSMESA", ""])
def test_what_draws_nothing_runs_with_any_mujoco_gl(env, name):
    done = play(env, MUJOCO_GL=name)
    assert "Traceback" not in done.stderr


def test_a_walker_that_is_not_drawn_opens_no_library_of_opengl():
    play("hexapod", more="import sys; assert not {'mujoco.egl', 'OpenGL'} & set(sys.modules)")


@pytest.mark.parametrize("env", ["hexapod", "InvertedPendulum-v5"])
def test_a_renderer_that_fails_names_its_variable(env):
    done = play(env, "rgb_array", DRAW, MUJOCO_GL="nonsense")
    assert done.stdout.startswith("EnvError no OpenGL to draw with: MUJOCO_GL is 'nonsense'")
    assert "Set it to egl" in done.stdout
    assert "Traceback" not in done.stderr


def test_pygame_draws_in_memory_without_a_word_and_names_its_variable_where_it_cannot():
    done = play("CartPole-v1", "rgb_array", DRAW)
    assert done.stdout.startswith("drawn (400, 600, 3)")
    assert "XDG_RUNTIME_DIR" not in done.stdout + done.stderr
    done = play("CartPole-v1", "rgb_array", DRAW, SDL_VIDEODRIVER="nonsense")
    assert "SDL_VIDEODRIVER is nonsense" in done.stdout
