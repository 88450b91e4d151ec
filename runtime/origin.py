"""The origin: where a policy came from, so that a file found in a year explains itself."""

from dataclasses import dataclass

from runtime.record import Record, Tree


@dataclass(frozen=True)
class Origin:
    """Who made an artifact, and how to make it again.

    env: id of the environment it was trained in.
    recipe: name of the training recipe.
    seed: of the training.
    steps: environment steps that it was trained for.
    created: UTC time of the export, ISO 8601.
    version: of spikedeploy that wrote the file.
    sha256: of network, codec and convention; `save` writes it and `load` checks it.
    """

    env: str
    recipe: str = ""
    seed: int = 0
    steps: int = 0
    created: str = ""
    version: str = ""
    sha256: str = ""

    def to_record(self) -> Tree:
        """What the file stores."""
        return {
            "env": self.env,
            "recipe": self.recipe,
            "seed": self.seed,
            "steps": self.steps,
            "created": self.created,
            "version": self.version,
            "sha256": self.sha256,
        }

    @classmethod
    def from_record(cls, record: Record) -> "Origin":
        """The origin that a file states."""
        record.only("env", "recipe", "seed", "steps", "created", "version", "sha256")
        return cls(
            env=record.text("env"),
            recipe=record.text("recipe"),
            seed=record.whole("seed"),
            steps=record.whole("steps"),
            created=record.text("created"),
            version=record.text("version"),
            sha256=record.text("sha256"),
        )
