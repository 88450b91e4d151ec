"""A process that does one job: `python -m spikedeploy.experiments.worker`, the job on stdin.

stdin holds one line of JSON, {"call": "module:function", "arguments": {...}}, and stays open: when
it closes, because the experiment was interrupted or even killed, the process interrupts itself as
Ctrl-C would, and training ends with a checkpoint.
"""

import json
import os
import signal
import sys
import threading
from importlib import import_module

from spikedeploy.user_errors import one_line

INTERRUPTED = 130  # as a shell says of a program that Ctrl-C ended


def main() -> int:
    """Do the job; the exit status: 0 done, INTERRUPTED, else failed with a line on stderr."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's `&` makes it ignored
    job = json.loads(sys.stdin.readline())
    threading.Thread(target=_interrupt_at_the_end_of_stdin, daemon=True).start()
    module, _, function = job["call"].partition(":")
    try:
        done = getattr(import_module(module), function)(**job["arguments"])
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        line = one_line(error)
        if line is None:
            raise
        print(f"error: {line}", file=sys.stderr)
        return 1
    return INTERRUPTED if done is False else 0


def _interrupt_at_the_end_of_stdin() -> None:
    os.read(sys.stdin.fileno(), 1)  # returns when the other end closes, and never before
    main_thread = threading.main_thread().ident
    if main_thread is not None:  # only a signal to that thread wakes what it waits for
        signal.pthread_kill(main_thread, signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
