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
    chip: in whose integers it is trained; None in float
    size: neurons of the hidden layers, "64,64"
    encoder: "population", "rate" or "delta"
    budget, dense: of a sparse student, and that it is none
    """
    if network is not None:
        return _own_student(teacher, network, chip, encoder, timesteps, size, budget, dense)
    sparse = _is_sparse(dense, chip, encoder, budget)
    return _student_settings(teacher, size, encoder, timesteps, sparse, chip)


def _student_settings(
    teacher: str | None,
    size: str | None,
    encoder: str | None,
    timesteps: int | None,
    sparse: bool,
    chip: str | None = None,
) -> tuple[str, list[str]]:
    """Return the recipe and the overrides of a student; what is None stays the recipe's.

    size: neurons of the hidden layers, "64,64"
    encoder: "population", "rate" or "delta"
    sparse: whether the student sends events and is pruned
    chip: in whose integers it is trained; None in float
    """
    settings = [] if teacher is None else [f"teacher={json.dumps(teacher)}"]
    steps = [] if timesteps is None else [f"policy.timesteps={timesteps}"]
    if size is not None:
        settings.append(f"policy.hidden={_hidden(size, sparse)}")
    if sparse:
        if encoder not in (None, "delta"):
            raise ConfigError(
                f"--encoder {encoder}: a student with --budget sends events by the delta code; "
                "leave one of the two out"
            )
        return SPARSE, [*settings, *steps]
    if encoder == "delta":
        raise ConfigError("--encoder delta is of sparse students: leave --dense and --for out")
    if encoder is not None:
        settings.append(f"policy.coding={_CODINGS[encoder]}")
    settings += steps
    if chip is not None:
        return "for-chip", [*settings, f"policy.chip={json.dumps(chip)}"]
    return "distill-snn", settings


def _own_student(
    teacher: str | None,
    network: str,
    chip: str | None,
    encoder: str | None,
    timesteps: int | None,
    size: str | None,
    budget: str | None,
    dense: bool,
) -> tuple[str, list[str]]:
    """Return the recipe and the overrides of a student that is a network of the user.

    network: module:Class, or a .nir file
    size, budget, dense: refused, as its own network has a size and is not pruned
    """
    for name, given in (("--size", size), ("--budget", budget), ("--dense", dense or None)):
        if given is not None:
            raise ConfigError(f"{name} and --network: a network of yours is trained as it is")
    if encoder == "delta":
        raise ConfigError("--encoder delta is of sparse students: leave --network out")
    settings = {
        "teacher": teacher,
        "policy.network": network,
        "policy.chip": chip,
        "policy.coding": encoder and _CODINGS[encoder],
        "policy.timesteps": timesteps,
    }
    found = [f"{k}={json.dumps(value)}" for k, value in settings.items() if value is not None]
    return "distill-network", found


def _is_sparse(dense: bool, chip: str | None, encoder: str | None, budget: str | None) -> bool:
    """Return whether a student sends events and is pruned: unless options say otherwise."""
    if budget is not None:
        if dense or chip is not None:
            other = "--dense" if dense else "--for"
            raise ConfigError(f"{other} and --budget: such students are not pruned")
        return True
    return not dense and chip is None and encoder in (None, "delta")


def _hidden(size: str, sparse: bool) -> str:
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
    return str(numbers[0] if sparse else numbers)
