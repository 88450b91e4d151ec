"""Recipe and settings of what `train` and `distill` are asked for, also in Python."""

import json
import shlex

from spikedeploy.runtime.errors import ConfigError

_CODINGS = {"population": "population", "rate": "regular"}
SPARSE = "distill-sparse"  # recipe


def own_network(network: str, chip: str | None) -> list[str]:
    """Settings that name a network of the user, and the chip in whose integers it is trained."""
    on = [] if chip is None else [f"policy.chip={json.dumps(chip)}"]
    return [f"policy.network={json.dumps(network)}", *on]


def chip_student(env: str, chip: str, given: list[str]) -> list[str]:
    """Settings that name the chip, and the shipped teacher of the environment unless one is."""
    settings = [f"policy.chip={json.dumps(chip)}"]
    if not any(each.replace(" ", "").startswith("teacher=") for each in given):
        from spikedeploy import envs, zoo
        from spikedeploy.envs.foreign import check_target, is_target

        envs.spec(env)  # refuses a name that none has, before it asks for a teacher
        if is_target(env):
            check_target(env)
        teacher = zoo.teacher(env)
        if teacher is None:
            raise ConfigError(
                f"no float teacher of {env} is shipped: give one with --set teacher=PATH, such as "
                f"the run of `spikedeploy train {env} --recipe ppo-mlp`, or imitate a Python "
                f"function of yours: `spikedeploy distill my_module:pilot --env {env} --for "
                f"{shlex.quote(chip)}`"
            )
        settings.append(f"teacher={json.dumps(teacher)}")
    return settings


def student(
    teacher: str | None,
    network: str | None = None,
    chip: str | None = None,
    size: str | None = None,
    encoder: str | None = None,
    timesteps: int | None = None,
    budget: str | None = None,
    dense: bool = False,
) -> tuple[str, list[str]]:
    """Recipe and overrides of a student; what is None stays the recipe's.

    network: module:Class or a .nir file of the user
    chip: chip in whose integers it is trained; None in float
    size: neurons of the hidden layers, "64,64"
    encoder: "population", "rate" or "delta"
    budget, dense: of a sparse student, and that it is none
    """
    own = {"--size": size, "--budget": budget, "--dense": dense or None}
    for name in own if network is not None else ():
        if own[name] is not None:
            raise ConfigError(f"{name} and --network: a network of yours is trained as it is")
    if budget is not None and (dense or chip is not None):
        other = "--dense" if dense else "--for"
        raise ConfigError(f"{other} and --budget: such students are not pruned")
    unpruned = dense or chip is not None or network is not None
    sparse = budget is not None or (not unpruned and encoder in (None, "delta"))
    if sparse and encoder not in (None, "delta"):
        raise ConfigError(
            f"--encoder {encoder}: a student with --budget sends events by the delta code; leave "
            "one of the two out"
        )
    if not sparse and encoder == "delta":
        raise ConfigError(
            "--encoder delta is of sparse students: leave --dense, --for and --network out"
        )
    settings = {
        "teacher": teacher,
        "policy.network": network,
        "policy.chip": chip,
        "policy.hidden": None if size is None else _hidden(size, sparse),
        "policy.coding": None if sparse or encoder is None else _CODINGS[encoder],
        "policy.timesteps": timesteps,
    }
    recipe = SPARSE if sparse else "distill-snn" if chip is None else "for-chip"
    overrides = [f"{k}={json.dumps(value)}" for k, value in settings.items() if value is not None]
    return recipe if network is None else "distill-network", overrides


def _hidden(size: str, sparse: bool) -> int | list[int]:
    """Return the neurons of hidden layers as a setting."""
    parts = size.split(",")
    if not all(part.strip().isascii() and part.strip().isdigit() for part in parts):
        raise ConfigError(f"--size {size}: neurons of the hidden layers, as in --size 64,64")
    if sparse and len(parts) > 1:
        raise ConfigError(
            f"--size {size}: a sparse student has one hidden layer, as in --size 32; --dense has "
            "several"
        )
    numbers = [int(part) for part in parts]
    return numbers[0] if sparse else numbers
