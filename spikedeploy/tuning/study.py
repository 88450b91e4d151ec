"""Optuna's record of a study: a journal file that processes share, or a database of a cluster."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.tuning.plan import TuningPlan

if TYPE_CHECKING:
    import optuna

_PLAN = "plan"
_STARTS = 10  # trials at random before the search begins
_UNPRUNED = 5  # trials that run to their end before others are compared with them


def journal(folder: Path) -> str:
    """The storage of a folder, as --storage takes it."""
    return str(folder / "journal.log")


def opened(plan: TuningPlan, storage: str, number: int = 0) -> "optuna.Study":
    """The study of the plan, made where there is none.

    storage  path of a journal file, or URL of a database
    number   of the process, so that no two draw the same first settings
    """
    library = _imported()
    study: optuna.Study = library.create_study(
        storage=_storage(storage),
        study_name=plan.name,
        load_if_exists=True,
        sampler=_sampler(plan, number),
        pruner=library.pruners.MedianPruner(n_startup_trials=_UNPRUNED),
        directions=["maximize", "minimize"] if plan.two else ["maximize"],
    )
    asked = plan.as_json()
    made = study.user_attrs.get(_PLAN)
    if made is None:
        study.set_user_attr(_PLAN, asked)
    elif made != asked:
        _refuse(made, asked, storage)
    return study


def _imported() -> Any:  # noqa: ANN401 - the module
    try:
        import optuna
    except ImportError as error:
        raise ConfigError('tune needs Optuna: pip install "spikedeploy[tune]"') from error
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


def _storage(storage: str) -> Any:  # noqa: ANN401 - a class of Optuna's
    from optuna.exceptions import StorageInternalError
    from optuna.storages import JournalStorage, RDBStorage
    from optuna.storages.journal import JournalFileBackend

    if "://" not in storage:
        Path(storage).parent.mkdir(parents=True, exist_ok=True)
        try:
            return JournalStorage(JournalFileBackend(storage))
        except ValueError as error:  # a line that is no JSON
            raise ConfigError(
                f"{storage} is damaged, or no journal of a search ({error}): cut off the line that "
                "is torn, or name another --folder"
            ) from error
    from sqlalchemy.exc import SQLAlchemyError

    try:
        return RDBStorage(storage)
    except (SQLAlchemyError, StorageInternalError, ImportError, ValueError) as error:
        why = str(error).splitlines()[0]
        raise ConfigError(
            f"--storage {storage}: no database can be opened there ({why}). Give an SQLAlchemy "
            "URL, as postgresql://user@host/name, and install its driver; or leave --storage out."
        ) from error


def _sampler(plan: TuningPlan, number: int) -> Any:  # noqa: ANN401
    """TPE (Bergstra et al. 2011), which also serves two objectives, and budgets as constraints."""
    from optuna.samplers import TPESampler

    seed = 100_003 * plan.seed + number
    return TPESampler(seed=seed, n_startup_trials=_STARTS, constant_liar=True)


def _refuse(made: dict[str, Any], asked: dict[str, Any], storage: str) -> None:
    differ = [key for key in asked if made.get(key) != asked[key]]
    said = "; ".join(f"{key} was {made.get(key)!r}, is {asked[key]!r}" for key in differ)
    raise ConfigError(
        f"{storage} holds a study with another plan ({said}). Ask the same to go on, or name "
        "another --folder."
    )
