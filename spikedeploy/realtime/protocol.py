"""Requests to `serve` and its replies: one JSON object each, as docs/realtime.md lists them."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from spikedeploy.runtime.errors import SpikedeployError

VERSION = 1
REQUESTS = ("info", "reset", "act", "bye")
WANTED = ("spikes", "sops", "energy")
_FIELDS = {"do", "seed", "observation", "want"}
_LARGEST_SEED = 2**63
# bytes of a request besides its observation, and of each number in it
_ENVELOPE, _NUMBER = 4096, 32


class RequestError(SpikedeployError):
    """A request that is none, or that cannot be answered now."""


@dataclass(frozen=True)
class Request:
    """What a client asks for.

    do           one of REQUESTS
    seed         of the episode that `reset` begins
    observation  of `act`, as JSON has it
    want         of `act`: some of WANTED
    """

    do: str
    seed: int = 0
    observation: Any = None
    want: tuple[str, ...] = ()


def largest_request(observed: int) -> int:
    """Bytes that a request with so many observed numbers may have."""
    return _ENVELOPE + _NUMBER * observed


def parsed(body: bytes) -> Request:
    """The request in a message; RequestError where it is none."""
    fields = _object(body)
    if unknown := sorted(set(fields) - _FIELDS):
        raise RequestError(
            f"unknown field {unknown[0][:40]!r}; a request has {', '.join(sorted(_FIELDS))}"
        )
    do, seed, want = fields.get("do"), fields.get("seed", 0), fields.get("want", [])
    if do not in REQUESTS:
        raise RequestError(f"'do' is {str(do)[:40]!r}; it must be one of {', '.join(REQUESTS)}")
    if type(seed) is not int or not 0 <= seed < _LARGEST_SEED:
        raise RequestError("'seed' must be a whole number from 0 to 2^63 - 1")
    if not isinstance(want, list) or not all(each in WANTED for each in want):
        raise RequestError(f"'want' must be a list of some of {', '.join(WANTED)}")
    if do == "act" and not isinstance(fields.get("observation"), list):
        raise RequestError("'act' needs 'observation', a list of numbers")
    return Request(do, seed, fields.get("observation"), tuple(want))


def reply(answer: Mapping[str, Any]) -> bytes:
    """The message of an answer."""
    return json.dumps({"ok": True, **answer}, allow_nan=False).encode()


def refusal(sentence: str) -> bytes:
    """The message of an error."""
    return json.dumps({"ok": False, "error": " ".join(sentence.split())}).encode()


def finite(value: float) -> float | None:
    """The number; None, JSON's null, for infinity."""
    return value if math.isfinite(value) else None


def _object(body: bytes) -> dict[str, Any]:
    try:
        found = json.loads(body.decode())
    except (ValueError, RecursionError) as error:  # no UTF-8, no JSON, or one nested too deep
        raise RequestError(f"the request is no JSON: {str(error)[:80]}") from error
    if not isinstance(found, dict):
        raise RequestError(f"the request is a JSON {type(found).__name__}, and no object")
    return found
