"""A row of an experiment that is kept until what made it changes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.files import as_text, read_json, write_text

Record = dict[str, Any]


@dataclass(frozen=True)
class StoredRow:
    """One row of an experiment, in a file of its own.

    file  where the result is
    of    what it must have been made with
    """

    file: Path
    of: Record

    @property
    def found(self) -> Record | None:
        """The result; None where it is missing or was made with something else."""
        if not self.file.is_file():
            return None
        made = read_json(self.file)
        return made.get("row") if made.get("of") == self.of else None

    def write(self, row: Record) -> None:
        """Write the result."""
        write_text(self.file, as_text({"of": self.of, "row": row}))
