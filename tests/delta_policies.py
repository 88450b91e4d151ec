"""Event-driven and pruned policies with random weights, and walks for them."""

import numpy as np
import torch

from spikedeploy.trainers.config import DeltaSnnConfig
from spikedeploy.trainers.policies import DeltaSnnPolicy, PrunedMlpPolicy


def with_config(**settings):
    """Arguments of an event-driven policy, those that are of its configuration in one."""
    own = {n: settings.pop(n) for n in DeltaSnnConfig.model_fields if n in settings}
    return {"settings": DeltaSnnConfig(**own), **settings}


def delta_policy(obs=5, act=2, hidden=8, seed=0, left=0.7, **settings):
    """An event-driven policy with random weights, of which a share is left."""
    torch.manual_seed(seed)
    policy = DeltaSnnPolicy(obs, act, **with_config(hidden=hidden, **settings))
    policy.normalizer.mean.normal_()
    policy.normalizer.std.uniform_(0.5, 2.0)
    policy.step.uniform_(0.2, 0.6)
    with torch.no_grad():
        policy.past.weight.normal_(0, 0.3)
        policy.action_bias.normal_(0, 0.2)
        policy._beta.normal_(0.4, 0.5)
        if hidden:
            policy._gamma.normal_(0, 0.5)
    return thinned(policy, left)


def pruned_mlp(obs=5, act=2, hidden=(6, 4), seed=0, left=0.7, **settings):
    """A small float policy with random weights, of which a share is left."""
    torch.manual_seed(seed)
    policy = PrunedMlpPolicy(obs, act, hidden, **settings)
    policy.normalizer.std.uniform_(0.5, 2.0)
    with torch.no_grad():
        policy.past.weight.normal_(0, 0.3)
        for bias in policy.biases:
            bias.normal_(0, 0.2)
    return thinned(policy, left)


def thinned(policy, left):
    """The policy with a random share of its synapses."""
    for name, mask in policy.named_buffers():
        if name.endswith("mask"):
            mask.copy_((torch.rand_like(mask) < left).float())
    return policy.requires_grad_(False)


def walk(steps=60, obs=5, seed=0):
    """Observations (S, obs) that drift, and return."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((steps, obs))
    for t in range(1, steps):
        rows[t] = 0.9 * rows[t - 1] + rng.normal(0, 0.5, obs)
    return rows


@torch.no_grad()
def followed(policy, observation):
    """Means (S, act), events (S T, obs) and hidden spikes (S T, H) of `advance` from rest."""
    state = policy.initial_states(1)
    seen = torch.from_numpy(observation).to(policy.action_bias.dtype)
    rows = [policy.advance(row[None], state) for row in seen]
    mean, *sent = (torch.cat(column) for column in zip(*rows, strict=True))
    return [mean.numpy(), *(each.flatten(0, 1).numpy() for each in sent)]


def arriving(policy, events):
    """What arrives (S, obs) in each timestep of events (S, obs), and what currents hold."""
    moved = torch.from_numpy(events) * policy.step
    if policy.delay:
        moved = torch.cat([torch.zeros_like(moved[:1]), moved[:-1]])
    seen = torch.zeros_like(moved)
    for t, now in enumerate(moved):
        seen[t] = policy.current_decay * seen[t - 1] + now
    return moved, seen
