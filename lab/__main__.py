"""`python -m lab NAME …`: run what makes the published tables."""

import sys
from importlib import import_module

# command -> its module, whose main() reads the command line and may return an exit code
COMMANDS = {"tables": "lab.tables"}


def main() -> int | None:
    """Run the command that is named; return its exit code."""
    words = sys.argv[1:]
    if not words or words[0] not in COMMANDS:
        print(f"usage: python -m lab {{{','.join(COMMANDS)}}} …", file=sys.stderr)
        return 2
    sys.argv = [f"python -m lab {words[0]}", *words[1:]]
    code: int | None = import_module(COMMANDS[words[0]]).main()
    return code


if __name__ == "__main__":
    sys.exit(main())
