"""Pages that say with which release they were made."""

import re


def without_version(page):
    """A page of results/, whichever release made it."""
    return re.sub(r"\bspikedeploy \d+\.\d+\.\d+", "spikedeploy", page)
