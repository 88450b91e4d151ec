"""A check that a foreign environment repeats an episode when its seed is repeated.

Policies are compared on the same seeds, in as many processes as there are. Where an environment
carries something from one episode to the next, an episode depends on those that its process played
before. That shows in a few episodes of random actions, which are the same each time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np

from spikedeploy import envs
from spikedeploy.envs.rollout import draw_action
from spikedeploy.runtime.errors import EnvError

_STEPS = 200  # of the episode that is repeated, at most
_OTHERS, _FEW = 20, 10  # episodes in between, and steps of each at most
_Step = dict[str, Any]


def check_repeats(name: str, options: Mapping[str, Any]) -> str:
    """Refuse an environment with a memory; return a remark on one that never repeats, else "".

    Values of success that are neither true nor false are in the remark, too.

    A difference that appears after 20 episodes is not found. Our own environments do repeat.
    """
    if not envs.spec(name).foreign:
        return ""
    env = envs.make(name, **options)
    first = _play(env, 0, _STEPS)
    for seed in range(1, _OTHERS + 1):
        _play(env, seed, _FEW)
    later = _difference(first, _play(env, 0, _STEPS))
    env.close()
    unread = str(getattr(env.unwrapped, "remark", ""))
    env = envs.make(name, **options)
    anew = _difference(first, _play(env, 0, _STEPS))
    env.close()
    if later and not anew:
        raise EnvError(
            f"{name} carries something from one episode to the next: with seed 0 and the same "
            f"actions, {later} after {_OTHERS} other episodes, and as at first in a new instance. "
            "An episode would depend on those that its process played before. Begin it anew in "
            "reset(): running statistics, a counter of episodes, a random generator that the seed "
            "does not set. Or freeze it, or leave the wrapper out"
        )
    if not anew:
        return unread
    when = "each time" if later else "in each instance"
    return (
        f"{name} plays another episode {when}: with seed 0 and the same actions, {anew}. Policies "
        "meet other episodes, and results are others in each run and with other --workers. Draw "
        "all that is random in reset() and step() from self.np_random, which reset(seed=…) sets, "
        "and share nothing between instances" + f". {unread}" * bool(unread)
    )


def _play(env: gymnasium.Env[Any, Any], seed: int, most: int) -> list[_Step]:
    """Return everything observed in an episode of random actions, drawn from its seed."""
    rng, space = np.random.default_rng(seed), env.action_space
    seen: list[_Step] = [{"observation": env.reset(seed=seed)[0]}]
    over = False
    while not over and len(seen) <= most:
        observation, reward, terminated, truncated, _ = env.step(draw_action(space, rng))
        over = terminated or truncated
        ends = {"terminated": terminated, "truncated": truncated}
        seen.append({"observation": observation, "reward": reward, **ends})
    return seen


def _difference(first: list[_Step], again: list[_Step]) -> str:
    """The first thing that differs, in words; empty where nothing does."""
    for step, (one, other) in enumerate(zip(first, again, strict=False)):
        for what in one:
            before, now = (np.atleast_1d(np.asarray(each[what])) for each in (one, other))
            if (apart := np.flatnonzero(before != now)).size:
                k = int(apart[0])
                named = f"number {k} of the {what}" if before.size > 1 else f"the {what}"
                return f"{named} at step {step} was {before[k]!s:.9}, and is {now[k]!s:.9}"
    return ""
