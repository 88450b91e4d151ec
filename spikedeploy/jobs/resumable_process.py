"""A process for one job: `python -m spikedeploy.jobs.resumable_process`, the job on stdin.

stdin holds one line of JSON, {"call": "module:function", "arguments": {...}}, and stays open. When
it closes, because the experiment was interrupted or killed, the process interrupts itself as Ctrl-C
would, and training ends with a checkpoint.
"""

import json
import os
import signal
import sys
import threading
from importlib import import_module

from spikedeploy.user_errors import one_line

INTERRUPTED = 130  # a shell's exit status after Ctrl-C


def main() -> int:
    """Run the job; exit status 0 done, INTERRUPTED, or 1 after a line on stderr."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # with `&` a shell ignores it
    job = json.loads(sys.stdin.readline())
    threading.Thread(target=_interrupt_when_stdin_closes, daemon=True).start()
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


def _interrupt_when_stdin_closes() -> None:
    os.read(sys.stdin.fileno(), 1)  # returns only when the other end closes
    main_thread = threading.main_thread().ident
    if main_thread is not None:  # only a signal to the main thread interrupts a blocking call
        signal.pthread_kill(main_thread, signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
